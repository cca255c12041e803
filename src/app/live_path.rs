//! The data path as the sequencer sees it: opened for a series, watched, drained, closed.
//!
//! In: armed cameras and what is to be kept of a series. Out: the books, the analysis and the recording of each series.
//! Never: decides when a run ends. Fails: [`DataPathError`] in the words of what failed.

use super::analysis::{Prepared, TRACE_POINTS};
use super::data_path::{
    AnalysisPart, DataPath, DataPathSettings, LookPart, PathFailure, PreviewPart, RunReport,
};
use super::preview_picture::{PreviewPicture, compose, compose_and_look};
use super::recorder::{Recorder, RecorderStatus};
use super::window::board::{Onlooker, PathNumbers};
use crate::acquisition::{
    Conditions, FocusGauge, FramePair, LeaveOut, Light, Patience, Progress, Surroundings,
};
use crate::control::contracts::{self, ArmedCamera, DataPathError, Drain, PathProgress, StopRecord};
use crate::control::plan::{AcquisitionEvent, RecordingFormat};
use crate::control::run_state::FinishReason;
use crate::reconstruction::{CameraLook, PixelMap, QualitySettings};
use crate::recording::{
    self, CameraDescription, Format, Recording, RecordingPlan, RecordingSummary, StopStatus,
};
use crate::sofi::cumulant::CumulantEngine;
use sofiscope_hal::{CameraIdentity, CameraSettings, Channel, Nanometers};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// A camera that is silent for longer than this and than five periods, while the other is not, has stalled.
const LONGEST_SILENCE: Duration = Duration::from_millis(500);

/// Frames of more pixels than this are judged by a larger part of them.
const LARGE_FRAME: usize = 1 << 20;

/// What every series of a run has in common.
#[derive(Debug, Clone)]
pub(super) struct PathOptions {
    /// The analysis; none where frames are only recorded.
    pub(super) analysis: Option<Prepared>,
    /// Shortest time between two pictures; none for no preview.
    pub(super) preview_every: Option<Duration>,
    /// Whether the cameras wait for memory.
    pub(super) patience: Patience,
    /// Pairs that the analysis is not to have.
    pub(super) leave_out: LeaveOut,
    /// What the focus lock says of every frame.
    pub(super) focus: FocusGauge,
    /// Where recordings go; the number of the series is added from the second on.
    pub(super) recording: Option<PathBuf>,
    /// The cameras, R and T.
    pub(super) identities: [CameraIdentity; 2],
    /// Side of a camera pixel in the sample, nanometers.
    pub(super) pixel_pitch_nm: Option<f64>,
    /// Files to keep beside the frames.
    pub(super) provenance: Vec<(String, String)>,
    /// Frames of each camera that memory is taken for; the default follows from their size.
    pub(super) pool_frames: Option<usize>,
    /// The window, if there is one.
    pub(super) onlooker: Option<Onlooker>,
}

/// What one series left.
#[derive(Debug)]
pub(super) struct SeriesResult {
    /// Books, analysis, preview.
    pub(super) report: RunReport<PreviewPicture>,
    /// The recording, closed.
    pub(super) recording: Option<RecordingSummary>,
}

/// The data path of a run.
pub(super) struct LivePath {
    options: PathOptions,
    series: Option<Series>,
    /// What the series left, in their order.
    pub(super) results: Vec<SeriesResult>,
}

/// The series under way.
struct Series {
    wanted: Option<u64>,
    settings: CameraSettings,
    running: Option<DataPath<PreviewPicture>>,
    report: Option<RunReport<PreviewPicture>>,
    closed: Option<RecordingSummary>,
    last: Progress,
    seen: [Seen; 2],
    told_failure: bool,
}

/// Frames of a camera and of the other one when its last frame was seen.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    own: u64,
    other: u64,
}

impl LivePath {
    /// A path that waits for its first series.
    pub(super) fn new(options: PathOptions) -> Self {
        Self { options, series: None, results: Vec::new() }
    }

    fn analysis_part(
        &self,
        settings: &CameraSettings,
        wanted: Option<u64>,
    ) -> Result<Option<AnalysisPart<PreviewPicture>>, DataPathError> {
        let Some(prepared) = &self.options.analysis else { return Ok(None) };
        let (height, width) = (settings.region.height as usize, settings.region.width as usize);
        let engine = CumulantEngine::new(prepared.engine.clone(), height, width);
        let engine = engine.map_err(|error| DataPathError::Device(error.to_string()))?;
        let preview = self.options.preview_every.map(|every| {
            let painter = prepared.clone();
            let board = self.options.onlooker.as_ref().map(|onlooker| Arc::clone(&onlooker.board));
            PreviewPart {
                every,
                fine_pixels: height * width * prepared.grid.order().pow(2),
                compose: Box::new(move |snapshot| match &board {
                    None => compose(&painter, snapshot),
                    Some(board) => {
                        let (picture, look) = compose_and_look(&painter, snapshot);
                        board.sofi.store(Some(Arc::new(look)));
                        picture
                    }
                }),
            }
        });
        let trace_every = wanted.map_or(1, |exposures| exposures.div_ceil(TRACE_POINTS));
        let quality = QualitySettings {
            central_side: if height * width > LARGE_FRAME { 256 } else { 128 },
            matrix: prepared.matrix.clone(),
            pixel_pitch_nm: Some(prepared.pixel_pitch_nm),
            period: Some(settings.period),
            ..QualitySettings::new(prepared.engine.clone(), height, width)
        };
        Ok(Some(AnalysisPart { engine, trace_every, quality: Some(quality), preview }))
    }

    fn look_part(&self, settings: &CameraSettings) -> Option<LookPart> {
        let Onlooker { board, every, saturation_counts } = self.options.onlooker.clone()?;
        let width = settings.region.width as usize;
        let pitch_nm = self.options.pixel_pitch_nm.unwrap_or(1.0);
        let registration = self.options.analysis.as_ref().and_then(|prepared| prepared.engine.registration);
        let map = registration.and_then(|registration| PixelMap::undoing(&registration.transform));
        let look = move |pair: &FramePair| {
            let look = CameraLook::of(pair, width, pitch_nm, saturation_counts).registered(map);
            board.cameras.store(Some(Arc::new(look)));
        };
        Some(LookPart { every, look: Box::new(look) })
    }

    /// Place and light as the plan has them, which the sequencer has set or ended the series; focus as it comes.
    fn surroundings(&self, event: &AcquisitionEvent) -> Result<Surroundings, DataPathError> {
        let place = event.position.as_ref();
        let lines = event.laser_power_mw.iter().map(|(&line, &power_mw)| (line, power_mw));
        let light = Light::of(lines).ok_or_else(|| {
            let most = Light::MOST_LINES;
            DataPathError::Device(format!(
                "the plan lights more than {most} laser lines at once; remove some"
            ))
        })?;
        let series = Conditions {
            focus_nm: None,
            x_um: place.and_then(|place| place.x_um),
            y_um: place.and_then(|place| place.y_um),
            light,
        };
        Ok(Surroundings::of_series(self.options.focus.clone(), series))
    }

    fn recorder(
        &self,
        event: &AcquisitionEvent,
        cameras: &[ArmedCamera],
        conditions: Conditions,
    ) -> Result<Option<Recorder>, DataPathError> {
        let format = match event.duties.recording {
            RecordingFormat::OmeTiff => Format::OmeTiff,
            RecordingFormat::OmeZarr => Format::OmeZarr,
            RecordingFormat::None => return Ok(None),
        };
        let Some(directory) = &self.options.recording else { return Ok(None) };
        let directory = match event.series {
            0 => directory.clone(),
            series => directory.with_file_name(format!(
                "{}-{}",
                directory.file_name().unwrap_or_default().to_string_lossy(),
                series + 1
            )),
        };
        let describe = |channel: Channel| CameraDescription {
            identity: self.options.identities[channel.index()].clone(),
            settings: cameras[channel.index()].settings,
            pixel_size_nm: self.options.pixel_pitch_nm,
        };
        let plan = RecordingPlan {
            directory,
            format,
            cameras: Channel::BOTH.map(describe),
            planned_exposures: event.exposures,
            simulated: self.options.identities.iter().any(|identity| identity.simulated),
            conditions,
            provenance: self.options.provenance.clone(),
        };
        let recording = Recording::create(&plan).map_err(|error| recording_error(&error))?;
        let maps = self.options.analysis.iter().flat_map(|prepared| prepared.camera_maps.iter().enumerate());
        for (camera, used) in maps.filter_map(|(camera, used)| Some((camera, used.as_ref()?))) {
            used.keep(camera, &plan.directory)
                .map_err(|error| DataPathError::Recording(error.to_string()))?;
        }
        Ok(Some(Recorder { recording, status: RecorderStatus::default() }))
    }
}

impl contracts::DataPath for LivePath {
    fn arm(&mut self, event: &AcquisitionEvent, cameras: Vec<ArmedCamera>) -> Result<(), DataPathError> {
        let settings = cameras.first().map(|camera| camera.settings).ok_or_else(no_pair)?;
        let surroundings = self.surroundings(event)?;
        let analysis = self.analysis_part(&settings, event.exposures)?;
        let recorder = self.recorder(event, &cameras, surroundings.series())?;
        let streams: Vec<_> = cameras.into_iter().map(|camera| camera.stream).collect();
        let streams = streams.try_into().map_err(|_| no_pair())?;
        let path = DataPathSettings {
            pixels: settings.region.num_pixels(),
            period: settings.period,
            patience: self.options.patience,
            leave_out: LeaveOut {
                focus_gate_nm: event.duties.focus_gate.map(Nanometers::value),
                ..self.options.leave_out.clone()
            },
            surroundings,
            pool_frames: self.options.pool_frames,
        };
        let look = self.look_part(&settings);
        let running = DataPath::start(&path, streams, analysis, recorder, look)
            .map_err(|error| DataPathError::Device(error.to_string()))?;
        self.series = Some(Series {
            wanted: event.exposures,
            settings,
            running: Some(running),
            report: None,
            closed: None,
            last: Progress::default(),
            seen: [Seen::default(); 2],
            told_failure: false,
        });
        Ok(())
    }

    fn progress(&mut self) -> PathProgress {
        let patience = self.options.patience;
        let Some(series) = &mut self.series else { return PathProgress::default() };
        if let Some(running) = &mut series.running {
            series.last = running.progress();
            if let Some(Onlooker { board, .. }) = &self.options.onlooker {
                board.numbers.store(Arc::new(numbers(running, &series.last, &board.numbers.load())));
            }
        }
        let (mut snr, mut resolution_nm) = (Vec::new(), None);
        if let Some(quality) = series.running.as_mut().and_then(DataPath::quality) {
            // The stop rule asks for every species, so it hears of none as long as one is not known.
            snr = quality.snr_species.iter().copied().collect::<Option<Vec<f64>>>().unwrap_or_default();
            resolution_nm = worst(quality.resolution.iter().map(|resolution| resolution.nm));
        }
        let mut exposures = series.last.exposures;
        let mut failure = None;
        if let Some(running) = &series.running {
            if running.cameras_are_done() {
                // Nothing more will come: exposures at the very end that no camera delivered are settled as well.
                exposures = exposures.max(series.wanted.unwrap_or(exposures));
            }
            let frames = running.frames();
            for (seen, [own, other]) in series.seen.iter_mut().zip([frames, [frames[1], frames[0]]]) {
                if seen.own != own {
                    *seen = Seen { own, other };
                }
            }
            let since = [frames[1] - series.seen[0].other, frames[0] - series.seen[1].other];
            failure = failure_of(running, since, series.settings.period, patience);
        }
        let failure = failure.filter(|_| !series.told_failure);
        series.told_failure |= failure.is_some();
        let record_drops = series.last.unrecorded;
        PathProgress { exposures, record_drops, snr, resolution_nm, failure }
    }

    fn drain(&mut self) -> Result<Drain, DataPathError> {
        let Some(series) = &mut self.series else { return Ok(Drain::Done) };
        let Some(running) = series.running.take_if(|running| running.is_finished()) else {
            return Ok(if series.running.is_some() { Drain::UnderWay } else { Drain::Done });
        };
        let report = running.join();
        let failure = report.camera_failures.first().map(|(_, error)| error.to_string());
        let defect = report.defects.first().cloned();
        series.report = Some(report);
        match failure.or(defect) {
            Some(message) => Err(DataPathError::Device(message)),
            None => Ok(Drain::Done),
        }
    }

    fn abandon(&mut self) {
        if let Some(Series { running: Some(running), .. }) = &self.series {
            running.stop();
        }
    }

    fn close(&mut self) -> Result<(), DataPathError> {
        // The threads end by themselves once the cameras have; the stop record closes the files.
        let Some(series) = &mut self.series else { return Ok(()) };
        if let Some(running) = series.running.take() {
            running.stop();
            series.report = Some(running.join());
        }
        Ok(())
    }

    fn write_stop_record(&mut self, record: &StopRecord) -> Result<(), DataPathError> {
        let Some(mut series) = self.series.take() else { return Ok(()) };
        let Some(mut report) = series.report.take() else { return Ok(()) };
        let mut outcome = Ok(());
        if let Some(recording) = report.recording.take() {
            match recording.finish(stop_of(record)) {
                Ok(summary) => series.closed = Some(summary),
                Err(error) => outcome = Err(recording_error(&error)),
            }
        }
        self.results.push(SeriesResult { report, recording: series.closed });
        outcome
    }
}

/// The numbers of the moment; the quality stays the same one until a subsequence has closed.
fn numbers(running: &mut DataPath<PreviewPicture>, progress: &Progress, before: &PathNumbers) -> PathNumbers {
    let frames = running.frames();
    let latency = running.latency();
    let quality = running.quality().map(|quality| match &before.quality {
        Some(known) if **known == *quality => Arc::clone(known),
        _ => Arc::new(quality.clone()),
    });
    PathNumbers { progress: progress.clone(), frames, latency, quality }
}

/// What has failed; `since` are the frames that the other camera has delivered since the last one of R and of T.
fn failure_of(
    running: &DataPath<PreviewPicture>,
    since: [u64; 2],
    period: Duration,
    patience: Patience,
) -> Option<DataPathError> {
    match running.failure() {
        Some(PathFailure::Recording(message)) => return Some(DataPathError::Recording(message)),
        // Patient sources may end at different moments, as each is read at its own pace.
        Some(PathFailure::OneCamera) if patience == Patience::Live => {
            let silent = silent_camera(running);
            let message = format!("{silent} ended while the other camera goes on");
            return running
                .outlasted(LONGEST_SILENCE.max(5 * period))
                .then_some(DataPathError::Device(message));
        }
        Some(PathFailure::OneCamera) | None => {}
    }
    if patience == Patience::Patient {
        return None;
    }
    let limit = LONGEST_SILENCE.max(5 * period);
    let (silence, frames) = (running.silence(), running.frames());
    // A pause silences both cameras, and one of them is the first to be heard again.
    let enough = ((limit.as_secs_f64() / period.as_secs_f64().max(1e-6)) as u64 / 2).max(3);
    let stalled = Channel::BOTH.into_iter().find(|channel| {
        let (own, other) = (silence[channel.index()], silence[channel.other().index()]);
        own > limit && other < limit && since[channel.index()] >= enough
    })?;
    Some(DataPathError::Device(format!(
        "no frame from {stalled} for {} ms after {} frames, while the other camera delivers; \
         check its cable, its trigger and its power",
        silence[stalled.index()].as_millis(),
        frames[stalled.index()]
    )))
}

/// The largest of some values, if all of them are known.
fn worst(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    values.collect::<Option<Vec<f64>>>()?.into_iter().reduce(f64::max)
}

fn silent_camera(running: &DataPath<PreviewPicture>) -> Channel {
    let silence = running.silence();
    if silence[0] >= silence[1] { Channel::Reflected } else { Channel::Transmitted }
}

fn stop_of(record: &StopRecord) -> recording::StopRecord {
    let status = match &record.reason {
        FinishReason::Completed | FinishReason::StopRule(_) => StopStatus::Success,
        FinishReason::Stopped | FinishReason::Aborted => StopStatus::Abort,
        FinishReason::Failed(_) | FinishReason::Tripped(_) => StopStatus::Fail,
    };
    let mut reason = reason_text(&record.reason);
    for failure in &record.failures {
        if !reason.contains(failure.as_str()) {
            reason = format!("{reason}; {failure}");
        }
    }
    recording::StopRecord { status, reason }
}

/// Why a series ended, for people.
pub(super) fn reason_text(reason: &FinishReason) -> String {
    match reason {
        FinishReason::Completed => "all exposures were made".to_owned(),
        FinishReason::StopRule(rule) => rule.to_string(),
        FinishReason::Stopped => "stopped".to_owned(),
        FinishReason::Aborted => "aborted".to_owned(),
        FinishReason::Failed(message) => message.clone(),
        FinishReason::Tripped(message) => format!("safety trip: {message}"),
    }
}

fn recording_error(error: &recording::RecordingError) -> DataPathError {
    DataPathError::Recording(error.to_string())
}

fn no_pair() -> DataPathError {
    DataPathError::Device(
        "the instrument has not two cameras; add the other one to the instrument file".to_owned(),
    )
}
