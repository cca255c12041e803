//! The instrument in this process, as the window sees it.
//!
//! In: commands of the window. Out: newest values, commands to the session's thread and to the run under way.
//! Never: waits. Fails: [`Refused`] when the session is busy with too many earlier commands.

use super::recent;
use super::session::{Asked, Session, judge};
use super::shared::Shared;
use crate::app::AppError;
use crate::app::run::free_name;
use crate::app::session::COMMANDS;
use crate::control::plan::StagePosition;
use crate::control::preflight::{Outcome, may_begin, preflight};
use crate::control::sequencer::Command;
use crate::viewer::bench::{
    Activity, Bench, BenchCommand, BenchStatus, Gravity, Pictures, PlanEstimate, Refused,
};
use crossbeam_channel::{Sender, TrySendError, bounded};
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
    pub(super) fn warn(&self, text: &str) {
        self.shared.tell(Gravity::Warning, text);
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
            BenchCommand::SaveResults(directory) if *activity == Activity::Live => {
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
