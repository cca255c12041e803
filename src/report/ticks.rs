//! Where an axis has its ticks and what they say.
//!
//! In: the range of the data. Out: a range that ends on ticks, the ticks and their labels.
//! Never: makes more than about eight ticks. Fails: never; ranges without extent are widened.

use super::text;
use crate::display::nice_length_at_most;

/// An axis ready to be drawn.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Scale {
    /// Value at the start.
    pub(super) low: f64,
    /// Value at the end, above `low`.
    pub(super) high: f64,
    /// Ticks inside the range, with labels.
    pub(super) ticks: Vec<(f64, String)>,
    /// Labels are in units of ten to this power.
    pub(super) exponent: i32,
}

/// Chooses ticks for data between `low` and `high`; the ends move outward to the next tick.
pub(super) fn outward(low: f64, high: f64) -> Scale {
    let (low, high) = widened(low, high);
    let step = step_for(low, high);
    scale((low / step).floor() * step, (high / step - 1e-9).ceil() * step, step)
}

/// Chooses ticks for data between `low` and `high` and keeps the ends.
pub(super) fn exact(low: f64, high: f64) -> Scale {
    let (low, high) = widened(low, high);
    scale(low, high, step_for(low, high))
}

impl Scale {
    /// Place of `value` on the axis, 0 at the start and 1 at the end.
    pub(super) fn place(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }
}

fn widened(low: f64, high: f64) -> (f64, f64) {
    match (low, high) {
        (low, high) if !(low.is_finite() && high.is_finite() && (high - low).is_finite()) => (0.0, 1.0),
        (low, high) if high - low > 1e-12 * low.abs().max(high.abs()) => (low, high),
        (same, _) => (same - same.abs().max(1.0) / 2.0, same + same.abs().max(1.0) / 2.0),
    }
}

/// The smallest 1-2-5 step that gives at most seven intervals.
fn step_for(low: f64, high: f64) -> f64 {
    let least = (high - low) / 7.0;
    let below = nice_length_at_most(least).unwrap_or(least);
    if below >= least * (1.0 - 1e-9) {
        return below;
    }
    // The next longer one follows 1 by 2, 2 by 5, 5 by 10.
    nice_length_at_most(below * 2.5).unwrap_or(least)
}

#[expect(clippy::cast_possible_truncation, reason = "a handful of ticks; decimals of numbers near one")]
fn scale(low: f64, high: f64, step: f64) -> Scale {
    let largest = low.abs().max(high.abs());
    let exponent =
        if (1e-2..1e5).contains(&largest) { 0 } else { (largest.log10().floor() / 3.0).floor() as i32 * 3 };
    let unit = 10_f64.powi(exponent);
    let decimals = (-(step / unit).log10().floor()).clamp(0.0, 9.0) as usize;
    let first = (low / step - 1e-6).ceil();
    let num = ((high / step + 1e-6).floor() - first).clamp(0.0, 20.0) as i32;
    let values = (0..=num).map(|index| (first + f64::from(index)) * step);
    let label = |value: f64| match value / unit {
        scaled if decimals == 0 => text::count(scaled),
        scaled => text::minus(&format!("{:.decimals$}", scaled + 0.0)),
    };
    Scale { low, high, ticks: values.map(|value| (value, label(value))).collect(), exponent }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(scale: &Scale) -> Vec<&str> {
        scale.ticks.iter().map(|(_, label)| label.as_str()).collect()
    }

    #[test]
    fn ends_move_to_ticks() {
        let scale = outward(3.0, 96.0);
        assert_eq!(labels(&scale), ["0", "20", "40", "60", "80", "100"]);
        assert_eq!((scale.low, scale.high), (0.0, 100.0));
        assert_eq!(
            labels(&outward(0.0, 0.35)),
            ["0.00", "0.05", "0.10", "0.15", "0.20", "0.25", "0.30", "0.35"]
        );
        assert_eq!(labels(&exact(0.0, 3999.0)), ["0", "1000", "2000", "3000"]);
    }

    #[test]
    fn large_numbers_share_a_power_of_ten() {
        let scale = outward(0.0, 2.4e6);
        assert_eq!((scale.exponent, labels(&scale)[1]), (6, "0.5"));
        let scale = outward(-2e-5, 2e-5);
        assert_eq!((scale.exponent, labels(&scale)[0]), (-6, "−20"));
    }

    #[test]
    fn ranges_without_extent_still_work() {
        for (low, high) in [(5.0, 5.0), (0.0, 0.0), (f64::NAN, 1.0), (-f64::MAX, f64::MAX), (1e300, 1e300)] {
            let scale = outward(low, high);
            assert!(scale.high > scale.low && !scale.ticks.is_empty(), "{low} {high} {scale:?}");
        }
    }
}
