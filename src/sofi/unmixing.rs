//! Turns cumulant images of spectral channels into cumulant images of species (step 3; Eq. 2, S2, S4).
//!
//! In: the spectral responses, and one float32 image per spectral channel, all of one shape,
//! in the order of [`UnmixingMatrix::spectral_channels`] (two cameras: `u = 0..=n` pixels from T).
//! Out: one float32 image per species, in the order the species were given.
//! Never: mixes neighboring pixels, clips or invents values; NaN in any channel is NaN in every species.
//! Fails: [`UnmixingError`]; dyes that cannot be told apart are named.

use nalgebra::{DMatrix, DVector};
use ndarray::{Array2, ArrayRef2, ArrayView2};
use rayon::prelude::*;
use thiserror::Error;

use super::spectra::Species;

/// Systems with a larger condition number are refused.
pub const MAX_CONDITION: f64 = 1e6;
/// Largest cumulant order accepted.
pub const MAX_ORDER: usize = 12;
/// Most species that [`UnmixingMethod::NonNegative`] accepts: it keeps a solver for every subset.
pub const MAX_NON_NEGATIVE_SPECIES: usize = 10;

/// Sweeps of rotations that no matrix of this kind needs.
const MAX_SWEEPS: usize = 60;
/// Two unit columns closer than this count as one and the same spectrum.
const PARALLEL: f64 = 1e-4;

/// Why a mixture cannot be unmixed.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum UnmixingError {
    /// Nothing to unmix.
    #[error("no species given")]
    NoSpecies,
    /// Order outside `1..=MAX_ORDER`, or no physical channel.
    #[error("cumulant order {order} with {physical_channels} physical channels is not supported")]
    Order {
        /// The order asked for.
        order: usize,
        /// Number of physical channels.
        physical_channels: usize,
    },
    /// More unknowns than equations.
    #[error("{species} species but only {spectral_channels} spectral channels: use a higher order")]
    TooManySpecies {
        /// Number of species.
        species: usize,
        /// Number of spectral channels, `C(n + N_p - 1, n)`.
        spectral_channels: usize,
    },
    /// A share of light is not a number in `0..=1`.
    #[error("{name}: the share {value} of its light is not a number between 0 and 1")]
    Coefficient {
        /// The species.
        name: String,
        /// Its bad share.
        value: f64,
    },
    /// A species that no channel sees.
    #[error("{name} is seen by no channel")]
    Invisible {
        /// The species.
        name: String,
    },
    /// The number of names and of columns of proportions differ.
    #[error("{names} names for {columns} species")]
    Names {
        /// Number of names.
        names: usize,
        /// Number of species in the proportions.
        columns: usize,
    },
    /// Condition number above [`MAX_CONDITION`].
    #[error("cannot be told apart: {} (condition number {condition:.3e})", describe(groups))]
    Indistinguishable {
        /// Each group holds the names of species that look alike to these channels.
        groups: Vec<Vec<String>>,
        /// Condition number of the matrix.
        condition: f64,
    },
    /// Channel images are missing, superfluous or of different shapes.
    #[error("expected {expected} channel images of one shape, got {got}")]
    Images {
        /// Number of spectral channels.
        expected: usize,
        /// What was given instead.
        got: String,
    },
    /// The chosen method cannot be used on this system.
    #[error("unmixing method: {0}")]
    Method(String),
}

/// How the species are solved for, pixel by pixel.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub enum UnmixingMethod {
    /// Least squares by the pseudo-inverse; linear, keeps negative values.
    #[default]
    PseudoInverse,
    /// Least squares with every species at least zero (Lawson and Hanson).
    NonNegative,
    /// Weighted least squares: minimizes `sum_u w_u (kappa_u - (M s)_u)^2`.
    Weighted {
        /// One positive weight per spectral channel, best the inverse variances.
        weights: Vec<f64>,
    },
    /// Tikhonov: minimizes `|kappa - M s|^2 + (strength * sigma_max)^2 |s|^2`.
    Regularized {
        /// Strength relative to the largest singular value, at least 0 (0 is the pseudo-inverse).
        strength: f64,
    },
}

/// `M`, spectral channels from species, with its pseudo-inverse and conditioning.
#[derive(Debug, Clone, PartialEq)]
pub struct UnmixingMatrix {
    order: usize,
    names: Vec<String>,
    spectral_channels: Vec<Vec<usize>>,
    matrix: DMatrix<f64>,
    pseudo_inverse: DMatrix<f64>,
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
        let matrix = DMatrix::from_fn(spectral_channels.len(), names.len(), |row, i| {
            let set = &spectral_channels[row];
            set.iter().map(|&channel| proportions[[channel, i]]).product()
        });
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
    /// or more than [`MAX_NON_NEGATIVE_SPECIES`] species for the non-negative method.
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

/// A method made ready for one matrix.
#[derive(Debug, Clone)]
pub struct Unmixer {
    num_channels: usize,
    num_species: usize,
    solver: Solver,
}

#[derive(Debug, Clone)]
enum Solver {
    Linear(DMatrix<f64>),
    NonNegative(ActiveSets),
}

impl Unmixer {
    /// Solves one pixel; `kappa` in the order of the spectral channels.
    ///
    /// # Errors
    /// [`UnmixingError::Images`] unless there is one value per spectral channel.
    pub fn pixel(&self, kappa: &[f64]) -> Result<Vec<f64>, UnmixingError> {
        if kappa.len() != self.num_channels {
            return Err(self.wrong_images(format!("{} values", kappa.len())));
        }
        let mut species = vec![0.0; self.num_species];
        match &self.solver {
            Solver::Linear(inverse) => product(inverse, kappa, &mut species),
            Solver::NonNegative(sets) => sets.solve(kappa, &mut species),
        }
        Ok(species)
    }

    /// Solves every pixel of the channel images, in parallel over rows.
    ///
    /// # Errors
    /// [`UnmixingError::Images`] unless there is one image per spectral channel, all of one shape.
    pub fn images(&self, kappa: &[ArrayView2<f32>]) -> Result<Vec<Array2<f32>>, UnmixingError> {
        if kappa.len() != self.num_channels {
            return Err(self.wrong_images(format!("{} images", kappa.len())));
        }
        let shape = kappa[0].dim();
        if let Some(other) = kappa.iter().find(|image| image.dim() != shape) {
            return Err(self.wrong_images(format!("shapes {shape:?} and {:?}", other.dim())));
        }
        let mut images = vec![Array2::zeros(shape); self.num_species];
        if shape.0 > 0 && shape.1 > 0 {
            let (coordinates, rows) = rows_of(&mut images);
            coordinates.into_par_iter().zip(rows).for_each_init(
                || Scratch::new(self.num_channels, shape.1),
                |scratch, (y, mut species)| {
                    scratch.load(kappa, y);
                    self.row(scratch, &mut species);
                },
            );
        }
        Ok(images)
    }

    fn row(&self, scratch: &mut Scratch, species: &mut [&mut [f32]]) {
        match &self.solver {
            Solver::Linear(inverse) => linear_row(inverse, scratch, species),
            Solver::NonNegative(sets) => non_negative_row(sets, scratch, species),
        }
    }

    fn wrong_images(&self, got: String) -> UnmixingError {
        UnmixingError::Images { expected: self.num_channels, got }
    }
}

/// One row of every channel as float64, and one of sums.
struct Scratch {
    channels: Vec<Vec<f64>>,
    sums: Vec<f64>,
}

impl Scratch {
    fn new(num_channels: usize, width: usize) -> Self {
        Self { channels: vec![vec![0.0; width]; num_channels], sums: vec![0.0; width] }
    }

    fn load(&mut self, kappa: &[ArrayView2<f32>], y: usize) {
        for (channel, image) in self.channels.iter_mut().zip(kappa) {
            let row = image.row(y);
            match row.as_slice() {
                Some(values) => copy_widened(values, channel),
                None => channel.iter_mut().zip(row).for_each(|(to, &from)| *to = f64::from(from)),
            }
        }
    }
}

fn copy_widened(from: &[f32], to: &mut [f64]) {
    to.iter_mut().zip(from).for_each(|(to, &from)| *to = f64::from(from));
}

fn linear_row(inverse: &DMatrix<f64>, scratch: &mut Scratch, species: &mut [&mut [f32]]) {
    let Scratch { channels, sums } = scratch;
    for (i, output) in species.iter_mut().enumerate() {
        sums.fill(0.0);
        for (u, channel) in channels.iter().enumerate() {
            // Zero coefficients stay in: 0 * NaN carries a missing channel into every species.
            let coefficient = inverse[(i, u)];
            for (sum, kappa) in sums.iter_mut().zip(channel) {
                *sum += coefficient * kappa;
            }
        }
        for (to, &sum) in output.iter_mut().zip(sums.iter()) {
            *to = sum as f32;
        }
    }
}

fn non_negative_row(sets: &ActiveSets, scratch: &Scratch, species: &mut [&mut [f32]]) {
    let mut kappa = vec![0.0; scratch.channels.len()];
    let mut solution = vec![0.0; species.len()];
    for x in 0..scratch.sums.len() {
        for (value, channel) in kappa.iter_mut().zip(&scratch.channels) {
            *value = channel[x];
        }
        sets.solve(&kappa, &mut solution);
        for (output, &value) in species.iter_mut().zip(&solution) {
            output[x] = value as f32;
        }
    }
}

/// Row `y` of every image side by side, for all `y`.
fn rows_of(images: &mut [Array2<f32>]) -> (Vec<usize>, Vec<Vec<&mut [f32]>>) {
    let (height, _) = images[0].dim();
    let mut rows: Vec<Vec<&mut [f32]>> = (0..height).map(|_| Vec::new()).collect();
    for image in images {
        for (row, of_image) in rows.iter_mut().zip(image.rows_mut()) {
            row.extend(of_image.into_slice());
        }
    }
    ((0..height).collect(), rows)
}

/// Non-negative least squares after Lawson and Hanson (1974, chapter 23), with the least-squares
/// solution of every subset of species computed beforehand.
#[derive(Debug, Clone)]
struct ActiveSets {
    /// `M^T`, for the gradient.
    transposed: DMatrix<f64>,
    /// `M^T M`.
    normal: DMatrix<f64>,
    /// Pseudo-inverse of the columns in each subset, by bit mask, zero rows for absent species.
    inverses: Vec<DMatrix<f64>>,
}

impl ActiveSets {
    fn new(matrix: &DMatrix<f64>) -> Result<Self, UnmixingError> {
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

    fn solve(&self, kappa: &[f64], species: &mut [f64]) {
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

fn product(matrix: &DMatrix<f64>, vector: &[f64], result: &mut [f64]) {
    for (i, to) in result.iter_mut().enumerate() {
        *to = (0..vector.len()).map(|u| matrix[(i, u)] * vector[u]).sum();
    }
}

/// Singular values (largest first) and both sides' vectors: `matrix V = scaled`, whose columns are
/// orthogonal and have the singular values as norms.
struct SingularValues {
    values: Vec<f64>,
    scaled: DMatrix<f64>,
    right: DMatrix<f64>,
}

impl SingularValues {
    /// One-sided Jacobi rotations (Hestenes 1958): for matrices this small the most accurate way.
    fn of(matrix: &DMatrix<f64>) -> Self {
        let count = matrix.ncols();
        let (mut scaled, mut right) = (matrix.clone(), DMatrix::identity(count, count));
        for _ in 0..MAX_SWEEPS {
            let mut is_settled = true;
            for p in 0..count {
                for q in p + 1..count {
                    is_settled &= !make_orthogonal(&mut scaled, &mut right, p, q);
                }
            }
            if is_settled {
                break;
            }
        }
        let norms: Vec<f64> = scaled.column_iter().map(|column| column.norm()).collect();
        let mut by_size: Vec<usize> = (0..count).collect();
        by_size.sort_by(|&a, &b| norms[b].total_cmp(&norms[a]));
        Self {
            values: by_size.iter().map(|&k| norms[k]).collect(),
            scaled: scaled.select_columns(&by_size),
            right: right.select_columns(&by_size),
        }
    }
}

/// Rotates columns `p` and `q` until they are orthogonal; false if they were.
fn make_orthogonal(scaled: &mut DMatrix<f64>, right: &mut DMatrix<f64>, p: usize, q: usize) -> bool {
    let product = scaled.column(p).dot(&scaled.column(q));
    let (norm_p, norm_q) = (scaled.column(p).norm(), scaled.column(q).norm());
    if product.abs() <= f64::EPSILON * norm_p * norm_q {
        return false;
    }
    let zeta = (norm_q - norm_p) * (norm_q + norm_p) / (2.0 * product);
    let tangent = 1.0_f64.copysign(zeta) / (zeta.abs() + zeta.hypot(1.0));
    let cosine = 1.0 / tangent.hypot(1.0);
    let sine = cosine * tangent;
    for matrix in [scaled, right] {
        for row in 0..matrix.nrows() {
            let (a, b) = (matrix[(row, p)], matrix[(row, q)]);
            matrix[(row, p)] = cosine * a - sine * b;
            matrix[(row, q)] = sine * a + cosine * b;
        }
    }
    true
}

/// `V S^-1 U^T`; the columns are known to be independent, so no singular value is dropped.
fn pseudo_inverse(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let svd = SingularValues::of(matrix);
    let inverse_squares = svd.values.iter().map(|s| 1.0 / (s * s));
    let diagonal = DVector::from_iterator(svd.values.len(), inverse_squares);
    svd.right * DMatrix::from_diagonal(&diagonal) * svd.scaled.transpose()
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

/// All `c_1 <= ... <= c_n` out of `0..num_physical`, in lexicographic order.
fn channel_sets(order: usize, num_physical: usize) -> Vec<Vec<usize>> {
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

fn checked_singular_values(matrix: &DMatrix<f64>, names: &[String]) -> Result<Vec<f64>, UnmixingError> {
    let svd = SingularValues::of(matrix);
    let condition = condition(&svd.values);
    // Not "greater than": the condition of a singular matrix may be NaN.
    if condition <= MAX_CONDITION {
        return Ok(svd.values);
    }
    let mut groups = parallel_columns(matrix);
    if groups.is_empty() {
        groups = vec![null_members(&svd)];
    }
    let named = |group: Vec<usize>| group.into_iter().map(|i| names[i].clone()).collect();
    Err(UnmixingError::Indistinguishable { groups: groups.into_iter().map(named).collect(), condition })
}

/// Largest over smallest of values sorted from large to small.
fn condition(singular_values: &[f64]) -> f64 {
    let largest = singular_values.first().copied().unwrap_or(f64::NAN);
    let smallest = singular_values.last().copied().unwrap_or(f64::NAN);
    largest / smallest
}

/// Groups of two or more species whose columns point the same way.
fn parallel_columns(matrix: &DMatrix<f64>) -> Vec<Vec<usize>> {
    let units: Vec<DVector<f64>> =
        matrix.column_iter().map(|column| column.into_owned().normalize()).collect();
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (i, unit) in units.iter().enumerate() {
        let same = |group: &&mut Vec<usize>| (&units[group[0]] - unit).norm() < PARALLEL;
        match groups.iter_mut().find(same) {
            Some(group) => group.push(i),
            None => groups.push(vec![i]),
        }
    }
    groups.retain(|group| group.len() > 1);
    groups
}

/// Species that take part in the combinations the channels cannot see.
fn null_members(svd: &SingularValues) -> Vec<usize> {
    let unseen = svd.values[0] / MAX_CONDITION;
    let weight = |i: usize| -> f64 {
        (0..svd.values.len()).filter(|&k| svd.values[k] < unseen).map(|k| svd.right[(i, k)].powi(2)).sum()
    };
    let weights: Vec<f64> = (0..svd.values.len()).map(weight).collect();
    let most = weights.iter().copied().fold(0.0, f64::max);
    (0..weights.len()).filter(|&i| weights[i] >= 0.01 * most).collect()
}

fn describe(groups: &[Vec<String>]) -> String {
    let groups: Vec<String> = groups.iter().map(|group| group.join(" and ")).collect();
    groups.join("; ")
}

/// Reference images that other implementations made, for the tests of this room.
#[cfg(test)]
pub(super) mod reference {
    use std::{fs::File, path::Path};

    use ndarray::Array2;
    use tiff::decoder::{Decoder, DecodingResult};

    /// All pages of a reference file, or nothing (and a printed line) if the folder is absent.
    pub(in crate::sofi) fn pages(name: &str) -> Option<Vec<Array2<f32>>> {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data");
        if !Path::new(folder).is_dir() {
            println!("skipped: no reference data in {folder}");
            return None;
        }
        let file = File::open(Path::new(folder).join(name)).unwrap();
        let mut decoder = Decoder::new(file).unwrap();
        let mut pages = Vec::new();
        loop {
            let (width, height) = decoder.dimensions().unwrap();
            let values: Vec<f32> = match decoder.read_image().unwrap() {
                DecodingResult::F32(values) => values,
                DecodingResult::U16(values) => values.into_iter().map(f32::from).collect(),
                _ => panic!("unexpected pixel type in {name}"),
            };
            let shape = (height as usize, width as usize);
            pages.push(Array2::from_shape_vec(shape, values).unwrap());
            if !decoder.more_images() {
                return Some(pages);
            }
            decoder.next_image().unwrap();
        }
    }

    /// Largest difference over the root mean square of `expected`; NaN must be in the same places.
    pub(in crate::sofi) fn disagreement(image: &Array2<f32>, expected: &Array2<f32>) -> f64 {
        assert_eq!(image.dim(), expected.dim());
        let (mut worst, mut squares, mut count) = (0.0_f64, 0.0, 0.0);
        for (&a, &b) in image.iter().zip(expected) {
            assert_eq!(a.is_nan(), b.is_nan());
            if !b.is_nan() {
                worst = worst.max((f64::from(a) - f64::from(b)).abs());
                squares += f64::from(b).powi(2);
                count += 1.0;
            }
        }
        worst / (squares / count).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use proptest::prelude::*;

    use super::*;

    fn dyes(transmissions: &[f64]) -> Vec<Species> {
        let named = |(i, &t): (usize, &f64)| Species::new(&format!("dye {i}"), t).unwrap();
        transmissions.iter().enumerate().map(named).collect()
    }

    fn table_s1() -> Vec<Species> {
        let zt_594 = [("Alexa Fluor 488", 0.02), ("Atto 565", 0.35), ("Alexa Fluor 647", 0.98)];
        zt_594.map(|(name, t)| Species::new(name, t).unwrap()).to_vec()
    }

    fn names(count: usize) -> Vec<String> {
        (0..count).map(|i| format!("dye {i}")).collect()
    }

    /// The twin: every subset of species, solved by its normal equations; the least misfit wins.
    fn by_all_subsets(matrix: &UnmixingMatrix, kappa: &[f64]) -> (Vec<f64>, f64) {
        let m = &matrix.matrix;
        let mut best = (vec![0.0; m.ncols()], kappa.iter().map(|k| k * k).sum::<f64>());
        for set in 1..1_usize << m.ncols() {
            let members: Vec<usize> = (0..m.ncols()).filter(|i| set & (1 << i) != 0).collect();
            let part = m.select_columns(&members);
            let right = part.transpose() * DVector::from_column_slice(kappa);
            let Some(inverse) = (part.transpose() * &part).try_inverse() else {
                continue;
            };
            let solved = inverse * right;
            if solved.iter().all(|&s| s >= 0.0) {
                let mut species = vec![0.0; m.ncols()];
                members.iter().zip(solved.iter()).for_each(|(&i, &s)| species[i] = s);
                let misfit = misfit(matrix, &species, kappa);
                if misfit < best.1 {
                    best = (species, misfit);
                }
            }
        }
        best
    }

    fn misfit(matrix: &UnmixingMatrix, species: &[f64], kappa: &[f64]) -> f64 {
        let fitted = matrix.mix(species);
        fitted.iter().zip(kappa).map(|(f, k)| (f - k).powi(2)).sum()
    }

    /// Transmissions at least 0.15 apart, in random order of size.
    fn spread_transmissions(count: usize) -> impl Strategy<Value = Vec<f64>> {
        proptest::collection::vec(0.0..1.0_f64, count).prop_map(move |mut gaps| {
            let free = 1.0 - 0.15 * (count - 1) as f64;
            let sum: f64 = gaps.iter().sum::<f64>() + 0.1;
            let mut at = 0.0;
            for (i, gap) in gaps.iter_mut().enumerate() {
                at += *gap / sum * free + if i > 0 { 0.15 } else { 0.0 };
                *gap = at.min(1.0);
            }
            gaps
        })
    }

    proptest! {
        #[test]
        fn determinant_of_three_species_at_order_two(t in spread_transmissions(3)) {
            let matrix = UnmixingMatrix::new(2, &dyes(&t)).unwrap();
            let expected = (t[1] - t[0]) * (t[2] - t[0]) * (t[2] - t[1]);
            prop_assert!((matrix.determinant().unwrap() - expected).abs() < 1e-12);
            prop_assert!(expected.abs() <= 0.25);
        }

        #[test]
        fn unmixing_undoes_mixing(
            t in spread_transmissions(3),
            order in 2..=4_usize,
            s in proptest::collection::vec(-10.0..10.0_f64, 3),
        ) {
            let matrix = UnmixingMatrix::new(order, &dyes(&t)).unwrap();
            let methods = [
                UnmixingMethod::PseudoInverse,
                UnmixingMethod::Weighted { weights: (0..=order).map(|u| 1.0 + u as f64).collect() },
                UnmixingMethod::Regularized { strength: 0.0 },
            ];
            for method in methods {
                let unmixer = matrix.unmixer(&method).unwrap();
                let back = unmixer.pixel(&matrix.mix(&s)).unwrap();
                for (a, b) in back.iter().zip(&s) {
                    prop_assert!((a - b).abs() < 1e-9 * matrix.condition(), "{method:?}");
                }
            }
        }

        #[test]
        fn non_negative_finds_the_best_of_all_subsets(
            t in spread_transmissions(4),
            order in 3..=5_usize,
            noise in proptest::collection::vec(-1.0..1.0_f64, 6),
        ) {
            let matrix = UnmixingMatrix::new(order, &dyes(&t)).unwrap();
            let kappa = &noise[..=order];
            let unmixer = matrix.unmixer(&UnmixingMethod::NonNegative).unwrap();
            let species = unmixer.pixel(kappa).unwrap();
            let (expected, least) = by_all_subsets(&matrix, kappa);
            prop_assert!(species.iter().all(|&s| s >= 0.0));
            prop_assert!((misfit(&matrix, &species, kappa) - least).abs() < 1e-9);
            let scale = expected.iter().copied().fold(1.0, f64::max);
            for (a, b) in species.iter().zip(&expected) {
                prop_assert!((a - b).abs() < 1e-6 * scale, "{species:?} {expected:?}");
            }
        }

        #[test]
        fn two_channels_reduce_to_powers_of_t_and_r(t in spread_transmissions(3), order in 2..=6_usize) {
            let matrix = UnmixingMatrix::new(order, &dyes(&t)).unwrap();
            for u in 0..=order {
                prop_assert_eq!(matrix.spectral_channels()[u].iter().sum::<usize>(), u);
                for (i, t) in t.iter().enumerate() {
                    let expected = t.powi(u as i32) * (1.0 - t).powi((order - u) as i32);
                    prop_assert!((matrix.matrix()[[u, i]] - expected).abs() < 1e-14);
                }
            }
        }
    }

    #[test]
    fn the_pseudo_inverse_is_exact_to_rounding() {
        // A case that a general-purpose decomposition solved to eight digits only.
        let t = [0.037_001_195_345_244_59, 0.565_080_417_060_820_9, 0.961_669_960_954_710_6];
        let matrix = UnmixingMatrix::new(4, &dyes(&t)).unwrap();
        let identity = &matrix.pseudo_inverse * &matrix.matrix;
        assert!((identity - DMatrix::identity(3, 3)).amax() < 1e-14);
        let squares: f64 = matrix.singular_values().iter().map(|s| s * s).sum();
        assert!((squares - matrix.matrix.norm_squared()).abs() < 1e-14);
    }

    #[test]
    fn eigenvalues_of_table_s1() {
        let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
        let eigenvalues = matrix.eigenvalue_magnitudes().unwrap();
        for (value, expected) in eigenvalues.iter().zip([0.975, 0.960, 0.213]) {
            assert!((value - expected).abs() < 5e-4, "{eigenvalues:?}");
        }
        assert!((eigenvalues.iter().product::<f64>() - 0.200).abs() < 5e-4);
    }

    #[test]
    fn swapping_two_rows_only_changes_the_sign_of_the_determinant() {
        let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
        let mut swapped = matrix.matrix.clone();
        swapped.swap_rows(0, 2);
        assert!((swapped.determinant() + matrix.determinant().unwrap()).abs() < 1e-12);
    }

    #[test]
    fn general_channels_are_counted_and_ordered() {
        assert_eq!(channel_sets(2, 3), [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]]);
        assert_eq!(channel_sets(3, 1), [[0, 0, 0]]);
        assert_eq!(channel_sets(4, 3).len(), 15);
        let one = Array2::from_elem((1, 1), 0.5);
        let matrix = UnmixingMatrix::from_proportions(3, &names(1), &one).unwrap();
        assert!((matrix.matrix()[[0, 0]] - 0.125).abs() < 1e-15);
        let three = Array2::from_shape_vec((3, 1), vec![0.5, 0.3, 0.2]).unwrap();
        let matrix = UnmixingMatrix::from_proportions(2, &names(1), &three).unwrap();
        assert!((matrix.matrix()[[4, 0]] - 0.06).abs() < 1e-15);
    }

    #[test]
    fn noise_gain_is_the_spread_of_unmixed_unit_noise() {
        let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
        let inverse = matrix.pseudo_inverse();
        for (gain, row) in matrix.noise_gain().iter().zip(inverse.rows()) {
            let expected: f64 = row.iter().map(|v| v * v).sum();
            assert!((gain - expected.sqrt()).abs() < 1e-12);
        }
        assert!(matrix.condition() < 10.0);
    }

    #[test]
    fn dyes_of_the_same_color_are_refused_by_name() {
        let mut species = table_s1();
        species[2] = Species::new("Atto 594", 0.35).unwrap();
        let Err(error) = UnmixingMatrix::new(2, &species) else { panic!() };
        let message = error.to_string();
        assert!(message.contains("Atto 565 and Atto 594"), "{message}");
        assert!(!message.contains("488"), "{message}");
    }

    #[test]
    fn dependent_but_not_parallel_columns_are_refused_by_name() {
        // The third dye is the mean of the first two; the fourth stands apart.
        let shares = Array2::from_shape_vec(
            (4, 4),
            vec![0.8, 0.2, 0.5, 0.0, 0.2, 0.8, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1],
        )
        .unwrap();
        let Err(UnmixingError::Indistinguishable { groups, .. }) =
            UnmixingMatrix::from_proportions(1, &names(4), &shares)
        else {
            panic!()
        };
        assert_eq!(groups, [["dye 0", "dye 1", "dye 2"]]);
    }

    #[test]
    fn impossible_systems_are_refused() {
        let refused = |order, shares: &[f64]| UnmixingMatrix::new(order, &dyes(shares)).unwrap_err();
        assert_eq!(refused(2, &[]), UnmixingError::NoSpecies);
        let too_many = UnmixingError::TooManySpecies { species: 4, spectral_channels: 3 };
        assert_eq!(refused(2, &[0.0, 0.3, 0.6, 0.9]), too_many);
        assert!(matches!(refused(0, &[0.5]), UnmixingError::Order { .. }));
        assert!(matches!(refused(99, &[0.5]), UnmixingError::Order { .. }));
        let shares = |value| Array2::from_elem((2, 1), value);
        for bad in [f64::NAN, -0.1, 1.1] {
            let error = UnmixingMatrix::from_proportions(2, &names(1), &shares(bad));
            assert!(matches!(error, Err(UnmixingError::Coefficient { .. })));
        }
        let dark = UnmixingMatrix::from_proportions(2, &names(1), &shares(0.0));
        assert!(matches!(dark, Err(UnmixingError::Invisible { .. })));
        let unnamed = UnmixingMatrix::from_proportions(2, &[], &shares(0.5));
        assert!(unnamed.is_err());
    }

    #[test]
    fn bad_images_and_methods_are_refused() {
        let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
        let (small, large) = (Array2::zeros((2, 2)), Array2::zeros((2, 3)));
        assert!(matrix.unmix(&[small.view(), small.view()]).is_err());
        assert!(matrix.unmix(&[small.view(), small.view(), large.view()]).is_err());
        let weighted = |weights| matrix.unmixer(&UnmixingMethod::Weighted { weights });
        assert!(weighted(vec![1.0, 1.0]).is_err());
        assert!(weighted(vec![1.0, 0.0, 1.0]).is_err());
        assert!(matrix.unmixer(&UnmixingMethod::Regularized { strength: -1.0 }).is_err());
        assert!(matrix.unmixer(&UnmixingMethod::NonNegative).unwrap().pixel(&[1.0]).is_err());
        let empty: Array2<f32> = Array2::zeros((0, 0));
        let species = matrix.unmix(&[empty.view(), empty.view(), empty.view()]).unwrap();
        assert_eq!(species[2].dim(), (0, 0));
    }

    #[test]
    fn a_missing_channel_is_missing_in_every_species() {
        let matrix = UnmixingMatrix::new(2, &dyes(&[0.0, 0.5, 1.0])).unwrap();
        let full = Array2::from_elem((2, 3), 1.0_f32);
        let mut holed = full.clone();
        holed[[1, 2]] = f32::NAN;
        for method in [UnmixingMethod::PseudoInverse, UnmixingMethod::NonNegative] {
            let kappa = [full.view(), full.view(), holed.view()];
            for species in matrix.unmix_with(&method, &kappa).unwrap() {
                assert!(species[[1, 2]].is_nan());
                assert_eq!(species.iter().filter(|v| v.is_nan()).count(), 1);
            }
        }
    }

    #[test]
    fn transposed_views_unmix_alike() {
        let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
        let image = Array2::from_shape_fn((5, 4), |(y, x)| (y * 7 + x) as f32);
        let kappa = [image.view(), image.view(), image.view()];
        let turned = [image.t(), image.t(), image.t()];
        let (plain, turned) = (matrix.unmix(&kappa).unwrap(), matrix.unmix(&turned).unwrap());
        assert_eq!(plain[1].t(), turned[1]);
    }

    #[test]
    fn agrees_with_the_reference_of_two_cameras() {
        for order in 2..=4 {
            let folder = "twocamera/expected_";
            let Some(kappa) = reference::pages(&format!("{folder}cumulants_order{order}.tif")) else {
                return;
            };
            let expected = reference::pages(&format!("{folder}unmixed_order{order}.tif")).unwrap();
            check_against(order, &kappa, &expected);
        }
    }

    #[test]
    fn agrees_with_the_published_software() {
        let Some(kappa) = reference::pages("sofipackage/expected_order2.tif") else {
            return;
        };
        let expected = reference::pages("sofipackage/expected_unmixed_order2.tif").unwrap();
        check_against(2, &kappa, &expected);
    }

    fn check_against(order: usize, kappa: &[Array2<f32>], expected: &[Array2<f32>]) {
        let matrix = UnmixingMatrix::new(order, &table_s1()).unwrap();
        let views: Vec<_> = kappa.iter().map(|image| image.view()).collect();
        for (species, expected) in matrix.unmix(&views).unwrap().iter().zip(expected) {
            let difference = reference::disagreement(species, expected);
            println!("order {order}: {difference:.2e}");
            assert!(difference < 1e-5);
        }
    }

    #[test]
    #[ignore = "a measurement: run it alone, with --nocapture"]
    fn speed_of_a_large_image() {
        let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
        let image = Array2::from_shape_fn((4096, 4096), |(y, x)| ((y * 31 + x * 17) % 101) as f32);
        for method in [UnmixingMethod::PseudoInverse, UnmixingMethod::NonNegative] {
            for _ in 0..2 {
                let start = Instant::now();
                let kappa = [image.view(), image.view(), image.view()];
                matrix.unmix_with(&method, &kappa).unwrap();
                println!("{method:?}: {:?}", start.elapsed());
            }
        }
    }
}
