//! Contrast: which value is drawn darkest and which brightest.
//!
//! In: the values of one image, NaN where nothing could be computed. Out: two limits, low below high.
//! Never: fails on an image that is constant, negative or empty; changes data.
//! Fails: never.

use serde::{Deserialize, Serialize};

/// The values drawn with the lowest and the highest color; `low < high`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// Drawn with the lowest color, as is everything below.
    pub low: f64,
    /// Drawn with the highest color, as is everything above.
    pub high: f64,
}

impl Limits {
    /// Place of `value` between the limits, 0 to 1, clipped; NaN stays NaN.
    #[must_use]
    pub fn fraction(self, value: f64) -> f64 {
        if value.is_nan() {
            return f64::NAN;
        }
        let fraction = (value - self.low) / (self.high - self.low);
        // Limits that coincide show a step instead of nothing.
        if fraction.is_nan() { f64::from(u8::from(value > self.low)) } else { fraction.clamp(0.0, 1.0) }
    }
}

/// How the limits of an image are found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Contrast {
    /// The percentiles `low` and `high` (0 to 100) of the finite pixels.
    Percentile {
        /// Percent of the pixels that may lie below the lowest color.
        low: f64,
        /// Percent of the pixels that lie below the highest color.
        high: f64,
    },
    /// Zero to the percentile `high` (0 to 100): for images whose background is zero, such as cumulants.
    /// Negative noise is drawn black, which keeps additive composites dark where there is nothing.
    FromZero {
        /// Percent of the pixels that lie below the highest color.
        high: f64,
    },
    /// Limits set by hand.
    Manual(Limits),
}

impl Default for Contrast {
    /// 0.1 % to 99.9 %.
    fn default() -> Self {
        Self::Percentile { low: 0.1, high: 99.9 }
    }
}

impl Contrast {
    /// The limits for these values; NaN and infinities are ignored.
    ///
    /// Without any finite value the limits are 0 and 1.
    /// A constant image is drawn with the lowest color.
    #[must_use]
    pub fn limits<'a>(self, values: impl IntoIterator<Item = &'a f32>) -> Limits {
        let (low, high) = match self {
            Self::Manual(limits) => return limits,
            Self::Percentile { low, high } => (Some(low.min(high)), low.max(high)),
            Self::FromZero { high } => (None, high),
        };
        let mut finite: Vec<f32> = values.into_iter().copied().filter(|value| value.is_finite()).collect();
        let lowest = low.map_or(Some(0.0), |low| percentile(&mut finite, low));
        match (lowest, percentile(&mut finite, high)) {
            (Some(low), Some(high)) if high > low => Limits { low, high },
            (Some(low), Some(_)) => Limits { low, high: low + low.abs().max(1.0) },
            _ => Limits { low: 0.0, high: 1.0 },
        }
    }
}

/// The percentile `percent` (0 to 100, clipped) of finite values, by linear interpolation between the
/// two nearest ranks, so that 0 is the least and 100 the greatest; `None` if there are no values.
///
/// Reorders the values and takes time proportional to their number.
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a rank inside the slice")]
pub fn percentile(values: &mut [f32], percent: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let rank = percent.clamp(0.0, 100.0) / 100.0 * last as f64;
    let below = (rank.floor() as usize).min(last);
    let (_, &mut lower, above) = values.select_nth_unstable_by(below, f32::total_cmp);
    let upper = above.iter().copied().min_by(f32::total_cmp).unwrap_or(lower);
    let share = rank - below as f64;
    Some(f64::from(lower) * (1.0 - share) + f64::from(upper) * share)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn by_sorting(values: &[f32], percent: f64) -> f64 {
        let mut sorted = values.to_vec();
        sorted.sort_by(f32::total_cmp);
        let rank = percent / 100.0 * (sorted.len() - 1) as f64;
        let (low, high) = (rank.floor() as usize, rank.ceil() as usize);
        let share = rank - rank.floor();
        f64::from(sorted[low]) * (1.0 - share) + f64::from(sorted[high]) * share
    }

    proptest! {
        #[test]
        fn percentile_agrees_with_a_sort(
            values in prop::collection::vec(-1e6f32..1e6, 1..200),
            percent in 0.0..=100.0,
        ) {
            let expected = by_sorting(&values, percent);
            let found = percentile(&mut values.clone(), percent).unwrap();
            prop_assert!((found - expected).abs() <= 1e-9 * expected.abs().max(1.0));
        }
    }

    #[test]
    fn holes_do_not_count() {
        let values = [f32::NAN, 1.0, 2.0, 3.0, f32::INFINITY];
        let limits = Contrast::Percentile { low: 0.0, high: 100.0 }.limits(&values);
        assert_eq!(limits, Limits { low: 1.0, high: 3.0 });
    }

    #[test]
    fn unusual_images_have_usable_limits() {
        let contrast = Contrast::default();
        assert_eq!(contrast.limits(&[f32::NAN; 4]), Limits { low: 0.0, high: 1.0 });
        assert_eq!(contrast.limits(&[]), Limits { low: 0.0, high: 1.0 });
        for constant in [0.0, 7.0, -1e30, f32::MAX] {
            let limits = contrast.limits(&[constant; 9]);
            assert!(limits.high > limits.low);
            assert_eq!(limits.fraction(f64::from(constant)), 0.0);
        }
        let negative = contrast.limits(&[-5.0, -4.0, -3.0]);
        assert!(negative.low < negative.high && negative.high < 0.0);
        let from_zero = Contrast::FromZero { high: 99.0 };
        assert_eq!(from_zero.limits(&[-5.0, -4.0]), Limits { low: 0.0, high: 1.0 });
        assert_eq!(from_zero.limits(&[-5.0, 4.0, 4.0, 4.0]).high, 4.0);
    }

    #[test]
    fn manual_limits_win() {
        let limits = Limits { low: -1.0, high: 3.0 };
        assert_eq!(Contrast::Manual(limits).limits(&[100.0]), limits);
        assert_eq!(limits.fraction(1.0), 0.5);
        assert_eq!(limits.fraction(9.0), 1.0);
        assert!(limits.fraction(f64::NAN).is_nan());
        let step = Limits { low: 2.0, high: 2.0 };
        assert_eq!((step.fraction(1.0), step.fraction(2.0), step.fraction(3.0)), (0.0, 0.0, 1.0));
    }
}
