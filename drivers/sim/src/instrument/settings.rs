//! How the simulated instrument behaves: pace, counters, clocks, faults.
//!
//! In: nothing, or a [`Scenario`](super::Scenario). Out: plain values. Never: decides anything.

use std::sync::Arc;
use std::time::Duration;

use sofiscope_hal::{BlockId, Clock, IdRule, MonotonicClock};

/// How fast frames come.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pace {
    /// As fast as they are read, in virtual time; nothing is lost to a slow reader.
    Unpaced,
    /// By the clock; a slow reader loses frames when the driver's buffers are full.
    RealTime {
        /// Seconds of the instrument per second of the clock; 1 is the pace of a real camera.
        speed: f64,
    },
}

/// How a camera counts its frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Counter {
    /// 16 bit, 65535 is followed by 1; begins at 65400, so that it soon wraps.
    Careless16Bit,
    /// 64 bit, begins at 0.
    FromZero,
}

impl Counter {
    /// The rule for the driver, which allows frames to come late by `reorder`.
    pub(super) fn rule(self, reorder: u64) -> IdRule {
        let rule = match self {
            Self::Careless16Bit => IdRule { first: Some(BlockId(65_400)), ..IdRule::GIGE_VISION_16_BIT },
            Self::FromZero => IdRule::FROM_ZERO,
        };
        IdRule { reorder: rule.reorder.max(reorder), ..rule }
    }

    /// The id after `count` frames.
    pub(super) fn id(self, count: u64) -> BlockId {
        match self {
            Self::Careless16Bit => BlockId(1 + (65_399 + count) % 65_535),
            Self::FromZero => BlockId(count),
        }
    }
}

/// The clock of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeviceClock {
    /// Its time when the camera is armed for the first time.
    pub offset: Duration,
    /// Parts per million by which it runs fast.
    pub drift_ppm: f64,
    /// Each time is wrong by up to this many nanoseconds, either way; at most a quarter of the period.
    pub jitter_ns: u64,
}

/// Whole frames that go missing one after another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bursts {
    /// Probability that a burst begins with an exposure, 0 to 1.
    pub probability: f64,
    /// Fewest and most exposures in a burst.
    pub lengths: [u64; 2],
}

/// A jump of a camera's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockStep {
    /// First exposure with the new time.
    pub at: u64,
    /// Seconds by which the clock jumps; negative for backwards. At most 100000 either way.
    pub seconds: f64,
}

/// What goes wrong with one camera; nothing by default.
///
/// "One in N" is a probability of 1/N for each exposure by itself. Exposures are counted from arming.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraFaults {
    /// One in this many frames never arrives; its id is a gap.
    pub drop_one_in: Option<u64>,
    /// Runs of frames that never arrive.
    pub bursts: Option<Bursts>,
    /// One in this many intact frames arrives twice.
    pub duplicate_one_in: Option<u64>,
    /// Frames arrive shuffled within windows of this many exposures, 2 to 64.
    pub reorder_within: Option<u64>,
    /// One in this many frames arrives late.
    pub late_one_in: Option<u64>,
    /// Exposures by which late frames are late, 1 to 64.
    pub late_by_frames: u64,
    /// One in this many frames lacks packets.
    pub incomplete_one_in: Option<u64>,
    /// Frames of another size than configured.
    pub wrong_size_at: Vec<u64>,
    /// Triggers that the camera misses: its ids have no gap, but every later frame is one exposure off.
    pub missed_trigger_at: Vec<u64>,
    /// First exposure of which nothing comes any more, without any error.
    pub stall_at: Option<u64>,
    /// First exposure at which the camera is gone.
    pub die_at: Option<u64>,
    /// Exposures before which the camera exposes once more, half a period early: its ids have no gap, and every
    /// later frame is numbered one exposure too high.
    pub extra_trigger_at: Vec<u64>,
    /// First exposure after the counter began anew; 1 to 30000, so that it can be recognized by its ids.
    ///
    /// It still cannot when a thousand frames around it are lost; a trigger missed among the frames lost just
    /// around it is made good by the clock, so that later frames are not one exposure off for it.
    pub id_restart_at: Option<u64>,
    /// A jump of the camera's clock.
    pub clock_step: Option<ClockStep>,
    /// Arming fails with a fault of the device.
    pub start_fails: bool,
}

/// One simulated camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraBehavior {
    /// How it counts.
    pub counter: Counter,
    /// Its clock.
    pub clock: DeviceClock,
    /// Frames that the driver keeps for a slow reader; at least 1. Matters in real time only.
    pub buffers: usize,
    /// What goes wrong.
    pub faults: CameraFaults,
}

/// The whole instrument.
#[derive(Debug, Clone)]
pub struct InstrumentSettings {
    /// How fast frames come.
    pub pace: Pace,
    /// Decides, with channel and exposure, about every fault.
    pub seed: u64,
    /// Both cameras end after this many exposures.
    pub exposures: Option<u64>,
    /// Camera R and camera T.
    pub cameras: [CameraBehavior; 2],
    /// The clock of this computer.
    pub clock: Arc<dyn Clock>,
}

impl Default for InstrumentSettings {
    /// Unpaced and without faults; clocks far apart, which drift and jitter a little.
    fn default() -> Self {
        let behavior = |offset_s, drift_ppm| CameraBehavior {
            counter: Counter::Careless16Bit,
            clock: DeviceClock { offset: Duration::from_secs(offset_s), drift_ppm, jitter_ns: 2000 },
            buffers: 16,
            faults: CameraFaults::default(),
        };
        Self {
            pace: Pace::Unpaced,
            seed: 1,
            exposures: None,
            cameras: [behavior(1_000_000, 8.0), behavior(7_300_000, -11.0)],
            clock: Arc::new(MonotonicClock::default()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_careless_counter_wraps_past_zero() {
        let ids = [0, 135, 136, 135 + 65_535].map(|count| Counter::Careless16Bit.id(count).0);
        assert_eq!(ids, [65_400, 65_535, 1, 65_535]);
        assert_eq!(Counter::FromZero.id(70_000), BlockId(70_000));
    }
}
