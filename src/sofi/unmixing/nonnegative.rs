//! Non-negative least squares for one pixel at a time.
//!
//! In: the matrix once, then the cumulants of one pixel after another. Out: the species, none below zero.
//! Never: allocates per pixel, turns in a circle. Fails: [`UnmixingError::Method`] for too many species.

use nalgebra::DMatrix;

use super::jacobi::pseudo_inverse;
use super::{MAX_NON_NEGATIVE_SPECIES, UnmixingError};

/// Non-negative least squares after Lawson and Hanson (1974, chapter 23), with the least-squares
/// solution of every subset of species computed beforehand.
#[derive(Debug, Clone)]
pub(super) struct ActiveSets {
    /// `M^T`, for the gradient.
    transposed: DMatrix<f64>,
    /// `M^T M`.
    normal: DMatrix<f64>,
    /// Pseudo-inverse of the columns in each subset, by bit mask, zero rows for absent species.
    inverses: Vec<DMatrix<f64>>,
}

impl ActiveSets {
    pub(super) fn new(matrix: &DMatrix<f64>) -> Result<Self, UnmixingError> {
        let num_species = matrix.ncols();
        if num_species > MAX_NON_NEGATIVE_SPECIES {
            return Err(UnmixingError::Method(format!(
                "non-negative least squares takes at most {MAX_NON_NEGATIVE_SPECIES} species, got {num_species}"
            )));
        }
        Ok(Self {
            transposed: matrix.transpose(),
            normal: matrix.transpose() * matrix,
            inverses: (0..1_usize << num_species).map(|set| subset_inverse(matrix, set)).collect(),
        })
    }

    pub(super) fn solve(&self, kappa: &[f64], species: &mut [f64]) {
        let count = species.len();
        let all = self.inverses.len() - 1;
        // Most pixels: the unconstrained optimum is feasible, hence the optimum.
        product(&self.inverses[all], kappa, species);
        if species.iter().all(|&s| s >= 0.0) {
            return;
        }
        if kappa.iter().any(|k| !k.is_finite()) {
            species.fill(f64::NAN);
            return;
        }
        let mut projected = [0.0; MAX_NON_NEGATIVE_SPECIES];
        let mut trial = [0.0; MAX_NON_NEGATIVE_SPECIES];
        product(&self.transposed, kappa, &mut projected[..count]);
        let scale = kappa.iter().fold(0.0_f64, |most, k| most.max(k.abs()));
        species.fill(0.0);
        let mut passive = 0_usize;
        // Each round adds one species for good; rounding could at worst cycle, so rounds are bounded.
        for _ in 0..4 * count {
            let Some(entering) = self.steepest(&projected, species, passive, 1e-13 * scale) else {
                return;
            };
            passive |= 1 << entering;
            loop {
                product(&self.inverses[passive], kappa, &mut trial[..count]);
                let Some((leaving, step)) = first_to_vanish(species, &trial, passive) else {
                    species.copy_from_slice(&trial[..count]);
                    break;
                };
                for (s, t) in species.iter_mut().zip(&trial) {
                    *s = (*s + step * (t - *s)).max(0.0);
                }
                // Set by name, not by size, so that each turn makes the set smaller.
                species[leaving] = 0.0;
                passive &= !(1 << leaving);
            }
        }
    }

    /// The species outside the set along which the misfit falls most steeply.
    fn steepest(&self, projected: &[f64], species: &[f64], passive: usize, tolerance: f64) -> Option<usize> {
        let descent = |i: usize| {
            let fitted: f64 = (0..species.len()).map(|j| self.normal[(i, j)] * species[j]).sum();
            projected[i] - fitted
        };
        (0..species.len())
            .filter(|i| passive & (1 << i) == 0)
            .map(|i| (i, descent(i)))
            .filter(|&(_, slope)| slope > tolerance)
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(i, _)| i)
    }
}

/// The species of the set that first reaches zero on the way from `species` to `trial`, and after
/// which share of the way; nothing if `trial` is positive.
fn first_to_vanish(species: &[f64], trial: &[f64], passive: usize) -> Option<(usize, f64)> {
    (0..species.len())
        .filter(|&i| passive & (1 << i) != 0 && trial[i] <= 0.0)
        .map(|i| (i, species[i] / (species[i] - trial[i])))
        // From zero to zero there is no way to go: 0 / 0.
        .map(|(i, step)| (i, if step.is_finite() { step } else { 0.0 }))
        .min_by(|a, b| a.1.total_cmp(&b.1))
}

fn subset_inverse(matrix: &DMatrix<f64>, set: usize) -> DMatrix<f64> {
    let members: Vec<usize> = (0..matrix.ncols()).filter(|i| set & (1 << i) != 0).collect();
    let mut inverse = DMatrix::zeros(matrix.ncols(), matrix.nrows());
    if !members.is_empty() {
        let solved = pseudo_inverse(&matrix.select_columns(&members));
        for (row, &i) in members.iter().enumerate() {
            inverse.set_row(i, &solved.row(row));
        }
    }
    inverse
}

pub(super) fn product(matrix: &DMatrix<f64>, vector: &[f64], result: &mut [f64]) {
    for (i, to) in result.iter_mut().enumerate() {
        *to = (0..vector.len()).map(|u| matrix[(i, u)] * vector[u]).sum();
    }
}
