//! Unmixing itself: one method, made ready for one matrix, used on pixels or whole images.
//!
//! In: one value or image per spectral channel. Out: one value or image per species.
//! Never: mixes neighboring pixels; NaN in any channel is NaN in every species.
//! Fails: [`UnmixingError::Images`] for images that are missing or of different shapes.

use nalgebra::DMatrix;
use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

use super::UnmixingError;
use super::nonnegative::{ActiveSets, product};

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

/// A method made ready for one matrix.
#[derive(Debug, Clone)]
pub struct Unmixer {
    pub(super) num_channels: usize,
    pub(super) num_species: usize,
    pub(super) solver: Solver,
}

#[derive(Debug, Clone)]
pub(super) enum Solver {
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
