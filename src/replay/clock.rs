//! The clock of this computer, and how a reader waits by it.
//!
//! In: the time until which to wait, and a bell that may ring before. Out: the time now.
//! Never: sleeps through the bell. Fails: never.

use std::fmt;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use sofiscope_hal::HostTime;

/// Time as a replay sees it; a test brings its own.
pub trait Clock: fmt::Debug + Send + Sync {
    /// The time now.
    fn now(&self) -> HostTime;

    /// Waits until the time has come or the bell has rung more than `heard` times.
    fn wait(&self, bell: &Bell, heard: u64, until: HostTime);
}

/// Wakes those who wait when somebody has paused, gone on or stopped.
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
        let at_most = until.since(self.now());
        let waited = bell.rung.wait_timeout_while(bell.lock(), at_most, |rings| *rings == heard);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}

/// Nanoseconds of a duration, at most 584 years.
pub(super) fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bell_ends_a_wait() {
        let (clock, bell) = (MonotonicClock::default(), Bell::default());
        let heard = bell.rings();
        bell.ring();
        clock.wait(&bell, heard, HostTime(u64::MAX));
        clock.wait(&bell, bell.rings(), clock.now());
    }
}
