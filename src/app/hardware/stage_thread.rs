//! The stage on a thread of its own: one owner, a mailbox, and STOP past it.
//!
//! In: moves by name of a place, through [`StageHandle`]s. Out: where the stage is, for any number of lookers.
//! Never: waits for the end of a move with the mailbox closed, queues STOP. Fails: [`DeviceError`] to whoever asked.

use arc_swap::ArcSwap;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use sofiscope_hal::{
    DeviceError, DeviceIdentity, ErrorKind, Micrometers, Motion, Property, Stage, StageEnvelope, StagePoint,
    StopMotion,
};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::super::AppError;
use crate::control::contracts::StageDrive;
use crate::control::plan::StagePosition;

/// Requests that may wait.
const MAILBOX: usize = 8;
/// Time between two looks at a moving stage, and at one that stands.
const LOOKS: [Duration; 2] = [Duration::from_millis(20), Duration::from_millis(200)];
/// The whole travel takes a quarter of this.
const PATIENCE: Duration = Duration::from_secs(60);

/// Where the stage was at the last look.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::app) struct StageState {
    /// Its place, unless it did not answer.
    pub(in crate::app) place: Option<StagePoint>,
    /// What it was doing.
    pub(in crate::app) motion: Motion,
    /// What it said when it did not answer.
    pub(in crate::app) trouble: Option<String>,
}

/// An answer to whoever waits for it.
type Answer = Sender<Result<(), DeviceError>>;

struct Request {
    target: StagePosition,
    answer: Answer,
}

/// The stage from any thread.
#[derive(Clone)]
pub(in crate::app) struct StageHandle {
    requests: Sender<Request>,
    state: Arc<ArcSwap<StageState>>,
    stopper: Arc<dyn StopMotion>,
    envelope: StageEnvelope,
    identity: DeviceIdentity,
    properties: Arc<Vec<Property>>,
}

impl StageHandle {
    /// Gives the stage to a thread of its own; the thread ends with its last handle.
    ///
    /// # Errors
    /// [`AppError::Device`] when there is no thread to be had.
    pub(in crate::app) fn spawn(mut stage: Box<dyn Stage>) -> Result<Self, AppError> {
        let (requests, mailbox) = bounded(MAILBOX);
        let first = StageState { place: None, motion: Motion::Unknown, trouble: None };
        let state = Arc::new(ArcSwap::from_pointee(first));
        let handle = Self {
            requests,
            state: Arc::clone(&state),
            stopper: Arc::from(stage.stopper()),
            envelope: stage.envelope().clone(),
            identity: stage.identity().clone(),
            properties: Arc::new(stage.properties().unwrap_or_default()),
        };
        let work = move || Owner { stage, mailbox, state, waiting: None }.run();
        crate::pipeline::spawn("dev-stage", work)
            .map_err(|error| AppError::Device(format!("no thread for the stage: {error}")))?;
        Ok(handle)
    }

    /// Where it was at the last look.
    pub(in crate::app) fn state(&self) -> Arc<StageState> {
        self.state.load_full()
    }

    /// Where it may go.
    pub(in crate::app) fn envelope(&self) -> &StageEnvelope {
        &self.envelope
    }

    /// Which stage this is.
    pub(in crate::app) fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    /// Its properties when it was opened.
    pub(in crate::app) fn properties(&self) -> &[Property] {
        &self.properties
    }

    /// What stops it from anywhere.
    pub(in crate::app) fn stopper(&self) -> Arc<dyn StopMotion> {
        Arc::clone(&self.stopper)
    }

    /// Begins a move; the answer comes when it has ended. A move that is under way is replaced.
    ///
    /// # Errors
    /// [`Busy`](ErrorKind::Busy) when too many moves wait.
    pub(in crate::app) fn begin(
        &self,
        target: StagePosition,
    ) -> Result<Receiver<Result<(), DeviceError>>, DeviceError> {
        let (answer, answers) = bounded(1);
        let busy = |_| self.error(ErrorKind::Busy, "too many moves wait; stop it or wait for its end");
        self.requests.try_send(Request { target, answer }).map_err(busy)?;
        Ok(answers)
    }

    fn error(&self, kind: ErrorKind, message: &str) -> DeviceError {
        DeviceError::new(kind, self.identity.to_string(), message)
    }
}

impl StageDrive for StageHandle {
    fn move_to(&mut self, position: &StagePosition) -> Result<(), DeviceError> {
        let answers = self.begin(position.clone())?;
        let gone = |_| self.error(ErrorKind::Lost, "its thread gave no answer; home the stage again");
        answers.recv_timeout(PATIENCE + Duration::from_secs(1)).map_err(gone)?
    }
}

/// The thread's own.
struct Owner {
    stage: Box<dyn Stage>,
    mailbox: Receiver<Request>,
    state: Arc<ArcSwap<StageState>>,
    /// Who waits for the end of the move under way, and since when.
    waiting: Option<(Answer, Instant)>,
}

impl Owner {
    fn run(mut self) {
        loop {
            self.look();
            let pause = LOOKS[usize::from(self.waiting.is_none())];
            match self.mailbox.recv_timeout(pause) {
                Ok(request) => self.begin(request),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn look(&mut self) {
        let (place, motion) = (self.stage.position(), self.stage.motion());
        let trouble = place.as_ref().err().or(motion.as_ref().err()).map(ToString::to_string);
        let now =
            StageState { place: place.ok(), motion: *motion.as_ref().unwrap_or(&Motion::Unknown), trouble };
        if **self.state.load() != now {
            self.state.store(Arc::new(now));
        }
        if let Some((_, begun)) = &self.waiting {
            let patience_is_over = begun.elapsed() > PATIENCE;
            match motion {
                Ok(Motion::Moving) if !patience_is_over => {}
                Ok(Motion::Still) => self.answer(Ok(())),
                Ok(other) => {
                    let stopped = self.stage.stopper().stop_motion();
                    let message =
                        format!("the move did not end ({other:?}); it was stopped, home the stage again");
                    let error =
                        DeviceError::new(ErrorKind::Fault, self.stage.identity().to_string(), message);
                    self.answer(stopped.and(Err(error)));
                }
                Err(error) => self.answer(Err(error)),
            }
        }
    }

    fn begin(&mut self, Request { target, answer }: Request) {
        if self.waiting.is_some() {
            let name = self.stage.identity().to_string();
            self.answer(Err(DeviceError::new(
                ErrorKind::Busy,
                name,
                "another move took the place of this one",
            )));
        }
        match self.point(&target).and_then(|point| self.stage.move_to(point)) {
            Ok(()) => self.waiting = Some((answer, Instant::now())),
            // Whoever asked may have gone.
            Err(error) => drop(answer.try_send(Err(error))),
        }
    }

    fn point(&mut self, target: &StagePosition) -> Result<StagePoint, DeviceError> {
        let name = self.stage.identity().to_string();
        if target.z_um.is_some() {
            let message =
                "it moves in x and y only; remove z from the position and focus by hand or by the lock";
            return Err(DeviceError::new(ErrorKind::OutOfRange, name, message));
        }
        let um = |value: f64| {
            Micrometers::new(value)
                .map_err(|error| DeviceError::new(ErrorKind::OutOfRange, &name, error.to_string()))
        };
        let here = self.stage.position()?;
        Ok(StagePoint { x: target.x_um.map_or(Ok(here.x), um)?, y: target.y_um.map_or(Ok(here.y), um)? })
    }

    fn answer(&mut self, outcome: Result<(), DeviceError>) {
        if let Some((answer, _)) = self.waiting.take() {
            // Whoever asked may have gone.
            drop(answer.try_send(outcome));
        }
    }
}
