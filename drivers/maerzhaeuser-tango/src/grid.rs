//! Places as the controller takes them: millimeters with four decimals.

use std::ops::RangeInclusive;

use sofiscope_hal::{Micrometers, StageEnvelope, StagePoint};

/// Tenths beyond which no stage goes, and numbers are no longer exact.
const FARTHEST: f64 = 1e12;

/// Tenths of a micrometer: the fourth decimal of a millimeter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Tenths(i64);

impl Tenths {
    /// The nearest place on the grid that is inside, for a target that is inside; `None` for one that is not,
    /// or where no place of the grid is inside.
    fn inside(range: &RangeInclusive<Micrometers>, target: Micrometers) -> Option<Self> {
        let nearest = 10.0 * target.value();
        let candidates = [nearest.round(), nearest.floor(), nearest.ceil()];
        let place = candidates.map(|tenths| Self(tenths as i64)).into_iter();
        let mut inside =
            place.filter(|tenths| tenths.micrometers().is_some_and(|place| range.contains(&place)));
        if range.contains(&target) && nearest.abs() < FARTHEST { inside.next() } else { None }
    }

    fn micrometers(self) -> Option<Micrometers> {
        Micrometers::new(self.0 as f64 / 10.0).ok()
    }
}

impl std::fmt::Display for Tenths {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (sign, tenths) = (if self.0 < 0 { "-" } else { "" }, self.0.unsigned_abs());
        write!(formatter, "{sign}{}.{:04}", tenths / 10_000, tenths % 10_000)
    }
}

/// A target on the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct GridPoint {
    x: Tenths,
    y: Tenths,
}

impl GridPoint {
    /// The place of the grid for `target`, never outside the envelope.
    pub(crate) fn inside(envelope: &StageEnvelope, target: StagePoint) -> Option<Self> {
        Some(Self { x: Tenths::inside(&envelope.x, target.x)?, y: Tenths::inside(&envelope.y, target.y)? })
    }

    /// Back to micrometers.
    pub(crate) fn micrometers(self) -> Option<StagePoint> {
        Some(StagePoint { x: self.x.micrometers()?, y: self.y.micrometers()? })
    }
}

impl std::fmt::Display for GridPoint {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{} {}", self.x, self.y)
    }
}

/// What two envelopes have in common; `None` when that is nothing.
pub(crate) fn common(configured: &StageEnvelope, device: &StageEnvelope) -> Option<StageEnvelope> {
    let axis = |a: &RangeInclusive<Micrometers>, b: &RangeInclusive<Micrometers>| {
        let start = if a.start() >= b.start() { *a.start() } else { *b.start() };
        let end = if a.end() <= b.end() { *a.end() } else { *b.end() };
        (start < end).then_some(start..=end)
    };
    Some(StageEnvelope { x: axis(&configured.x, &device.x)?, y: axis(&configured.y, &device.y)? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn length(value: f64) -> Micrometers {
        Micrometers::new(value).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100_000))]

        #[test]
        fn what_is_written_is_inside_and_near(
            start in -1e5..1e5_f64, width in 0.0..2e5_f64, share in 0.0..=1.0_f64, special in 0..4,
        ) {
            let (start, end) = (start, start + width);
            let target = match special {
                0 => start,
                1 => end,
                _ => (start + share * width).clamp(start, end),
            };
            let range = length(start)..=length(end);
            if let Some(tenths) = Tenths::inside(&range, length(target)) {
                let written: f64 = tenths.to_string().parse().unwrap();
                let written = (written * 1e4).round() / 10.0;
                prop_assert!((start..=end).contains(&written), "{written} in {start}..={end}");
                prop_assert!((written - target).abs() <= 0.1 + 1e-9);
            } else {
                prop_assert!(width < 0.2);
            }
        }

        #[test]
        fn what_is_outside_has_no_place(start in -1e5..1e5_f64, width in 0.0..2e5_f64, target in any::<f64>()) {
            let Ok(target) = Micrometers::new(target) else { return Ok(()) };
            let range = length(start)..=length(start + width);
            if target.value() < start || target.value() > start + width {
                prop_assert_eq!(Tenths::inside(&range, target), None);
            }
        }
    }

    #[test]
    fn places_are_written_in_millimeters() {
        for (tenths, written) in [(13_000, "1.3000"), (-3000, "-0.3000"), (-1, "-0.0001"), (0, "0.0000")] {
            assert_eq!(Tenths(tenths).to_string(), written);
        }
    }

    #[test]
    fn envelopes_without_common_places_have_none() {
        let envelope =
            |x: [f64; 2]| StageEnvelope { x: length(x[0])..=length(x[1]), y: length(0.0)..=length(1.0) };
        assert_eq!(common(&envelope([0.0, 5.0]), &envelope([3.0, 9.0])), Some(envelope([3.0, 5.0])));
        assert_eq!(common(&envelope([0.0, 5.0]), &envelope([5.0, 9.0])), None);
    }
}
