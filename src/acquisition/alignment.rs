//! Do the two cameras' clocks agree that two frames are the same exposure?
//!
//! In: the device times of frames that claim to be one exposure, and of some later ones.
//! Out: a [`Verdict`]. Never: compares clocks themselves, only how their difference changes.
//! Fails: not at all; what cannot be explained is an outlier, and an outlier is no pair.
//!
//! A camera that misses a trigger, or sees one that is none, counts on without a gap: its ids are right and its
//! exposures are wrong. Only time tells: its frames come whole periods late or early from there on.

use sofiscope_hal::{Channel, DeviceTime};
use std::time::Duration;

/// More missed triggers in a row than this are taken for a step of the clock.
const MOST_MISSED: i64 = 1000;

/// More extra exposures in a row than this are taken for a step of the clock.
const MOST_EXTRA: i64 = 64;

/// Times that differ by more than this part of a period are not those of one exposure.
const CLOSE: f64 = 0.25;

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
    /// From here on, this camera's frames belong to exposures earlier by this many; it exposed without a trigger.
    Extra { channel: Channel, triggers: u64 },
    /// The clock of this camera was set to another time.
    ClockStep { channel: Channel, nanoseconds: i64 },
}

/// An exposure of which both frames are there.
pub(super) type Witness = (u64, Times);

/// What is known of the clocks.
#[derive(Debug, Clone)]
pub(super) struct Alignment {
    period_ns: f64,
    /// The last aligned exposure: its index, its times, and the expected difference R - T.
    last: Option<(i64, Times, f64)>,
}

/// Later exposures that must agree before a camera is believed to be off.
pub(super) const WITNESSES: usize = 3;

impl Alignment {
    pub(super) fn new(period: Duration) -> Self {
        Self { period_ns: (period.as_nanos() as f64).max(1.0), last: None }
    }

    /// Takes the times of the exposure before the first as known.
    pub(super) fn begin_after(&mut self, times: Times) {
        self.last = Some((-1, times, difference(times)));
    }

    /// Judges an exposure; `later` are following exposures of which both frames are there.
    pub(super) fn judge(&self, times: Times, later: &[Witness]) -> Verdict {
        let Some((last_exposure, last_times, expected)) = self.last else { return Verdict::Aligned };
        let is_off_by =
            |times: Times, shift_ns: f64| is_close(difference(times) - expected, shift_ns, self.period_ns);
        if is_off_by(times, 0.0) {
            return Verdict::Aligned;
        }
        let Some(&(witness, first)) = later.first().filter(|_| later.len() >= WITNESSES) else {
            return Verdict::Unclear;
        };
        let shift_ns = difference(first) - expected;
        if later.iter().any(|&(_, times)| !is_off_by(times, shift_ns)) || is_off_by(first, 0.0) {
            return Verdict::Outlier;
        }
        let surplus = [0, 1].map(|camera| {
            let due = (witness.cast_signed() - last_exposure) as f64 * self.period_ns;
            first[camera].nanoseconds_since(last_times[camera]) as f64 - due
        });
        let camera = usize::from(surplus[1].abs() > surplus[0].abs());
        let channel = Channel::BOTH[camera];
        let whole = (shift_ns / self.period_ns).round() as i64;
        let is_whole = is_off_by(first, whole as f64 * self.period_ns);
        let went_back = times[camera].nanoseconds_since(last_times[camera]) <= 0;
        let triggers = whole.unsigned_abs();
        // The frame of an extra exposure may be at any time itself; those behind it tell.
        if surplus[camera] < 0.0 && is_whole && !went_back && whole.abs() <= MOST_EXTRA {
            return Verdict::Extra { channel, triggers };
        }
        if !is_off_by(times, shift_ns) {
            return Verdict::Outlier;
        }
        if is_whole && !went_back && whole.abs() <= MOST_MISSED && surplus[camera] > 0.0 {
            return Verdict::Missed { channel, triggers };
        }
        Verdict::ClockStep { channel, nanoseconds: surplus[camera] as i64 }
    }

    /// Learns from an exposure that is aligned, or from which on a clock shows another time.
    pub(super) fn learn(&mut self, exposure: u64, times: Times, verdict: Verdict) {
        let now = difference(times);
        let expected = match (self.last, verdict) {
            (Some((.., expected)), Verdict::Aligned) => expected + (now - expected) * FOLLOW,
            _ => now,
        };
        self.last = Some((exposure.cast_signed(), times, expected));
    }
}

fn is_close(one_ns: f64, other_ns: f64, period_ns: f64) -> bool {
    (one_ns - other_ns).abs() < CLOSE * period_ns
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
            assert_eq!(alignment.judge(now, &[]), Verdict::Aligned, "{exposure}");
            alignment.learn(exposure, now, Verdict::Aligned);
        }
        alignment
    }

    fn following(exposure: u64, shift: [u64; 2]) -> [Witness; WITNESSES] {
        [1, 2, 3]
            .map(|ahead| (exposure + ahead, times(exposure + ahead + shift[0], exposure + ahead + shift[1])))
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
            assert_eq!(alignment.judge(now, &[]), Verdict::Unclear);
            let verdict = alignment.judge(now, &following(100, shift));
            assert_eq!(verdict, Verdict::Missed { channel, triggers: 1 });
        }
    }

    #[test]
    fn a_single_odd_time_is_no_pair_and_no_slip() {
        let alignment = aligned_until(100);
        assert_eq!(alignment.judge(times(102, 100), &following(100, [0, 0])), Verdict::Outlier);
    }

    #[test]
    fn a_clock_that_is_set_back_is_no_missed_trigger() {
        let mut alignment = aligned_until(100);
        let back = |times: Times| [DeviceTime(times[0].0 - 1_000_000_000), times[1]];
        let later = following(100, [0, 0]).map(|(exposure, times)| (exposure, back(times)));
        let now = back(times(100, 100));
        let verdict = alignment.judge(now, &later);
        assert!(matches!(verdict, Verdict::ClockStep { channel: Channel::Reflected, .. }), "{verdict:?}");
        alignment.learn(100, now, verdict);
        assert_eq!(alignment.judge(later[0].1, &[]), Verdict::Aligned);
    }

    #[test]
    fn a_clock_that_steps_by_no_whole_number_of_periods_is_no_missed_trigger() {
        for periods in [0.4, 0.6, 7.5, -0.4] {
            let alignment = aligned_until(100);
            let step = |(exposure, times): Witness| {
                let step_ns = (periods * PERIOD as f64) as i64;
                (exposure, [times[0], DeviceTime(times[1].0.wrapping_add_signed(step_ns))])
            };
            let later = following(100, [0, 0]).map(step);
            let verdict = alignment.judge(step((100, times(100, 100))).1, &later);
            let nanoseconds = (periods * PERIOD as f64) as i64;
            assert!(
                matches!(verdict, Verdict::ClockStep { channel: Channel::Transmitted, nanoseconds: found }
                    if (found - nanoseconds).abs() < 10_000),
                "{periods}: {verdict:?}"
            );
        }
    }

    #[test]
    fn an_extra_exposure_is_seen_on_the_camera_that_made_it() {
        let alignment = aligned_until(100);
        // Camera T counts one exposure too many, at any time before the next: its frames are one period early from there on.
        let early = |ahead: u64| (100 + ahead, times(100 + ahead, 99 + ahead));
        let later = [early(1), early(2), early(3)];
        for part in [0, 3, 5, 7] {
            let (_, mut now) = early(0);
            now[1] = DeviceTime(now[1].0 + PERIOD * part / 10);
            assert_eq!(alignment.judge(now, &[]), Verdict::Unclear);
            let verdict = alignment.judge(now, &later);
            assert!(
                part == 0 && matches!(verdict, Verdict::ClockStep { .. })
                    || verdict == Verdict::Extra { channel: Channel::Transmitted, triggers: 1 },
                "{part}: {verdict:?}"
            );
        }
    }

    #[test]
    fn the_first_exposure_is_judged_by_what_is_known_of_the_start() {
        let mut alignment = Alignment::new(Duration::from_nanos(PERIOD));
        alignment.begin_after(times(10, 10));
        assert_eq!(alignment.judge(times(11, 11), &[]), Verdict::Aligned);
        assert_eq!(alignment.judge(times(12, 11), &[]), Verdict::Unclear);
        let later = [0, 1, 2].map(|ahead| (1 + ahead, times(13 + ahead, 12 + ahead)));
        let verdict = alignment.judge(times(12, 11), &later);
        assert_eq!(verdict, Verdict::Missed { channel: Channel::Reflected, triggers: 1 });
    }
}
