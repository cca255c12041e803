//! From focus error to the next place of the drive.
//!
//! In the form of steps: `z[n] = z[n−1] − (Kp·(e[n] − e[n−1]) + Ki·e[n])`. What is clipped at slew limit or range is
//! forgotten, so nothing winds up. The drive is a position loop of its own, which makes the integral part the
//! main one; with a dead time of d periods the loop is stable for Ki < 1 / (2d + 1).

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};
use sofiscope_hal::Nanometers;

/// Gains and limits.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ServoSettings {
    /// Proportional gain, no unit.
    pub proportional: f64,
    /// Integral gain per period, no unit.
    pub integral: f64,
    /// Largest step of one period.
    pub slew: Nanometers,
    /// Errors below this are left alone.
    pub dead_band: Nanometers,
}

impl Default for ServoSettings {
    /// For 100 readings per second and a piezo that settles in 25 ms.
    fn default() -> Self {
        Self {
            proportional: 0.0,
            integral: 0.12,
            slew: Nanometers::new(500.0).unwrap_or_default(),
            dead_band: Nanometers::new(2.0).unwrap_or_default(),
        }
    }
}

/// What the servo did with an error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Where the drive shall go.
    pub z: Nanometers,
    /// Whether the range of the drive cut it short.
    pub is_at_end: bool,
}

/// The servo with its memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Servo {
    z: f64,
    last_error: Option<f64>,
}

impl Servo {
    /// Takes over where the drive stands.
    #[must_use]
    pub fn at(z: Nanometers) -> Self {
        Self { z: z.value(), last_error: None }
    }

    /// Where it has sent the drive.
    #[must_use]
    pub fn z(&self) -> Nanometers {
        Nanometers::new(self.z).unwrap_or_default()
    }

    /// The step that answers an error; NaN is answered by none.
    pub fn answer(
        &mut self,
        error_nm: f64,
        settings: &ServoSettings,
        range: &RangeInclusive<Nanometers>,
    ) -> Step {
        let change = self.last_error.map_or(0.0, |last| error_nm - last);
        self.last_error = error_nm.is_finite().then_some(error_nm);
        let wanted = if error_nm.abs() < settings.dead_band.value() {
            0.0
        } else {
            -(settings.proportional * change + settings.integral * error_nm)
        };
        let slew = settings.slew.value();
        let step = if wanted.is_finite() { wanted.clamp(-slew, slew) } else { 0.0 };
        let free = self.z + step;
        self.z = free.clamp(range.start().value(), range.end().value());
        Step { z: self.z(), is_at_end: self.z != free }
    }

    /// Forgets the last error, after readings that were not believed.
    pub fn interrupt(&mut self) {
        self.last_error = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn nm(value: f64) -> Nanometers {
        Nanometers::new(value).unwrap()
    }

    proptest! {
        #[test]
        fn the_drive_stays_in_range_and_below_the_slew_limit(
            errors in proptest::collection::vec(prop_oneof![-1e6_f64..1e6, Just(f64::NAN), Just(f64::INFINITY)], 1..100)
        ) {
            let (settings, range) = (ServoSettings::default(), nm(0.0)..=nm(300_000.0));
            let mut servo = Servo::at(nm(150_000.0));
            for error in errors {
                let before = servo.z();
                let step = servo.answer(error, &settings, &range);
                prop_assert!(range.contains(&step.z));
                prop_assert!(step.z.distance(before).value() <= settings.slew.value() + 1e-9);
            }
        }

        #[test]
        fn nothing_winds_up_at_the_end_of_the_range(pushes in 1_usize..500) {
            let (settings, range) = (ServoSettings::default(), nm(0.0)..=nm(1000.0));
            let mut servo = Servo::at(nm(990.0));
            for _ in 0..pushes {
                servo.answer(-400.0, &settings, &range);
            }
            prop_assert!(servo.z() <= nm(1000.0));
            let back = servo.answer(400.0, &settings, &range);
            prop_assert!(back.z < nm(1000.0), "the first error the other way moves it at once");
        }
    }

    #[test]
    fn small_errors_are_left_alone() {
        let mut servo = Servo::at(nm(500.0));
        let step = servo.answer(1.9, &ServoSettings::default(), &(nm(0.0)..=nm(1000.0)));
        assert_eq!(step, Step { z: nm(500.0), is_at_end: false });
    }
}
