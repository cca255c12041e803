//! The part of the report that says how good the result is.
//!
//! In, out, never, fails: as [`model`](super::model).

use serde::{Deserialize, Serialize};

use super::null;
use crate::display::Rgb;

/// A matrix as rows of numbers.
pub type Matrix = Vec<Vec<f64>>;

/// One fluorophore.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Species {
    /// Name.
    pub name: String,
    /// Share of its light in the transmission channel, 0 to 1.
    #[serde(deserialize_with = "null::number")]
    pub transmission: f64,
    /// Share of its light in the reflection channel, 0 to 1.
    #[serde(deserialize_with = "null::number")]
    pub reflection: f64,
    /// Wavelength of strongest emission, in nanometers.
    pub emission_nm: Option<f64>,
    /// Color in the composite.
    pub color: Option<Rgb>,
    /// Standard deviation of the unmixed image per standard deviation of the cumulant images.
    pub noise_gain: Option<f64>,
    /// Signal-to-noise ratio per pixel, from the spread between subsequences.
    pub signal_to_noise: Option<f64>,
    /// What flattening did.
    pub flattening: Option<FlatteningNotes>,
}

/// What flattening did to one species.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FlatteningNotes {
    /// Factor of each sub-grid `(p, q)`, in the order `p * n + q`; the first is 1.
    #[serde(deserialize_with = "null::list")]
    pub sub_grid_factors: Vec<f64>,
    /// Sentences about sub-grids that fell back to the distance factor.
    pub fallbacks: Vec<String>,
}

/// The linear system of unmixing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Unmixing {
    /// Names of the spectral channels in the order u = 0..n, e.g. `RR`, `TR`, `TT`: rows of the matrix.
    pub spectral_channels: Vec<String>,
    /// Mixing matrix: row = spectral channel, column = species.
    #[serde(deserialize_with = "null::rows")]
    pub matrix: Matrix,
    /// Singular values, largest first.
    #[serde(deserialize_with = "null::list")]
    pub singular_values: Vec<f64>,
    /// Largest over smallest singular value.
    #[serde(deserialize_with = "null::number")]
    pub condition_number: f64,
}

/// Mean intensity of each camera over time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct BleachingCurve {
    /// Exposure index at the middle of each block; at most about 500 blocks.
    #[serde(deserialize_with = "null::list")]
    pub exposures: Vec<f64>,
    /// Mean of camera R in each block.
    #[serde(deserialize_with = "null::list")]
    pub reflected: Vec<f64>,
    /// Mean of camera T in each block; `None` with one camera.
    #[serde(deserialize_with = "null::optional_list")]
    pub transmitted: Option<Vec<f64>>,
    /// Unit of the means.
    pub unit: CurveUnit,
}

/// Unit of an intensity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CurveUnit {
    /// Camera counts, offset included.
    #[default]
    Counts,
    /// Photons.
    Photons,
}

/// Crosstalk against the truth: row = species, column = image, in percent of the row's own image.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Crosstalk {
    /// Names of rows and columns.
    pub species: Vec<String>,
    /// In the flattened images.
    #[serde(deserialize_with = "null::rows")]
    pub flattened: Matrix,
    /// In the linearized images.
    #[serde(deserialize_with = "null::rows")]
    pub linearized: Matrix,
    /// Numbers to compare the linearized ones with.
    pub reference: Option<CrosstalkReference>,
}

impl Crosstalk {
    /// The largest absolute entry outside the diagonal, in percent; `None` without finite entries.
    #[must_use]
    pub fn worst(matrix: &[Vec<f64>]) -> Option<f64> {
        let rows = matrix.iter().enumerate();
        let entries = rows.flat_map(|(i, row)| row.iter().enumerate().filter(move |&(j, _)| i != j));
        entries.map(|(_, value)| value.abs()).filter(|value| value.is_finite()).max_by(f64::total_cmp)
    }
}

/// Crosstalk published elsewhere.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CrosstalkReference {
    /// Where the numbers are from, e.g. `paper, Table 2`.
    pub source: String,
    /// The numbers, in the order of [`Crosstalk::species`], in percent.
    #[serde(deserialize_with = "null::rows")]
    pub linearized: Matrix,
}

/// Resolution of the result images.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Resolution {
    /// One number per image and method.
    pub values: Vec<ResolutionValue>,
    /// Fourier ring correlation of one image each.
    pub curves: Vec<ResolutionCurve>,
}

/// The resolution of one image.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ResolutionValue {
    /// Which image.
    pub image: String,
    /// Method, e.g. `Fourier ring correlation, 1/7`.
    pub method: String,
    /// Resolution in nanometers; NaN if it could not be found.
    #[serde(deserialize_with = "null::number")]
    pub nanometers: f64,
}

/// Fourier ring correlation of one image.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ResolutionCurve {
    /// Which image.
    pub image: String,
    /// Spatial frequencies, in 1/µm.
    #[serde(deserialize_with = "null::list")]
    pub frequency_per_um: Vec<f64>,
    /// Correlation at each frequency, -1 to 1.
    #[serde(deserialize_with = "null::list")]
    pub correlation: Vec<f64>,
}
