//! Do both cameras' first frames show the same exposure?
//!
//! In: device times of the first frames of both cameras, and when they arrived. Out: a [`Start`].
//! Never: reads a clock, compares the clocks of two cameras. Fails: not at all; arrivals that are too irregular say nothing.
//!
//! A camera that misses the very first trigger begins a period late and has no earlier time to compare with.
//! On its own clock its frames lie on a regular grid; arrivals tie both grids to the clock of this computer.
//! Frames are delayed on their way, never early, so that the earliest arrival of several fixes a grid.

use super::alignment::Times;
use sofiscope_hal::{DeviceTime, HostTime};
use std::time::Duration;

/// Frames of each camera that are looked at.
pub(super) const START_FRAMES: usize = 8;

/// Farther than this part of a period from a whole number of periods nothing is concluded.
const CLOSE: f64 = 0.25;

/// One of the first frames: its number since arming, its time, its arrival.
pub(super) type First = (u64, DeviceTime, HostTime);

/// What the first frames tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Start {
    /// Triggers that R and T missed before their first frame, as far as arrivals say; one of them is 0.
    pub(super) missed: [u64; 2],
    /// Times of the exposure before the first, had there been one.
    pub(super) before: Times,
}

/// Where the exposures of one camera lie.
struct Grid {
    /// The first frame's time, to which everything else is relative.
    origin: DeviceTime,
    /// Time of number 0 on the camera's clock, nanoseconds since the origin, by the frame that makes it earliest:
    /// triggers missed later only make it later, and an extra exposure is later than its number would be.
    zero_ns: f64,
    /// When number 0 arrived, or would have without delays, nanoseconds on this computer's clock.
    arrived_ns: f64,
    /// The median delay beyond that.
    delay_ns: f64,
}

/// Compares the first frames of R and T; `None` when arrivals tell nothing.
pub(super) fn compare(frames: &[Vec<First>; 2], period: Duration) -> Option<Start> {
    let period_ns = (period.as_nanos() as f64).max(1.0);
    let [Some(r), Some(t)] = frames.each_ref().map(|frames| grid(frames, period_ns)) else {
        return None;
    };
    let later = (r.arrived_ns - t.arrived_ns) / period_ns;
    let is_clear = (later - later.round()).abs() < CLOSE
        && [&r, &t].into_iter().all(|grid| grid.delay_ns < CLOSE * period_ns);
    if !is_clear {
        return None;
    }
    let late = later.round() as i64;
    let missed = [late.max(0).unsigned_abs(), (-late).max(0).unsigned_abs()];
    let before = [(&r, missed[0]), (&t, missed[1])].map(|(grid, missed)| {
        let since_ns = grid.zero_ns - (missed + 1) as f64 * period_ns;
        DeviceTime(grid.origin.0.wrapping_add_signed(since_ns as i64))
    });
    Some(Start { missed, before })
}

fn grid(frames: &[First], period_ns: f64) -> Option<Grid> {
    let &(_, origin, _) = frames.first()?;
    let since_ns = |time: DeviceTime| time.nanoseconds_since(origin) as f64;
    let zero_ns = frames
        .iter()
        .map(|&(number, time, _)| since_ns(time) - number as f64 * period_ns)
        .fold(f64::INFINITY, f64::min);
    let arrivals = frames.iter().map(|&(_, time, arrived)| arrived.0 as f64 - since_ns(time) + zero_ns);
    let arrived_ns = arrivals.clone().fold(f64::INFINITY, f64::min);
    Some(Grid { origin, zero_ns, arrived_ns, delay_ns: median(arrivals) - arrived_ns })
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(20);

    /// Frames of exposures, numbered from 0 on, that arrive a little after their time, some of them much later.
    fn frames(truly: impl IntoIterator<Item = f64>, clock_ns: u64, delays_ms: &[u64]) -> Vec<First> {
        let frame = |(number, exposure): (usize, f64)| {
            let time_ns = (exposure * 20e6) as u64;
            let delay_ns = 2_000_000 + delays_ms[number % delays_ms.len()] * 1_000_000;
            (number as u64, DeviceTime(clock_ns + time_ns), HostTime(3_000_000_000 + time_ns + delay_ns))
        };
        truly.into_iter().take(START_FRAMES).enumerate().map(frame).collect()
    }

    fn from(first: u32) -> impl Iterator<Item = f64> {
        (first..).map(f64::from)
    }

    #[test]
    fn triggers_missed_at_the_start_are_counted() {
        for (r, t, missed) in [(0, 0, [0, 0]), (1, 0, [1, 0]), (0, 1, [0, 1]), (3, 1, [2, 0])] {
            let first = [frames(from(r), 5_000, &[0, 1, 30]), frames(from(t), 7_000_000_000, &[1, 0])];
            let start = compare(&first, PERIOD).unwrap();
            assert_eq!(start.missed, missed);
            let exposures =
                |time: DeviceTime, clock_ns: u64| time.nanoseconds_since(DeviceTime(clock_ns)) / 20_000_000;
            let before = (exposures(start.before[0], 5_000), exposures(start.before[1], 7_000_000_000));
            assert_eq!(before.0, before.1, "the same exposure");
        }
    }

    #[test]
    fn an_extra_exposure_before_the_first_does_not_count_as_the_first() {
        let early = std::iter::once(0.5).chain(from(1));
        let start =
            compare(&[frames(early, 100_000_000, &[0]), frames(from(1), 100_000_000, &[0])], PERIOD).unwrap();
        assert_eq!((start.missed, start.before[0]), ([0, 1], start.before[1]));
    }

    #[test]
    fn irregular_arrivals_and_half_periods_say_nothing() {
        let late = [0, 19, 15, 40];
        assert_eq!(compare(&[frames(from(1), 0, &late), frames(from(0), 0, &late)], PERIOD), None);
        assert_eq!(compare(&[frames(from(0), 0, &[0]), frames(from(0), 0, &[9])], PERIOD), None);
        assert_eq!(compare(&[Vec::new(), frames(from(0), 0, &[0])], PERIOD), None);
    }
}
