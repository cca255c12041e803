//! A measured table from volts to milliwatts.
//!
//! In: points of a power meter. Out: the level for a power. Never: extrapolates. Fails: [`CalibrationError`],
//! [`OutsideCalibration`].

use sofiscope_hal::{Milliwatts, Volts};

/// One reading of the power meter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationPoint {
    /// Level at the input.
    pub level: Volts,
    /// Power that was measured.
    pub power: Milliwatts,
}

/// Why a table is none.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// A line needs two points.
    #[error("{0} points; measure at least 2")]
    TooFew(usize),
    /// A level below zero, or a power below zero.
    #[error("point {0} is below zero")]
    Negative(usize),
    /// Level or power does not rise.
    #[error("point {0} does not lie above the one before, in level and in power")]
    NotRising(usize),
    /// The laser would emit at a level that is meant to be dark.
    #[error("the threshold of {threshold} does not lie within 0 and the first level of {first}")]
    Threshold {
        /// The threshold.
        threshold: Volts,
        /// Level of the first point.
        first: Volts,
    },
}

/// A power beside the table.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{power} is neither 0 nor within the calibrated {least} to {greatest}")]
pub struct OutsideCalibration {
    /// What was asked.
    pub power: Milliwatts,
    /// The least that was measured.
    pub least: Milliwatts,
    /// The most that was measured.
    pub greatest: Milliwatts,
}

/// A table that rises strictly, with straight lines between its points.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    points: Vec<CalibrationPoint>,
    threshold: Volts,
}

impl Calibration {
    /// Checks a table; below `threshold` the laser is dark.
    ///
    /// # Errors
    /// The first fault that is found; points are counted from 1.
    pub fn new(points: Vec<CalibrationPoint>, threshold: Volts) -> Result<Self, CalibrationError> {
        if points.len() < 2 {
            return Err(CalibrationError::TooFew(points.len()));
        }
        let negative = |point: &CalibrationPoint| point.level < Volts::ZERO || point.power < Milliwatts::ZERO;
        if let Some(index) = points.iter().position(negative) {
            return Err(CalibrationError::Negative(index + 1));
        }
        let stays =
            |pair: &[CalibrationPoint]| pair[1].level <= pair[0].level || pair[1].power <= pair[0].power;
        if let Some(index) = points.windows(2).position(stays) {
            return Err(CalibrationError::NotRising(index + 2));
        }
        let first = points[0].level;
        if threshold < Volts::ZERO || threshold > first {
            return Err(CalibrationError::Threshold { threshold, first });
        }
        Ok(Self { points, threshold })
    }

    /// Level below which the laser is dark.
    #[must_use]
    pub fn threshold(&self) -> Volts {
        self.threshold
    }

    /// The most that was measured.
    #[must_use]
    pub fn greatest(&self) -> Milliwatts {
        self.points[self.points.len() - 1].power
    }

    /// The level for a power; no power is no level.
    ///
    /// # Errors
    /// [`OutsideCalibration`] for powers that nobody has measured.
    pub fn level_for(&self, power: Milliwatts) -> Result<Volts, OutsideCalibration> {
        if power == Milliwatts::ZERO {
            return Ok(Volts::ZERO);
        }
        let holds = |pair: &&[CalibrationPoint]| pair[0].power <= power && power <= pair[1].power;
        let level = self.points.windows(2).find(holds).and_then(|pair| {
            let (low, high) = (pair[0], pair[1]);
            let part = (power.value() - low.power.value()) / (high.power.value() - low.power.value());
            let level = low.level.value() + part * (high.level.value() - low.level.value());
            // Rounding must not lead beyond the points.
            Volts::new(level.clamp(low.level.value(), high.level.value())).ok()
        });
        level.ok_or(OutsideCalibration { power, least: self.points[0].power, greatest: self.greatest() })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn volts(level: f64) -> Volts {
        Volts::new(level).unwrap()
    }

    fn mw(power: f64) -> Milliwatts {
        Milliwatts::new(power).unwrap()
    }

    fn table(points: &[(f64, f64)], threshold: f64) -> Result<Calibration, CalibrationError> {
        let point = |&(level, power)| CalibrationPoint { level: volts(level), power: mw(power) };
        Calibration::new(points.iter().map(point).collect(), volts(threshold))
    }

    #[test]
    fn tables_that_are_none_are_refused() {
        assert_eq!(table(&[(1.0, 1.0)], 0.5), Err(CalibrationError::TooFew(1)));
        assert_eq!(table(&[(-1.0, 1.0), (2.0, 3.0)], 0.0), Err(CalibrationError::Negative(1)));
        assert_eq!(table(&[(1.0, 1.0), (1.0, 3.0)], 0.5), Err(CalibrationError::NotRising(2)));
        assert_eq!(table(&[(1.0, 1.0), (2.0, 3.0), (3.0, 3.0)], 0.5), Err(CalibrationError::NotRising(3)));
        assert!(matches!(table(&[(1.0, 1.0), (2.0, 3.0)], 1.5), Err(CalibrationError::Threshold { .. })));
        assert!(matches!(table(&[(1.0, 1.0), (2.0, 3.0)], -0.5), Err(CalibrationError::Threshold { .. })));
    }

    #[test]
    fn between_points_lines_are_straight_and_beyond_them_there_is_nothing() {
        let table = table(&[(1.0, 2.0), (2.0, 10.0), (5.0, 100.0)], 0.8).unwrap();
        let level = |power| table.level_for(mw(power)).map(Volts::value);
        assert_eq!(level(0.0), Ok(0.0));
        assert_eq!(level(6.0), Ok(1.5));
        assert_eq!(level(55.0), Ok(3.5));
        assert_eq!(level(100.0), Ok(5.0));
        for outside in [-1.0, 0.5, 1.99, 100.01, 1e300] {
            assert!(level(outside).is_err(), "{outside}");
        }
    }

    proptest! {
        #[test]
        fn levels_rise_with_power_and_stay_within_the_table(
            steps in prop::collection::vec((0.001..1.0_f64, 0.001..50.0_f64), 2..32),
            parts in prop::array::uniform2(0.0..=1.0_f64),
        ) {
            let mut sum = (0.0, 0.0);
            let points: Vec<_> = steps.iter().map(|step| {
                sum = (sum.0 + step.0, sum.1 + step.1);
                sum
            }).collect();
            let table = table(&points, 0.0).unwrap();
            let (first, last) = (points[0], points[points.len() - 1]);
            let mut powers = parts.map(|part| first.1 + part * (last.1 - first.1));
            powers.sort_by(f64::total_cmp);
            let levels = powers.map(|power| table.level_for(mw(power.min(last.1))).unwrap().value());
            prop_assert!(levels[0] <= levels[1]);
            prop_assert!(first.0 <= levels[0] && levels[1] <= last.0);
        }
    }
}
