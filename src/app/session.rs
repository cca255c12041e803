//! One session with the instrument: the sequencer at work, Ctrl-C heard, progress shown, results written.
//!
//! In: devices, a data path's options, the steps of a plan. Out: stop records, results and what scripts are told.
//! Never: writes results over others. Fails: [`AppError`] of the kind of what failed.

use super::AppError;
use super::analysis::{Analysis, Prepared};
use super::live_path::{LivePath, PathOptions, SeriesResult, reason_text};
use super::progress::Progress;
use super::results::{COMPOSITE_SIDE, Scores, Summary, ensure_space, write_results};
use crate::acquisition::{HostClock, Loss};
use crate::control::contracts::{Clock, StopRecord};
use crate::control::plan::AcquisitionEvent;
use crate::control::run_state::FinishReason;
use crate::control::sequencer::{Begin, Command, Devices, Patience, Sequencer, Status};
use crate::display::PngNotes;
use crate::files::OutputDirectory;
use crate::reconstruction::{CameraDrift, Quality};
use serde::Serialize;
use sofiscope_hal::{HostTime, StopMotion};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

/// Commands that may wait for the sequencer.
pub(super) const COMMANDS: usize = 16;

impl Clock for HostClock {
    fn now(&self) -> HostTime {
        HostClock::now(self)
    }
}

/// What a session left.
#[derive(Debug)]
pub(super) struct Acquired {
    pub(super) records: Vec<StopRecord>,
    pub(super) results: Vec<SeriesResult>,
}

/// What scripts are told at the end of `demo`, `run` and `replay`.
#[derive(Debug, Serialize)]
pub(super) struct Ended {
    pub(super) frames_received: u64,
    pub(super) frames_recorded: u64,
    /// By reason.
    pub(super) frames_lost: BTreeMap<String, u64>,
    pub(super) pairs: u64,
    pub(super) pairs_analyzed: u64,
    pub(super) simulated: bool,
    /// Why the run ended, for people.
    pub(super) ended: String,
    /// How good the image is, as the run knew it at its end.
    pub(super) quality: Option<Quality>,
    pub(super) recording: Option<PathBuf>,
    pub(super) results: Option<PathBuf>,
}

/// Carries out the steps, showing progress on stderr.
///
/// # Errors
/// [`AppError::Device`] when Ctrl-C cannot be heard.
pub(super) fn acquire(
    devices: Devices,
    options: PathOptions,
    events: Vec<AcquisitionEvent>,
) -> Result<Acquired, AppError> {
    let (sender, commands) = crossbeam_channel::bounded(COMMANDS);
    let _listening = listen_for_interrupts(sender)?;
    let (mut shown, mut bar) = (0, None);
    let total = events.iter().filter_map(|event| event.exposures).sum();
    let mut observer = |status: &Status<'_>| {
        let bar = bar.get_or_insert_with(|| Progress::begin("exposures", total));
        let frames = status.progress.frames;
        bar.advance(frames.saturating_sub(shown));
        shown = shown.max(frames);
    };
    let (acquired, _) = carry_out(devices, options, events, commands, &mut observer);
    if let Some(bar) = bar {
        bar.finish();
    }
    Ok(acquired)
}

/// Carries out the steps with commands from anywhere; gives the devices back.
pub(super) fn carry_out(
    devices: Devices,
    options: PathOptions,
    events: Vec<AcquisitionEvent>,
    commands: crossbeam_channel::Receiver<Command>,
    observer: &mut dyn FnMut(&Status<'_>),
) -> (Acquired, Devices) {
    let mut path = LivePath::new(options);
    let clock = HostClock::start();
    let mut records = Vec::new();
    let mut sequencer = Sequencer {
        devices,
        path: &mut path,
        commands,
        clock: &clock,
        observer,
        begin: Begin::AtOnce,
        patience: Patience::default(),
    };
    for event in events {
        let record = sequencer.run_event(event);
        let is_success = record.reason.is_success();
        records.push(record);
        if !is_success {
            break;
        }
    }
    let Sequencer { devices, .. } = sequencer;
    (Acquired { records, results: path.results }, devices)
}

/// The place to which Ctrl-C is told; one for the whole program, as there is one keyboard.
static INTERRUPTS: OnceLock<Mutex<Option<crossbeam_channel::Sender<Command>>>> = OnceLock::new();

/// While this is held, Ctrl-C is a command to the sequencer; afterwards it ends the program again.
struct Listening;

fn listen_for_interrupts(sender: crossbeam_channel::Sender<Command>) -> Result<Listening, AppError> {
    let slot = INTERRUPTS.get_or_init(Default::default);
    let is_first = {
        let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
        slot.replace(sender).is_none()
    };
    static HANDLER: OnceLock<Result<(), String>> = OnceLock::new();
    let handler = HANDLER.get_or_init(|| ctrlc::set_handler(interrupted).map_err(|error| error.to_string()));
    debug_assert!(is_first, "one session at a time");
    match handler {
        Ok(()) => Ok(Listening),
        Err(error) => Err(AppError::Device(format!("Ctrl-C cannot be heard: {error}"))),
    }
}

/// What stops motion past every queue; the stage of the open instrument, if it has one.
static STOPPERS: Mutex<Vec<Arc<dyn StopMotion>>> = Mutex::new(Vec::new());

/// From now on Ctrl-C stops this too, before anything else.
pub(super) fn stop_with_interrupts(stopper: Arc<dyn StopMotion>) {
    STOPPERS.lock().unwrap_or_else(PoisonError::into_inner).push(stopper);
}

fn interrupted() {
    for stopper in STOPPERS.lock().unwrap_or_else(PoisonError::into_inner).iter() {
        if let Err(error) = stopper.stop_motion() {
            eprintln!("STOP could not be sent: {error}");
        }
    }
    let slot = INTERRUPTS.get_or_init(Default::default);
    let listener = slot.lock().unwrap_or_else(PoisonError::into_inner).clone();
    match listener {
        Some(sender) => {
            // A full queue holds a stop already.
            let _ = sender.try_send(Command::Interrupt);
        }
        // 128 + SIGINT, as shells expect of a program that nobody asked to stay.
        None => end_program(),
    }
}

#[expect(clippy::exit, reason = "Ctrl-C with nothing under way ends the program, as without a handler")]
fn end_program() {
    std::process::exit(130);
}

impl Drop for Listening {
    fn drop(&mut self) {
        if let Some(slot) = INTERRUPTS.get() {
            *slot.lock().unwrap_or_else(PoisonError::into_inner) = None;
        }
    }
}

impl Ended {
    /// The books in one line.
    pub(super) fn line(&self) -> String {
        let lost: u64 = self.frames_lost.values().sum();
        let words = |name: &str| Loss::named(name).map_or(name.to_owned(), |loss| loss.in_words().to_owned());
        let reasons: Vec<String> =
            self.frames_lost.iter().map(|(why, n)| format!("{n} {}", words(why))).collect();
        let why = if lost > 0 { format!(" ({})", reasons.join(", ")) } else { String::new() };
        let recording = self.recording.as_ref().map(|path| format!(", recording {}", path.display()));
        format!(
            "{} frames received, {} recorded, {lost} lost{why}; {} pairs, {} analyzed{}",
            self.frames_received,
            self.frames_recorded,
            self.pairs,
            self.pairs_analyzed,
            recording.unwrap_or_default()
        )
    }
}

impl Acquired {
    /// The first series that did not end as planned, as an error of the program.
    pub(super) fn failure(&self) -> Option<AppError> {
        self.records.iter().find_map(|record| match &record.reason {
            FinishReason::Failed(_) => Some(AppError::Device(reason_text(&record.reason))),
            FinishReason::Tripped(_) => Some(AppError::Safety(reason_text(&record.reason))),
            _ => None,
        })
    }

    /// What scripts are told; results are filled in by whoever writes them.
    pub(super) fn ended(&self, simulated: bool) -> Ended {
        let mut ended = Ended {
            frames_received: 0,
            frames_recorded: 0,
            frames_lost: BTreeMap::new(),
            pairs: 0,
            pairs_analyzed: 0,
            simulated,
            ended: self.records.last().map(|record| reason_text(&record.reason)).unwrap_or_default(),
            quality: None,
            recording: None,
            results: None,
        };
        for result in &self.results {
            let accounts = &result.report.dispatch.accounts;
            ended.frames_received += accounts.cameras.iter().map(|camera| camera.received).sum::<u64>();
            ended.pairs += accounts.pairs;
            ended.pairs_analyzed += accounts.pairs_analyzed;
            for (reason, frames) in accounts.lost_by_reason() {
                *ended.frames_lost.entry(reason.name().to_owned()).or_default() += frames;
            }
            let live = result.report.analysis.as_ref();
            ended.quality = live.and_then(|live| live.quality.last().cloned()).or(ended.quality);
            if let Some(recording) = &result.recording {
                ended.frames_recorded += recording.recorded.iter().sum::<u64>();
                ended.recording.get_or_insert_with(|| recording.directory.clone());
            }
        }
        ended
    }
}

/// The images of a series' live analysis.
///
/// # Errors
/// [`AppError::Data`] when there is too little to make an image of.
pub(super) fn analysis_of(result: &mut SeriesResult, prepared: Prepared) -> Result<Analysis, AppError> {
    let live = result.report.analysis.take().ok_or_else(|| {
        AppError::Data(format!("the live analysis failed: {}", result.report.defects.join("; ")))
    })?;
    let mut prepared = prepared;
    prepared.warnings.extend(loss_warnings(result));
    if live
        .quality
        .last()
        .and_then(|quality| quality.lag.as_ref())
        .is_some_and(|lag| lag.in_step == Some(false))
    {
        prepared.warnings.push(
            "The light of both cameras agrees best some exposures apart: they do not see the same exposures. \
             Check trigger and cabling; species images of this run must not be trusted."
                .to_owned(),
        );
    }
    if let Some(drift) = live.quality.last().and_then(|quality| quality.drift).filter(CameraDrift::is_too_far)
    {
        prepared.warnings.push(drift_warning(&drift, prepared.registration.is_some()));
    }
    let took = Duration::from_secs_f64(result.report.seconds);
    let mut analysis = prepared.finish(&live.engine, live.feed, took)?;
    analysis.quality = live.quality.last().cloned();
    Ok(analysis)
}

/// What the reader of a report must know about cameras that lie elsewhere.
fn drift_warning(drift: &CameraDrift, is_registered: bool) -> String {
    let far = format!("{:.2} px", drift.distance_px());
    let about = if is_registered {
        format!("The cameras lie {far} from where their registration says")
    } else {
        format!("What both cameras see lies {far} apart, and no registration is used")
    };
    format!(
        "{about}: species images of this run leak into each other. Calibrate with `sofiscope calibrate registration` \
         and analyze again with its file."
    )
}

/// What the reader of a report must know about lost frames.
fn loss_warnings(result: &SeriesResult) -> Vec<String> {
    let accounts = &result.report.dispatch.accounts;
    let mut warnings = Vec::new();
    for (reason, frames) in accounts.lost_by_reason() {
        warnings.push(format!("{frames} frames were lost: {} ({reason}).", reason.in_words()));
    }
    for (reason, pairs) in &accounts.analysis_left_out {
        let words = reason.in_words();
        warnings.push(format!("{pairs} pairs were not analyzed while frames came: {words} ({reason})."));
    }
    if let Err(law) = accounts.balance() {
        warnings.push(format!("The books do not balance, which is a defect of the program: {law}."));
    }
    warnings
}

/// Writes the last picture of the preview, as the operator saw it, into the directory of the run.
///
/// # Errors
/// [`AppError`] when the disk says no.
pub(super) fn write_preview(result: &SeriesResult, directory: &Path) -> Result<(), AppError> {
    let Some(picture) = &result.report.picture else { return Ok(()) };
    match &picture.image {
        Ok(image) => {
            let (mut image, factor) = image.fitted(COMPOSITE_SIDE).map_err(AppError::data)?;
            let pitch_nm = picture.pixel_pitch_nm / factor;
            image.draw_scale_bar(pitch_nm);
            let notes = PngNotes {
                title: Some(format!("preview: {}", picture.label)),
                pixel_pitch_nm: Some(pitch_nm),
            };
            image.write_png(&directory.join("preview.png"), &notes).map_err(AppError::data)
        }
        Err(reason) => {
            tracing::warn!(%reason, "the last preview has no picture");
            Ok(())
        }
    }
}

/// Writes the results of an analysis into a directory that must not exist yet.
///
/// # Errors
/// [`AppError`] when the disk says no.
pub(super) fn write(
    analysis: &Analysis,
    directory: &Path,
    scores: Option<Scores>,
) -> Result<(PathBuf, Summary), AppError> {
    let out = OutputDirectory::create(directory)?;
    ensure_space(&analysis.prepared, &out)?;
    let command = std::env::args().collect::<Vec<_>>().join(" ");
    let summary = write_results(analysis, &out, &command, scores)?;
    Ok((out.commit()?, summary))
}
