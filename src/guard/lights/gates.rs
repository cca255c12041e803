//! The thread that owns the trigger controller.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use sofiscope_hal::{
    DeviceError, DeviceIdentity, GateCapabilities, GatePattern, GateState, Interlock, Volts,
};

use super::{Controller, Event, Hold, JOBS, Recall, full, recalled, say, trip_of};
use crate::guard::safety::Trip;

/// Time between two heartbeats; the controller waits 250 ms for them.
const HEARTBEAT: Duration = Duration::from_millis(50);
/// Time between two looks at what the gates really do.
const LOOK: Duration = Duration::from_millis(100);
/// Looks in a row that may fail before the controller counts as lost.
const STRIKES: u32 = 3;

/// What the controller can be asked.
#[derive(Debug)]
pub enum GateJob {
    /// Let gates open when asked.
    Arm,
    /// Open these, during exposures where the controller knows them.
    Open(GatePattern),
    /// An analog output.
    Level(u8, Volts),
    /// Pulses.
    StartTrain(Duration, Option<u64>),
    /// No pulses.
    StopTrain,
}

struct Ticketed {
    /// Recalls before it was asked.
    recalls: u64,
    ticket: Option<u64>,
    job: GateJob,
    done: Option<Sender<Result<(), DeviceError>>>,
}

/// The other end of the thread; may be cloned.
#[derive(Clone)]
pub struct Gates {
    jobs: Sender<Ticketed>,
    recall: Recall,
    state: Arc<Mutex<Option<GateState>>>,
    identity: DeviceIdentity,
    capabilities: GateCapabilities,
}

impl Gates {
    /// Starts the thread; it ends when the last [`Gates`] is dropped, with all gates closed.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn spawn(
        controller: Box<dyn Controller>,
        hold: Hold,
        events: Sender<Event>,
    ) -> std::io::Result<(Self, JoinHandle<()>)> {
        let (jobs, waiting) = bounded(JOBS);
        let gates = Self {
            jobs,
            recall: Recall::default(),
            state: Arc::default(),
            identity: controller.identity().clone(),
            capabilities: controller.capabilities().clone(),
        };
        let mut owner = Owner {
            controller,
            hold,
            recall: gates.recall.clone(),
            recalls: 0,
            state: Arc::clone(&gates.state),
            events,
            wants_open: false,
            armed_epoch: None,
            strikes: 0,
        };
        let thread =
            std::thread::Builder::new().name("guard-gates".to_owned()).spawn(move || owner.live(&waiting))?;
        Ok((gates, thread))
    }

    /// Which controller.
    #[must_use]
    pub fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    /// What it can do.
    #[must_use]
    pub fn capabilities(&self) -> &GateCapabilities {
        &self.capabilities
    }

    /// What it said last; `None` when it could not be asked.
    #[must_use]
    pub fn state(&self) -> Option<GateState> {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Closes everything, past every job.
    pub fn close(&self) {
        self.recall.raise();
        // Wakes the thread; when the queue is full it is awake.
        let _ = self.jobs.try_send(self.ticketed(None, GateJob::StopTrain, None));
    }

    /// Posts a job that is settled later, under `ticket`.
    ///
    /// # Errors
    /// [`Busy`](sofiscope_hal::ErrorKind::Busy) when too much is waiting.
    pub fn post(&self, ticket: u64, job: GateJob) -> Result<(), DeviceError> {
        let job = self.ticketed(Some(ticket), job, None);
        self.jobs.try_send(job).map_err(|_| full("trigger controller"))
    }

    /// Sets an analog output and waits for it: for the lasers whose power is a level of the controller.
    ///
    /// # Errors
    /// What the controller says.
    pub fn set_level(&self, output: u8, level: Volts) -> Result<(), DeviceError> {
        let (done, outcome) = bounded(1);
        let job = self.ticketed(None, GateJob::Level(output, level), Some(done));
        self.jobs.try_send(job).map_err(|_| full("trigger controller"))?;
        outcome.recv_timeout(Duration::from_secs(3)).unwrap_or_else(|_| Err(full("trigger controller")))
    }

    fn ticketed(
        &self,
        ticket: Option<u64>,
        job: GateJob,
        done: Option<Sender<Result<(), DeviceError>>>,
    ) -> Ticketed {
        Ticketed { recalls: self.recall.count(), ticket, job, done }
    }
}

struct Owner {
    controller: Box<dyn Controller>,
    hold: Hold,
    recall: Recall,
    /// Recalls that were carried out.
    recalls: u64,
    state: Arc<Mutex<Option<GateState>>>,
    events: Sender<Event>,
    /// Whether gates may be open by what was asked last.
    wants_open: bool,
    /// The controller's epoch when it was armed: another one means that it has been reset.
    armed_epoch: Option<u32>,
    strikes: u32,
}

impl Owner {
    fn live(&mut self, jobs: &Receiver<Ticketed>) {
        let (mut beat, mut look) = (Instant::now(), Instant::now());
        loop {
            let now = Instant::now();
            let wait = beat.min(look).saturating_duration_since(now);
            let job = jobs.recv_timeout(wait);
            let recalls = self.recall.count();
            if recalls != self.recalls {
                self.recalls = recalls;
                self.close_gates();
            }
            match job {
                Ok(job) => self.settle(job),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if self.wants_open && !self.hold.is_held() {
                self.close_gates();
            }
            let now = Instant::now();
            if now >= beat {
                beat = now + HEARTBEAT;
                self.give_heartbeat();
            }
            if now >= look {
                look = now + LOOK;
                self.look();
            }
        }
        self.close_gates();
    }

    fn settle(&mut self, asked: Ticketed) {
        let is_void = asked.recalls != self.recall.count()
            && matches!(asked.job, GateJob::Arm | GateJob::Open(_) | GateJob::StartTrain(..));
        let outcome = if is_void { Err(recalled("trigger controller")) } else { self.carry_out(&asked.job) };
        if let Some(done) = asked.done {
            // Whoever asked may have given up waiting.
            let _ = done.try_send(outcome.clone());
        }
        if let Some(ticket) = asked.ticket {
            say(&self.events, Event::Settled { ticket, outcome });
        }
    }

    fn carry_out(&mut self, job: &GateJob) -> Result<(), DeviceError> {
        match job {
            GateJob::Arm => {
                self.controller.arm()?;
                self.armed_epoch = Some(self.controller.state()?.epoch);
                Ok(())
            }
            GateJob::Open(_) if !self.hold.is_held() => Err(DeviceError::new(
                sofiscope_hal::ErrorKind::Fault,
                "laser guard",
                "nobody holds the light on any more",
            )),
            GateJob::Open(pattern) => {
                self.wants_open = true;
                if self.controller.capabilities().sequence > 0 {
                    self.controller.begin_sequence(&[*pattern])
                } else {
                    self.controller.set_gates(*pattern)
                }
            }
            GateJob::Level(output, level) => self.controller.set_level(*output, *level),
            GateJob::StartTrain(period, pulses) => self.controller.start(*period, *pulses),
            GateJob::StopTrain => self.controller.stop(),
        }
    }

    fn close_gates(&mut self) {
        self.wants_open = false;
        self.armed_epoch = None;
        if let Err(error) = self.controller.disarm() {
            self.unknown();
            say(&self.events, Event::Wrong(trip_of(&error)));
        }
    }

    fn give_heartbeat(&mut self) {
        let is_held = !self.wants_open || self.hold.is_held();
        if self.armed_epoch.is_some()
            && is_held
            && let Err(error) = self.controller.heartbeat()
        {
            self.strike(&error);
        }
    }

    fn look(&mut self) {
        match self.controller.state() {
            Ok(state) => {
                self.strikes = 0;
                *self.state.lock().unwrap_or_else(PoisonError::into_inner) = Some(state);
                self.judge(state);
            }
            Err(error) => self.strike(&error),
        }
    }

    fn judge(&mut self, state: GateState) {
        let Some(epoch) = self.armed_epoch else { return };
        let trip = match state.trip {
            Some(sofiscope_hal::GateTrip::Interlock) => {
                Some(Trip::Interlock(format!("{:?} at the controller", Interlock::Open).to_lowercase()))
            }
            Some(trip) => Some(Trip::Controller(format!("{trip:?}").to_lowercase())),
            None if state.epoch != epoch => Some(Trip::Controller("it has been reset".to_owned())),
            None => None,
        };
        if let Some(trip) = trip {
            self.armed_epoch = None;
            self.wants_open = false;
            say(&self.events, Event::Wrong(trip));
        }
    }

    fn strike(&mut self, error: &DeviceError) {
        self.strikes += 1;
        let is_gone = error.kind() == sofiscope_hal::ErrorKind::Lost;
        if is_gone && self.strikes == 1 || !is_gone && self.strikes == STRIKES {
            self.unknown();
            say(&self.events, Event::Wrong(trip_of(error)));
        }
    }

    fn unknown(&self) {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}
