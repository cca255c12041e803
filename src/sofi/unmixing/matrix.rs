//! The mixing matrix `M` of a set of dyes, and everything that follows from it (Eq. 2, S2, S4).
//!
//! In: cumulant order and spectral responses. Out: [`UnmixingMatrix`], proved to be solvable.
//! Never: exists for dyes that cannot be told apart. Fails: [`UnmixingError`].

use nalgebra::{DMatrix, DVector};
use ndarray::{Array2, ArrayRef2, ArrayView2};

use super::diagnosis::{checked_singular_values, condition};
use super::jacobi::pseudo_inverse;
use super::nonnegative::ActiveSets;
use super::unmixer::{Solver, Unmixer, UnmixingMethod};
use super::{MAX_ORDER, UnmixingError};
use crate::sofi::spectra::Species;

/// `M`, spectral channels from species, with its pseudo-inverse and conditioning.
#[derive(Debug, Clone, PartialEq)]
pub struct UnmixingMatrix {
    order: usize,
    names: Vec<String>,
    spectral_channels: Vec<Vec<usize>>,
    pub(super) matrix: DMatrix<f64>,
    pub(super) pseudo_inverse: DMatrix<f64>,
    singular_values: Vec<f64>,
}

impl UnmixingMatrix {
    /// Two channels behind one dichroic: `M[u, i] = T_i^u R_i^(n-u)`, rows `u = 0..=n` (Eq. 2, S2).
    ///
    /// # Errors
    /// Every variant of [`UnmixingError`] but `Images` and `Method`.
    pub fn new(order: usize, species: &[Species]) -> Result<Self, UnmixingError> {
        let names: Vec<String> = species.iter().map(|s| s.name.clone()).collect();
        let shares = Array2::from_shape_fn((2, species.len()), |(channel, i)| match channel {
            0 => species[i].response.reflection(),
            _ => species[i].response.transmission(),
        });
        Self::from_proportions(order, &names, &shares)
    }

    /// Any number `N_p` of physical channels (Eq. S4): `M[(c_1..c_n), i] = prod_j P[c_j, i]`.
    ///
    /// `proportions` has shape `(N_p, species)` and values in `0..=1`. The rows are all sets of
    /// channels `c_1 <= ... <= c_n` in lexicographic order; with the two channels in the order
    /// (R, T) that is `u = 0..=n`, and one channel gives a single row.
    ///
    /// # Errors
    /// Every variant of [`UnmixingError`] but `Images` and `Method`.
    pub fn from_proportions(
        order: usize,
        names: &[String],
        proportions: &ArrayRef2<f64>,
    ) -> Result<Self, UnmixingError> {
        check_proportions(order, names, proportions)?;
        let spectral_channels = channel_sets(order, proportions.nrows());
        if names.len() > spectral_channels.len() {
            return Err(UnmixingError::TooManySpecies {
                species: names.len(),
                spectral_channels: spectral_channels.len(),
            });
        }
        let matrix = mixing_matrix(&spectral_channels, proportions);
        let singular_values = checked_singular_values(&matrix, names)?;
        Ok(Self {
            order,
            names: names.to_vec(),
            spectral_channels,
            pseudo_inverse: pseudo_inverse(&matrix),
            matrix,
            singular_values,
        })
    }

    /// Cumulant order `n`.
    #[must_use]
    pub fn order(&self) -> usize {
        self.order
    }

    /// Names of the species, in the order of the columns and of the unmixed images.
    #[must_use]
    pub fn species(&self) -> &[String] {
        &self.names
    }

    /// The physical channels (from 0; two cameras: 0 = R, 1 = T) of each row, in the order of the images.
    #[must_use]
    pub fn spectral_channels(&self) -> &[Vec<usize>] {
        &self.spectral_channels
    }

    /// `M[row, species]`, dimensionless.
    #[must_use]
    pub fn matrix(&self) -> Array2<f64> {
        to_array(&self.matrix)
    }

    /// Pseudo-inverse of `M`, `[species, row]`, dimensionless.
    #[must_use]
    pub fn pseudo_inverse(&self) -> Array2<f64> {
        to_array(&self.pseudo_inverse)
    }

    /// Singular values of `M`, largest first.
    #[must_use]
    pub fn singular_values(&self) -> &[f64] {
        &self.singular_values
    }

    /// Largest over smallest singular value, `1..=MAX_CONDITION`.
    #[must_use]
    pub fn condition(&self) -> f64 {
        condition(&self.singular_values)
    }

    /// Standard deviation of each unmixed species for independent unit noise in every channel:
    /// the row norms of the pseudo-inverse.
    #[must_use]
    pub fn noise_gain(&self) -> Vec<f64> {
        self.pseudo_inverse.row_iter().map(|row| row.norm()).collect()
    }

    /// Determinant, if there are as many species as spectral channels.
    ///
    /// For three species at order 2 with `R = 1 - T` it is `(T2-T1)(T3-T1)(T3-T2)`
    /// with the rows in the order RR, TR, TT and a sign change for each swap of rows.
    #[must_use]
    pub fn determinant(&self) -> Option<f64> {
        self.matrix.is_square().then(|| self.matrix.determinant())
    }

    /// Absolute eigenvalues, largest first, if `M` is square (supporting information, Fig. S2b).
    #[must_use]
    pub fn eigenvalue_magnitudes(&self) -> Option<Vec<f64>> {
        if !self.matrix.is_square() {
            return None;
        }
        let eigenvalues = self.matrix.complex_eigenvalues();
        let mut magnitudes: Vec<f64> = eigenvalues.iter().map(|z| z.re.hypot(z.im)).collect();
        magnitudes.sort_by(|a, b| b.total_cmp(a));
        Some(magnitudes)
    }

    /// Mixes the cumulants of the species into those of the spectral channels: `kappa = M s`.
    ///
    /// Species beyond the slice count as zero.
    #[must_use]
    pub fn mix(&self, species: &[f64]) -> Vec<f64> {
        let row_sum = |row: usize| {
            let terms = species.iter().take(self.names.len()).enumerate();
            terms.map(|(i, s)| self.matrix[(row, i)] * s).sum()
        };
        (0..self.matrix.nrows()).map(row_sum).collect()
    }

    /// Unmixes images by the pseudo-inverse.
    ///
    /// # Errors
    /// [`UnmixingError::Images`] unless there is one image per spectral channel, all of one shape.
    pub fn unmix(&self, kappa: &[ArrayView2<f32>]) -> Result<Vec<Array2<f32>>, UnmixingError> {
        self.unmix_with(&UnmixingMethod::PseudoInverse, kappa)
    }

    /// Unmixes images by the method chosen.
    ///
    /// # Errors
    /// [`UnmixingError::Images`] and those of [`UnmixingMatrix::unmixer`].
    pub fn unmix_with(
        &self,
        method: &UnmixingMethod,
        kappa: &[ArrayView2<f32>],
    ) -> Result<Vec<Array2<f32>>, UnmixingError> {
        self.unmixer(method)?.images(kappa)
    }

    /// Prepares a method once, to be used on many pixels or images.
    ///
    /// # Errors
    /// [`UnmixingError::Method`]: wrong number of weights, weights not positive, negative strength,
    /// or more than [`MAX_NON_NEGATIVE_SPECIES`](super::MAX_NON_NEGATIVE_SPECIES) species for the non-negative method.
    pub fn unmixer(&self, method: &UnmixingMethod) -> Result<Unmixer, UnmixingError> {
        let solver = match method {
            UnmixingMethod::PseudoInverse => Solver::Linear(self.pseudo_inverse.clone()),
            UnmixingMethod::NonNegative => Solver::NonNegative(ActiveSets::new(&self.matrix)?),
            UnmixingMethod::Weighted { weights } => Solver::Linear(self.weighted_inverse(weights)?),
            UnmixingMethod::Regularized { strength } => Solver::Linear(self.regularized_inverse(*strength)?),
        };
        Ok(Unmixer { num_channels: self.matrix.nrows(), num_species: self.matrix.ncols(), solver })
    }

    fn weighted_inverse(&self, weights: &[f64]) -> Result<DMatrix<f64>, UnmixingError> {
        let all_good = weights.iter().all(|w| w.is_finite() && *w > 0.0);
        if weights.len() != self.matrix.nrows() || !all_good {
            return Err(UnmixingError::Method(format!(
                "needs {} positive weights, got {weights:?}",
                self.matrix.nrows()
            )));
        }
        let roots =
            DMatrix::from_diagonal(&DVector::from_iterator(weights.len(), weights.iter().map(|w| w.sqrt())));
        Ok(pseudo_inverse(&(&roots * &self.matrix)) * roots)
    }

    fn regularized_inverse(&self, strength: f64) -> Result<DMatrix<f64>, UnmixingError> {
        if !(strength.is_finite() && strength >= 0.0) {
            return Err(UnmixingError::Method(format!(
                "regularization strength {strength} must be at least 0"
            )));
        }
        // Least squares of M stacked on strength * sigma_max * identity.
        let (rows, columns) = self.matrix.shape();
        let diagonal = strength * self.singular_values[0];
        let stacked = DMatrix::from_fn(rows + columns, columns, |row, i| {
            if row < rows {
                self.matrix[(row, i)]
            } else if row - rows == i {
                diagonal
            } else {
                0.0
            }
        });
        Ok(pseudo_inverse(&stacked).columns(0, rows).into_owned())
    }
}

fn to_array(matrix: &DMatrix<f64>) -> Array2<f64> {
    Array2::from_shape_fn(matrix.shape(), |index| matrix[index])
}

fn check_proportions(
    order: usize,
    names: &[String],
    proportions: &ArrayRef2<f64>,
) -> Result<(), UnmixingError> {
    let (physical_channels, columns) = proportions.dim();
    if names.is_empty() {
        return Err(UnmixingError::NoSpecies);
    }
    if names.len() != columns {
        return Err(UnmixingError::Names { names: names.len(), columns });
    }
    if !(1..=MAX_ORDER).contains(&order) || physical_channels == 0 {
        return Err(UnmixingError::Order { order, physical_channels });
    }
    for ((_, i), &value) in proportions.indexed_iter() {
        if !(0.0..=1.0).contains(&value) {
            return Err(UnmixingError::Coefficient { name: names[i].clone(), value });
        }
    }
    match (0..columns).find(|&i| proportions.column(i).iter().all(|&share| share == 0.0)) {
        Some(dark) => Err(UnmixingError::Invisible { name: names[dark].clone() }),
        None => Ok(()),
    }
}

/// `M[(c_1..c_n), i] = prod_j P[c_j, i]` (Eq. S4), whether it can be inverted or not.
pub(in crate::sofi) fn mixing_matrix(
    spectral_channels: &[Vec<usize>],
    proportions: &ArrayRef2<f64>,
) -> DMatrix<f64> {
    DMatrix::from_fn(spectral_channels.len(), proportions.ncols(), |row, i| {
        spectral_channels[row].iter().map(|&channel| proportions[[channel, i]]).product()
    })
}

/// All `c_1 <= ... <= c_n` out of `0..num_physical`, in lexicographic order.
pub(in crate::sofi) fn channel_sets(order: usize, num_physical: usize) -> Vec<Vec<usize>> {
    let mut sets = vec![Vec::new()];
    for _ in 0..order {
        sets = sets
            .iter()
            .flat_map(|set: &Vec<usize>| {
                let least = set.last().copied().unwrap_or(0);
                (least..num_physical).map(move |next| {
                    let mut longer = set.clone();
                    longer.push(next);
                    longer
                })
            })
            .collect();
    }
    sets
}
