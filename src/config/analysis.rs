//! Settings of an analysis: a TOML file, overridden by arguments, checked as a whole.

use crate::sofi::grid::Combinations;
use crate::sofi::linearization::{Acceleration, Reconvolution};
use crate::sofi::registration::Interpolation;
use crate::sofi::unmixing::UnmixingMethod;
use serde::{Deserialize, Serialize};
use sofiscope_form::Faults;
use std::path::PathBuf;

/// Objective of the paper's microscope.
const DEFAULT_NUMERICAL_APERTURE: f64 = 1.27;

/// Settings as typed; every key may be left out.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawAnalysis {
    /// Cumulant order, 2 to 6.
    pub order: Option<usize>,
    /// Exposures per subsequence.
    pub subsequence_exposures: Option<u64>,
    /// `all-closest`, `one-per-position` or `sofipackage`.
    pub combinations: Option<String>,
    /// Exposures by which each pixel of a tuple is delayed.
    pub lags_exposures: Option<Vec<u64>>,
    /// Names of the dyes, in the order of the result images.
    pub species: Option<Vec<String>>,
    /// Name of the dichroic between the cameras.
    pub dichroic: Option<String>,
    /// `pseudo-inverse` or `non-negative`.
    pub unmixing: Option<String>,
    /// `equal-means` or `distance-factor`.
    pub flattening: Option<String>,
    /// Iterations of Lucy–Richardson.
    pub iterations: Option<usize>,
    /// Whether iterations are accelerated after Biggs and Andrews.
    pub accelerated: Option<bool>,
    /// Whether the linearized image is blurred with the default width again.
    pub reconvolution: Option<bool>,
    /// Where the width of the point-spread function comes from where none is given: `optics` or `measured`.
    pub psf: Option<String>,
    /// Standard deviation of the camera's point-spread function, camera pixels, for all species.
    pub psf_sigma_px: Option<f64>,
    /// Numerical aperture of the objective.
    pub numerical_aperture: Option<f64>,
    /// Size of a camera pixel in the sample, nanometers.
    pub pixel_pitch_nm: Option<f64>,
    /// Count at which the camera saturates.
    pub saturation_counts: Option<f32>,
    /// File of the registration of camera T onto camera R.
    pub registration_file: Option<String>,
    /// `unbiased-sinc` or `bilinear-frames`.
    pub registration: Option<String>,
    /// Files of the maps of each camera, R before T; `none` for a camera without.
    pub camera_maps: Option<Vec<String>>,
    /// File of measured shares of the dyes' light, as a `dichroics.toml`.
    pub response_file: Option<String>,
}

/// Where the width of the point-spread function comes from where none is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PsfSource {
    /// Numerical aperture and emission wavelength; measured for species whose emission is not known.
    Optics,
    /// The data themselves, then beads, then the optics: the first that is clear.
    Measured,
}

impl PsfSource {
    /// Names in settings, the default first.
    pub const NAMES: [(&str, Self); 2] = [("optics", Self::Optics), ("measured", Self::Measured)];
}

/// Settings that can be believed.
#[derive(Debug, Clone, PartialEq)]
pub struct AnalysisSettings {
    /// Cumulant order, 2 to 6.
    pub order: usize,
    /// Exposures per subsequence, at least 2; `None` for 200 or the whole stack if that is shorter.
    pub subsequence: Option<u64>,
    /// Rule for pixel sets.
    pub combinations: Combinations,
    /// Delay of each pixel of a tuple, in exposures; empty for none.
    pub lags: Vec<u64>,
    /// Names of the dyes.
    pub species: Vec<String>,
    /// Name of the dichroic.
    pub dichroic: Option<String>,
    /// How the mixing is inverted.
    pub unmixing: UnmixingMethod,
    /// Whether sub-grids are weighted by the distance factor instead of equal means.
    pub distance_factor: bool,
    /// Iterations of Lucy–Richardson.
    pub iterations: usize,
    /// How one iteration leads to the next.
    pub acceleration: Acceleration,
    /// What the linearized image is blurred with.
    pub reconvolution: Reconvolution,
    /// Where the width of the point-spread function comes from where none is given.
    pub psf: PsfSource,
    /// Width of the point-spread function, camera pixels.
    pub psf_sigma_px: Option<f64>,
    /// Numerical aperture.
    pub numerical_aperture: f64,
    /// Camera pixel in the sample, nanometers, if it was given.
    pub pixel_pitch_nm: Option<f64>,
    /// Count at which the camera saturates, if it was given.
    pub saturation_counts: Option<f32>,
    /// File of the registration of camera T onto camera R.
    pub registration_file: Option<PathBuf>,
    /// How T is brought onto R.
    pub interpolation: Interpolation,
    /// Files of the maps of each camera; empty for none, and `none` for a camera without.
    pub camera_maps: Vec<PathBuf>,
    /// File of measured shares of the dyes' light.
    pub response_file: Option<PathBuf>,
}

/// Keys of a settings file, see [`RawAnalysis`].
const KEYS: [&str; 20] = [
    "order",
    "subsequence_exposures",
    "combinations",
    "lags_exposures",
    "species",
    "dichroic",
    "unmixing",
    "flattening",
    "iterations",
    "accelerated",
    "reconvolution",
    "psf",
    "psf_sigma_px",
    "numerical_aperture",
    "pixel_pitch_nm",
    "saturation_counts",
    "registration_file",
    "registration",
    "camera_maps",
    "response_file",
];

/// Everything that is wrong with the settings.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", faults.join("; "))]
pub struct AnalysisFaults {
    /// One sentence per fault, with its key and the remedy.
    pub faults: Vec<String>,
}

impl RawAnalysis {
    /// Reads a settings file.
    ///
    /// # Errors
    /// Every fault of syntax, or every unknown key, or the first value of a wrong kind; each with its line.
    pub fn from_toml(text: &str) -> Result<Self, AnalysisFaults> {
        let faults = Faults::new(text);
        sofiscope_form::read(&faults, |form| form.know(&KEYS));
        let mut faults = faults.into_list();
        if !faults.is_empty() {
            // One slip of syntax is several errors to the parser.
            faults.dedup_by_key(|fault| fault.line);
            return Err(AnalysisFaults { faults: faults.iter().map(ToString::to_string).collect() });
        }
        toml::from_str(text).map_err(|error| {
            let before = error.span().map_or("", |span| &text[..span.start.min(text.len())]);
            let line = 1 + before.matches('\n').count();
            let message = in_words(error.message().trim());
            AnalysisFaults { faults: vec![format!("line {line}: {message}; give a value of that kind")] }
        })
    }

    /// These settings where they are given, those of `other` where not.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            order: self.order.or(other.order),
            subsequence_exposures: self.subsequence_exposures.or(other.subsequence_exposures),
            combinations: self.combinations.or(other.combinations),
            lags_exposures: self.lags_exposures.or(other.lags_exposures),
            species: self.species.or(other.species),
            dichroic: self.dichroic.or(other.dichroic),
            unmixing: self.unmixing.or(other.unmixing),
            flattening: self.flattening.or(other.flattening),
            iterations: self.iterations.or(other.iterations),
            accelerated: self.accelerated.or(other.accelerated),
            reconvolution: self.reconvolution.or(other.reconvolution),
            psf: self.psf.or(other.psf),
            psf_sigma_px: self.psf_sigma_px.or(other.psf_sigma_px),
            numerical_aperture: self.numerical_aperture.or(other.numerical_aperture),
            pixel_pitch_nm: self.pixel_pitch_nm.or(other.pixel_pitch_nm),
            saturation_counts: self.saturation_counts.or(other.saturation_counts),
            registration_file: self.registration_file.or(other.registration_file),
            registration: self.registration.or(other.registration),
            camera_maps: self.camera_maps.or(other.camera_maps),
            response_file: self.response_file.or(other.response_file),
        }
    }
}

impl TryFrom<RawAnalysis> for AnalysisSettings {
    type Error = AnalysisFaults;

    fn try_from(raw: RawAnalysis) -> Result<Self, AnalysisFaults> {
        let mut faults = Vec::new();
        let order = raw.order.unwrap_or(2);
        if !(2..=6).contains(&order) {
            faults.push(format!("order {order} is not available; choose an order from 2 to 6"));
        }
        if let Some(short) = raw.subsequence_exposures.filter(|&length| length < 2) {
            faults.push(format!(
                "a subsequence of {short} exposures is too short; take at least 2, in practice 100 to 500"
            ));
        }
        let combinations =
            choose(&mut faults, "combinations", raw.combinations.as_deref(), &Combinations::NAMES);
        let unmixing = [
            ("pseudo-inverse", UnmixingMethod::PseudoInverse),
            ("non-negative", UnmixingMethod::NonNegative),
        ];
        let flattening = [("equal-means", false), ("distance-factor", true)];
        for (key, value) in [
            ("psf_sigma_px", raw.psf_sigma_px),
            ("numerical_aperture", raw.numerical_aperture),
            ("pixel_pitch_nm", raw.pixel_pitch_nm),
            ("saturation_counts", raw.saturation_counts.map(f64::from)),
        ] {
            if let Some(value) = value.filter(|value| !(value.is_finite() && *value > 0.0)) {
                faults.push(format!("{key} = {value} must be a positive number"));
            }
        }
        let settings = Self {
            order,
            subsequence: raw.subsequence_exposures,
            combinations,
            lags: raw.lags_exposures.unwrap_or_default(),
            species: raw.species.unwrap_or_default(),
            dichroic: raw.dichroic,
            unmixing: choose(&mut faults, "unmixing", raw.unmixing.as_deref(), &unmixing),
            distance_factor: choose(&mut faults, "flattening", raw.flattening.as_deref(), &flattening),
            iterations: raw.iterations.unwrap_or(20),
            acceleration: match raw.accelerated {
                Some(true) => Acceleration::BiggsAndrews,
                _ => Acceleration::None,
            },
            reconvolution: match raw.reconvolution {
                Some(false) => Reconvolution::None,
                _ => Reconvolution::Default,
            },
            psf: choose(&mut faults, "psf", raw.psf.as_deref(), &PsfSource::NAMES),
            psf_sigma_px: raw.psf_sigma_px,
            numerical_aperture: raw.numerical_aperture.unwrap_or(DEFAULT_NUMERICAL_APERTURE),
            pixel_pitch_nm: raw.pixel_pitch_nm,
            saturation_counts: raw.saturation_counts,
            registration_file: raw.registration_file.map(PathBuf::from),
            interpolation: choose(
                &mut faults,
                "registration",
                raw.registration.as_deref(),
                &Interpolation::NAMES,
            ),
            camera_maps: raw.camera_maps.unwrap_or_default().into_iter().map(PathBuf::from).collect(),
            response_file: raw.response_file.map(PathBuf::from),
        };
        if faults.is_empty() { Ok(settings) } else { Err(AnalysisFaults { faults }) }
    }
}

/// A message about kinds of values with words in place of the names of Rust's types.
pub(super) fn in_words(message: &str) -> String {
    [
        ("usize", "a whole number"),
        ("u64", "a whole number"),
        ("u32", "a whole number"),
        ("f64", "a number"),
        ("f32", "a number"),
        ("a string", "a text"),
        ("a boolean", "true or false"),
        ("a sequence", "a list"),
        ("a map", "a table"),
    ]
    .iter()
    .fold(message.to_owned(), |said, (kind, words)| {
        said.replace(&format!("expected {kind}"), &format!("expected {words}"))
    })
}

/// The value with that name, the first one when none was given; an unknown name is a fault that lists the known ones.
fn choose<T: Clone>(faults: &mut Vec<String>, key: &str, name: Option<&str>, known: &[(&str, T)]) -> T {
    let name = name.unwrap_or(known[0].0);
    if let Some((_, value)) = known.iter().find(|(known, _)| *known == name) {
        return value.clone();
    }
    let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
    faults.push(format!("{key} = \"{name}\" is not known; choose one of {}", names.join(", ")));
    known[0].1.clone()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_win_over_the_file_and_the_rest_has_defaults() {
        let file = RawAnalysis::from_toml("order = 3\nsubsequence_exposures = 150").unwrap();
        let arguments = RawAnalysis { order: Some(4), ..RawAnalysis::default() };
        let settings = AnalysisSettings::try_from(arguments.or(file)).unwrap();
        assert_eq!((settings.order, settings.subsequence, settings.iterations), (4, Some(150), 20));
    }

    #[test]
    fn all_faults_are_listed_at_once() {
        let raw =
            RawAnalysis::from_toml("order = 9\nsubsequence_exposures = 1\nflattening = \"flat\"").unwrap();
        assert_eq!(AnalysisSettings::try_from(raw).unwrap_err().faults.len(), 3);
    }

    #[test]
    fn unknown_keys_are_refused_with_their_line() {
        let fault = RawAnalysis::from_toml("order = 2\nsubsequense = 3").unwrap_err().to_string();
        assert!(fault.contains("line 2") && fault.contains("subsequense"), "{fault}");
        let fault = RawAnalysis::from_toml("oder = 2\nspecies = []\niteration = 3").unwrap_err();
        let written = fault.faults.iter().filter(|fault| fault.contains("write `"));
        assert_eq!(written.count(), 2, "{fault}");
    }

    #[test]
    fn every_key_of_the_settings_is_known() {
        let raw = serde_json::to_value(RawAnalysis::default()).unwrap();
        let mut keys: Vec<&String> = raw.as_object().unwrap().keys().collect();
        let mut known = KEYS.to_vec();
        keys.sort();
        known.sort_unstable();
        assert_eq!(keys, known);
    }

    #[test]
    fn faults_of_syntax_and_kind_are_one_line_each() {
        for (text, part) in [
            ("order = = 2", "line 1"),
            ("order = 2\niterations = \"many\"", "line 2: invalid type"),
            ("order = -3", "expected a whole number"),
            ("[order]\nx = 1", "line 1"),
        ] {
            let fault = RawAnalysis::from_toml(text).unwrap_err().to_string();
            assert!(fault.contains(part) && !fault.contains('\n'), "{fault}");
        }
    }
}
