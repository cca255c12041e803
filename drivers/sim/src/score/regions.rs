//! Which pixels belong to one species alone, and which to none.
//!
//! In: the truth and the grid of the images. Out: means over the regions of the crosstalk score.
//! Never: counts a NaN pixel. Fails: [`ScoreError`] for an empty region.

use super::{Plane, ScoreError};
use crate::truth::{Outline, Truth};

/// Pixels within this distance of a species belong to it.
const ON_PX: f64 = 0.75;
/// Pixels of a species are at least this far from all others.
pub(super) const CLEAR_PX: f64 = 6.0;
/// Background is at least this far from everything.
const BACKGROUND_PX: f64 = 7.0;

/// Pixel numbers of the regions of a scene.
pub(super) struct Regions {
    of_species: Vec<Vec<usize>>,
    background: Vec<usize>,
}

impl Regions {
    pub(super) fn new(truth: &Truth, images: &[Plane<'_>]) -> Result<Self, ScoreError> {
        check_images(truth, images)?;
        let outlines: Vec<Outline<'_>> =
            (0..truth.species.len()).map(|species| truth.outline(species)).collect();
        let mut regions = Self { of_species: vec![Vec::new(); outlines.len()], background: Vec::new() };
        let Some(grid) = images.first() else {
            return Ok(regions);
        };
        for pixel in 0..grid.pixels.len() {
            let point = grid.position(pixel);
            let distances: Vec<f64> = outlines.iter().map(|outline| outline.distance(point)).collect();
            if distances.iter().all(|&distance| distance >= BACKGROUND_PX) {
                regions.background.push(pixel);
            }
            if let Some(species) = alone(&distances) {
                regions.of_species[species].push(pixel);
            }
        }
        Ok(regions)
    }

    /// Mean of an image over the pixels of a species.
    pub(super) fn mean_of(&self, species: usize, image: &Plane<'_>, name: &str) -> Result<f64, ScoreError> {
        mean_and_deviation(image, &self.of_species[species])
            .map(|(mean, _)| mean)
            .ok_or_else(|| ScoreError::NothingOf(name.into()))
    }

    /// Mean and standard deviation of an image over the background.
    pub(super) fn background(&self, image: &Plane<'_>) -> Result<(f64, f64), ScoreError> {
        mean_and_deviation(image, &self.background).ok_or(ScoreError::NoBackground)
    }
}

/// The species a place belongs to, if it belongs to one alone.
fn alone(distances: &[f64]) -> Option<usize> {
    let own = distances.iter().position(|&distance| distance <= ON_PX)?;
    let mut others = distances.iter().enumerate().filter(|&(species, _)| species != own);
    others.all(|(_, &distance)| distance >= CLEAR_PX).then_some(own)
}

/// Checks that there is one image per species and that all have one size.
pub(super) fn check_images(truth: &Truth, images: &[Plane<'_>]) -> Result<(), ScoreError> {
    let (expected, found) = (truth.species.len(), images.len());
    if expected != found {
        return Err(ScoreError::Images { expected, found });
    }
    let fits = |image: &Plane<'_>| {
        let size = (image.height, image.width, image.fold);
        size == (images[0].height, images[0].width, images[0].fold)
            && image.fold > 0
            && !image.pixels.is_empty()
            && image.height.checked_mul(image.width) == Some(image.pixels.len())
    };
    match images.iter().position(|image| !fits(image)) {
        Some(number) => Err(ScoreError::Size(number)),
        None => Ok(()),
    }
}

fn mean_and_deviation(image: &Plane<'_>, pixels: &[usize]) -> Option<(f64, f64)> {
    let valid = || pixels.iter().map(|&pixel| f64::from(image.pixels[pixel])).filter(|value| !value.is_nan());
    let number = valid().count() as f64;
    let mean = valid().sum::<f64>() / number;
    let variance = valid().map(|value| (value - mean).powi(2)).sum::<f64>() / number;
    (number > 0.0).then(|| (mean, variance.sqrt()))
}
