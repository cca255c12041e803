//! Controller and lasers in the guard's hand: one thread owns each port.
//!
//! In: jobs with a ticket, and flags that overtake every job. Out: [`Event`]s. Never: opens a gate while the hold
//! has run out, stops trying to make a laser dark. Fails: every fault becomes an [`Event::Wrong`].

mod gates;
mod laser;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::Sender;
use sofiscope_hal::{DeviceError, ErrorKind, GateController, Laser, TriggerSource};

use super::safety::Trip;

pub use gates::{GateJob, Gates};
pub use laser::{LaserJob, Line};

/// Jobs that may wait at one port.
const JOBS: usize = 8;

/// A controller that opens gates and gives pulses from one clock.
pub trait Controller: GateController + TriggerSource {}

impl<C: GateController + TriggerSource> Controller for C {}

/// A laser and the gate in front of it.
pub struct LaserStation {
    /// Output of the controller, from 0.
    pub gate: u8,
    /// The laser.
    pub laser: Box<dyn Laser>,
}

/// What the threads have to say.
#[derive(Debug)]
pub enum Event {
    /// A job with a ticket is done, or not.
    Settled {
        /// The ticket.
        ticket: u64,
        /// How it went.
        outcome: Result<(), DeviceError>,
    },
    /// Something is wrong, whether a job asked for it or not.
    Wrong(Trip),
}

/// Until when the gates may be held open, in nanoseconds since the guard began; 0 for not at all.
#[derive(Debug, Clone)]
pub struct Hold {
    until: Arc<AtomicU64>,
    begun: Instant,
}

impl Default for Hold {
    fn default() -> Self {
        Self { until: Arc::default(), begun: Instant::now() }
    }
}

impl Hold {
    /// Time since the guard began.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.begun.elapsed()
    }

    /// Holds until `until`, or not at all.
    pub fn set(&self, until: Option<Duration>) {
        let nanoseconds = until.map_or(0, |until| u64::try_from(until.as_nanos()).unwrap_or(u64::MAX));
        self.until.store(nanoseconds, Ordering::Release);
    }

    /// Whether somebody holds now.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.now().as_nanos() < u128::from(self.until.load(Ordering::Acquire))
    }
}

/// Overtakes every job: what was asked before a recall is void after it.
#[derive(Debug, Clone, Default)]
struct Recall(Arc<AtomicU64>);

impl Recall {
    fn raise(&self) {
        self.0.fetch_add(1, Ordering::AcqRel);
    }

    /// How many there have been.
    fn count(&self) -> u64 {
        self.0.load(Ordering::Acquire)
    }
}

/// What an error of a device means for safety.
fn trip_of(error: &DeviceError) -> Trip {
    match error.kind() {
        ErrorKind::Fault | ErrorKind::OutOfRange | ErrorKind::Busy => Trip::DeviceFault(error.to_string()),
        ErrorKind::Timeout
        | ErrorKind::Ended
        | ErrorKind::Lost
        | ErrorKind::Protocol
        | ErrorKind::Identity => Trip::DeviceLost(error.to_string()),
    }
}

fn say(events: &Sender<Event>, event: Event) {
    // A guard that does not listen any more is ending, and with it everything goes dark.
    let _ = events.send_timeout(event, Duration::from_secs(1));
}

fn recalled(device: &str) -> DeviceError {
    DeviceError::new(ErrorKind::Busy, device, "light was recalled before this was done")
}

fn full(device: &str) -> DeviceError {
    DeviceError::new(
        ErrorKind::Busy,
        device,
        "more is waiting for it than it can do; it does not answer in time",
    )
}
