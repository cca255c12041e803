//! How wide a filament appears.
//!
//! In: the truth and one image per species. Out: full width at half maximum of each cross-section in nanometers.
//! Never: interpolates pixels; a Gaussian over the distance from the axis is fitted to the pixels as they are.
//! Fails: [`ScoreError`] for species without a filament or without a peak.

use super::regions::{CLEAR_PX, check_images};
use super::{Plane, ScoreError};
use crate::truth::Truth;

/// The cross-section is fitted up to this distance from the axis.
const REACH_PX: f64 = 4.0;
/// `2 * sqrt(2 ln 2)`: full width at half maximum of a Gaussian over its standard deviation.
const FWHM_PER_SIGMA: f64 = 2.354_820_045_030_949;

/// Full width at half maximum of the cross-section of the filaments of each species in its own image, in nanometers.
///
/// A Gaussian with free center, width, height and base is fitted to all pixels within 4 camera pixels of a
/// filament's axis, beside it rather than beyond its ends, and at least 6 away from other species.
///
/// # Errors
/// [`ScoreError`] when images do not fit, or a species has no free filament or no peak on it.
pub fn resolution_nm(truth: &Truth, images: &[Plane<'_>]) -> Result<Vec<f64>, ScoreError> {
    check_images(truth, images)?;
    let widths = images.iter().enumerate().map(|(species, image)| {
        let name = &truth.species[species].name;
        let section = cross_section(truth, species, image);
        if section.len() < 10 {
            return Err(ScoreError::NoFilament(name.clone()));
        }
        let sigma_px = fit_sigma(&section).ok_or_else(|| ScoreError::NoSignal(name.clone()))?;
        Ok(FWHM_PER_SIGMA * sigma_px * truth.pixel_pitch_nm)
    });
    widths.collect()
}

/// Signed distance from the axis and value of each pixel around the filaments of a species.
fn cross_section(truth: &Truth, species: usize, image: &Plane<'_>) -> Vec<(f64, f64)> {
    let outline = truth.outline(species);
    let others: Vec<_> = (0..truth.species.len())
        .filter(|&other| other != species)
        .map(|other| truth.outline(other))
        .collect();
    let section = image.pixels.iter().enumerate().filter_map(|(pixel, &value)| {
        let point = image.position(pixel);
        let nearest = outline.nearest_axis(point)?;
        let beside = !nearest.at_end && nearest.distance <= REACH_PX;
        let clear = beside && others.iter().all(|other| other.distance(point) >= CLEAR_PX);
        (clear && !value.is_nan()).then(|| (nearest.signed, f64::from(value)))
    });
    section.collect()
}

/// Least squares over center and width by a shrinking search; height and base follow linearly.
fn fit_sigma(section: &[(f64, f64)]) -> Option<f64> {
    let mut best = (f64::INFINITY, 0.0, 1.0);
    for center in (-4..=4).map(|step| 0.25 * f64::from(step)) {
        for sigma in (1..=24).map(|step| 0.125 * f64::from(step)) {
            keep_better(&mut best, section, center, sigma);
        }
    }
    let mut step = 0.125;
    while step > 1e-5 {
        let (before, center, sigma) = best;
        for (dc, ds) in [(step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step)] {
            keep_better(&mut best, section, center + dc, sigma + ds);
        }
        if best.0 >= before {
            step /= 2.0;
        }
    }
    best.0.is_finite().then_some(best.2)
}

fn keep_better(best: &mut (f64, f64, f64), section: &[(f64, f64)], center: f64, sigma: f64) {
    if sigma < 0.02 {
        return;
    }
    if let Some(error) = residual(section, center, sigma)
        && error < best.0
    {
        *best = (error, center, sigma);
    }
}

/// Sum of squares left by the best peak of this center and width; `None` unless it points upwards.
fn residual(section: &[(f64, f64)], center: f64, sigma: f64) -> Option<f64> {
    let bell = |distance: f64| (-0.5 * ((distance - center) / sigma).powi(2)).exp();
    let n = section.len() as f64;
    let (mut g, mut gg, mut v, mut gv, mut vv) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for &(distance, value) in section {
        let weight = bell(distance);
        g += weight;
        gg += weight * weight;
        v += value;
        gv += weight * value;
        vv += value * value;
    }
    let spread = gg - g * g / n;
    let height = (gv - g * v / n) / spread;
    (spread > 1e-9 && height > 0.0).then(|| (vv - v * v / n) - height * height * spread)
}
