//! What a mixing matrix is worth (Fig. S2b).
//!
//! In: an order and shares of light. Out: [`Merit`]. Never: refuses a matrix for being singular.
//! Fails: [`ChoiceError`].

use nalgebra::{DMatrix, Schur};
use ndarray::ArrayRef2;

use super::ChoiceError;
use crate::sofi::unmixing::{
    MAX_CONDITION, MAX_ORDER, SingularValues, channel_sets, mixing_matrix, pseudo_inverse,
};

/// Rounds of the search for eigenvalues, far above what small matrices need.
const SCHUR_ROUNDS: usize = 10_000;

/// What makes one choice better than another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Criterion {
    /// The product of the singular values, which is `|det M|` and so the product of the eigenvalues where `M` is
    /// square: the paper's.
    #[default]
    Product,
    /// The smallest singular value.
    SmallestSingularValue,
    /// The least noise gain of the worst dye.
    Noise,
}

/// What a mixing matrix is worth; all numbers are dimensionless.
#[derive(Debug, Clone, PartialEq)]
pub struct Merit {
    /// Rows of `M`.
    pub spectral_channels: usize,
    /// `det M`, where `M` is square.
    pub determinant: Option<f64>,
    /// Magnitudes of the eigenvalues, largest first, where `M` is square.
    pub eigenvalues: Option<Vec<f64>>,
    /// Singular values, largest first, one per dye.
    pub singular_values: Vec<f64>,
    /// Their product; `|det M|` where `M` is square.
    pub product: f64,
    /// Largest over smallest singular value; infinite for a singular matrix.
    pub condition: f64,
    /// Standard deviation of each unmixed dye for unit noise in every spectral channel, where the condition number
    /// is not above the limit of the unmixing.
    pub noise_gain: Option<Vec<f64>>,
}

impl Merit {
    /// Judges the order `n` and shares `P[channel, dye]` in `0..=1`, channels from the short to the long side.
    ///
    /// # Errors
    /// [`ChoiceError`] for a system without a meaning or with more dyes than spectral channels.
    pub fn of(order: usize, shares: &ArrayRef2<f64>) -> Result<Self, ChoiceError> {
        let matrix = mixture(order, shares)?;
        let singular_values = SingularValues::of(&matrix).values;
        let condition = condition(&singular_values);
        let noise_gain = (condition <= MAX_CONDITION).then(|| noise_gain(&matrix));
        Ok(Self {
            spectral_channels: matrix.nrows(),
            determinant: matrix.is_square().then(|| matrix.determinant()),
            eigenvalues: if matrix.is_square() { eigenvalues(&matrix) } else { None },
            product: singular_values.iter().product(),
            singular_values,
            condition,
            noise_gain,
        })
    }

    /// Smallest singular value.
    #[must_use]
    pub fn smallest_singular_value(&self) -> f64 {
        self.singular_values.last().copied().unwrap_or(0.0)
    }

    /// Noise gain of the dye that has the most; infinite where the mixture cannot be unmixed.
    #[must_use]
    pub fn worst_noise_gain(&self) -> f64 {
        let gains = self.noise_gain.as_ref();
        gains.map_or(f64::INFINITY, |gains| gains.iter().copied().fold(0.0, f64::max))
    }

    /// A number that is larger for the better choice; 0 or the least of all where it cannot be unmixed.
    #[must_use]
    pub fn by(&self, criterion: Criterion) -> f64 {
        match criterion {
            Criterion::Product => self.product,
            Criterion::SmallestSingularValue => self.smallest_singular_value(),
            Criterion::Noise => 1.0 / self.worst_noise_gain(),
        }
    }
}

/// Number of spectral channels, `C(n + N_p - 1, n)`; saturates.
#[must_use]
pub fn spectral_channels(order: usize, channels: usize) -> usize {
    if channels == 0 {
        return 0;
    }
    let step = |number: usize, k: usize| number.saturating_mul(channels - 1 + k) / k;
    (1..=order).fold(1, step)
}

/// The mixing matrix of a system that has a meaning.
pub(super) fn mixture(order: usize, shares: &ArrayRef2<f64>) -> Result<DMatrix<f64>, ChoiceError> {
    let (channels, dyes) = shares.dim();
    if dyes == 0 || channels == 0 || !(1..=MAX_ORDER).contains(&order) {
        return Err(ChoiceError::Empty { dyes, channels, order });
    }
    let spectral_channels = spectral_channels(order, channels);
    if dyes > spectral_channels {
        return Err(ChoiceError::TooManyDyes { dyes, spectral_channels, order, channels });
    }
    if let Some(((_, dye), &value)) = shares.indexed_iter().find(|(_, share)| !(0.0..=1.0).contains(*share)) {
        return Err(ChoiceError::Share { dye, value });
    }
    Ok(mixing_matrix(&channel_sets(order, channels), shares))
}

pub(super) fn condition(singular_values: &[f64]) -> f64 {
    match (singular_values.first(), singular_values.last()) {
        (Some(&largest), Some(&smallest)) if smallest > 0.0 => largest / smallest,
        _ => f64::INFINITY,
    }
}

fn noise_gain(matrix: &DMatrix<f64>) -> Vec<f64> {
    pseudo_inverse(matrix).row_iter().map(|row| row.norm()).collect()
}

fn eigenvalues(matrix: &DMatrix<f64>) -> Option<Vec<f64>> {
    let schur = Schur::try_new(matrix.clone(), f64::EPSILON, SCHUR_ROUNDS)?;
    let mut magnitudes: Vec<f64> = schur.complex_eigenvalues().iter().map(|z| z.re.hypot(z.im)).collect();
    magnitudes.sort_by(|a, b| b.total_cmp(a));
    Some(magnitudes)
}
