//! How well the species of small patches are told apart.
//!
//! In: the truth of a patch grid (paper, Fig. 2) and one image per species. Out: shares and crosstalk.
//! Never: counts a NaN pixel. Fails: [`ScoreError`] for scenes without patches.

use super::regions::check_images;
use super::{Plane, ScoreError, relative_percent};
use crate::truth::{PatchTruth, Truth};

/// Pixels within this distance of its center stand for a patch, in camera pixels.
const CORE_PX: f64 = 0.5;

/// Separation of the species of a patch grid.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchScore {
    /// Share of the patches, 0 to 1, whose brightest image is the one of their species.
    pub correct_fraction: f64,
    /// The same for the patches of each species; NaN for a species without a patch.
    pub correct_fraction_by_species: Vec<f64>,
    /// Mean over the patches of species `i` of image `j`, in percent of image `i`: row = species, column = image.
    pub crosstalk_percent: Vec<Vec<f64>>,
    /// Patches with valid pixels in all images.
    pub num_patches: usize,
}

/// Scores the images of a patch grid at the centers of its patches.
///
/// # Errors
/// [`ScoreError`] when images do not fit, the scene has no patches, or a species has none with signal.
pub fn patch_score(truth: &Truth, images: &[Plane<'_>]) -> Result<PatchScore, ScoreError> {
    check_images(truth, images)?;
    let seen: Vec<(usize, Vec<f64>)> = truth
        .patches
        .iter()
        .map(|patch| (patch.species, core_means(patch, images)))
        .filter(|(_, means)| means.iter().all(|mean| !mean.is_nan()))
        .collect();
    if seen.is_empty() {
        return Err(ScoreError::NoPatches);
    }
    let of_species = |species: usize| seen.iter().filter(move |(own, _)| *own == species);
    let is_correct = |(own, means): &&(usize, Vec<f64>)| brightest(means) == Some(*own);
    let crosstalk_percent = truth
        .species
        .iter()
        .enumerate()
        .map(|(species, facts)| {
            let sums: Vec<f64> = (0..images.len())
                .map(|image| of_species(species).map(|(_, means)| means[image]).sum())
                .collect();
            relative_percent(&sums, species, &facts.name)
        })
        .collect::<Result<_, _>>()?;
    Ok(PatchScore {
        correct_fraction: seen.iter().filter(is_correct).count() as f64 / seen.len() as f64,
        correct_fraction_by_species: (0..images.len())
            .map(|species| {
                let correct = of_species(species).filter(is_correct).count();
                correct as f64 / of_species(species).count() as f64
            })
            .collect(),
        crosstalk_percent,
        num_patches: seen.len(),
    })
}

fn brightest(means: &[f64]) -> Option<usize> {
    (0..means.len()).max_by(|&a, &b| means[a].total_cmp(&means[b]))
}

/// Mean of each image over the core of a patch; NaN without a valid pixel.
fn core_means(patch: &PatchTruth, images: &[Plane<'_>]) -> Vec<f64> {
    images.iter().map(|image| core_mean(patch.center_px, image)).collect()
}

fn core_mean(center_px: [f64; 2], image: &Plane<'_>) -> f64 {
    let fold = image.fold as f64;
    let around = |axis: usize, length: usize| {
        let first = ((center_px[axis] - CORE_PX) * fold).ceil().max(0.0) as usize;
        let end = ((center_px[axis] + CORE_PX) * fold).floor() + 1.0;
        first..(end.max(0.0) as usize).min(length)
    };
    let (mut sum, mut number) = (0.0, 0.0);
    for y in around(0, image.height) {
        for x in around(1, image.width) {
            let value = f64::from(image.pixels[y * image.width + x]);
            if !value.is_nan() {
                sum += value;
                number += 1.0;
            }
        }
    }
    sum / number
}
