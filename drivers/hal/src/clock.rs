//! The clock of this computer, and how a reader waits by it; for cameras that are made of software.
//!
//! In: the time until which to wait, and a bell that may ring before. Out: the time now.
//! Never: sleeps through the bell. Fails: never.

use std::fmt;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::HostTime;

/// Time as a simulated or replayed camera sees it; a test brings a [`ManualClock`].
pub trait Clock: fmt::Debug + Send + Sync {
    /// The time now.
    fn now(&self) -> HostTime;

    /// Waits until the time has come or the bell has rung more than `heard` times.
    fn wait(&self, bell: &Bell, heard: u64, until: HostTime);
}

/// Wakes those who wait when the state of the instrument has changed: somebody began, paused or stopped.
#[derive(Debug, Default)]
pub struct Bell {
    rings: Mutex<u64>,
    rung: Condvar,
}

impl Bell {
    /// How often it has rung.
    #[must_use]
    pub fn rings(&self) -> u64 {
        *self.lock()
    }

    /// Wakes everyone who waits.
    pub fn ring(&self) {
        *self.lock() += 1;
        self.rung.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, u64> {
        self.rings.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for a ring after the one `heard`, for `at_most` this long.
    fn wait(&self, heard: u64, at_most: Duration) {
        let waited = self.rung.wait_timeout_while(self.lock(), at_most, |rings| *rings == heard);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}

/// The monotonic clock of this computer, from the moment the value was made.
#[derive(Debug, Clone, Copy)]
pub struct MonotonicClock {
    begin: Instant,
}

impl Default for MonotonicClock {
    fn default() -> Self {
        Self { begin: Instant::now() }
    }
}

impl Clock for MonotonicClock {
    fn now(&self) -> HostTime {
        HostTime(nanoseconds(self.begin.elapsed()))
    }

    fn wait(&self, bell: &Bell, heard: u64, until: HostTime) {
        bell.wait(heard, until.since(self.now()));
    }
}

/// A clock that stands still until someone sets it or waits: waiting brings it to the time awaited at once.
#[derive(Debug, Default)]
pub struct ManualClock {
    now_ns: Mutex<u64>,
}

impl ManualClock {
    /// Lets time pass.
    pub fn advance(&self, by: Duration) {
        let mut now_ns = self.lock();
        *now_ns = now_ns.saturating_add(nanoseconds(by));
    }

    fn lock(&self) -> MutexGuard<'_, u64> {
        self.now_ns.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Clock for ManualClock {
    fn now(&self) -> HostTime {
        HostTime(*self.lock())
    }

    fn wait(&self, bell: &Bell, heard: u64, until: HostTime) {
        if bell.rings() == heard {
            let mut now_ns = self.lock();
            *now_ns = until.0.max(*now_ns);
        }
    }
}

/// Nanoseconds of a duration, at most 584 years.
#[must_use]
pub fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waiting_brings_a_manual_clock_forward_unless_the_bell_has_rung() {
        let (clock, bell) = (ManualClock::default(), Bell::default());
        clock.advance(Duration::from_nanos(5));
        clock.wait(&bell, bell.rings(), HostTime(20));
        assert_eq!(clock.now(), HostTime(20));
        let heard = bell.rings();
        bell.ring();
        clock.wait(&bell, heard, HostTime(90));
        assert_eq!(clock.now(), HostTime(20));
    }

    #[test]
    fn the_bell_ends_a_wait_on_the_monotonic_clock() {
        let (clock, bell) = (MonotonicClock::default(), Bell::default());
        let heard = bell.rings();
        bell.ring();
        clock.wait(&bell, heard, HostTime(u64::MAX));
        assert!(clock.now() < HostTime(u64::MAX / 2));
    }
}
