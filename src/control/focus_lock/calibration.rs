//! What a signal of the focus sensor means in nanometers, found by a sweep of the drive.
//!
//! A line is fitted to the readings near the middle of the sweep; a sweep that is no line there, or whose signal
//! hardly changes, is refused. How far from focus the signal still tells the way is taken from where it stops
//! changing in one direction.

use serde::{Deserialize, Serialize};
use sofiscope_hal::{FocusReading, Nanometers};

/// Half of the sweep that is fitted: ± 500 nm around its middle.
const FITTED_NM: f64 = 500.0;
/// Smallest share of the variance that the line must explain.
const LEAST_R_SQUARED: f64 = 0.99;
/// Share of the light in focus below which a reading is not trusted.
const LEAST_LIGHT_SHARE: f64 = 0.5;

/// One place of the sweep and what the sensor saw there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepPoint {
    /// Where the drive was.
    pub z: Nanometers,
    /// Mean of the readings there.
    pub reading: FocusReading,
}

/// What makes a reading worth believing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Trust {
    /// Least light on the sensor, in its own units.
    pub least_light: f64,
    /// Largest saturated share of the spot.
    pub most_saturated: f64,
    /// Least shape, 0 to 1.
    pub least_shape: f64,
}

impl Trust {
    /// Whether a reading can be believed.
    #[must_use]
    pub fn accepts(&self, reading: &FocusReading) -> bool {
        reading.signal.is_finite()
            && reading.light >= self.least_light
            && reading.saturated <= self.most_saturated
            && reading.shape >= self.least_shape
    }
}

/// From signal to focus error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Signal in focus.
    pub zero: f64,
    /// Change of the signal when the drive goes up by one nanometer; its sign is that of the optics.
    pub slope_per_nm: f64,
    /// Focus errors up to this size are told with the right sign.
    pub capture: Nanometers,
    /// What makes a reading worth believing.
    pub trust: Trust,
}

/// Why a sweep gives no calibration.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// Not enough places near the middle.
    #[error(
        "only {0} of the sweep's places have a usable signal within ± 500 nm of its middle; at least 5 are needed"
    )]
    TooFew(usize),
    /// The signal is no line there.
    #[error(
        "the signal does not follow a line (r² = {0:.3}, at least 0.99 is needed); check the beam and reduce vibrations"
    )]
    NoLine(f64),
    /// The signal hardly changes.
    #[error(
        "the signal changes by {found:.4} per µm only, at least {needed} is needed; check the angle of the beam"
    )]
    Flat {
        /// What was found.
        found: f64,
        /// What is needed.
        needed: f64,
    },
}

impl Calibration {
    /// Fits a sweep; `least_slope_per_um` is the smallest usable change of the signal (3 pixels per micrometer
    /// for a spot on a camera).
    ///
    /// # Errors
    /// [`CalibrationError`].
    pub fn from_sweep(sweep: &[SweepPoint], least_slope_per_um: f64) -> Result<Self, CalibrationError> {
        let usable: Vec<&SweepPoint> =
            sweep.iter().filter(|point| point.reading.signal.is_finite()).collect();
        let middle = middle_of(&usable);
        let near: Vec<(f64, f64)> = usable
            .iter()
            .map(|point| (point.z.value() - middle, point.reading.signal))
            .filter(|(z, _)| z.abs() <= FITTED_NM)
            .collect();
        if near.len() < 5 {
            return Err(CalibrationError::TooFew(near.len()));
        }
        let (zero, slope_per_nm, r_squared) = line(&near);
        let found = slope_per_nm.abs() * 1000.0;
        if found < least_slope_per_um {
            return Err(CalibrationError::Flat { found, needed: least_slope_per_um });
        }
        if r_squared < LEAST_R_SQUARED {
            return Err(CalibrationError::NoLine(r_squared));
        }
        let light = near_light(&usable, middle);
        Ok(Self {
            zero,
            slope_per_nm,
            capture: Nanometers::new(capture_nm(&usable, middle, slope_per_nm)).unwrap_or(Nanometers::ZERO),
            trust: Trust { least_light: light * LEAST_LIGHT_SHARE, most_saturated: 0.05, least_shape: 0.5 },
        })
    }

    /// Focus error of a reading, nanometers: positive when the drive is too high.
    #[must_use]
    pub fn error_nm(&self, reading: &FocusReading) -> f64 {
        (reading.signal - self.zero) / self.slope_per_nm
    }
}

fn middle_of(points: &[&SweepPoint]) -> f64 {
    let (least, greatest) =
        points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, greatest), point| {
            (least.min(point.z.value()), greatest.max(point.z.value()))
        });
    f64::midpoint(least, greatest)
}

/// Least squares: value at zero, slope, and share of the variance that the line explains.
fn line(points: &[(f64, f64)]) -> (f64, f64, f64) {
    let number = points.len() as f64;
    let mean_z = points.iter().map(|(z, _)| z).sum::<f64>() / number;
    let mean_s = points.iter().map(|(_, s)| s).sum::<f64>() / number;
    let (mut zz, mut zs, mut ss) = (0.0, 0.0, 0.0);
    for (z, s) in points {
        let (z, s) = (z - mean_z, s - mean_s);
        zz += z * z;
        zs += z * s;
        ss += s * s;
    }
    let slope = if zz > 0.0 { zs / zz } else { 0.0 };
    let r_squared = if zz > 0.0 && ss > 0.0 { zs * zs / (zz * ss) } else { 0.0 };
    (mean_s - slope * mean_z, slope, r_squared)
}

fn near_light(points: &[&SweepPoint], middle: f64) -> f64 {
    let near = points.iter().filter(|point| (point.z.value() - middle).abs() <= FITTED_NM);
    let light: Vec<f64> = near.map(|point| point.reading.light).collect();
    light.iter().sum::<f64>() / light.len().max(1) as f64
}

/// How far from the middle the signal still changes the right way, on the shorter side.
fn capture_nm(points: &[&SweepPoint], middle: f64, slope: f64) -> f64 {
    let mut sorted: Vec<(f64, f64)> = points
        .iter()
        .map(|point| (point.z.value() - middle, point.reading.signal * slope.signum()))
        .collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let reach = |side: &mut dyn Iterator<Item = &(f64, f64)>, rises: f64| {
        let (mut far, mut last) = (0.0_f64, None::<f64>);
        for (z, signal) in side {
            if last.is_some_and(|last| (signal - last) * rises <= 0.0) {
                break;
            }
            (far, last) = (z.abs(), Some(*signal));
        }
        far
    };
    let up = reach(&mut sorted.iter().filter(|(z, _)| *z >= 0.0), 1.0);
    let down = reach(&mut sorted.iter().rev().filter(|(z, _)| *z <= 0.0), -1.0);
    up.min(down)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sofiscope_hal::HostTime;

    fn sweep(signal: impl Fn(f64) -> f64) -> Vec<SweepPoint> {
        (-20..=20)
            .map(|step| {
                let z = f64::from(step) * 100.0;
                let reading = FocusReading {
                    number: 0,
                    at: HostTime(0),
                    signal: signal(z),
                    light: 1000.0,
                    saturated: 0.0,
                    shape: 1.0,
                };
                SweepPoint { z: Nanometers::new(z + 50_000.0).unwrap(), reading }
            })
            .collect()
    }

    #[test]
    fn a_line_gives_zero_slope_and_trust() {
        let found = Calibration::from_sweep(&sweep(|z| 320.0 - 0.065 * z), 3.0).unwrap();
        assert!((found.zero - 320.0).abs() < 1e-9 && (found.slope_per_nm + 0.065).abs() < 1e-12);
        assert!((found.trust.least_light - 500.0).abs() < 1e-9);
        assert!((found.capture.value() - 2000.0).abs() < 1e-9);
    }

    #[test]
    fn the_capture_range_ends_where_the_signal_turns() {
        let found = Calibration::from_sweep(&sweep(|z| 10.0 + 60.0 * (z / 1000.0).sin()), 3.0).unwrap();
        // A sine turns a quarter of its period from its zero, here 1571 nm; the sweep has steps of 100 nm.
        assert!((found.capture.value() - 1600.0).abs() <= 100.0, "{}", found.capture);
    }

    #[test]
    fn sweeps_that_tell_nothing_are_refused() {
        let flat = Calibration::from_sweep(&sweep(|z| 0.001 * z), 3.0);
        assert!(matches!(flat, Err(CalibrationError::Flat { .. })), "{flat:?}");
        let curved = Calibration::from_sweep(&sweep(|z| 0.02 * z + 1e-4 * z * z), 3.0);
        assert!(matches!(curved, Err(CalibrationError::NoLine(_))), "{curved:?}");
        let dark = Calibration::from_sweep(&sweep(|_| f64::NAN), 3.0);
        assert!(matches!(dark, Err(CalibrationError::TooFew(_))), "{dark:?}");
    }
}
