//! The session behind the window: one thread that opens instruments and carries out what is asked, one thing
//! after another.
//!
//! In: [`Asked`] commands. Out: newest values in [`Shared`]. Never: draws, begins what was asked before a STOP.
//! Fails: not at all; what cannot be done is an event that says why and what to do.

mod properties;
mod replay;

pub(super) use replay::{UnderWay, speed_of};

use super::board::Onlooker;
use super::card;
use super::coloring::{Measured, UnderLive, dyes_in_use};
use super::numbers::{Counter, RunOutline};
use super::registering::{Used, in_words};
use super::shared::Shared;
use crate::app::AppError;
use crate::app::analysis::{Prepared, Source};
use crate::app::analysis_note::AnalysisNote;
use crate::app::instrument::{About, MOST_BYTES, OpenInstrument, Sample};
use crate::app::live_path::{PathOptions, SeriesResult, reason_text};
use crate::app::run::{Kept, keep, path_options};
use crate::app::session::{Acquired, analysis_of, carry_out, write};
use crate::app::simulated;
use crate::app::text_file::read_text;
use crate::config::{AnalysisSettings, Instrument, RawAnalysis};
use crate::control::plan::{AcquisitionEvent, FocusWish, Plan, Readback, RecordingFormat};
use crate::control::preflight::Facts;
use crate::control::run_state::RunPhase;
use crate::control::sequencer::{Command, Devices, Status};
use crate::files::free_bytes;
use crate::viewer::bench::{Activity, BenchCommand, DyeInUse, Gravity, LiveSettings, RunNumbers};
use arc_swap::ArcSwapOption;
use crossbeam_channel::Receiver;
use sofiscope_hal::Region;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Shortest time between two looks at the cameras.
const LOOK_EVERY: Duration = Duration::from_millis(45);
/// Shortest time between two looks at the disk.
const DISK_EVERY: Duration = Duration::from_secs(1);

/// A command, and how often STOP had been pressed when it was given.
#[derive(Debug)]
pub(super) struct Asked {
    pub(super) command: BenchCommand,
    pub(super) stops: u64,
}

/// The open instrument without its devices.
pub(super) struct Known {
    pub(super) instrument: Instrument,
    /// Its file.
    text: String,
    about: About,
    /// The registration that the next live view and run go by, where it is not the instrument's own.
    pub(super) registered: ArcSwapOption<Used>,
    /// The instrument's own, for people.
    own_registration: Option<String>,
    /// Shares of the dyes' light that the next live view and run go by, where they are not the instrument's own.
    pub(super) measured: ArcSwapOption<Measured>,
    /// The instrument's own.
    own_dyes: Arc<Vec<DyeInUse>>,
}

impl Known {
    /// Serial numbers of cameras R and T.
    pub(super) fn serials(&self) -> [Option<String>; 2] {
        self.about.facts.identities.each_ref().map(|identity| Some(identity.serial.clone()))
    }

    /// What the next live view and run go by, for people.
    pub(super) fn registration_in_words(&self) -> Option<String> {
        let used = self.registered.load_full().map(|used| used.words.clone());
        used.or_else(|| self.own_registration.clone())
    }

    /// The text of measured shares that the instrument's file names.
    pub(super) fn own_response(&self) -> Option<String> {
        self.about.source_of(None, Duration::ZERO, None).calibrations.response
    }

    /// The shares of the dyes' light that the next live view and run go by.
    pub(super) fn dyes(&self) -> Arc<Vec<DyeInUse>> {
        self.measured.load_full().map_or_else(|| Arc::clone(&self.own_dyes), |used| Arc::clone(&used.dyes))
    }

    /// The source with the registration and the shares that are used.
    fn with_calibrations(&self, mut source: Source) -> Source {
        let registration = self.registered.load_full().map(|used| used.text.clone());
        source.registration = registration.or(source.registration);
        match self.measured.load_full() {
            Some(measured) => measured.applied(source),
            None => source,
        }
    }
}

/// The thread's own.
pub(super) struct Session {
    shared: Arc<Shared>,
    asked: Receiver<Asked>,
    to_run: Receiver<Command>,
    /// The devices of the open instrument, unless they are at work.
    devices: Option<Devices>,
    /// The last live view, to be written when somebody wants to keep it.
    last_live: Option<(SeriesResult, Prepared)>,
}

impl Session {
    pub(super) fn new(shared: Arc<Shared>, asked: Receiver<Asked>, to_run: Receiver<Command>) -> Self {
        Self { shared, asked, to_run, devices: None, last_live: None }
    }

    /// Works until the window is gone.
    pub(super) fn run(mut self) {
        while let Ok(asked) = self.asked.recv() {
            if asked.stops != self.shared.stops.load(Ordering::SeqCst) {
                self.shared.tell(Gravity::Warning, "what was asked before STOP was not begun");
                continue;
            }
            let done = self.carry_out(asked.command);
            if let Err(error) = done {
                self.shared.tell(Gravity::Error, error.to_string());
            }
            let rest = if self.devices.is_some() { Activity::Idle } else { Activity::Closed };
            self.shared.activity.store(Arc::new(rest));
        }
    }

    fn carry_out(&mut self, command: BenchCommand) -> Result<(), AppError> {
        match command {
            BenchCommand::OpenSimulated => self.open(
                Instrument::simulated_toml().to_owned(),
                Path::new("the built-in simulated instrument"),
            ),
            BenchCommand::OpenInstrument(path) => self.open(read_text(&path, MOST_BYTES)?, &path),
            BenchCommand::CloseInstrument => {
                self.close();
                Ok(())
            }
            BenchCommand::Live(settings) => self.live(&settings),
            BenchCommand::Run { plan, out } => self.plan(&plan, &out),
            BenchCommand::Replay { recording, speed, from } => self.replay(&recording, speed, from),
            BenchCommand::SaveResults(directory) => self.save(&directory),
            BenchCommand::SetProperty { device, property, value } => {
                self.set_property(&device, &property, &value)
            }
            // Those are for whatever is under way, and nothing is.
            BenchCommand::Pause
            | BenchCommand::Resume
            | BenchCommand::ReplaySpeed(_)
            | BenchCommand::Seek(_)
            | BenchCommand::Focus(_)
            | BenchCommand::Registration(_)
            | BenchCommand::Colors(_)
            | BenchCommand::Finish
            | BenchCommand::MoveStage { .. } => Ok(()),
        }
    }

    fn close(&mut self) {
        self.shared.card.store(None);
        self.shared.stage.store(None);
        self.shared.lights.store(None);
        self.shared.lasers.store(Arc::default());
        self.shared.watch_focus(None, None);
        self.devices = None;
        self.shared.registrar.leave();
        self.shared.colorist.leave();
        if let Some(known) = self.shared.known.swap(None) {
            self.shared.tell(Gravity::Note, format!("{} is closed", known.instrument.name()));
        }
    }

    fn open(&mut self, text: String, path: &Path) -> Result<(), AppError> {
        self.close();
        self.shared.activity.store(Arc::new(Activity::Opening));
        let instrument = Instrument::from_toml(&text)
            .map_err(|faults| AppError::Usage(format!("{}: {faults}", path.display())))?;
        let OpenInstrument { mut devices, about } =
            OpenInstrument::open(&instrument, &text, path, Sample::Again)?;
        let mut card = card::card(&instrument, &about);
        for warning in properties::read_all(&mut devices, &mut card) {
            self.shared.tell(Gravity::Warning, warning);
        }
        let label =
            card.label.as_ref().map_or(String::new(), |label| format!(" ({label}: no hardware is involved)"));
        self.shared.tell(Gravity::Note, format!("{} is open{label}", card.name));
        for warning in &card.warnings {
            self.shared.tell(Gravity::Warning, warning.clone());
        }
        let gauge = card.has_focus.then(|| about.facts.focus.clone());
        self.shared.watch_focus(gauge, about.focus.clone());
        self.shared.lasers.store(Arc::new(card::told_lasers(&instrument, &BTreeMap::new())));
        self.shared.stage.store(about.stage.clone().map(Arc::new));
        self.shared.lights.store(about.lights.clone().map(Arc::new));
        self.shared.card.store(Some(Arc::new(card)));
        self.watch_lights(&instrument);
        let own = about.source_of(None, Duration::ZERO, None);
        let own_dyes = Arc::new(dyes_in_use(&own, instrument.dichroic()));
        let own_registration = own.registration.map(|text| in_words(&text));
        let (registered, measured) = (ArcSwapOption::empty(), ArcSwapOption::empty());
        let known = Known { instrument, text, about, registered, own_registration, measured, own_dyes };
        self.shared.known.store(Some(Arc::new(known)));
        self.devices = Some(devices);
        Ok(())
    }

    /// Lasers and gates are asked once a second, as long as this instrument is open.
    fn watch_lights(&self, instrument: &Instrument) {
        let (Some(lights), instrument) = (self.shared.lights.load_full(), instrument.clone()) else { return };
        let (shared, lights) = (Arc::downgrade(&self.shared), Arc::downgrade(&lights));
        let work = move || {
            while let (Some(shared), Some(lights)) = (shared.upgrade(), lights.upgrade()) {
                match lights.state() {
                    Ok(state) => shared.lasers.store(Arc::new(card::read_lasers(&instrument, &state))),
                    Err(error) => tracing::warn!("{error}"),
                }
                drop((shared, lights));
                // Nothing will ever come: this is a pause between two questions.
                let _ = crossbeam_channel::after(Duration::from_secs(1)).recv();
            }
        };
        if let Err(error) = crate::pipeline::spawn("watch-lights", work) {
            self.shared.tell(Gravity::Error, format!("no thread to watch the lasers: {error}"));
        }
    }

    fn live(&mut self, settings: &LiveSettings) -> Result<(), AppError> {
        let known = self.known()?;
        let prepared = prepare_live(&known, settings)?;
        let event = live_event(settings);
        let options = path_options(&prepared, &known.about.facts, known.about.patience);
        let outline = RunOutline { series: 1, period: settings.exposure, ..RunOutline::default() };
        self.shared.colorist.watch(UnderLive { settings: settings.clone(), prepared: prepared.clone() });
        let mut acquired = self.take(&known.instrument, options, vec![event], outline, &Activity::Live)?;
        if let Some(result) = acquired.results.pop() {
            self.last_live = Some((result, prepared));
        }
        acquired.failure().map_or(Ok(()), Err)
    }

    fn plan(&mut self, text: &str, out: &Path) -> Result<(), AppError> {
        let known = self.known()?;
        let (plan, prepared, _) = judge(&known, text, out)?;
        let outline = RunOutline {
            planned: plan.exposures_per_series(),
            series: plan.events().count(),
            period: plan.cameras().period,
            recording: (plan.recording() != RecordingFormat::None).then(|| out.to_owned()),
            bytes_per_exposure: 4 * (prepared.source.height * prepared.source.width) as u64,
        };
        let provenance = vec![
            ("plan.yaml".to_owned(), text.to_owned()),
            ("instrument.toml".to_owned(), known.text.clone()),
            AnalysisNote::of(plan.analysis(), &prepared).file()?,
        ];
        let options = PathOptions {
            recording: Some(out.to_owned()),
            provenance,
            ..path_options(&prepared, &known.about.facts, known.about.patience)
        };
        if plan.recording() == RecordingFormat::None {
            let failed = |error| AppError::Usage(format!("{}: {error}", out.display()));
            std::fs::create_dir(out).map_err(failed)?;
        }
        let events = plan.events().collect();
        let mut acquired = self.take(&known.instrument, options, events, outline, &Activity::Run)?;
        let Kept { ended, summaries, failure } = keep(&mut acquired, &prepared, out)?;
        self.shared.tell(Gravity::Note, format!("{}; {}", ended.line(), ended.ended));
        if !summaries.is_empty() || ended.recording.is_some() {
            self.shared.kept(out);
        }
        failure.map_or(Ok(()), Err)
    }

    fn known(&self) -> Result<Arc<Known>, AppError> {
        self.shared.known.load_full().ok_or_else(nothing_open)
    }

    /// Carries out events with the devices of the open instrument, which are there again afterwards.
    fn take(
        &mut self,
        instrument: &Instrument,
        options: PathOptions,
        events: Vec<AcquisitionEvent>,
        outline: RunOutline,
        activity: &Activity,
    ) -> Result<Acquired, AppError> {
        let devices = self.devices.take().ok_or_else(nothing_open)?;
        let is_simulated = self.shared.card.load().as_ref().is_some_and(|card| card.label.is_some());
        self.shared.is_simulated.store(is_simulated, Ordering::SeqCst);
        let has_no_guard = self.shared.lights.load().is_none();
        let tell = |lit: &BTreeMap<u32, f64>| {
            if has_no_guard {
                self.shared.lasers.store(Arc::new(card::told_lasers(instrument, lit)));
            }
        };
        tell(&events.first().map(|event| event.laser_power_mw.clone()).unwrap_or_default());
        let (acquired, devices) = self.run_with(devices, options, events, outline, activity);
        tell(&BTreeMap::new());
        self.devices = Some(devices);
        Ok(acquired)
    }

    fn run_with(
        &self,
        devices: Devices,
        options: PathOptions,
        events: Vec<AcquisitionEvent>,
        outline: RunOutline,
        activity: &Activity,
    ) -> (Acquired, Devices) {
        // Whatever was meant for an earlier run is not meant for this one.
        self.to_run.try_iter().for_each(drop);
        let shared = Arc::clone(&self.shared);
        // What is under way is told first: a window without pictures and without activity shows its first screen.
        shared.activity.store(Arc::new(activity.clone()));
        shared.board.clear();
        shared.quality.store(Arc::default());
        shared.run.store(Arc::new(RunNumbers::default()));
        // A replay does not know when its cameras were saturated but at the end of their range.
        let known = shared.known.load_full().filter(|_| *activity != Activity::Replay);
        let saturation_counts = known.map_or([u16::MAX; 2], |known| known.about.facts.saturation_counts);
        let onlooker = Onlooker { board: Arc::clone(&shared.board), every: LOOK_EVERY, saturation_counts };
        let options = PathOptions { onlooker: Some(onlooker), ..options };
        let place = outline.recording.clone();
        let (mut counter, begun) = (Counter::new(outline), Instant::now());
        let mut disk = Disk { place, free: None, at: None };
        let mut observer = |status: &Status<'_>| {
            let numbers = shared.board.numbers.load();
            if let Some(quality) = &numbers.quality
                && shared.quality.load().last() != Some(quality.as_ref())
            {
                let mut history = shared.quality.load().as_ref().clone();
                history.push(quality.as_ref().clone());
                shared.quality.store(Arc::new(history));
            }
            let free = disk.free(begun.elapsed());
            shared.run.store(Arc::new(counter.numbers(status, &numbers, begun.elapsed(), free)));
            let now = match (status.phase, activity) {
                (RunPhase::Draining(_) | RunPhase::Closing(_), _) => Activity::Ending,
                // A replay that is held stays a replay; its own status says that it is held.
                (RunPhase::Paused, Activity::Run) => Activity::Paused,
                (_, activity) => activity.clone(),
            };
            if **shared.activity.load() != now {
                shared.activity.store(Arc::new(now));
            }
        };
        let commands = self.to_run.clone();
        let (acquired, devices) = carry_out(devices, options, events, commands, &mut observer);
        for record in &acquired.records {
            let gravity = if record.reason.is_success() { Gravity::Note } else { Gravity::Warning };
            let ended = reason_text(&record.reason);
            let mut numbers = shared.run.load().as_ref().clone();
            numbers.ended.clone_from(&ended);
            shared.run.store(Arc::new(numbers));
            shared.tell(gravity, format!("{} exposures; {ended}", record.exposures));
        }
        (acquired, devices)
    }

    fn save(&mut self, directory: &Path) -> Result<(), AppError> {
        let saved = match self.last_live.take() {
            Some((mut result, prepared)) => match analysis_of(&mut result, prepared) {
                Ok(analysis) => write(&analysis, directory, None)?.0,
                Err(error) => {
                    self.shared.tell(Gravity::Warning, format!("{error}; what is shown is saved instead"));
                    self.shared.write_shown(directory)?
                }
            },
            None => self.shared.write_shown(directory)?,
        };
        self.shared.kept(&saved);
        Ok(())
    }
}

/// Free bytes of the disk that is recorded on, asked now and then.
struct Disk {
    place: Option<PathBuf>,
    free: Option<u64>,
    at: Option<Duration>,
}

impl Disk {
    fn free(&mut self, now: Duration) -> Option<u64> {
        let place = self.place.as_ref()?;
        if self.at.is_none_or(|at| now.saturating_sub(at) >= DISK_EVERY) {
            (self.free, self.at) = (free_bytes(place).ok(), Some(now));
        }
        self.free
    }
}

fn nothing_open() -> AppError {
    AppError::usage("no instrument is open; start the simulated microscope or open an instrument file")
}

fn live_event(settings: &LiveSettings) -> AcquisitionEvent {
    let mut event = simulated::series(settings.exposure, 0, RecordingFormat::None);
    event.exposures = None;
    event.cameras.readback = Readback::Accept;
    event.cameras.regions = [region_of(settings); 2];
    event.laser_power_mw.clone_from(&settings.laser_power_mw);
    if settings.hold_focus {
        event.duties.focus = FocusWish::Hold;
    }
    event
}

fn region_of(settings: &LiveSettings) -> Option<Region> {
    settings.region.map(|[left, top, width, height]| Region { left, top, width, height })
}

fn prepare_live(known: &Known, settings: &LiveSettings) -> Result<Prepared, AppError> {
    let raw = RawAnalysis {
        order: Some(settings.order),
        subsequence_exposures: Some(settings.subsequence),
        species: (!settings.species.is_empty()).then(|| settings.species.clone()),
        dichroic: known.instrument.dichroic().map(str::to_owned),
        numerical_aperture: known.instrument.numerical_aperture(),
        ..RawAnalysis::default()
    };
    let source = known.with_calibrations(known.about.source_of(region_of(settings), settings.exposure, None));
    Prepared::new(AnalysisSettings::try_from(raw).map_err(AppError::usage)?, source)
}

/// A plan that fits the open instrument, how it is analyzed, and what its pre-flight has to say.
///
/// # Errors
/// [`AppError`] with all faults, one per line.
pub(super) fn judge(known: &Known, text: &str, out: &Path) -> Result<(Plan, Prepared, Facts), AppError> {
    let plan = Plan::from_text(text).map_err(AppError::usage)?;
    let misfits = plan.misfits(&known.instrument);
    if !misfits.is_empty() {
        let list: Vec<String> = misfits.iter().map(ToString::to_string).collect();
        return Err(AppError::Usage(list.join("\n")));
    }
    let source = known.with_calibrations(known.about.source(&plan));
    let settings = AnalysisSettings::try_from(plan.analysis().clone()).map_err(AppError::usage)?;
    let prepared = Prepared::new(settings, source.clone())?;
    let facts = known.about.facts(&plan, &source, &prepared, out, None)?;
    Ok((plan, prepared, facts))
}
