//! What surrounds an exposure: focus error, place on the stage, light.
//!
//! In: where the focus error of the moment comes from; place and light of a series. Out: [`Conditions`] of each frame.
//! Never: locks, waits, allocates, guesses. Fails: not at all; what is not known is `None`.

use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The focus error is told in steps of this many to the nanometer, so that every copy of it is the same number.
pub(crate) const FOCUS_STEPS_PER_NM: f64 = 100.0;

/// Where the focus error of the moment comes from; the default knows of none.
#[derive(Clone, Default)]
pub struct FocusGauge(Option<Arc<dyn Fn() -> Option<f64> + Send + Sync>>);

impl FocusGauge {
    /// A gauge that asks `now_nm` for every frame, on the threads of the cameras: it must neither lock nor wait.
    pub fn new(now_nm: impl Fn() -> Option<f64> + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(now_nm)))
    }

    /// Nanometers, in hundredths; `None` while no lock holds.
    #[must_use]
    pub fn now_nm(&self) -> Option<f64> {
        let error = self.0.as_ref().and_then(|now_nm| now_nm()).filter(|error| error.is_finite())?;
        // Without the zero, errors just below it would be written as -0.
        Some((error * FOCUS_STEPS_PER_NM).round() / FOCUS_STEPS_PER_NM + 0.0)
    }
}

impl std::fmt::Debug for FocusGauge {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_tuple("FocusGauge").field(&self.0.is_some()).finish()
    }
}

/// Laser lines that are lit, with their powers; as text `488=10;561=2.5`, in nanometers and milliwatts.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Light {
    /// Wavelengths in increasing order; those behind the last lit line are 0.
    lines: [(u16, f32); Self::MOST_LINES],
}

impl Light {
    /// Most lines at once; as many as a trigger controller has gates.
    pub const MOST_LINES: usize = 8;

    /// Light of these lines, nanometers and milliwatts; lines without power are not lit.
    /// `None` for more lines than [`MOST_LINES`](Self::MOST_LINES), and for numbers that are no light.
    #[must_use]
    pub fn of(lines: impl IntoIterator<Item = (u32, f64)>) -> Option<Self> {
        let mut light = Self::default();
        let (mut number, mut last) = (0, 0);
        for (line, power) in lines {
            let line = u16::try_from(line).ok()?;
            let power = power as f32;
            if line <= last || !power.is_finite() || power < 0.0 {
                return None;
            }
            last = line;
            if power > 0.0 {
                *light.lines.get_mut(number)? = (line, power);
                number += 1;
            }
        }
        Some(light)
    }

    /// The lit lines, nanometers and milliwatts.
    pub fn lines(&self) -> impl Iterator<Item = (u32, f64)> + '_ {
        let lit = self.lines.iter().take_while(|(line, _)| *line > 0);
        lit.map(|&(line, power)| (u32::from(line), f64::from(power)))
    }

    /// Light from its text.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let line = |part: &str| {
            let (line, power) = part.split_once('=')?;
            let power = power.parse::<f32>().ok().filter(|power| *power > 0.0)?;
            Some((line.parse().ok()?, f64::from(power)))
        };
        let parts = text.split(';').filter(|_| !text.is_empty());
        Self::of(parts.map(line).collect::<Option<Vec<(u32, f64)>>>()?)
    }
}

impl TryFrom<String> for Light {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        Self::parse(&text).ok_or_else(|| format!("{text:?} is no light such as 488=10;561=2.5"))
    }
}

impl From<Light> for String {
    fn from(light: Light) -> Self {
        light.to_string()
    }
}

impl std::fmt::Display for Light {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (place, (line, power)) in self.lines.iter().take_while(|(line, _)| *line > 0).enumerate() {
            let between = if place > 0 { ";" } else { "" };
            write!(formatter, "{between}{line}={power}")?;
        }
        Ok(())
    }
}

/// What surrounded a frame when it was received.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Conditions {
    /// Focus error, nanometers; `None` when no lock held.
    #[serde(skip)]
    pub focus_nm: Option<f64>,
    /// Place on the stage, micrometers; `None` for wherever it stood.
    pub x_um: Option<f64>,
    /// Place on the stage, micrometers; `None` for wherever it stood.
    pub y_um: Option<f64>,
    /// The laser lines of the series.
    pub light: Light,
}

/// What grabbers ask for the conditions of each frame; clones know the same.
#[derive(Debug, Clone, Default)]
pub struct Surroundings {
    focus: FocusGauge,
    series: Conditions,
}

impl Surroundings {
    /// The surroundings of a series: place and light stay as they are, the focus error is that of the moment.
    #[must_use]
    pub fn of_series(focus: FocusGauge, series: Conditions) -> Self {
        Self { focus, series }
    }

    /// Place and light, which stay as they are.
    #[must_use]
    pub fn series(&self) -> Conditions {
        self.series
    }

    /// The conditions of a frame that was just received.
    #[must_use]
    pub fn now(&self) -> Conditions {
        Conditions { focus_nm: self.focus.now_nm(), ..self.series }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn light_is_read_back(lines in proptest::collection::btree_map(200_u32..=2000, 0.0_f64..1e5, 0..=8)) {
            let light = Light::of(lines.clone()).unwrap();
            prop_assert_eq!(Light::parse(&light.to_string()), Some(light));
            prop_assert_eq!(light.lines().count(), lines.values().filter(|power| **power as f32 > 0.0).count());
        }

        #[test]
        fn a_focus_error_is_told_within_half_a_step(error in -1e5_f64..1e5) {
            let told = FocusGauge::new(move || Some(error)).now_nm().unwrap();
            prop_assert!((told - error).abs() <= 0.005 + 1e-9);
        }
    }

    #[test]
    fn light_is_written_as_people_write_it() {
        let light = Light::of([(405, 0.0), (488, 10.0), (561, 2.5)]).unwrap();
        assert_eq!(light.to_string(), "488=10;561=2.5");
        assert_eq!(Light::default().to_string(), "");
        assert_eq!(Light::of((0..9).map(|line| (400 + line, 1.0))), None, "more than can be written");
        for text in ["488", "488=x", "488=-1", "561=1;488=1", "488=1;488=1", "488=1;", "488=NaN", "488=inf"] {
            assert_eq!(Light::parse(text), None, "{text}");
        }
    }

    #[test]
    fn only_a_number_is_a_focus_error() {
        for none in [None, Some(f64::NAN), Some(f64::INFINITY)] {
            assert_eq!(FocusGauge::new(move || none).now_nm(), None);
        }
        assert_eq!(FocusGauge::default().now_nm(), None);
        let told = FocusGauge::new(|| Some(-0.001)).now_nm().unwrap();
        assert_eq!(told.to_string(), "0");
    }
}
