//! Clocks that must never be mixed: each camera has its own, and so has this computer.
//!
//! A time of one clock is a type of its own, so that times of different clocks cannot be subtracted.

use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Time on the clock of one camera, nanoseconds since a beginning of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct DeviceTime(pub u64);

impl DeviceTime {
    /// Nanoseconds from `earlier` to this time on the same clock; negative when `earlier` is later.
    #[must_use]
    pub fn nanoseconds_since(self, earlier: Self) -> i64 {
        self.0.wrapping_sub(earlier.0).cast_signed()
    }
}

/// Time on the monotonic clock of this computer, nanoseconds since the run was prepared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct HostTime(pub u64);

impl HostTime {
    /// Time from `earlier` to this one; zero when `earlier` is later.
    #[must_use]
    pub fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_keep_their_sign_across_the_wrap_of_the_clock() {
        assert_eq!(DeviceTime(5).nanoseconds_since(DeviceTime(u64::MAX)), 6);
        assert_eq!(DeviceTime(u64::MAX).nanoseconds_since(DeviceTime(5)), -6);
        assert_eq!(HostTime(3).since(HostTime(7)), Duration::ZERO);
    }
}
