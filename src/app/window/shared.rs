//! What the session and the window share: newest values, and the ways into the session.
//!
//! In: values from the session's thread. Out: a [`BenchStatus`] put together whenever the window looks.
//! Never: holds a lock while anybody works. Fails: not at all.

use super::board::Board;
use super::coloring::Colorist;
use super::recent;
use super::registering::Registrar;
use super::save::save_look;
use super::session::{Known, UnderWay};
use crate::acquisition::FocusGauge;
use crate::app::AppError;
use crate::app::hardware::{Guarded, StageHandle};
use crate::control::contracts::Illumination;
use crate::control::focus_lock::FocusRemote;
use crate::control::sequencer::Command;
use crate::reconstruction::Quality;
use crate::viewer::bench::{
    Activity, BenchStatus, Event, FocusStatus, Gravity, InstrumentCard, LaserStatus, RunNumbers, StageStatus,
};
use arc_swap::{ArcSwap, ArcSwapOption};
use sofiscope_hal::Motion;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Events that are kept.
const MOST_EVENTS: usize = 1000;
/// Points of the trace of the focus error.
const MOST_FOCUS_POINTS: usize = 600;

/// Everything that both sides know.
pub(super) struct Shared {
    pub(super) board: Arc<Board>,
    pub(super) activity: ArcSwap<Activity>,
    pub(super) card: ArcSwapOption<InstrumentCard>,
    pub(super) run: ArcSwap<RunNumbers>,
    pub(super) quality: ArcSwap<Vec<Quality>>,
    pub(super) lasers: ArcSwap<Vec<LaserStatus>>,
    pub(super) stage: ArcSwapOption<StageHandle>,
    pub(super) lights: ArcSwapOption<Guarded>,
    /// The open instrument, for whoever judges plans.
    pub(super) known: ArcSwapOption<Known>,
    pub(super) recent: ArcSwap<Vec<PathBuf>>,
    pub(super) last_saved: ArcSwapOption<PathBuf>,
    /// To the sequencer of the series under way.
    pub(super) to_sequencer: crossbeam_channel::Sender<Command>,
    /// How often STOP was pressed: what was asked before the last time is not begun any more.
    pub(super) stops: AtomicU64,
    /// Whether no hardware is behind what the board shows.
    pub(super) is_simulated: AtomicBool,
    /// The registration of the cameras from live frames.
    pub(super) registrar: Registrar,
    /// The shares of the dyes' light from live frames.
    pub(super) colorist: Colorist,
    events: ArcSwap<Vec<Event>>,
    writing: Mutex<()>,
    /// The replay under way.
    pub(super) replay: ArcSwapOption<UnderWay>,
    /// The focus lock of the open instrument, for whoever asks something of it.
    pub(super) focus_remote: ArcSwapOption<FocusRemote>,
    focus: ArcSwapOption<FocusGauge>,
    trace: Mutex<VecDeque<(Instant, f64)>>,
}

impl Shared {
    pub(super) fn new(to_sequencer: crossbeam_channel::Sender<Command>, recent: Vec<PathBuf>) -> Self {
        Self {
            board: Arc::default(),
            activity: ArcSwap::default(),
            card: ArcSwapOption::empty(),
            run: ArcSwap::default(),
            quality: ArcSwap::default(),
            lasers: ArcSwap::default(),
            stage: ArcSwapOption::empty(),
            lights: ArcSwapOption::empty(),
            known: ArcSwapOption::empty(),
            recent: ArcSwap::from_pointee(recent),
            last_saved: ArcSwapOption::empty(),
            to_sequencer,
            stops: AtomicU64::new(0),
            is_simulated: AtomicBool::new(false),
            registrar: Registrar::default(),
            colorist: Colorist::default(),
            events: ArcSwap::default(),
            writing: Mutex::default(),
            replay: ArcSwapOption::empty(),
            focus_remote: ArcSwapOption::empty(),
            focus: ArcSwapOption::empty(),
            trace: Mutex::default(),
        }
    }

    /// Adds an event.
    pub(super) fn tell(&self, gravity: Gravity, text: impl Into<String>) {
        let text = text.into();
        match gravity {
            Gravity::Note => tracing::info!("{text}"),
            Gravity::Warning => tracing::warn!("{text}"),
            Gravity::Error => tracing::error!("{text}"),
        }
        let time = jiff::Zoned::now().strftime("%H:%M:%S").to_string();
        let _one_writer = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let mut events = self.events.load().as_ref().clone();
        events.push(Event { time, gravity, text });
        let surplus = events.len().saturating_sub(MOST_EVENTS);
        events.drain(..surplus);
        self.events.store(Arc::new(events));
    }

    /// The focus lock of the open instrument, if it has one.
    pub(super) fn watch_focus(&self, gauge: Option<FocusGauge>, remote: Option<FocusRemote>) {
        self.focus_remote.store(remote.map(Arc::new));
        self.focus.store(gauge.map(Arc::new));
        self.trace.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// STOP: what moves stands, what shines is dark, what runs is aborted, what waits is not begun.
    pub(super) fn stop(&self) {
        self.stops.fetch_add(1, Ordering::SeqCst);
        if let Some(stage) = self.stage.load_full()
            && let Err(error) = stage.stopper().stop_motion()
        {
            self.tell(Gravity::Error, format!("STOP could not be sent to the stage: {error}"));
        }
        // A full queue holds an end already.
        let _ = self.to_sequencer.try_send(Command::Abort);
        if let Some(lights) = self.lights.load_full() {
            // The guard may be asked something at this moment: the window does not wait for it.
            let dark = move || {
                let mut lights = Guarded::clone(&lights);
                if let Err(error) = lights.off() {
                    tracing::error!("{error}");
                }
            };
            if let Err(error) = crate::pipeline::spawn("stop", dark) {
                self.tell(Gravity::Error, format!("STOP found no thread for the lasers: {error}"));
            }
        }
        self.tell(Gravity::Warning, "STOP: lasers off, motion stopped, run aborted");
    }

    /// Writes what is shown, and tells what became of it.
    pub(super) fn save_shown(&self, directory: &Path) {
        match self.write_shown(directory) {
            Ok(saved) => self.kept(&saved),
            Err(error) => self.tell(Gravity::Error, error.to_string()),
        }
    }

    /// Writes what is shown into a directory that must not exist yet.
    ///
    /// # Errors
    /// [`AppError`]: nothing is shown yet; the disk.
    pub(super) fn write_shown(&self, directory: &Path) -> Result<PathBuf, AppError> {
        let look = self.board.sofi.load_full();
        let look = look.ok_or_else(|| AppError::usage("there is no image yet; start the live view first"))?;
        save_look(&look, self.shows_simulated(), directory)
    }

    /// Whether no hardware is behind what is shown.
    pub(super) fn shows_simulated(&self) -> bool {
        self.is_simulated.load(Ordering::SeqCst)
    }

    /// A directory was written.
    pub(super) fn kept(&self, directory: &Path) {
        let directory = directory.canonicalize().unwrap_or_else(|_| directory.to_owned());
        self.tell(Gravity::Note, format!("saved: {}", directory.display()));
        self.recent.store(Arc::new(recent::remember(&self.recent.load(), &directory)));
        self.last_saved.store(Some(Arc::new(directory)));
    }

    /// How things stand now.
    pub(super) fn status(&self) -> BenchStatus {
        BenchStatus {
            instrument: self.card.load_full(),
            activity: self.activity.load().as_ref().clone(),
            run: self.run.load().as_ref().clone(),
            quality: self.quality.load_full(),
            stage: self.stage.load_full().and_then(|stage| stage_status(&stage)),
            lasers: self.lasers.load().as_ref().clone(),
            focus: self.focus.load_full().map(|gauge| self.focus_status(&gauge)),
            registration: self.registrar.status(self.known.load_full().as_deref()),
            colors: self.colorist.status(self.known.load_full().as_deref()),
            replay: self.replay.load_full().map(|replay| replay.status(self.run.load().exposures)),
            events: self.events.load_full(),
            recent: self.recent.load_full(),
            last_saved: self.last_saved.load_full().map(|path| path.as_ref().clone()),
        }
    }

    /// Looking at the focus is what fills its trace.
    fn focus_status(&self, gauge: &FocusGauge) -> FocusStatus {
        let (error, now) = (gauge.now_nm(), Instant::now());
        let mut trace = self.trace.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(error) = error {
            trace.push_back((now, error));
            if trace.len() > MOST_FOCUS_POINTS {
                trace.pop_front();
            }
        }
        let trace: Vec<_> =
            trace.iter().map(|&(at, error)| (-now.duration_since(at).as_secs_f64(), error)).collect();
        let state = match (error, trace.is_empty()) {
            (Some(_), _) => "locked",
            (None, true) => "off",
            (None, false) => "not locked",
        };
        let told = FocusStatus { state: state.to_owned(), trace, ..FocusStatus::default() };
        let Some(remote) = self.focus_remote.load_full() else { return told };
        let status = remote.status();
        FocusStatus {
            quality: (status.state == "locked").then_some(status.quality),
            reason: status.fault.or(status.reason),
            z_um: Some(status.z_nm / 1e3),
            is_calibrated: status.calibration.is_some(),
            state: status.state,
            ..told
        }
    }
}

fn stage_status(stage: &StageHandle) -> Option<StageStatus> {
    let state = stage.state();
    let place = state.place?;
    Some(StageStatus {
        x_um: place.x.value(),
        y_um: place.y.value(),
        is_moving: state.motion == Motion::Moving,
    })
}
