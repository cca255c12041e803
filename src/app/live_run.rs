//! One live run from configured cameras to the closed books: arming, trigger, watching, stopping.
//!
//! In: cameras and trigger behind their contracts, what to analyze and to record.
//! Out: [`RunReport`] and why the run ended. Never: leaves a camera armed or a trigger running.
//! Fails: [`AppError`] before the first exposure; after it, a run ends with a [`FinishReason`].

use super::AppError;
use super::data_path::{AnalysisPart, DataPath, DataPathSettings, RunReport};
use super::recorder::Recorder;
use crate::acquisition::Progress;
use sofiscope_hal::{Camera, CameraSettings, Channel, TriggerSource};
use std::thread;
use std::time::{Duration, Instant};

/// How often the run is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// A camera that is silent for longer than this and than five periods has stalled.
const LONGEST_SILENCE: Duration = Duration::from_millis(500);

/// Why a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum FinishReason {
    /// Every exposure asked for was made.
    Completed,
    /// Somebody asked for the end.
    Stopped(String),
    /// Something failed.
    Failed(String),
}

/// The devices of a run.
pub(super) struct Devices {
    pub(super) cameras: [Box<dyn Camera>; 2],
    pub(super) trigger: Option<Box<dyn TriggerSource>>,
}

/// What a run does.
pub(super) struct RunRequest<P> {
    pub(super) camera: CameraSettings,
    /// Exposures; until stopped if not given.
    pub(super) exposures: Option<u64>,
    pub(super) data_path: DataPathSettings,
    pub(super) analysis: Option<AnalysisPart<P>>,
    pub(super) recorder: Option<Recorder>,
    /// Whether cameras that fall silent have stalled; patient sources have not.
    pub(super) watch_silence: bool,
}

/// Runs to the end; `look` is called some fifty times a second and may ask for the end.
pub(super) fn run<P: Send + Sync + 'static>(
    devices: &mut Devices,
    request: RunRequest<P>,
    mut look: impl FnMut(&mut DataPath<P>) -> Option<String>,
) -> Result<(RunReport, FinishReason, Duration), AppError> {
    let RunRequest { camera: want, exposures, data_path: settings, analysis, recorder, watch_silence } =
        request;
    let device = |error: sofiscope_hal::DeviceError| AppError::Device(error.to_string());
    for camera in &mut devices.cameras {
        let got = camera.configure(&want).map_err(device)?;
        check_read_back(camera.as_ref(), &want, &got)?;
    }
    let streams = arm(devices)?;
    let mut path = DataPath::start(&settings, streams, analysis, recorder).inspect_err(|_| quiet(devices))?;
    let begun = Instant::now();
    if let Some(trigger) = &mut devices.trigger
        && let Err(error) = trigger.start(want.period, exposures)
    {
        path.stop();
        quiet(devices);
        path.join();
        return Err(device(error));
    }
    let silence = (!watch_silence).then_some(Duration::MAX).unwrap_or(LONGEST_SILENCE.max(5 * want.period));
    let reason = loop {
        if path.cameras_are_done() {
            break FinishReason::Completed;
        }
        if let Some(reason) = look(&mut path) {
            break FinishReason::Stopped(reason);
        }
        if path.recorder_is_done() {
            break FinishReason::Failed("the recording ended".to_owned());
        }
        if let Some(reason) = stalled(&path, silence) {
            break FinishReason::Failed(reason);
        }
        thread::park_timeout(LOOK_EVERY);
    };
    quiet(devices);
    if reason != FinishReason::Completed {
        path.stop();
    }
    look(&mut path);
    let report = path.join();
    let reason = match report.camera_failures.first() {
        Some((_, error)) => FinishReason::Failed(error.to_string()),
        None => reason,
    };
    Ok((report, reason, begun.elapsed()))
}

/// Trigger first, so that no camera sees a pulse that the other does not.
fn quiet(devices: &mut Devices) {
    if let Some(trigger) = &mut devices.trigger
        && let Err(error) = trigger.stop()
    {
        tracing::error!(%error, "the trigger could not be stopped");
    }
    for camera in &mut devices.cameras {
        if let Err(error) = camera.stop() {
            tracing::error!(%error, "a camera could not be stopped");
        }
    }
}

fn arm(devices: &mut Devices) -> Result<[Box<dyn sofiscope_hal::FrameStream>; 2], AppError> {
    let [reflected, transmitted] = &mut devices.cameras;
    let streams = reflected.arm().and_then(|r| transmitted.arm().map(|t| [r, t]));
    streams.map_err(|error| {
        quiet(devices);
        AppError::Device(error.to_string())
    })
}

fn check_read_back(camera: &dyn Camera, want: &CameraSettings, got: &CameraSettings) -> Result<(), AppError> {
    if want.region == got.region && want.trigger == got.trigger && want.period == got.period {
        return Ok(());
    }
    Err(AppError::Device(format!(
        "{} {}: asked for {want:?}, it does {got:?}; ask for what it can do",
        camera.identity().model,
        camera.identity().serial
    )))
}

fn stalled<P: Send + Sync + 'static>(path: &DataPath<P>, limit: Duration) -> Option<String> {
    let silence = path.silence();
    let silent = Channel::BOTH.into_iter().find(|channel| silence[channel.index()] > limit)?;
    let (silence, frames) = (silence[silent.index()], path.frames()[silent.index()]);
    Some(format!(
        "no frame from {silent} for {} ms after {frames} frames; check its cable, its trigger and its power",
        silence.as_millis()
    ))
}

/// One line about a run under way.
pub(super) fn progress_line(progress: &Progress, elapsed: Duration) -> String {
    let lost: u64 = progress.lost.values().sum();
    format!(
        "{} pairs, {:.0} per second, {lost} frames lost, {} pairs not analyzed, {} frames not recorded",
        progress.pairs,
        progress.pairs as f64 / elapsed.as_secs_f64().max(1e-3),
        progress.analysis_left_out,
        progress.unrecorded
    )
}
