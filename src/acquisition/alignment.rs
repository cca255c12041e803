//! Do the two cameras' clocks agree that two frames are the same exposure?
//!
//! In: the device times of frames that claim to be one exposure, and of some later ones.
//! Out: a [`Verdict`]. Never: compares clocks themselves, only how their difference changes.
//! Fails: not at all; what cannot be explained is an outlier, and an outlier is no pair.
//!
//! A camera that misses a trigger counts on without a gap: its ids are right and its exposures are wrong.
//! Only time tells: its frames come a whole period late from there on.

use sofiscope_hal::{Channel, DeviceTime};
use std::time::Duration;

/// More missed triggers in a row than this are taken for a step of the clock.
const MOST_MISSED: i64 = 1000;

/// Part of a new difference that enters the expected one; follows a drift of 100 ppm at any usual frame rate.
const FOLLOW: f64 = 1.0 / 8.0;

/// Times of one exposure on both cameras' clocks, in the order R, T.
pub(super) type Times = [DeviceTime; 2];

/// What the times say of an exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// The same exposure.
    Aligned,
    /// More exposures are needed to tell.
    Unclear,
    /// Not the same exposure, and nothing follows from it for others.
    Outlier,
    /// From here on, this camera's frames belong to exposures later by this many.
    Missed { channel: Channel, triggers: u64 },
    /// The clock of this camera was set to another time.
    ClockStep { channel: Channel, nanoseconds: i64 },
}

/// What is known of the clocks.
#[derive(Debug, Clone)]
pub(super) struct Alignment {
    period_ns: f64,
    /// The last aligned exposure: its index, its times, and the expected difference R - T.
    last: Option<(u64, Times, f64)>,
}

/// Later exposures that must agree before a camera is believed to have missed a trigger.
pub(super) const WITNESSES: usize = 3;

impl Alignment {
    pub(super) fn new(period: Duration) -> Self {
        Self { period_ns: (period.as_nanos() as f64).max(1.0), last: None }
    }

    /// Judges an exposure; `later` are times of following exposures of which both frames are there.
    pub(super) fn judge(&self, exposure: u64, times: Times, later: &[Times]) -> Verdict {
        let Some((last_exposure, last_times, expected)) = self.last else { return Verdict::Aligned };
        let periods = |times: Times| ((difference(times) - expected) / self.period_ns).round() as i64;
        let off = periods(times);
        if off == 0 {
            return Verdict::Aligned;
        }
        if later.len() < WITNESSES {
            return Verdict::Unclear;
        }
        if later.iter().any(|&times| periods(times) != off) {
            return Verdict::Outlier;
        }
        let elapsed = |camera: usize| times[camera].nanoseconds_since(last_times[camera]) as f64;
        let due = (exposure - last_exposure) as f64 * self.period_ns;
        let surplus = [elapsed(0) - due, elapsed(1) - due];
        let camera = usize::from(surplus[1].abs() > surplus[0].abs());
        let channel = Channel::BOTH[camera];
        if elapsed(camera) <= 0.0 || off.abs() > MOST_MISSED {
            return Verdict::ClockStep { channel, nanoseconds: surplus[camera] as i64 };
        }
        if surplus[camera] > 0.0 {
            return Verdict::Missed { channel, triggers: off.unsigned_abs() };
        }
        Verdict::Outlier
    }

    /// Learns from an exposure that is aligned, or from which on a clock shows another time.
    pub(super) fn learn(&mut self, exposure: u64, times: Times, verdict: Verdict) {
        let now = difference(times);
        let expected = match (self.last, verdict) {
            (Some((.., expected)), Verdict::Aligned) => expected + (now - expected) * FOLLOW,
            _ => now,
        };
        self.last = Some((exposure, times, expected));
    }
}

fn difference([reflected, transmitted]: Times) -> f64 {
    reflected.nanoseconds_since(transmitted) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: u64 = 20_000_000;

    fn times(reflected: u64, transmitted: u64) -> Times {
        [DeviceTime(5_000 + reflected * PERIOD), DeviceTime(37_000_000_000 + transmitted * (PERIOD + 2_000))]
    }

    fn aligned_until(exposures: u64) -> Alignment {
        let mut alignment = Alignment::new(Duration::from_nanos(PERIOD));
        for exposure in 0..exposures {
            let now = times(exposure, exposure);
            assert_eq!(alignment.judge(exposure, now, &[]), Verdict::Aligned, "{exposure}");
            alignment.learn(exposure, now, Verdict::Aligned);
        }
        alignment
    }

    fn following(exposure: u64, shift: [u64; 2]) -> [Times; WITNESSES] {
        [1, 2, 3].map(|ahead| times(exposure + ahead + shift[0], exposure + ahead + shift[1]))
    }

    #[test]
    fn clocks_may_be_far_apart_and_drift_for_a_whole_run() {
        // 100 ppm over 100 000 exposures are 200 s, ten thousand periods.
        aligned_until(100_000);
    }

    #[test]
    fn a_missed_trigger_is_seen_on_the_camera_that_missed_it() {
        let alignment = aligned_until(100);
        for (shift, channel) in [([1, 0], Channel::Reflected), ([0, 1], Channel::Transmitted)] {
            let now = times(100 + shift[0], 100 + shift[1]);
            assert_eq!(alignment.judge(100, now, &[]), Verdict::Unclear);
            let verdict = alignment.judge(100, now, &following(100, shift));
            assert_eq!(verdict, Verdict::Missed { channel, triggers: 1 });
        }
    }

    #[test]
    fn a_single_odd_time_is_no_pair_and_no_slip() {
        let alignment = aligned_until(100);
        assert_eq!(alignment.judge(100, times(102, 100), &following(100, [0, 0])), Verdict::Outlier);
    }

    #[test]
    fn a_clock_that_is_set_back_is_no_missed_trigger() {
        let mut alignment = aligned_until(100);
        let back = |times: Times| [DeviceTime(times[0].0 - 1_000_000_000), times[1]];
        let later = following(100, [0, 0]).map(back);
        let now = back(times(100, 100));
        let verdict = alignment.judge(100, now, &later);
        assert!(matches!(verdict, Verdict::ClockStep { channel: Channel::Reflected, .. }), "{verdict:?}");
        alignment.learn(100, now, verdict);
        assert_eq!(alignment.judge(101, later[0], &[]), Verdict::Aligned);
    }

    #[test]
    fn an_extra_trigger_is_never_a_pair() {
        let alignment = aligned_until(100);
        // Camera T counts one exposure too many: its frames are one period early from here on.
        let early = |ahead: u64| times(100 + ahead, 99 + ahead);
        let mut now = early(0);
        now[1] = DeviceTime(now[1].0 + PERIOD / 4);
        assert_eq!(alignment.judge(100, now, &[early(1), early(2), early(3)]), Verdict::Outlier);
    }
}
