//! The thread that owns one laser.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use sofiscope_hal::{DeviceError, DeviceIdentity, Emission, Interlock, LaserState, Milliwatts};

use super::{Event, JOBS, LaserStation, Recall, full, recalled, say, trip_of};
use crate::guard::safety::Trip;

/// Time between two questions while it emits: a line that is unplugged is only noticed by asking, and its gate is to
/// be closed within 300 ms.
const LOOK_LIT: Duration = Duration::from_millis(100);
/// Time between two questions while it is dark.
const LOOK_DARK: Duration = Duration::from_secs(1);
/// Time between two attempts to make it dark.
const TRY_AGAIN: Duration = Duration::from_millis(100);
/// Questions in a row that may go wrong.
const STRIKES: u32 = 3;

/// What a laser can be asked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LaserJob {
    /// Emit with this power.
    Emit(Milliwatts),
    /// Be dark, and confirm it.
    Dark,
}

struct Ticketed {
    /// Recalls before it was asked.
    recalls: u64,
    ticket: Option<u64>,
    job: LaserJob,
}

/// The other end of the thread.
pub struct Line {
    jobs: Sender<Ticketed>,
    recall: Recall,
    state: Arc<Mutex<Option<LaserState>>>,
    identity: DeviceIdentity,
    wavelength_nm: u32,
    power_cap: Milliwatts,
    gate: u8,
}

impl Line {
    /// Starts the thread; it ends when the [`Line`] is dropped, with the laser dark.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn spawn(station: LaserStation, events: Sender<Event>) -> std::io::Result<(Self, JoinHandle<()>)> {
        let LaserStation { gate, laser } = station;
        let (jobs, waiting) = bounded(JOBS);
        let line = Self {
            jobs,
            recall: Recall::default(),
            state: Arc::default(),
            identity: laser.identity().clone(),
            wavelength_nm: laser.wavelength_nm(),
            power_cap: laser.power_cap(),
            gate,
        };
        let mut owner = Owner {
            laser,
            recall: line.recall.clone(),
            recalls: 0,
            state: Arc::clone(&line.state),
            events,
            wants_light: false,
            strikes: 0,
        };
        let thread = std::thread::Builder::new()
            .name(format!("guard-{}", line.wavelength_nm))
            .spawn(move || owner.live(&waiting))?;
        Ok((line, thread))
    }

    /// Which laser.
    #[must_use]
    pub fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    /// Nanometers.
    #[must_use]
    pub fn wavelength_nm(&self) -> u32 {
        self.wavelength_nm
    }

    /// The most that may be asked.
    #[must_use]
    pub fn power_cap(&self) -> Milliwatts {
        self.power_cap
    }

    /// Output of the controller in front of it.
    #[must_use]
    pub fn gate(&self) -> u8 {
        self.gate
    }

    /// What it said last; `None` when it could not be asked.
    #[must_use]
    pub fn state(&self) -> Option<LaserState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Makes it dark, past every job.
    pub fn darken(&self) {
        self.recall.raise();
        // Wakes the thread; when the queue is full it is awake.
        let _ =
            self.jobs.try_send(Ticketed { recalls: self.recall.count(), ticket: None, job: LaserJob::Dark });
    }

    /// Posts a job that is settled later, under `ticket`.
    ///
    /// # Errors
    /// [`Busy`](sofiscope_hal::ErrorKind::Busy) when too much is waiting.
    pub fn post(&self, ticket: u64, job: LaserJob) -> Result<(), DeviceError> {
        let job = Ticketed { recalls: self.recall.count(), ticket: Some(ticket), job };
        self.jobs.try_send(job).map_err(|_| full(&self.identity.to_string()))
    }
}

struct Owner {
    laser: Box<dyn sofiscope_hal::Laser>,
    recall: Recall,
    /// Recalls that were carried out.
    recalls: u64,
    state: Arc<Mutex<Option<LaserState>>>,
    events: Sender<Event>,
    /// Whether it may emit by what was asked last.
    wants_light: bool,
    strikes: u32,
}

impl Owner {
    fn live(&mut self, jobs: &Receiver<Ticketed>) {
        let mut look = Instant::now();
        loop {
            let job = jobs.recv_timeout(look.saturating_duration_since(Instant::now()));
            let recalls = self.recall.count();
            if recalls != self.recalls {
                self.recalls = recalls;
                self.be_dark();
                look = Instant::now();
            }
            match job {
                Ok(job) => self.settle(&job),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if Instant::now() >= look {
                let is_fine = self.look();
                let wait = match (self.wants_light, is_fine) {
                    (_, false) => TRY_AGAIN,
                    (true, true) => LOOK_LIT,
                    (false, true) => LOOK_DARK,
                };
                look = Instant::now() + wait;
            }
        }
        self.be_dark();
    }

    fn settle(&mut self, asked: &Ticketed) {
        // Without a ticket it only woke the thread.
        let Some(ticket) = asked.ticket else { return };
        let outcome = match asked.job {
            LaserJob::Emit(power) => self.emit(power, asked.recalls),
            LaserJob::Dark => {
                self.wants_light = false;
                self.laser.switch_off()
            }
        };
        say(&self.events, Event::Settled { ticket, outcome });
    }

    fn emit(&mut self, power: Milliwatts, recalls: u64) -> Result<(), DeviceError> {
        self.laser.set_power(power)?;
        // Darkness that was asked for meanwhile comes first.
        if recalls != self.recall.count() {
            return Err(recalled(&self.laser.identity().to_string()));
        }
        self.wants_light = true;
        self.laser.switch_on()
    }

    /// The short way first, then the one that is confirmed.
    fn be_dark(&mut self) {
        self.wants_light = false;
        let sent = self.laser.make_dark();
        if let Err(error) = self.laser.switch_off().and(sent) {
            self.unknown();
            say(
                &self.events,
                Event::Wrong(Trip::DeviceLost(format!("{error}; its light could not be confirmed off"))),
            );
        }
    }

    /// Asks what it does; false when it must be tried again soon.
    fn look(&mut self) -> bool {
        let state = match self.laser.state() {
            Ok(state) => state,
            Err(error) => {
                self.strikes += 1;
                let is_sure =
                    matches!(error.kind(), sofiscope_hal::ErrorKind::Lost | sofiscope_hal::ErrorKind::Fault);
                if is_sure && self.strikes == 1 || !is_sure && self.strikes == STRIKES {
                    self.unknown();
                    say(&self.events, Event::Wrong(trip_of(&error)));
                }
                return false;
            }
        };
        self.strikes = 0;
        let wrong = self.wrong_with(&state);
        *self.state.lock().unwrap_or_else(PoisonError::into_inner) = Some(state);
        let Some(trip) = wrong else { return true };
        say(&self.events, Event::Wrong(trip));
        self.be_dark();
        false
    }

    /// What about this state must not be.
    fn wrong_with(&self, state: &LaserState) -> Option<Trip> {
        let name = self.laser.identity();
        if let Some(fault) = &state.fault {
            return Some(Trip::DeviceFault(format!("{name}: {fault}")));
        }
        if self.wants_light && state.interlock == Interlock::Open {
            return Some(Trip::Interlock(name.to_string()));
        }
        if !self.wants_light && state.emission != Emission::Off {
            return Some(Trip::DeviceFault(format!("{name} emits although nobody asked it to; use its key")));
        }
        if self.wants_light && state.emission == Emission::Off {
            return Some(Trip::DeviceFault(format!("{name} went dark by itself: interlock, key or fault")));
        }
        None
    }

    fn unknown(&self) {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}
