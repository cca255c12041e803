//! The instrument in this process, as the window sees it.
//!
//! In: commands of the window. Out: newest values, commands to the session's thread and to the run under way.
//! Never: waits. Fails: [`Refused`] when the session is busy with too many earlier commands.

use super::coloring;
use super::recent;
use super::registering;
use super::save::keep_picture;
use super::session::{Asked, Session, judge, speed_of};
use super::shared::Shared;
use crate::app::AppError;
use crate::app::hardware::FOCUS_SWEEP_NM;
use crate::app::run::free_name;
use crate::app::session::COMMANDS;
use crate::control::focus_lock::FocusCommand;
use crate::control::plan::StagePosition;
use crate::control::preflight::{Outcome, may_begin, preflight};
use crate::control::sequencer::Command;
use crate::viewer::AsSeen;
use crate::viewer::bench::{
    Activity, Bench, BenchCommand, BenchStatus, FocusAsk, Gravity, Pictures, PlanEstimate, Refused,
    ReplayStatus,
};
use crossbeam_channel::{Sender, TrySendError, bounded};
use sofiscope_hal::Nanometers;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Commands that may wait for the session.
const ASKED: usize = 8;

/// The instrument of this process.
pub(super) struct LocalBench {
    shared: Arc<Shared>,
    asked: Sender<Asked>,
}

impl LocalBench {
    /// Starts the session's thread; it ends with the last of its benches.
    ///
    /// # Errors
    /// [`AppError::Device`] when there is no thread to be had.
    pub(super) fn start() -> Result<Self, AppError> {
        let (asked, commands) = bounded(ASKED);
        let (to_sequencer, to_run) = bounded(COMMANDS);
        let shared = Arc::new(Shared::new(to_sequencer, recent::remembered()));
        let session = Session::new(Arc::clone(&shared), commands, to_run);
        crate::pipeline::spawn("session", move || session.run())
            .map_err(|error| AppError::Device(format!("no thread for the session: {error}")))?;
        Ok(Self { shared, asked })
    }

    /// Ends what is under way in good order, for a window that closes.
    pub(super) fn end(&self) {
        // A full queue holds an end already.
        let _ = self.shared.to_sequencer.try_send(Command::Stop);
    }

    /// Tells the person something.
    pub(super) fn tell(&self, gravity: Gravity, text: &str) {
        self.shared.tell(gravity, text);
    }

    /// Whether no hardware is behind what is shown.
    pub(super) fn shows_simulated(&self) -> bool {
        self.shared.shows_simulated()
    }

    /// A handle on the same instrument.
    pub(super) fn another(&self) -> Self {
        Self { shared: Arc::clone(&self.shared), asked: self.asked.clone() }
    }

    fn to_run(&self, command: Command) -> Result<(), Refused> {
        match self.shared.to_sequencer.try_send(command) {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => Err(Refused),
        }
    }

    fn to_session(&self, command: BenchCommand) -> Result<(), Refused> {
        let stops = self.shared.stops.load(Ordering::SeqCst);
        self.asked.try_send(Asked { command, stops }).map_err(|_| Refused)
    }

    fn move_stage(&self, x_um: f64, y_um: f64) {
        let Some(stage) = self.shared.stage.load_full() else {
            return self.shared.tell(Gravity::Error, "the instrument has no stage");
        };
        let target = StagePosition { x_um: Some(x_um), y_um: Some(y_um), ..StagePosition::default() };
        let shared = Arc::clone(&self.shared);
        let watch = move || match stage.begin(target).map(|answer| answer.recv()) {
            Ok(Ok(Ok(()))) => shared.tell(Gravity::Note, format!("the stage is at {x_um:.2}, {y_um:.2} µm")),
            Ok(Err(_)) => {}
            Ok(Ok(Err(error))) | Err(error) => shared.tell(Gravity::Error, error.to_string()),
        };
        if let Err(error) = crate::pipeline::spawn("move", watch) {
            self.shared.tell(Gravity::Error, format!("no thread for the move: {error}"));
        }
    }
}

impl Bench for LocalBench {
    fn status(&self) -> Arc<BenchStatus> {
        Arc::new(self.shared.status())
    }

    fn pictures(&self) -> Pictures {
        let board = &self.shared.board;
        Pictures { cameras: board.cameras.load_full(), sofi: board.sofi.load_full() }
    }

    fn ask(&self, command: BenchCommand) -> Result<(), Refused> {
        let activity = self.shared.activity.load_full();
        let is_looking = matches!(*activity, Activity::Live | Activity::Replay);
        match command {
            BenchCommand::Pause => self.to_run(Command::Pause),
            BenchCommand::Resume => self.to_run(Command::Resume),
            BenchCommand::Finish => self.to_run(Command::Stop),
            BenchCommand::MoveStage { x_um, y_um } => {
                self.move_stage(x_um, y_um);
                Ok(())
            }
            BenchCommand::ReplaySpeed(times) => {
                if let Some(replay) = self.shared.replay.load_full() {
                    replay.control.set_speed(speed_of(times));
                }
                Ok(())
            }
            BenchCommand::Seek(exposure) => self.seek(exposure),
            BenchCommand::Focus(asked) => {
                self.ask_focus(asked, &activity);
                Ok(())
            }
            BenchCommand::Registration(asked) => {
                registering::obey(&self.shared, asked);
                Ok(())
            }
            BenchCommand::Colors(asked) => {
                coloring::obey(&self.shared, asked);
                Ok(())
            }
            BenchCommand::SetProperty { device, property, .. } if *activity != Activity::Idle => {
                self.shared.tell(
                    Gravity::Warning,
                    format!(
                        "{device}: '{property}' is changed only while the cameras rest; finish what is under way (F), \
                         then change it"
                    ),
                );
                Ok(())
            }
            BenchCommand::SaveResults(directory) if is_looking => {
                self.save_shown(&directory);
                Ok(())
            }
            BenchCommand::Run { .. } if matches!(*activity, Activity::Run | Activity::Paused) => {
                self.shared.tell(Gravity::Warning, "a run is under way; finish it first");
                Ok(())
            }
            other => {
                // What is only looked at makes room for whatever comes.
                if is_looking {
                    self.to_run(Command::Stop)?;
                }
                self.to_session(other)
            }
        }
    }

    fn keep_picture(&self, picture: AsSeen) -> Result<(), Refused> {
        let shared = Arc::clone(&self.shared);
        let keep = move || match keep_picture(&picture, shared.shows_simulated()) {
            Ok(()) => shared.tell(Gravity::Note, format!("saved: {}", picture.path.display())),
            Err(error) => shared.tell(Gravity::Error, error.to_string()),
        };
        match crate::pipeline::spawn("picture", keep) {
            Ok(_) => Ok(()),
            Err(error) => {
                self.shared.tell(Gravity::Error, format!("no thread to save the picture: {error}"));
                Err(Refused)
            }
        }
    }

    fn stop(&self) {
        self.shared.stop();
    }

    fn judge_plan(&self, text: &str) -> Result<PlanEstimate, String> {
        let known = self.shared.known.load_full();
        let known = known.ok_or("no instrument is open; open one first, as plans are judged for it")?;
        let (plan, _, facts) =
            judge(&known, text, &free_name("sofiscope-run")).map_err(|error| error.to_string())?;
        let checks = preflight(&facts);
        Ok(PlanEstimate {
            may_begin: may_begin(&checks),
            checks: checks.iter().map(|check| (gravity(check.outcome), check.to_string())).collect(),
            duration: plan.duration(),
            bytes: facts.planned_bytes(),
            series: plan.events().count(),
            exposures: plan.exposures_per_series(),
        })
    }
}

impl LocalBench {
    /// What is played ends, and begins again with another exposure.
    fn seek(&self, exposure: u64) -> Result<(), Refused> {
        let Some(replay) = self.shared.replay.load_full() else {
            self.shared.tell(Gravity::Warning, "nothing is played; begin a replay first");
            return Ok(());
        };
        let (exposures, _) = replay.control.extent();
        let from = exposure.min(exposures.saturating_sub(1));
        let ReplayStatus { recording, speed, .. } = replay.status(0);
        self.to_run(Command::Stop)?;
        self.to_session(BenchCommand::Replay { recording, speed, from })
    }

    fn ask_focus(&self, asked: FocusAsk, activity: &Activity) {
        let Some(focus) = self.shared.focus_remote.load_full() else {
            return self.shared.tell(Gravity::Warning, "this instrument has no focus lock");
        };
        let is_run = matches!(activity, Activity::Run | Activity::Paused | Activity::Ending);
        if is_run && asked != FocusAsk::Lock {
            return self.shared.tell(
                Gravity::Warning,
                "the focus lock belongs to the run under way; finish it first, or let the lock hold again",
            );
        }
        let nanometers = |value: f64| Nanometers::new(value).unwrap_or_default();
        let command = match asked {
            FocusAsk::Lock => FocusCommand::Lock,
            FocusAsk::Release => FocusCommand::Release,
            FocusAsk::Calibrate => FocusCommand::Calibrate(nanometers(FOCUS_SWEEP_NM)),
            FocusAsk::MoveBy(step) => FocusCommand::MoveTo(nanometers(focus.status().z_nm + step)),
        };
        if let Err(error) = focus.ask(command) {
            self.shared.tell(Gravity::Error, error.to_string());
        }
    }

    fn save_shown(&self, directory: &std::path::Path) {
        let (shared, directory) = (Arc::clone(&self.shared), directory.to_owned());
        let save = move || shared.save_shown(&directory);
        if let Err(error) = crate::pipeline::spawn("save", save) {
            self.shared.tell(Gravity::Error, format!("no thread to save: {error}"));
        }
    }
}

fn gravity(outcome: Outcome) -> Gravity {
    match outcome {
        Outcome::Pass => Gravity::Note,
        Outcome::Warn => Gravity::Warning,
        Outcome::Fail => Gravity::Error,
    }
}
