//! Scores images against the ground truth.
//!
//! In: the truth and one image per species. Out: crosstalk, resolution, signal-to-noise, separation of patches.
//! Never: changes an image; NaN pixels are ignored everywhere.
//! Fails: [`ScoreError`] for images that do not fit each other, and for regions without a pixel.

mod patches;
mod regions;
mod resolution;
#[cfg(test)]
mod tests;

pub use patches::{PatchScore, patch_score};
use regions::Regions;
pub use resolution::resolution_nm;

use crate::truth::Truth;

/// An image on an `n`-fold grid over camera R: pixel `[Y, X]` sits at camera position `(Y / n, X / n)`.
#[derive(Debug, Clone, Copy)]
pub struct Plane<'a> {
    /// Pixels, row by row; NaN where there is no value.
    pub pixels: &'a [f32],
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// `n`, at least 1.
    pub fold: usize,
}

impl Plane<'_> {
    /// Camera position `[y, x]` of a pixel given by its place in `pixels`.
    pub(crate) fn position(&self, pixel: usize) -> [f64; 2] {
        let fold = self.fold as f64;
        [(pixel / self.width) as f64 / fold, (pixel % self.width) as f64 / fold]
    }
}

/// Why there is no score.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ScoreError {
    /// There must be one image per species.
    #[error("{found} images were given for {expected} species")]
    Images {
        /// Species of the truth.
        expected: usize,
        /// Images given.
        found: usize,
    },
    /// An image has no size, a size that differs from the others, or another number of pixels than its size says.
    #[error("image {0} does not have the size of the first image, or not as many pixels as its size says")]
    Size(usize),
    /// No valid pixel lies on a species and away from all others.
    #[error("no pixel lies on `{0}` and far enough from all other species")]
    NothingOf(String),
    /// No valid pixel lies far from everything.
    #[error("no pixel lies far enough from all species to be background")]
    NoBackground,
    /// The image of a species is not brighter on the species than in the background.
    #[error("the image of `{0}` is not brighter on it than in the background")]
    NoSignal(String),
    /// The cross-section of a species cannot be measured.
    #[error("`{0}` has no filament whose width could be measured")]
    NoFilament(String),
    /// The scene has no patches.
    #[error("the scene has no patches")]
    NoPatches,
}

/// Crosstalk in percent: row = species, column = image; the diagonal is 100.
///
/// For species `i` the mean of image `j` within 0.75 camera pixels of its filaments (or inside its areas) and
/// at least 6 away from all other species, minus the mean of image `j` at least 7 away from everything,
/// relative to the same of image `i` (paper, Tables 2 and 3).
///
/// # Errors
/// [`ScoreError`] when images do not fit, a region is empty, or an image shows no signal of its own species.
pub fn crosstalk_percent(truth: &Truth, images: &[Plane<'_>]) -> Result<Vec<Vec<f64>>, ScoreError> {
    let regions = Regions::new(truth, images)?;
    let background = images
        .iter()
        .map(|image| regions.background(image).map(|(mean, _)| mean))
        .collect::<Result<Vec<f64>, _>>()?;
    truth
        .species
        .iter()
        .enumerate()
        .map(|(species, facts)| {
            let above = images
                .iter()
                .zip(&background)
                .map(|(image, base)| Ok(regions.mean_of(species, image, &facts.name)? - base))
                .collect::<Result<Vec<f64>, ScoreError>>()?;
            relative_percent(&above, species, &facts.name)
        })
        .collect()
}

fn relative_percent(above: &[f64], own: usize, name: &str) -> Result<Vec<f64>, ScoreError> {
    if above[own] > 0.0 {
        Ok(above.iter().map(|mean| 100.0 * (mean / above[own])).collect())
    } else {
        Err(ScoreError::NoSignal(name.into()))
    }
}

/// Signal-to-noise ratio of each species in its own image: the mean on it above the mean of the background,
/// over the standard deviation of the background. Infinite for a background without any spread.
///
/// # Errors
/// [`ScoreError`] when images do not fit or a region is empty.
pub fn signal_to_noise(truth: &Truth, images: &[Plane<'_>]) -> Result<Vec<f64>, ScoreError> {
    let regions = Regions::new(truth, images)?;
    images
        .iter()
        .enumerate()
        .map(|(species, image)| {
            let signal = regions.mean_of(species, image, &truth.species[species].name)?;
            let (mean, deviation) = regions.background(image)?;
            Ok((signal - mean) / deviation)
        })
        .collect()
}
