//! The data path of one run: starts its threads, watches them, joins them.
//!
//! ```text
//! grab-r ─┐                  ┌─► record ─► disk
//!         ├─► pair ──────────┼─► look ─► latest frames, where somebody looks
//! grab-t ─┘                  └─► analyze ─► preview ─► latest picture
//! ```
//!
//! In: armed frame streams and what to do with pairs. Out: [`RunReport`] with the books closed.
//! Never: lets one consumer hold up another. Fails: [`AppError`] when threads or memory are not to be had.

use super::AppError;
use super::recorder::{Recorder, RecorderStatus};
use crate::acquisition::{
    Dispatch, DispatchReport, ExposureRecord, FramePair, FramePool, Grabbed, Grabber, GrabberEnd,
    GrabberStatus, HostClock, LeaveOut, Pairing, PairingSettings, Patience, PressureGauge, Progress,
    Surroundings, Tap,
};
use crate::pipeline::{
    Bell, Publisher, Received, Receiver, Sender, Stage, Viewer, WhenFull, bounded, latest, spawn,
};
use crate::reconstruction::{
    LiveAnalysis, LiveReport, PreviewReport, PreviewSettings, Quality, QualityMonitor, QualitySettings,
    Shown, Snapshot, preview,
};
use crate::recording::Recording;
use crate::sofi::cumulant::{CumulantEngine, PushError};
use sofiscope_hal::{Channel, DeviceError, FrameStream, HostTime};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Memory for frames of both cameras, unless a camera's frames are so large that they need more.
const POOL_BYTES: usize = 3 << 30;

/// Fewest and most frames of a camera that memory is taken for.
const POOL_FRAMES: std::ops::RangeInclusive<usize> = 160..=4096;

/// Places for losses in the queues from the cameras, beside those for frames.
const LOSS_PLACES: usize = 4096;

/// Exposures by which a frame may come later than its successor.
const REORDER: u64 = 16;

/// How a data path works.
#[derive(Debug, Clone)]
pub(super) struct DataPathSettings {
    /// Pixels of a frame.
    pub(super) pixels: usize,
    /// Time from exposure to exposure.
    pub(super) period: Duration,
    /// Whether the sources wait.
    pub(super) patience: Patience,
    /// Pairs that the analysis is not to have.
    pub(super) leave_out: LeaveOut,
    /// What surrounds the frames.
    pub(super) surroundings: Surroundings,
    /// Frames of each camera that memory is taken for; the default follows from their size.
    pub(super) pool_frames: Option<usize>,
}

/// Somebody looks at the cameras themselves.
pub(super) struct LookPart {
    /// Shortest time between two looks.
    pub(super) every: Duration,
    /// Gets a pair now and then; it is free again when this returns.
    pub(super) look: Box<dyn FnMut(&FramePair) + Send>,
}

impl DataPathSettings {
    /// Frames of each camera that there is memory for.
    pub(super) fn frames(&self) -> usize {
        let by_memory = POOL_BYTES / (2 * self.pixels * size_of::<u16>()).max(1);
        let frames = by_memory.clamp(*POOL_FRAMES.start(), *POOL_FRAMES.end());
        self.pool_frames.unwrap_or(frames)
    }

    /// Bytes of the frame pools.
    pub(super) fn pool_bytes(&self) -> u64 {
        (self.frames() * 2 * self.pixels * size_of::<u16>()) as u64
    }
}

/// The analysis of a run and what makes pictures of it.
pub(super) struct AnalysisPart<P> {
    pub(super) engine: CumulantEngine<u16>,
    pub(super) trace_every: u64,
    /// How good the image is while frames come in; none where nobody asks.
    pub(super) quality: Option<QualitySettings>,
    pub(super) preview: Option<PreviewPart<P>>,
}

/// Makes pictures of snapshots.
pub(super) struct PreviewPart<P> {
    pub(super) every: Duration,
    pub(super) fine_pixels: usize,
    pub(super) compose: Box<dyn FnMut(&Snapshot) -> P + Send>,
}

type PreviewStage = Stage<PreviewReport>;
type AnalysisStage = Stage<Result<LiveReport, PushError>>;

/// A run under way.
pub(super) struct DataPath<P: Send + Sync> {
    grabbers: Vec<Stage<GrabberEnd>>,
    status: [Arc<GrabberStatus>; 2],
    dispatch: Stage<DispatchReport>,
    analysis: Option<AnalysisStage>,
    preview: Option<PreviewStage>,
    recorder: Option<Stage<Recording>>,
    look: Option<Stage<()>>,
    recorder_status: RecorderStatus,
    stop: Arc<AtomicBool>,
    progress: Viewer<Progress>,
    pictures: Viewer<Shown<P>>,
    quality: Viewer<Option<Quality>>,
    clock: HostClock,
    /// When the first exposure could begin.
    begin: HostTime,
}

/// What can fail while frames come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum PathFailure {
    /// The disk.
    Recording(String),
    /// One camera has ended and the other has not.
    OneCamera,
}

/// How a run ended.
#[derive(Debug)]
pub(super) struct RunReport<P> {
    /// The last picture of the preview.
    pub(super) picture: Option<Arc<P>>,
    /// The books.
    pub(super) dispatch: DispatchReport,
    /// The analysis, unless there was none or it failed.
    pub(super) analysis: Option<LiveReport>,
    /// The preview.
    pub(super) preview: PreviewReport,
    /// The recording, still open for its stop record.
    pub(super) recording: Option<Recording>,
    /// Cameras that failed.
    pub(super) camera_failures: Vec<(Channel, DeviceError)>,
    /// Threads that failed.
    pub(super) defects: Vec<String>,
    /// From the begin to the last frame, seconds.
    pub(super) seconds: f64,
}

impl<P: Send + Sync + 'static> DataPath<P> {
    /// Takes the memory and starts the threads.
    pub(super) fn start(
        settings: &DataPathSettings,
        streams: [Box<dyn FrameStream>; 2],
        analysis: Option<AnalysisPart<P>>,
        recorder: Option<Recorder>,
        look: Option<LookPart>,
    ) -> Result<Self, AppError> {
        let clock = HostClock::start();
        let stop = Arc::new(AtomicBool::new(false));
        let gauge = PressureGauge::default();
        let frames = settings.frames();
        let bell = Bell::default();
        let (mut grabbers, mut status, mut from_grabbers) = (Vec::new(), Vec::new(), Vec::new());
        for (channel, stream) in Channel::BOTH.into_iter().zip(streams) {
            let pool =
                FramePool::new(frames, settings.pixels).map_err(|error| no_memory(settings, &error))?;
            let (grabber, queue) = grabber(settings, channel, stream, pool, &bell, clock, &stop);
            status.push(Arc::clone(&grabber.status));
            from_grabbers.push(queue);
            grabbers.push(grabber);
        }
        let from_grabbers: [Receiver<Grabbed>; 2] = pair(from_grabbers);
        let when_full = match settings.patience {
            Patience::Live => WhenFull::Refuse,
            Patience::Patient => WhenFull::Wait,
        };
        let (judge, quality) = latest(None);
        let (to_analysis, analysis, preview, pictures) =
            analysis_stages(analysis, frames, when_full, &gauge, clock, judge)?;
        let recorder_status = recorder.as_ref().map(|recorder| recorder.status.clone()).unwrap_or_default();
        let (to_recording, recorder) = recorder_stage(recorder, frames, when_full)?;
        let (to_look, look) = look_stage(look)?;
        let (publisher, progress) = latest(Progress::default());
        let lead = (settings.patience == Patience::Live).then_some((frames / 4) as u64);
        let pairing =
            Pairing::new(PairingSettings { period: settings.period, reorder: REORDER, lead }, 2 * frames);
        let dispatch = Dispatch {
            from_grabbers,
            bell,
            pairing,
            to_analysis,
            to_recording,
            to_look,
            leave_out: settings.leave_out.clone(),
            gauge,
            progress: publisher,
            stop: Arc::clone(&stop),
        };
        let dispatch = spawn("pair", move || dispatch.run()).map_err(no_thread)?;
        let grabbers = grabbers
            .into_iter()
            .zip(["grab-r", "grab-t"])
            .map(|(grabber, name)| spawn(name, move || grabber.run()).map_err(no_thread))
            .collect::<Result<_, _>>()?;
        let status = pair(status);
        let begin = clock.now();
        Ok(Self {
            grabbers,
            status,
            dispatch,
            analysis,
            preview,
            recorder,
            look,
            recorder_status,
            stop,
            progress,
            pictures,
            quality,
            clock,
            begin,
        })
    }

    /// What is shown now.
    pub(super) fn progress(&mut self) -> Progress {
        self.progress.look().clone()
    }

    /// From the last frame of the newest picture to the picture.
    pub(super) fn latency(&mut self) -> Duration {
        self.pictures.look().latency
    }

    /// How good the image is by now, once a subsequence has closed.
    pub(super) fn quality(&mut self) -> Option<&Quality> {
        self.quality.look().as_ref()
    }

    /// Whether both cameras have said all they had to say and every exposure is resolved.
    pub(super) fn cameras_are_done(&self) -> bool {
        self.grabbers.iter().all(Stage::is_finished) && self.dispatch.is_finished()
    }

    /// Whether everything that came is worked on.
    pub(super) fn is_finished(&self) -> bool {
        self.cameras_are_done()
            && self.analysis.as_ref().is_none_or(Stage::is_finished)
            && self.preview.as_ref().is_none_or(Stage::is_finished)
            && self.recorder.as_ref().is_none_or(Stage::is_finished)
            && self.look.as_ref().is_none_or(Stage::is_finished)
    }

    /// What has failed so far.
    pub(super) fn failure(&self) -> Option<PathFailure> {
        if let Some(message) = self.recorder_status.failure() {
            return Some(PathFailure::Recording(message.to_owned()));
        }
        let ended = self.grabbers.iter().filter(|grabber| grabber.is_finished()).count();
        // A camera that ends while the other goes on has failed; its error is told when the run is joined.
        (ended == 1).then_some(PathFailure::OneCamera)
    }

    /// Time since the last frame of each camera; before the first, since the threads were there.
    pub(super) fn silence(&self) -> [Duration; 2] {
        let now = self.clock.now();
        self.status
            .each_ref()
            .map(|status| now.since(self.begin.max(HostTime(status.last_frame_ns.load(Ordering::Relaxed)))))
    }

    /// Whether the camera that still goes on has had this much time to end as well.
    pub(super) fn outlasted(&self, time: Duration) -> bool {
        self.silence().into_iter().max().unwrap_or_default() > time
    }

    /// Frames that came from each camera, usable or not.
    pub(super) fn frames(&self) -> [u64; 2] {
        self.status.each_ref().map(|status| status.frames.load(Ordering::Relaxed))
    }

    /// Ends the grabbing; everything that came is still worked on.
    pub(super) fn stop(&self) {
        self.stop.store(true, Ordering::Release);
    }

    /// Waits until everything that came is worked on.
    pub(super) fn join(mut self) -> RunReport<P> {
        let (mut camera_failures, mut defects) = (Vec::new(), Vec::new());
        let newest = self.status.iter().map(|status| status.last_frame_ns.load(Ordering::Relaxed)).max();
        let seconds = HostTime(newest.unwrap_or_default()).since(self.begin).as_secs_f64();
        for (channel, grabber) in Channel::BOTH.into_iter().zip(self.grabbers) {
            match grabber.join() {
                Ok(GrabberEnd::Failed(error)) => camera_failures.push((channel, error)),
                Ok(_) => {}
                Err(panic) => defects.push(panic.to_string()),
            }
        }
        let mut note = |text: String| defects.push(text);
        let dispatch = self.dispatch.join().unwrap_or_else(|panic| {
            note(panic.to_string());
            DispatchReport::default()
        });
        let analysis = self.analysis.and_then(|stage| match stage.join() {
            Ok(Ok(report)) => Some(report),
            Ok(Err(error)) => {
                note(error.to_string());
                None
            }
            Err(panic) => {
                note(panic.to_string());
                None
            }
        });
        let preview = self.preview.map_or_else(PreviewReport::default, |stage| {
            stage.join().unwrap_or_else(|panic| {
                note(panic.to_string());
                PreviewReport::default()
            })
        });
        if let Some(Err(panic)) = self.look.map(Stage::join) {
            note(panic.to_string());
        }
        let picture = self.pictures.look().picture.clone();
        let recording = self.recorder.and_then(|stage| stage.join().map_err(|p| note(p.to_string())).ok());
        RunReport { picture, dispatch, analysis, preview, recording, camera_failures, defects, seconds }
    }
}

fn grabber(
    settings: &DataPathSettings,
    channel: Channel,
    stream: Box<dyn FrameStream>,
    pool: FramePool,
    bell: &Bell,
    clock: HostClock,
    stop: &Arc<AtomicBool>,
) -> (Grabber, Receiver<Grabbed>) {
    let frames = settings.frames();
    let name = match channel {
        Channel::Reflected => "grab-r→pair",
        Channel::Transmitted => "grab-t→pair",
    };
    let (to_pairing, queue) = bounded(name, frames + LOSS_PLACES, WhenFull::Refuse, bell);
    let grabber = Grabber {
        channel,
        stream,
        pool,
        pixels: settings.pixels,
        to_pairing,
        patience: settings.patience,
        clock,
        surroundings: settings.surroundings.clone(),
        stop: Arc::clone(stop),
        status: Arc::default(),
    };
    (grabber, queue)
}

type AnalysisParts<P> =
    (Option<Sender<FramePair>>, Option<AnalysisStage>, Option<PreviewStage>, Viewer<Shown<P>>);

fn analysis_stages<P: Send + Sync + 'static>(
    analysis: Option<AnalysisPart<P>>,
    frames: usize,
    when_full: WhenFull,
    gauge: &PressureGauge,
    clock: HostClock,
    judge: Publisher<Option<Quality>>,
) -> Result<AnalysisParts<P>, AppError> {
    let (publisher, pictures) = latest(Shown::default());
    let Some(AnalysisPart { engine, trace_every, quality, preview: part }) = analysis else {
        return Ok((None, None, None, pictures));
    };
    let (sender, pairs) = bounded("pair→analyze", (frames * 3 / 8).max(1), when_full, &Bell::default());
    let (mut link, mut stage) = (None, None);
    if let Some(PreviewPart { every, fine_pixels, compose }) = part {
        let settings = PreviewSettings { every, fine_pixels, gauge: gauge.clone(), clock };
        let (its_link, work) = preview(&settings, compose, publisher);
        let threads = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .thread_name(|_| "preview-math".to_owned())
            .start_handler(|_| yield_to_others())
            .build()
            .map_err(|error| AppError::Device(format!("no thread for the preview: {error}")))?;
        stage = Some(spawn("preview", move || threads.install(|| work.run())).map_err(no_thread)?);
        link = Some(its_link);
    }
    let quality = quality.map(QualityMonitor::new).transpose().map_err(AppError::usage)?;
    let quality = quality.map(|monitor| monitor.publishing(judge));
    let analysis = LiveAnalysis { engine, pairs, trace_every, preview: link, quality, clock };
    let analysis = spawn("analyze", move || analysis.run()).map_err(no_thread)?;
    Ok((Some(sender), Some(analysis), stage, pictures))
}

/// The thread that calls this runs when nobody more important wants to; where that is refused, it runs as others.
fn yield_to_others() {
    be_nice(10);
}

/// The thread that calls this, and those that it starts, run after others that are less nice; nice values are from 0
/// to 19.
pub(super) fn be_nice(nice: i32) {
    let this_thread = rustix::thread::gettid();
    if let Err(errno) = rustix::process::setpriority_process(Some(this_thread), nice) {
        tracing::debug!(%errno, "a thread runs with the priority of the others");
    }
}

type RecorderParts = (Option<Sender<ExposureRecord>>, Option<Stage<Recording>>);

fn recorder_stage(
    recorder: Option<Recorder>,
    frames: usize,
    when_full: WhenFull,
) -> Result<RecorderParts, AppError> {
    let Some(recorder) = recorder else { return Ok((None, None)) };
    let (sender, records) = bounded("pair→record", (frames / 2).max(1), when_full, &Bell::default());
    let stage = spawn("record", move || recorder.run(records)).map_err(no_thread)?;
    Ok((Some(sender), Some(stage)))
}

type LookParts = (Option<Tap>, Option<Stage<()>>);

fn look_stage(part: Option<LookPart>) -> Result<LookParts, AppError> {
    let Some(LookPart { every, mut look }) = part else { return Ok((None, None)) };
    let (to_look, mut pairs) = bounded("pair→look", 1, WhenFull::Refuse, &Bell::default());
    let work = move || {
        yield_to_others();
        loop {
            match pairs.receive(Duration::from_secs(1)) {
                Received::Value(pair) => look(&pair),
                Received::Empty => {}
                Received::Closed => return,
            }
        }
    };
    let stage = spawn("look", work).map_err(no_thread)?;
    Ok((Some(Tap { to_look, every, last: None }), Some(stage)))
}

fn no_memory(settings: &DataPathSettings, error: &std::io::Error) -> AppError {
    let mebibytes = settings.pool_bytes() >> 20;
    AppError::Device(format!(
        "{mebibytes} MiB of memory for frames are not to be had ({error}); close other programs or choose a smaller region"
    ))
}

fn pair<T>(both: Vec<T>) -> [T; 2] {
    match <[T; 2]>::try_from(both) {
        Ok(pair) => pair,
        Err(other) => unreachable!("two cameras gave {} parts", other.len()),
    }
}

#[expect(clippy::needless_pass_by_value, reason = "it is handed to map_err")]
fn no_thread(error: std::io::Error) -> AppError {
    AppError::Device(format!("no thread could be started ({error}); close other programs and try again"))
}
