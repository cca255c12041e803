//! Gives the shifted sub-grids of a cumulant image equal weight (step 4; Eq. S6).
//!
//! In: one species' (or spectral channel's) image on the `n`-fold grid, and `D(p, q)`, the summed
//! squared pair distance of the pixel tuple at sub-position `(p, q)` in camera pixels squared, `n x n`.
//! Out: the image with each sub-grid multiplied by one number, and a [`FlatteningReport`].
//! Never: moves or smooths pixels; NaN stays NaN and takes no part in any mean.
//! Fails: [`FlatteningError`].
//!
//! Eq. S6 prints `r_k` where `r_l` is meant: `d_n = prod_{j<l} U((r_j - r_l) / sqrt(n))`, for a
//! Gaussian `U` of standard deviation `sigma` camera pixels `d_n = exp(-D / (2 n sigma^2))`.

use ndarray::{Array2, ArrayRef2, s};
use thiserror::Error;

/// A mean counts as clearly positive from this many standard errors.
pub const CLEARLY_POSITIVE: f64 = 3.0;

/// Why an image cannot be flattened.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum FlatteningError {
    /// `D` is not a square table of finite numbers, at least 1 x 1 and not negative.
    #[error("the distances must be a square table of finite numbers, one per sub-position")]
    Distances,
    /// The width given is not a positive number.
    #[error("the width {0} of the point-spread function must be a positive number of camera pixels")]
    Width(f64),
    /// The means do not fall with distance, or there are too few clear ones.
    #[error(
        "the width of the point-spread function cannot be estimated: the means of the sub-grids \
         do not fall with the distance of their pixels ({clear_means} clear means); give it instead"
    )]
    NotEstimable {
        /// Number of sub-grids whose mean is clearly positive.
        clear_means: usize,
    },
}

/// Where the width of the point-spread function comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PsfWidth {
    /// Standard deviation in camera pixels, positive.
    Known(f64),
    /// From the sub-grids of the image itself, see [`estimate_sigma`].
    Estimated,
}

/// How the weights are found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Flattening {
    /// Every sub-grid gets the mean of sub-grid (0, 0); one whose mean is not clearly positive gets
    /// its distance factor relative to (0, 0) instead, from this width.
    EqualMeans(PsfWidth),
    /// Every sub-grid is divided by `exp(-D / (2 n sigma^2))`.
    DistanceFactor(PsfWidth),
}

/// What was done to each sub-grid.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatteningReport {
    /// Factor that sub-grid `(p, q)` was multiplied by, `n x n`.
    pub scales: Array2<f64>,
    /// Mean of each sub-grid before, over its valid pixels; NaN if it has none.
    pub means: Array2<f64>,
    /// Standard error of each mean; NaN with fewer than two pixels.
    pub standard_errors: Array2<f64>,
    /// Sub-grids that could not be scaled to equal means and got the distance factor.
    pub fallbacks: Vec<(usize, usize)>,
    /// Width used or estimated, camera pixels; nothing if none was needed.
    pub sigma_px: Option<f64>,
}

/// Flattens one image; the order `n` is the side of `distances`.
///
/// # Errors
/// [`FlatteningError::Distances`], [`FlatteningError::Width`], and [`FlatteningError::NotEstimable`]
/// where an estimated width is needed (for equal means only when a sub-grid falls back).
pub fn flatten(
    image: &ArrayRef2<f32>,
    distances: &Array2<f64>,
    flattening: Flattening,
) -> Result<(Array2<f32>, FlatteningReport), FlatteningError> {
    check_distances(distances)?;
    let grids = SubGrids::measure(image, distances.nrows());
    let report = match flattening {
        Flattening::EqualMeans(width) => equal_means(grids, distances, width)?,
        Flattening::DistanceFactor(width) => distance_factor(grids, distances, width)?,
    };
    Ok((scaled(image, &report.scales), report))
}

/// Width of the point-spread function, standard deviation in camera pixels, from the image itself:
/// least squares of `ln(mean)` against `D`, whose slope is `-1 / (2 n sigma^2)`.
///
/// Only sub-grids with a clearly positive mean count.
///
/// # Errors
/// [`FlatteningError::NotEstimable`] unless the means fall with `D`; [`FlatteningError::Distances`].
pub fn estimate_sigma(image: &ArrayRef2<f32>, distances: &Array2<f64>) -> Result<f64, FlatteningError> {
    check_distances(distances)?;
    SubGrids::measure(image, distances.nrows()).sigma(distances)
}

/// `exp(-D / (2 n sigma^2))`, the distance factor of Eq. S6 for a Gaussian; `sigma` in camera pixels.
#[must_use]
pub fn gaussian_distance_factor(distance: f64, order: usize, sigma_px: f64) -> f64 {
    (-distance / (2.0 * order as f64 * sigma_px * sigma_px)).exp()
}

fn equal_means(
    grids: SubGrids,
    distances: &Array2<f64>,
    width: PsfWidth,
) -> Result<FlatteningReport, FlatteningError> {
    let reference_is_clear = grids.is_clear((0, 0));
    let keeps_mean = |at| reference_is_clear && grids.is_clear(at);
    let positions = distances.indexed_iter().map(|(at, _)| at);
    let fallbacks: Vec<_> = positions.filter(|&at| !keeps_mean(at)).collect();
    let sigma_px = match (width, fallbacks.is_empty()) {
        (PsfWidth::Estimated, true) => None,
        _ => Some(grids.width(distances, width)?),
    };
    let scales = Array2::from_shape_fn(distances.dim(), |at| match sigma_px {
        Some(sigma) if !keeps_mean(at) => {
            let factor = |d| gaussian_distance_factor(d, distances.nrows(), sigma);
            factor(distances[[0, 0]]) / factor(distances[at])
        }
        _ => grids.means[[0, 0]] / grids.means[at],
    });
    Ok(grids.report(scales, fallbacks, sigma_px))
}

fn distance_factor(
    grids: SubGrids,
    distances: &Array2<f64>,
    width: PsfWidth,
) -> Result<FlatteningReport, FlatteningError> {
    let sigma = grids.width(distances, width)?;
    let order = distances.nrows();
    let scales = distances.mapv(|d| 1.0 / gaussian_distance_factor(d, order, sigma));
    Ok(grids.report(scales, Vec::new(), Some(sigma)))
}

/// Mean and standard error of each sub-grid.
struct SubGrids {
    means: Array2<f64>,
    standard_errors: Array2<f64>,
}

impl SubGrids {
    fn measure(image: &ArrayRef2<f32>, order: usize) -> Self {
        let mut means = Array2::from_elem((order, order), f64::NAN);
        let mut standard_errors = means.clone();
        for p in 0..order.min(image.nrows()) {
            for q in 0..order.min(image.ncols()) {
                let grid = image.slice(s![p..;order, q..;order]);
                (means[[p, q]], standard_errors[[p, q]]) = mean_and_error(&grid);
            }
        }
        Self { means, standard_errors }
    }

    fn is_clear(&self, at: (usize, usize)) -> bool {
        let mean = self.means[at];
        mean > 0.0 && mean >= CLEARLY_POSITIVE * self.standard_errors[at]
    }

    fn width(&self, distances: &Array2<f64>, width: PsfWidth) -> Result<f64, FlatteningError> {
        match width {
            PsfWidth::Known(sigma) if sigma.is_finite() && sigma > 0.0 => Ok(sigma),
            PsfWidth::Known(sigma) => Err(FlatteningError::Width(sigma)),
            PsfWidth::Estimated => self.sigma(distances),
        }
    }

    fn sigma(&self, distances: &Array2<f64>) -> Result<f64, FlatteningError> {
        let points: Vec<(f64, f64)> = distances
            .indexed_iter()
            .filter(|&(at, _)| self.is_clear(at))
            .map(|(at, &distance)| (distance, self.means[at].ln()))
            .collect();
        let slope = slope(&points);
        // Without two different distances the slope is NaN.
        if slope.is_nan() || slope >= 0.0 {
            return Err(FlatteningError::NotEstimable { clear_means: points.len() });
        }
        Ok((-1.0 / (2.0 * distances.nrows() as f64 * slope)).sqrt())
    }

    fn report(
        self,
        scales: Array2<f64>,
        fallbacks: Vec<(usize, usize)>,
        sigma_px: Option<f64>,
    ) -> FlatteningReport {
        FlatteningReport {
            scales,
            means: self.means,
            standard_errors: self.standard_errors,
            fallbacks,
            sigma_px,
        }
    }
}

/// Least-squares slope; NaN if all abscissas are the same.
fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let mean_x = points.iter().map(|p| p.0).sum::<f64>() / count;
    let mean_y = points.iter().map(|p| p.1).sum::<f64>() / count;
    let covariance: f64 = points.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
    let variance: f64 = points.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
    covariance / variance
}

fn mean_and_error(grid: &ArrayRef2<f32>) -> (f64, f64) {
    let valid = || grid.iter().filter(|v| v.is_finite()).map(|&v| f64::from(v));
    let count = valid().count() as f64;
    let mean = valid().sum::<f64>() / count;
    let spread: f64 = valid().map(|v| (v - mean).powi(2)).sum();
    // One pixel has no spread to judge it by: (0 / 0) is NaN and never clear.
    (mean, (spread / (count - 1.0) / count).sqrt())
}

fn scaled(image: &ArrayRef2<f32>, scales: &Array2<f64>) -> Array2<f32> {
    let order = scales.nrows();
    let mut flat = image.to_owned();
    for ((p, q), &scale) in scales.indexed_iter() {
        if p < image.nrows() && q < image.ncols() {
            flat.slice_mut(s![p..;order, q..;order]).mapv_inplace(|v| (f64::from(v) * scale) as f32);
        }
    }
    flat
}

fn check_distances(distances: &Array2<f64>) -> Result<(), FlatteningError> {
    let good = distances.is_square()
        && !distances.is_empty()
        && distances.iter().all(|d| d.is_finite() && *d >= 0.0);
    good.then_some(()).ok_or(FlatteningError::Distances)
}

#[cfg(test)]
mod tests {
    use ndarray::array;
    use proptest::prelude::*;

    use super::*;
    use crate::sofi::unmixing::reference;

    fn order_two() -> Array2<f64> {
        array![[4.0, 1.0], [1.0, 2.0]]
    }

    /// A structured image whose sub-grids carry the distance factors of a Gaussian.
    fn uneven(sigma: f64) -> Array2<f32> {
        Array2::from_shape_fn((40, 60), |(y, x)| {
            let structure = 2.0 + ((y / 2) as f64 * 0.3).sin() + ((x / 2) as f64 * 0.2).cos();
            (structure * gaussian_distance_factor(order_two()[[y % 2, x % 2]], 2, sigma)) as f32
        })
    }

    #[test]
    fn equal_means_agree_with_the_reference() {
        let Some(unmixed) = reference::pages("twocamera/expected_unmixed_order2.tif") else {
            return;
        };
        let expected = reference::pages("twocamera/expected_flattened_order2.tif").unwrap();
        for (image, expected) in unmixed.iter().zip(&expected) {
            let method = Flattening::EqualMeans(PsfWidth::Estimated);
            let (flat, report) = flatten(image, &order_two(), method).unwrap();
            let difference = reference::disagreement(&flat, expected);
            let sigma = estimate_sigma(image, &order_two());
            println!("flattened: {difference:.2e}, estimated width {sigma:?}");
            assert!(difference < 1e-5);
            assert!(report.fallbacks.is_empty());
        }
    }

    #[test]
    fn both_methods_undo_the_distance_factor() {
        let image = uneven(1.1);
        let even = uneven(1e9);
        let (by_mean, report) =
            flatten(&image, &order_two(), Flattening::EqualMeans(PsfWidth::Known(1.0))).unwrap();
        assert!(report.fallbacks.is_empty());
        let (by_distance, _) =
            flatten(&image, &order_two(), Flattening::DistanceFactor(PsfWidth::Estimated)).unwrap();
        assert!(reference::disagreement(&by_distance, &even) < 1e-5);
        let relative = by_mean.mapv(|v| (f64::from(v) / gaussian_distance_factor(4.0, 2, 1.1)) as f32);
        assert!(reference::disagreement(&relative, &even) < 1e-5);
    }

    #[test]
    fn unclear_sub_grids_fall_back_and_are_listed() {
        let mut image = uneven(1.0);
        let mut sign = 1.0;
        image.slice_mut(s![1..;2, 0..;2]).mapv_inplace(|v| {
            sign = -sign;
            sign * v
        });
        let known = Flattening::EqualMeans(PsfWidth::Known(1.0));
        let (_, report) = flatten(&image, &order_two(), known).unwrap();
        assert_eq!(report.fallbacks, [(1, 0)]);
        let expected = (-4.0_f64 / 4.0).exp() / (-1.0_f64 / 4.0).exp();
        assert!((report.scales[[1, 0]] - expected).abs() < 1e-12);
        assert!((report.scales[[1, 1]] - (-0.5_f64).exp()).abs() < 1e-4);
        let estimated = Flattening::EqualMeans(PsfWidth::Estimated);
        let (_, report) = flatten(&image, &order_two(), estimated).unwrap();
        assert!((report.sigma_px.unwrap() - 1.0).abs() < 1e-3);
    }

    #[test]
    fn an_unclear_reference_makes_all_fall_back() {
        let mut image = uneven(1.0);
        image.slice_mut(s![0..;2, 0..;2]).fill(-1.0);
        let known = Flattening::EqualMeans(PsfWidth::Known(0.9));
        let (_, report) = flatten(&image, &order_two(), known).unwrap();
        assert_eq!(report.fallbacks.len(), 4);
        assert_eq!(report.scales[[0, 0]], 1.0);
        let nothing = Array2::from_elem((4, 4), f32::NAN);
        let (flat, report) = flatten(&nothing, &order_two(), known).unwrap();
        assert!(flat.iter().all(|v| v.is_nan()));
        assert_eq!(report.fallbacks.len(), 4);
    }

    #[test]
    fn a_width_that_cannot_be_had_is_refused() {
        let flat = Array2::from_shape_fn((8, 8), |(y, x)| (y + x) as f32 + 1.0);
        let rising = Array2::from_shape_fn((8, 8), |(y, x)| order_two()[[y % 2, x % 2]] as f32);
        assert!(estimate_sigma(&rising, &order_two()).is_err());
        assert!(estimate_sigma(&flat, &Array2::from_elem((2, 2), 3.0)).is_err());
        for bad in [0.0, -1.0, f64::NAN] {
            let method = Flattening::DistanceFactor(PsfWidth::Known(bad));
            assert!(flatten(&flat, &order_two(), method).is_err());
        }
        let known = Flattening::DistanceFactor(PsfWidth::Known(1.0));
        assert!(flatten(&flat, &Array2::zeros((2, 3)), known).is_err());
        assert!(flatten(&flat, &Array2::zeros((0, 0)), known).is_err());
        assert!(flatten(&flat, &array![[f64::NAN]], known).is_err());
    }

    #[test]
    fn images_smaller_than_the_grid_pass() {
        let known = Flattening::EqualMeans(PsfWidth::Known(1.0));
        for shape in [(0, 0), (1, 1), (1, 5)] {
            let image = Array2::from_elem(shape, 2.0);
            let (flat, _) = flatten(&image, &order_two(), known).unwrap();
            assert_eq!(flat.dim(), shape);
        }
    }

    proptest! {
        #[test]
        fn sub_grids_have_equal_means_whatever_their_gains(
            gains in proptest::collection::vec(0.1..10.0_f64, 9),
        ) {
            let distances = Array2::from_elem((3, 3), 1.0);
            let image = Array2::from_shape_fn((30, 33), |(y, x)| {
                let structure = 1.0 + 0.5 * ((y * 5 + x * 3) % 7) as f64;
                (structure * gains[y % 3 * 3 + x % 3]) as f32
            });
            let method = Flattening::EqualMeans(PsfWidth::Estimated);
            let (flat, report) = flatten(&image, &distances, method).unwrap();
            let after = SubGrids::measure(&flat, 3).means;
            for mean in &after {
                prop_assert!((mean / report.means[[0, 0]] - 1.0).abs() < 1e-5);
            }
        }
    }
}
