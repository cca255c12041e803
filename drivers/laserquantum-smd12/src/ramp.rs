//! Whether the power is where it should be by now: a DPSS laser rises over seconds.
//!
//! In: times, set and measured powers. Out: [`Ramp`] of the next moment, or what is wrong.
//! Never: reads a clock. Fails: [`Deviation`].

use std::time::Duration;

use sofiscope_hal::Milliwatts;

/// Time after which the power must be there.
const LONGEST: Duration = Duration::from_secs(60);
/// Part within which it has arrived.
const ARRIVED: f64 = 0.02;
/// Part by which it may be off afterwards.
const TOLERANCE: f64 = 0.1;
/// Part by which a meter that is right may read above the cap.
const READING_TOLERANCE: f64 = 0.02;
/// The power is read in whole milliwatts.
const READING_STEP_MW: f64 = 1.0;
/// Part of the set power that any laser shows that emits at all.
const ANY_LIGHT: f64 = 0.05;

/// How far it has come.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ramp {
    /// Nobody wants light.
    Dark,
    /// On its way since a time, from a power.
    Rising {
        /// When it began, on the clock of the driver.
        since: Duration,
        /// Where it began.
        from: Milliwatts,
    },
    /// It has been at its power.
    Steady,
}

/// Limits of the power.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Aim {
    pub(crate) set: Milliwatts,
    pub(crate) cap: Milliwatts,
}

/// What is wrong with the power.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Deviation {
    /// Above set power or cap.
    #[error("more power than was set, or than its cap")]
    TooMuch,
    /// Fell below.
    #[error("power has fallen by more than a tenth")]
    TooLittle,
    /// Says that it emits and does not.
    #[error("enabled for 60 s and dark: its interlock or key may be open, or its diode dead")]
    Dark,
    /// Not there in time.
    #[error("power was not reached within 60 s")]
    TooSlow,
}

impl Ramp {
    /// The ramp after `measured` was read at `now`.
    pub(crate) fn step(self, aim: Aim, measured: Milliwatts, now: Duration) -> Result<Self, Deviation> {
        let (set, read) = (aim.set.value(), measured.value());
        let highest = match self {
            Self::Rising { from, .. } => set.max(from.value()),
            Self::Dark | Self::Steady => set,
        };
        let limit = (highest * (1.0 + TOLERANCE)).min(aim.cap.value() * (1.0 + READING_TOLERANCE));
        if read > limit + READING_STEP_MW {
            return Err(Deviation::TooMuch);
        }
        match self {
            Self::Dark => Ok(Self::Dark),
            Self::Steady if read < set * (1.0 - TOLERANCE) - READING_STEP_MW => Err(Deviation::TooLittle),
            Self::Steady => Ok(Self::Steady),
            Self::Rising { .. } if (read - set).abs() <= set * ARRIVED + READING_STEP_MW => Ok(Self::Steady),
            Self::Rising { since, .. } if now.saturating_sub(since) < LONGEST => Ok(self),
            Self::Rising { .. } if read < set * ANY_LIGHT => Err(Deviation::Dark),
            Self::Rising { .. } => Err(Deviation::TooSlow),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(ramp: Ramp, read: f64, at_s: u64) -> Result<Ramp, Deviation> {
        let mw = |power| Milliwatts::new(power).unwrap();
        ramp.step(Aim { set: mw(100.0), cap: mw(150.0) }, mw(read), Duration::from_secs(at_s))
    }

    fn rising(from: f64) -> Ramp {
        Ramp::Rising { since: Duration::from_secs(10), from: Milliwatts::new(from).unwrap() }
    }

    #[test]
    fn a_rising_power_has_a_minute() {
        assert_eq!(step(rising(0.0), 3.0, 12), Ok(rising(0.0)));
        assert_eq!(step(rising(0.0), 98.0, 20), Ok(Ramp::Steady));
        assert_eq!(step(rising(0.0), 80.0, 70), Err(Deviation::TooSlow));
        assert_eq!(step(rising(0.0), 2.0, 70), Err(Deviation::Dark));
        assert_eq!(step(rising(0.0), 115.0, 12), Err(Deviation::TooMuch));
    }

    #[test]
    fn a_falling_power_may_come_from_above_but_not_from_above_the_cap() {
        assert_eq!(step(rising(140.0), 139.0, 11), Ok(rising(140.0)));
        assert_eq!(step(rising(149.0), 155.0, 11), Err(Deviation::TooMuch));
    }

    #[test]
    fn a_steady_power_stays_within_a_tenth() {
        assert_eq!(step(Ramp::Steady, 93.0, 99), Ok(Ramp::Steady));
        assert_eq!(step(Ramp::Steady, 88.0, 99), Err(Deviation::TooLittle));
        assert_eq!(step(Ramp::Steady, 112.0, 99), Err(Deviation::TooMuch));
    }
}
