//! Beads in a mean image: where they are, to a fraction of a pixel.
//!
//! In: the mean image of one camera. Out: [`Bead`]s, brightest first.
//! Never: takes a bead whose window leaves the image, or one whose shape is not that of a spot.
//! Fails: not at all; an image without beads has none.

use nalgebra::{SMatrix, SVector};
use ndarray::{Array2, ArrayView2};

/// Width of the Laplacian of a Gaussian that finds spots, pixels.
const FINDER_SIGMA: f64 = 1.3;
/// Half of the window that a spot is fitted in, pixels.
const WINDOW: usize = 4;
/// A spot's response over the robust spread of all responses.
const LEAST_RESPONSE: f64 = 8.0;
/// Widths of spots that are beads, pixels.
const WIDTHS: std::ops::RangeInclusive<f64> = 0.5..=3.0;
/// A fit that ends farther from where it began is not of that spot, pixels.
const FARTHEST: f64 = 1.5;
/// Steps of a fit.
const MOST_STEPS: usize = 30;

/// A bright spot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bead {
    /// Center, pixels.
    pub y: f64,
    /// Center, pixels.
    pub x: f64,
    /// Standard deviation of its Gaussian, pixels.
    pub sigma: f64,
    /// Height above its surroundings, counts.
    pub height: f64,
}

/// Finds spots and fits a Gaussian to each.
#[must_use]
pub fn find_beads(image: &ArrayView2<'_, f32>) -> Vec<Bead> {
    let response = laplacian(image);
    let threshold = LEAST_RESPONSE * spread(&response);
    let (height, width) = image.dim();
    let mut beads = Vec::new();
    for y in WINDOW..height.saturating_sub(WINDOW) {
        for x in WINDOW..width.saturating_sub(WINDOW) {
            if response[[y, x]] > threshold && is_highest(&response, y, x) {
                beads.extend(fit(image, y, x));
            }
        }
    }
    beads.sort_by(|a, b| b.height.total_cmp(&a.height));
    without_doubles(beads)
}

/// Minus the Laplacian of a Gaussian: high where there is a spot of about its width.
fn laplacian(image: &ArrayView2<'_, f32>) -> Array2<f64> {
    let radius = (4.0 * FINDER_SIGMA).ceil() as i64;
    let squared = FINDER_SIGMA * FINDER_SIGMA;
    let gauss = |x: f64| libm::exp(-x * x / (2.0 * squared));
    let offsets: Vec<f64> = (-radius..=radius).map(|x| x as f64).collect();
    let sum: f64 = offsets.iter().map(|&x| gauss(x)).sum();
    let smooth: Vec<f64> = offsets.iter().map(|&x| gauss(x) / sum).collect();
    let mut curved: Vec<f64> = offsets.iter().map(|&x| (1.0 - x * x / squared) * gauss(x) / sum).collect();
    // An even image has no response.
    let rest = curved.iter().sum::<f64>() / curved.len() as f64;
    curved.iter_mut().for_each(|weight| *weight -= rest);
    let image = image.mapv(f64::from);
    along_columns(&along_rows(&image, &smooth), &curved)
        + along_columns(&along_rows(&image, &curved), &smooth)
}

fn along_rows(image: &Array2<f64>, weights: &[f64]) -> Array2<f64> {
    let (_, width) = image.dim();
    let radius = weights.len() as i64 / 2;
    Array2::from_shape_fn(image.dim(), |(y, x)| {
        let at = |k: usize| image[[y, (x as i64 + k as i64 - radius).clamp(0, width as i64 - 1) as usize]];
        weights.iter().enumerate().map(|(k, weight)| weight * at(k)).sum()
    })
}

fn along_columns(image: &Array2<f64>, weights: &[f64]) -> Array2<f64> {
    along_rows(&image.t().to_owned(), weights).t().to_owned()
}

/// The standard deviation of a Gaussian with the same median of absolute values.
fn spread(response: &Array2<f64>) -> f64 {
    let mut values: Vec<f64> = response.iter().map(|value| value.abs()).collect();
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    let (_, median, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    1.4826 * *median
}

fn is_highest(response: &Array2<f64>, y: usize, x: usize) -> bool {
    let here = response[[y, x]];
    let around = (y - 2..=y + 2).flat_map(|j| (x - 2..=x + 2).map(move |i| (j, i)));
    around
        .filter(|&place| place != (y, x))
        .all(|place| response[place] < here || (response[place] == here && place > (y, x)))
}

fn fit(image: &ArrayView2<'_, f32>, y: usize, x: usize) -> Option<Bead> {
    let (bead, noise) = fit_spot(image, y, x)?;
    (bead.height > 4.0 * noise).then_some(bead)
}

/// Least squares of `height * exp(-r^2 / (2 sigma^2)) + level` over the window, after Levenberg and Marquardt.
///
/// Also gives the scatter around the fit. `None` where the window leaves the image or no spot of its center is found.
pub(super) fn fit_spot(image: &ArrayView2<'_, f32>, y: usize, x: usize) -> Option<(Bead, f64)> {
    let fits = |at: usize, side: usize| at >= WINDOW && at + WINDOW < side;
    if !fits(y, image.dim().0) || !fits(x, image.dim().1) {
        return None;
    }
    let pixels: Vec<(f64, f64, f64)> = (y - WINDOW..=y + WINDOW)
        .flat_map(|j| (x - WINDOW..=x + WINDOW).map(move |i| (j, i)))
        .map(|(j, i)| (j as f64, i as f64, f64::from(image[[j, i]])))
        .collect();
    if pixels.iter().any(|(_, _, value)| !value.is_finite()) {
        return None;
    }
    let level = pixels.iter().map(|(_, _, value)| *value).fold(f64::INFINITY, f64::min);
    let top = f64::from(image[[y, x]]);
    let mut found = SVector::<f64, 5>::from([y as f64, x as f64, FINDER_SIGMA, top - level, level]);
    let mut damping = 1e-3;
    let (mut equations, mut error) = normal_equations(&pixels, &found);
    for _ in 0..MOST_STEPS {
        let (mut matrix, right) = equations;
        for k in 0..5 {
            matrix[(k, k)] *= 1.0 + damping;
        }
        let step = matrix.cholesky()?.solve(&right);
        let next = found + step;
        let (new_equations, new_error) = normal_equations(&pixels, &next);
        if new_error.is_finite() && new_error <= error {
            let is_done = step[0].abs().max(step[1].abs()).max(step[2].abs()) < 1e-6;
            (found, equations, error) = (next, new_equations, new_error);
            damping = (damping * 0.2).max(1e-9);
            if is_done {
                break;
            }
        } else {
            damping *= 8.0;
            if damping > 1e9 {
                break;
            }
        }
    }
    let bead = Bead { y: found[0], x: found[1], sigma: found[2].abs(), height: found[3] };
    let noise = (error / (pixels.len() - 5) as f64).sqrt();
    let is_bead = (bead.y - y as f64).hypot(bead.x - x as f64) <= FARTHEST && WIDTHS.contains(&bead.sigma);
    is_bead.then_some((bead, noise))
}

type Equations = (SMatrix<f64, 5, 5>, SVector<f64, 5>);

fn normal_equations(pixels: &[(f64, f64, f64)], at: &SVector<f64, 5>) -> (Equations, f64) {
    let (mut matrix, mut right, mut error) = (SMatrix::zeros(), SVector::zeros(), 0.0);
    let (sigma, height, level) = (at[2], at[3], at[4]);
    for &(y, x, value) in pixels {
        let (dy, dx) = (y - at[0], x - at[1]);
        let squared = (dy * dy + dx * dx) / (sigma * sigma);
        let spot = libm::exp(-0.5 * squared);
        let residual = value - height * spot - level;
        let slope = SVector::<f64, 5>::from([
            height * spot * dy / (sigma * sigma),
            height * spot * dx / (sigma * sigma),
            height * spot * squared / sigma,
            spot,
            1.0,
        ]);
        matrix += slope * slope.transpose();
        right += slope * residual;
        error += residual * residual;
    }
    ((matrix, right), error)
}

/// Of fits that ended on the same spot, the first.
fn without_doubles(beads: Vec<Bead>) -> Vec<Bead> {
    let mut kept: Vec<Bead> = Vec::with_capacity(beads.len());
    for bead in beads {
        if kept.iter().all(|other| (other.y - bead.y).hypot(other.x - bead.x) > 2.0) {
            kept.push(bead);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spots_are_found_where_they_are() {
        let places = [[20.3, 14.8], [33.75, 40.1], [9.5, 50.25]];
        let image = Array2::from_shape_fn((48, 64), |(y, x)| {
            let spot = |place: &[f64; 2]| {
                let squared = (y as f64 - place[0]).powi(2) + (x as f64 - place[1]).powi(2);
                300.0 * libm::exp(-squared / (2.0 * 1.2 * 1.2))
            };
            let grain = ((y * 37 + x * 91) % 17) as f64 * 0.1;
            (100.0 + grain + places.iter().map(spot).sum::<f64>()) as f32
        });
        let beads = find_beads(&image.view());
        assert_eq!(beads.len(), 3, "{beads:?}");
        for place in places {
            let nearest = beads.iter().map(|b| (b.y - place[0]).hypot(b.x - place[1])).fold(9.0, f64::min);
            assert!(nearest < 0.01, "{nearest}");
        }
        assert!(beads.iter().all(|bead| (bead.sigma - 1.2).abs() < 0.02));
    }

    #[test]
    fn noise_alone_has_no_beads() {
        let image = Array2::from_shape_fn((64, 64), |(y, x)| {
            let mixed = (y * 64 + x).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
            (mixed % 1000) as f32
        });
        assert!(find_beads(&image.view()).len() < 3);
    }
}
