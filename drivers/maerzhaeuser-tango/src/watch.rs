//! What was begun, and how long it may take.

use std::time::Duration;

use sofiscope_hal::{DeviceError, ErrorKind, StagePoint};

use crate::grid::GridPoint;

/// A motion must show itself within this time; before it, an axis that stands may not have begun.
pub(crate) const SHOWS_WITHIN: Duration = Duration::from_millis(300);
/// One leg of homing: the controller itself gives up after 90 s.
pub(crate) const HOMING_LEG: Duration = Duration::from_secs(100);

/// Half of homing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Leg {
    /// `cal`: to the lower end switches, which become the origin.
    Calibration,
    /// `rm`: to the upper ones, which become the limits.
    RangeMeasure,
}

impl Leg {
    pub(crate) fn verb(self) -> &'static str {
        match self {
            Self::Calibration => "cal",
            Self::RangeMeasure => "rm",
        }
    }

    /// What `?calst` has when it is done.
    pub(crate) fn bit(self) -> u32 {
        match self {
            Self::Calibration => 1,
            Self::RangeMeasure => 2,
        }
    }
}

/// When a motion was begun and must be over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Watch {
    pub(crate) begun: Duration,
    pub(crate) until: Duration,
}

impl Watch {
    pub(crate) fn new(now: Duration, time: Duration) -> Self {
        Self { begun: now, until: now + time }
    }

    pub(crate) fn shows(&self, now: Duration) -> bool {
        now >= self.begun + SHOWS_WITHIN
    }
}

/// What the driver has begun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Activity {
    /// The place is not known; homing makes it known.
    Unknown,
    /// Nothing.
    Still,
    /// A move.
    Moving { target: GridPoint, watch: Watch },
    /// The search for the end switches.
    Homing { leg: Leg, watch: Watch },
}

impl Activity {
    pub(crate) fn is_motion(self) -> bool {
        matches!(self, Self::Moving { .. } | Self::Homing { .. })
    }

    /// Whether a move may begin.
    pub(crate) fn allows_move(self, device: &str) -> Result<(), DeviceError> {
        let message = match self {
            Self::Still | Self::Moving { .. } => return Ok(()),
            Self::Unknown => "the place of the stage is not known; home it first",
            Self::Homing { .. } => "the stage is homing; wait for its end, or stop it",
        };
        Err(DeviceError::new(ErrorKind::Busy, device, message))
    }

    /// Whether settings may change.
    pub(crate) fn allows_settings(self, device: &str) -> Result<(), DeviceError> {
        if self.is_motion() {
            let message = "the stage moves; change its properties when it stands";
            return Err(DeviceError::new(ErrorKind::Busy, device, message));
        }
        Ok(())
    }
}

/// Speed and acceleration of one axis, in mm/s and m/s².
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Pace {
    pub(crate) velocity_mm_s: f64,
    pub(crate) acceleration_m_s2: f64,
}

/// Longest time that a move may take: half as much again as a trapezoid takes, and 2 s.
pub(crate) fn allowed(from: StagePoint, to: StagePoint, paces: [Pace; 2]) -> Duration {
    let ways = [from.x.distance(to.x).value(), from.y.distance(to.y).value()];
    let times = ways.into_iter().zip(paces).map(|(way, pace)| trapezoid_s(way, pace));
    let slowest = times.fold(0.0, f64::max);
    Duration::try_from_secs_f64(1.5 * slowest).unwrap_or(HOMING_LEG) + Duration::from_secs(2)
}

fn trapezoid_s(way_um: f64, pace: Pace) -> f64 {
    // The controller takes no slower and no lazier axis than this.
    let speed = 1e3 * pace.velocity_mm_s.max(1e-3);
    let acceleration = 1e6 * pace.acceleration_m_s2.max(1e-3);
    if way_um * acceleration >= speed * speed {
        way_um / speed + speed / acceleration
    } else {
        2.0 * (way_um / acceleration).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sofiscope_hal::Micrometers;

    #[test]
    fn the_slower_axis_decides() {
        let point = |x, y| StagePoint { x: Micrometers::new(x).unwrap(), y: Micrometers::new(y).unwrap() };
        let pace = Pace { velocity_mm_s: 10.0, acceleration_m_s2: 0.2 };
        let time = allowed(point(0.0, 0.0), point(50_000.0, 200.0), [pace; 2]);
        assert!((time.as_secs_f64() - (1.5 * 5.05 + 2.0)).abs() < 1e-6, "{time:?}");
        let slow = Pace { velocity_mm_s: 0.01, ..pace };
        assert!(allowed(point(0.0, 0.0), point(50_000.0, 200.0), [pace, slow]) > Duration::from_secs(30));
    }
}
