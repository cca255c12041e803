//! What `dyes` found, as scripts see it.
//!
//! In: merits. Out: [`Findings`], one JSON object. Never: a number without a meaning; those are null. Fails: not at all.

use crate::sofi::dye_choice::Merit;
use ndarray::Array2;
use serde::Serialize;

/// What was found.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Findings {
    /// Cumulant order.
    pub(super) order: usize,
    /// Physical channels.
    pub(super) channels: usize,
    /// Spectral channels, `C(n + N_p - 1, n)`.
    pub(super) spectral_channels: usize,
    /// What the choices are ranked by: product, smallest-singular-value or noise.
    pub(super) by: &'static str,
    /// Error of one share that crosstalk is predicted for.
    pub(super) t_error: f64,
    /// Dyes of the best choice.
    pub(super) species: Vec<String>,
    /// Best ideal edges for these dyes, nanometers.
    pub(super) best_edges_nm: Vec<f64>,
    /// Two channels: edges whose product is at least 90 % of the best one's, nanometers.
    pub(super) good_edges_nm: Option<[f64; 2]>,
    /// All choices, the best first.
    pub(super) choices: Vec<Choice>,
    /// Two channels: one ideal edge over wavelength for these dyes.
    pub(super) sweep: Vec<SweepPoint>,
    /// Where the emissions come from.
    pub(super) spectra: Vec<Provenance>,
    /// What the reader must know.
    pub(super) notes: Vec<String>,
}

/// A set of dyes and what divides their light.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Choice {
    pub(super) species: Vec<String>,
    /// Name of the dichroic; "ideal edge" for step edges.
    pub(super) dichroic: String,
    /// `coefficients`, `curve` or `ideal-edge`.
    pub(super) kind: &'static str,
    /// Where its numbers come from.
    pub(super) about: String,
    /// Wavelengths of ideal edges, nanometers.
    pub(super) edges_nm: Vec<f64>,
    /// Shares of light by channel, short wavelengths first (R, T), then by dye.
    pub(super) shares: Vec<Vec<f64>>,
    #[serde(flatten)]
    pub(super) merit: Worth,
    /// Crosstalk if the shares of one dye are wrong: row = dye with the error, column = image, percent.
    pub(super) crosstalk_percent: Vec<Vec<f64>>,
    /// The largest entry beside the diagonal, by magnitude.
    pub(super) worst_crosstalk_percent: Option<f64>,
}

/// A merit in numbers.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Worth {
    pub(super) determinant: Option<f64>,
    pub(super) eigenvalues: Option<Vec<f64>>,
    pub(super) singular_values: Vec<f64>,
    pub(super) product: f64,
    pub(super) smallest_singular_value: f64,
    pub(super) condition: f64,
    pub(super) noise_gain: Option<Vec<f64>>,
}

/// One place of an ideal edge.
#[derive(Debug, Clone, Serialize)]
pub(super) struct SweepPoint {
    pub(super) edge_nm: f64,
    #[serde(flatten)]
    pub(super) merit: Worth,
}

/// Where an emission comes from.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Provenance {
    pub(super) species: String,
    /// A file, or "parametric, for planning"; null where there is none.
    pub(super) emission: Option<String>,
}

impl From<&Merit> for Worth {
    fn from(merit: &Merit) -> Self {
        Self {
            determinant: merit.determinant,
            eigenvalues: merit.eigenvalues.clone(),
            singular_values: merit.singular_values.clone(),
            product: merit.product,
            smallest_singular_value: merit.smallest_singular_value(),
            condition: merit.condition,
            noise_gain: merit.noise_gain.clone(),
        }
    }
}

pub(super) fn rows(table: &Array2<f64>) -> Vec<Vec<f64>> {
    table.rows().into_iter().map(|row| row.to_vec()).collect()
}

/// The largest entry beside the diagonal, by magnitude.
pub(super) fn worst(table: &Array2<f64>) -> Option<f64> {
    let beside = table.indexed_iter().filter(|((i, j), _)| i != j).map(|(_, &value)| value);
    beside.max_by(|a, b| a.abs().total_cmp(&b.abs())).filter(|value| value.is_finite())
}
