//! Makes brightness linear again: deconvolves, takes the `n`-th root, reconvolves (step 5; bSOFI).
//!
//! In: one species' flattened image of order `n` on the `n`-fold grid, and the point-spread
//! function in camera pixels.
//! Out: an image of the same shape; scaling the input by `c` scales it by `c^(1/n)`.
//! NaN (and infinite) pixels stay NaN and are missing data: a frame of them is cut off, so that the
//! image is mirrored at its valid border, and those inside take no part in the misfit.
//! Never: makes light that was not there; an image without a positive pixel gives zeros.
//! Fails: [`LinearizationError`].
//!
//! Lucy–Richardson: `x <- x * H^T(d / H x) / H^T(m)`, `d` the data clipped at zero, `m` one where
//! there is data and zero where it is missing, starting from a flat image of the mean of `d`.
//! Every iteration conserves the flux: `sum x H^T(m) = sum d`, hence `sum x = sum d` without holes.

use ndarray::{Array2, ArrayRef2, ArrayViewMut2, Zip, s};
use rayon::prelude::*;
use thiserror::Error;

use super::{
    convolution::{Blur, convolve},
    psf::{Psf, PsfError},
};

/// Where less than this share of a pixel's light falls on valid pixels, it is not estimated.
const LEAST_COVERAGE: f32 = 1e-3;
/// Estimates below this share of the brightest datum are zero (keeps arithmetic off subnormals).
const FAINTEST: f32 = 1e-20;

/// Why an image cannot be linearized.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum LinearizationError {
    /// The point-spread function cannot be used at this order, or the width to reconvolve with is bad.
    #[error(transparent)]
    Psf(#[from] PsfError),
}

/// How to deconvolve and reconvolve.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearizationSettings {
    /// Point-spread function of the *camera* image, in camera pixels; at order `n` it is narrowed
    /// to `U^n` on the `n`-fold grid (a Gaussian: standard deviation `sigma sqrt(n)` output pixels).
    pub psf: Psf,
    /// Iterations of Lucy–Richardson; 0 leaves the clipped image as it is.
    pub iterations: usize,
    /// Plain or accelerated iterations.
    pub acceleration: Acceleration,
    /// What to blur with after the root.
    pub reconvolution: Reconvolution,
}

/// How one iteration leads to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Acceleration {
    /// Lucy–Richardson from a flat start.
    #[default]
    None,
    /// Vector extrapolation after Biggs and Andrews (Appl. Opt. 36, 1766, 1997), starting from the
    /// data, as in the deconvolution that published SOFI software calls.
    BiggsAndrews,
}

/// What the linearized image is blurred with, to look like an image a microscope could make.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Reconvolution {
    /// A Gaussian of as many *output* pixels as the point-spread function has camera pixels,
    /// so `sigma / n` camera pixels.
    #[default]
    Default,
    /// A Gaussian of this standard deviation in output pixels.
    Sigma(f64),
    /// Nothing.
    None,
}

impl LinearizationSettings {
    /// 20 plain iterations and the default reconvolution.
    #[must_use]
    pub fn new(psf: Psf) -> Self {
        Self { psf, iterations: 20, acceleration: Acceleration::None, reconvolution: Reconvolution::Default }
    }

    /// The same for a Gaussian of standard deviation `sigma_px` camera pixels.
    ///
    /// # Errors
    /// [`PsfError::Sigma`].
    pub fn gaussian(sigma_px: f64) -> Result<Self, PsfError> {
        Psf::gaussian(sigma_px).map(Self::new)
    }

    fn reconvolution_psf(&self) -> Result<Option<Psf>, PsfError> {
        match self.reconvolution {
            Reconvolution::Default => Psf::gaussian(self.psf.sigma()).map(Some),
            Reconvolution::Sigma(sigma) => Psf::gaussian(sigma).map(Some),
            Reconvolution::None => Ok(None),
        }
    }
}

/// Linearizes an image of order `order >= 1`.
///
/// # Errors
/// [`LinearizationError::Psf`]: order 0, a width that is out of range.
pub fn linearize(
    image: &ArrayRef2<f32>,
    order: usize,
    settings: &LinearizationSettings,
) -> Result<Array2<f32>, LinearizationError> {
    let psf = settings.psf.narrowed(order)?;
    let reconvolution = settings.reconvolution_psf()?;
    let Some(valid) = ValidPart::of(image) else {
        return Ok(Array2::from_elem(image.dim(), f32::NAN));
    };
    let mut linear = valid.deconvolved(&psf, settings.iterations, settings.acceleration);
    take_root(&mut linear, order);
    if let Some(psf) = reconvolution {
        linear = convolve(&linear, &psf);
    }
    Ok(valid.restored(&linear, valid.peak.powf(1.0 / order as f64)))
}

/// Lucy–Richardson deconvolution alone; `psf` in pixels of `image`, brightness in its units.
#[must_use]
pub fn deconvolve(
    image: &ArrayRef2<f32>,
    psf: &Psf,
    iterations: usize,
    acceleration: Acceleration,
) -> Array2<f32> {
    match ValidPart::of(image) {
        Some(valid) => valid.restored(&valid.deconvolved(psf, iterations, acceleration), valid.peak),
        None => Array2::from_elem(image.dim(), f32::NAN),
    }
}

/// The smallest rectangle that holds all valid pixels, clipped at zero, scaled to a maximum of 1.
struct ValidPart<'a> {
    image: &'a ArrayRef2<f32>,
    corner: (usize, usize),
    /// NaN where missing.
    data: Array2<f32>,
    /// What the maximum was; 1 if nothing is positive.
    peak: f64,
}

impl<'a> ValidPart<'a> {
    fn of(image: &'a ArrayRef2<f32>) -> Option<Self> {
        let (rows, columns) = (valid_span(image)?, valid_span(&image.t())?);
        let mut data =
            image.slice(s![rows.0..rows.1, columns.0..columns.1]).as_standard_layout().into_owned();
        let peak = data.iter().copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
        let peak = if peak > 0.0 { f64::from(peak) } else { 1.0 };
        data.mapv_inplace(|v| match v {
            v if v.is_finite() => (f64::from(v.max(0.0)) / peak) as f32,
            _ => f32::NAN,
        });
        Some(Self { image, corner: (rows.0, columns.0), data, peak })
    }

    fn deconvolved(&self, psf: &Psf, iterations: usize, acceleration: Acceleration) -> Array2<f32> {
        let problem = LucyRichardson::new(&self.data, psf);
        match acceleration {
            _ if iterations == 0 => problem.data_start(),
            Acceleration::None => problem.plain(iterations),
            Acceleration::BiggsAndrews => problem.accelerated(iterations),
        }
    }

    /// Back in the frame and in the units of the image, NaN where that was NaN.
    fn restored(&self, part: &Array2<f32>, scale: f64) -> Array2<f32> {
        let mut whole = Array2::from_elem(self.image.dim(), f32::NAN);
        let (top, left) = self.corner;
        let (height, width) = part.dim();
        let inside: ArrayViewMut2<f32> = whole.slice_mut(s![top..top + height, left..left + width]);
        Zip::from(inside).and(part).and(&self.data).for_each(|to, &value, datum| {
            if !datum.is_nan() {
                *to = (f64::from(value) * scale) as f32;
            }
        });
        whole
    }
}

/// First and one past the last row with a finite pixel.
fn valid_span(image: &ArrayRef2<f32>) -> Option<(usize, usize)> {
    let has_data = |row: &usize| image.row(*row).iter().any(|v| v.is_finite());
    let first = (0..image.nrows()).find(has_data)?;
    let last = (0..image.nrows()).rev().find(has_data)?;
    Some((first, last + 1))
}

/// The iteration for one image.
struct LucyRichardson<'a> {
    /// At least 0; NaN where missing.
    data: &'a Array2<f32>,
    blur: Blur,
    /// `H^T m`, unless it is 1 everywhere.
    coverage: Option<Array2<f32>>,
    /// Least blurred estimate to divide by.
    floor: f32,
}

impl<'a> LucyRichardson<'a> {
    fn new(data: &'a Array2<f32>, psf: &Psf) -> Self {
        let blur = Blur::new(psf, data.dim());
        let is_whole = data.iter().all(|v| !v.is_nan());
        let coverage = (!is_whole || !blur.is_symmetric()).then(|| {
            let mask = data.mapv(|v| if v.is_nan() { 0.0 } else { 1.0 });
            let mut coverage = Array2::zeros(data.dim());
            blur.apply_transposed_then(&mask, &mut coverage, |_, _| {});
            coverage
        });
        Self { data, floor: blur.rounding_floor(), blur, coverage }
    }

    fn plain(&self, iterations: usize) -> Array2<f32> {
        let mut estimate = Array2::from_elem(self.data.dim(), self.mean());
        let (mut ratio, mut next) = (estimate.clone(), estimate.clone());
        for _ in 0..iterations {
            self.step(&estimate, &mut ratio, &mut next);
            std::mem::swap(&mut estimate, &mut next);
        }
        estimate
    }

    /// Each iteration starts from `y = x + lambda (x - x_before)`, with `lambda` from the last two
    /// steps `g = x - y`: `lambda = <g, g_before> / <g_before, g_before>` in `0..=1`.
    fn accelerated(&self, iterations: usize) -> Array2<f32> {
        let shape = self.data.dim();
        let (mut now, mut before) = (self.data_start(), Array2::zeros(shape));
        let (mut step, mut step_before) = (Array2::zeros(shape), Array2::zeros(shape));
        let (mut start, mut ratio) = (Array2::zeros(shape), Array2::zeros(shape));
        for iteration in 1..=iterations {
            let lambda = match iteration {
                1 | 2 => 0.0,
                _ => extrapolation(&step, &step_before),
            };
            combine(&mut start, &now, &before, |x, old| (x + lambda * (x - old)).max(0.0));
            std::mem::swap(&mut before, &mut now);
            self.step(&start, &mut ratio, &mut now);
            std::mem::swap(&mut step, &mut step_before);
            combine(&mut step, &now, &start, |x, y| x - y);
        }
        now
    }

    /// One iteration from `estimate` to `next`, with `ratio` as working space.
    fn step(&self, estimate: &Array2<f32>, ratio: &mut Array2<f32>, next: &mut Array2<f32>) {
        self.blur.apply_then(estimate, ratio, |y, row| {
            for (value, &datum) in row.iter_mut().zip(row_of(self.data, y)) {
                // False for missing data too.
                *value = if datum > 0.0 { datum / value.max(self.floor) } else { 0.0 };
            }
        });
        self.blur.apply_transposed_then(ratio, next, |y, row| {
            let estimates = row_of(estimate, y);
            match &self.coverage {
                None => update(row, estimates),
                Some(coverage) => update_covered(row, estimates, row_of(coverage, y)),
            }
        });
    }

    /// Mean of the valid data such that `sum x H^T(m) = sum d` from the start.
    fn mean(&self) -> f32 {
        let valid = self.data.iter().filter(|v| !v.is_nan());
        let (sum, count) = valid.fold((0.0, 0_usize), |(sum, count), &v| (sum + f64::from(v), count + 1));
        (sum / count as f64) as f32
    }

    /// The data themselves, the mean where they are missing.
    fn data_start(&self) -> Array2<f32> {
        let mean = self.mean();
        self.data.mapv(|v| if v.is_nan() { mean } else { v })
    }
}

#[inline(always)]
fn update(corrections: &mut [f32], estimates: &[f32]) {
    for (value, &estimate) in corrections.iter_mut().zip(estimates) {
        *value = without_faintest(*value * estimate);
    }
}

#[inline(always)]
fn update_covered(corrections: &mut [f32], estimates: &[f32], coverage: &[f32]) {
    for ((value, &estimate), &coverage) in corrections.iter_mut().zip(estimates).zip(coverage) {
        *value = if coverage >= LEAST_COVERAGE {
            without_faintest(*value * estimate / coverage)
        } else {
            estimate
        };
    }
}

#[inline(always)]
fn without_faintest(value: f32) -> f32 {
    if value > FAINTEST { value } else { 0.0 }
}

/// Row `y` of an image in standard layout.
#[inline(always)]
fn row_of(image: &Array2<f32>, y: usize) -> &[f32] {
    let width = image.ncols();
    image.as_slice().and_then(|values| values.get(y * width..(y + 1) * width)).unwrap_or_default()
}

fn extrapolation(step: &Array2<f32>, before: &Array2<f32>) -> f32 {
    let lambda = dot(step, before) / (dot(before, before) + f64::EPSILON);
    lambda.clamp(0.0, 1.0) as f32
}

fn dot(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    // Rows are summed in order, so that the result does not depend on the number of threads.
    let rows: Vec<f64> = (0..a.nrows())
        .into_par_iter()
        .map(|y| {
            let pairs = row_of(a, y).iter().zip(row_of(b, y));
            pairs.map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
        })
        .collect();
    rows.iter().sum()
}

fn combine(to: &mut Array2<f32>, a: &Array2<f32>, b: &Array2<f32>, of: impl Fn(f32, f32) -> f32 + Sync) {
    let width = to.ncols().max(1);
    let rows = to.as_slice_mut().unwrap_or_default().par_chunks_mut(width);
    rows.enumerate().for_each(|(y, row)| {
        for ((to, &a), &b) in row.iter_mut().zip(row_of(a, y)).zip(row_of(b, y)) {
            *to = of(a, b);
        }
    });
}

fn take_root(image: &mut Array2<f32>, order: usize) {
    let root: fn(f32, f32) -> f32 = match order {
        1 => |v, _| v,
        2 => |v, _| v.sqrt(),
        3 => |v, _| v.cbrt(),
        4 => |v, _| v.sqrt().sqrt(),
        _ => f32::powf,
    };
    let exponent = 1.0 / order as f32;
    let values = image.as_slice_mut().unwrap_or_default();
    values.par_iter_mut().for_each(|v| *v = root(*v, exponent));
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use nalgebra::{DMatrix, DVector};
    use ndarray::Array3;
    use proptest::prelude::*;

    use super::*;
    use crate::sofi::{flattening, psf::GaussianPsf, unmixing::reference};

    fn spots(height: usize, width: usize) -> Array2<f32> {
        let sharp = Array2::from_shape_fn((height, width), |(y, x)| {
            if (y * 7 + x * 13) % 31 == 0 { 10.0 + (y * x % 5) as f32 } else { 0.0 }
        });
        convolve(&sharp, &Psf::gaussian(1.5).unwrap())
    }

    fn sum(image: &Array2<f32>) -> f64 {
        image.iter().filter(|v| !v.is_nan()).map(|&v| f64::from(v)).sum()
    }

    /// `H` as a matrix: every source pixel and its mirror images within reach.
    fn dense(psf: &GaussianPsf, height: usize, width: usize) -> DMatrix<f64> {
        let half = psf.sampled();
        let along = |size: usize| {
            let mut matrix = DMatrix::zeros(size, size);
            let radius = half.len() as isize - 1;
            for i in 0..size as isize {
                for k in -radius..=radius {
                    let period = 2 * size as isize;
                    let j = (i + k).rem_euclid(period);
                    let j = if j < size as isize { j } else { period - 1 - j };
                    matrix[(i as usize, j as usize)] += half[k.unsigned_abs()];
                }
            }
            matrix
        };
        along(height).kronecker(&along(width))
    }

    fn vector(image: &Array2<f32>) -> DVector<f64> {
        DVector::from_iterator(image.len(), image.iter().map(|&v| f64::from(v)))
    }

    /// The twin: Lucy–Richardson with matrices, in float64.
    fn densely(image: &Array2<f32>, psf: &GaussianPsf, iterations: usize) -> DVector<f64> {
        let h = dense(psf, image.nrows(), image.ncols());
        let data = vector(image);
        let mask = data.map(|v| if v.is_nan() { 0.0 } else { 1.0 });
        let clipped = data.map(|v| if v > 0.0 { v } else { 0.0 });
        let coverage = h.tr_mul(&mask);
        let mut x = mask.map(|_| clipped.sum() / mask.sum());
        for _ in 0..iterations {
            let blurred = &h * &x;
            let ratio = clipped.zip_map(&blurred, |d, b| if d > 0.0 { d / b } else { 0.0 });
            let correction = h.tr_mul(&ratio);
            x = x.zip_zip_map(&correction, &coverage, |x, c, m| x * c / m);
        }
        x
    }

    proptest! {
        #[test]
        fn agrees_with_matrices(
            height in 1..8_usize, width in 1..8_usize, sigma in 0.5..1.5_f64,
            values in proptest::collection::vec(-0.5..4.0_f32, 64), hole in 0..128_usize,
        ) {
            let mut image = Array2::from_shape_fn((height, width), |(y, x)| values[y * 8 + x]);
            // A missing pixel inside, if there is an inside, and if something remains.
            let at = (hole / 8 % height, hole % width);
            let inside = at.0 > 0 && at.1 > 0 && at.0 + 1 < height && at.1 + 1 < width;
            if inside {
                image[at] = f32::NAN;
            }
            let psf = GaussianPsf::new(sigma).unwrap();
            let fast = deconvolve(&image, &Psf::Gaussian(psf), 10, Acceleration::None);
            let slow = densely(&image, &psf, 10);
            for ((a, b), datum) in fast.iter().zip(slow.iter()).zip(&image) {
                prop_assert_eq!(a.is_nan(), datum.is_nan());
                if !a.is_nan() {
                    prop_assert!((f64::from(*a) - b).abs() < 1e-4 * slow.amax().max(1e-30));
                }
            }
        }

        #[test]
        fn brightness_is_linear(order in 1..6_usize, exponent in -20..20_i32) {
            let image = spots(20, 24);
            let scale = 3.0_f32.powi(exponent);
            let settings = LinearizationSettings::gaussian(1.2).unwrap();
            let plain = linearize(&image, order, &settings).unwrap();
            let scaled = linearize(&(&image * scale), order, &settings).unwrap();
            let root = f64::from(scale).powf(1.0 / order as f64);
            let peak = plain.iter().copied().fold(0.0, f32::max);
            for (a, b) in plain.iter().zip(&scaled) {
                prop_assert!((f64::from(*a) - f64::from(*b) / root).abs() < 1e-4 * f64::from(peak));
            }
        }
    }

    #[test]
    fn deconvolution_conserves_flux() {
        let image = spots(60, 47);
        for acceleration in [Acceleration::None, Acceleration::BiggsAndrews] {
            let psf = Psf::gaussian(1.5).unwrap();
            let sharp = deconvolve(&image, &psf, 20, acceleration);
            assert!((sum(&sharp) / sum(&image) - 1.0).abs() < 1e-5);
            let (before, after) = (image.iter(), sharp.iter());
            let highest = |v: f32, w: &f32| v.max(*w);
            assert!(after.fold(0.0, highest) > 1.5 * before.fold(0.0, highest));
        }
    }

    #[test]
    fn a_constant_stays_constant_up_to_the_edge() {
        let mut image = Array2::from_elem((40, 31), 16.0_f32);
        image.slice_mut(s![..3, ..]).fill(f32::NAN);
        image.slice_mut(s![.., 29..]).fill(f32::NAN);
        image.slice_mut(s![12..15, 10..13]).fill(f32::NAN);
        for acceleration in [Acceleration::None, Acceleration::BiggsAndrews] {
            for order in 1..=5 {
                let mut settings = LinearizationSettings::gaussian(1.3).unwrap();
                settings.acceleration = acceleration;
                let linear = linearize(&image, order, &settings).unwrap();
                let expected = 16.0_f32.powf(1.0 / order as f32);
                for (value, datum) in linear.iter().zip(&image) {
                    assert_eq!(value.is_nan(), datum.is_nan());
                    assert!(value.is_nan() || (value / expected - 1.0).abs() < 1e-5, "{value}");
                }
            }
        }
    }

    #[test]
    fn a_frame_of_missing_pixels_changes_nothing_inside() {
        let image = spots(30, 26);
        let mut framed = Array2::from_elem((37, 35), f32::NAN);
        framed.slice_mut(s![4..34, 3..29]).assign(&image);
        let settings = LinearizationSettings::gaussian(1.1).unwrap();
        let alone = linearize(&image, 2, &settings).unwrap();
        let inside = linearize(&framed, 2, &settings).unwrap();
        assert_eq!(alone, inside.slice(s![4..34, 3..29]));
        assert_eq!(inside.iter().filter(|v| !v.is_nan()).count(), image.len());
    }

    #[test]
    fn nothing_gives_nothing() {
        let settings = LinearizationSettings::gaussian(1.0).unwrap();
        let run = |image: Array2<f32>| linearize(&image, 2, &settings).unwrap();
        assert_eq!(run(Array2::zeros((7, 9))), Array2::<f32>::zeros((7, 9)));
        assert_eq!(run(Array2::from_elem((3, 3), -2.0)), Array2::<f32>::zeros((3, 3)));
        assert!(run(Array2::from_elem((3, 3), f32::NAN)).iter().all(|v| v.is_nan()));
        assert_eq!(run(Array2::zeros((0, 4))).dim(), (0, 4));
        assert_eq!(run(Array2::zeros((4, 0))).dim(), (4, 0));
        let one = run(Array2::from_elem((1, 1), 9.0));
        assert!((one[[0, 0]] - 3.0).abs() < 1e-5);
        let row = run(Array2::from_elem((1, 12), 9.0));
        assert!(row.iter().all(|v| (v - 3.0).abs() < 1e-4));
    }

    #[test]
    fn no_iterations_and_no_reconvolution_leave_the_root() {
        let mut settings = LinearizationSettings::gaussian(1.0).unwrap();
        settings.iterations = 0;
        settings.reconvolution = Reconvolution::None;
        let image = spots(12, 12);
        let linear = linearize(&image, 2, &settings).unwrap();
        for (a, b) in linear.iter().zip(&image) {
            assert!((a - b.sqrt()).abs() < 1e-5);
        }
    }

    #[test]
    fn bad_settings_are_refused() {
        let mut settings = LinearizationSettings::gaussian(1.0).unwrap();
        assert!(linearize(&spots(4, 4), 0, &settings).is_err());
        settings.reconvolution = Reconvolution::Sigma(-1.0);
        assert!(linearize(&spots(4, 4), 2, &settings).is_err());
        assert!(LinearizationSettings::gaussian(f64::NAN).is_err());
    }

    #[test]
    fn an_image_of_the_psf_does_as_its_gaussian() {
        let gaussian = GaussianPsf::new(1.5).unwrap();
        let half = gaussian.sampled();
        let side = 2 * half.len() - 1;
        let sampled = Array2::from_shape_fn((side, side), |(y, x)| {
            (half[y.abs_diff(side / 2)] * half[x.abs_diff(side / 2)]) as f32
        });
        let image = spots(40, 33);
        let of = |psf: &Psf| deconvolve(&image, psf, 10, Acceleration::None);
        let by_image = of(&Psf::image(&sampled).unwrap());
        let by_gaussian = of(&Psf::Gaussian(gaussian));
        assert!(reference::disagreement(&by_image, &by_gaussian) < 1e-3);
        assert!((sum(&by_image) / sum(&image) - 1.0).abs() < 1e-4);
    }

    /// Mean over frames of the product of two pixels' deviations, on the grid of the published
    /// software: output `(i, j)` is at camera position `(1 + i / 2, 1 + j / 2)`.
    fn second_order(frames: &[Array2<f32>]) -> Array2<f32> {
        let (height, width) = frames[0].dim();
        let mut deviations = Array3::<f64>::zeros((frames.len(), height, width));
        for (mut to, frame) in deviations.outer_iter_mut().zip(frames) {
            to.assign(&frame.mapv(f64::from));
        }
        let mean = deviations.mean_axis(ndarray::Axis(0)).unwrap();
        deviations -= &mean;
        let covariance = |a: (usize, usize), b: (usize, usize)| {
            let (a, b) = (deviations.slice(s![.., a.0, a.1]), deviations.slice(s![.., b.0, b.1]));
            a.dot(&b) / frames.len() as f64
        };
        Array2::from_shape_fn((2 * (height - 3) - 1, 2 * (width - 3) - 1), |(i, j)| {
            let (y, x) = (1 + i / 2, 1 + j / 2);
            let value = match (i % 2, j % 2) {
                (0, 0) => 0.5 * (covariance((y - 1, x), (y + 1, x)) + covariance((y, x - 1), (y, x + 1))),
                (0, _) => covariance((y, x), (y, x + 1)),
                (_, 0) => covariance((y, x), (y + 1, x)),
                _ => 0.5 * (covariance((y, x), (y + 1, x + 1)) + covariance((y + 1, x), (y, x + 1))),
            };
            value as f32
        })
    }

    fn correlation(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
        let mean = |v: &Array2<f32>| sum(v) / v.len() as f64;
        let (mean_a, mean_b) = (mean(a), mean(b));
        let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
        for (&a, &b) in a.iter().zip(b) {
            let (a, b) = (f64::from(a) - mean_a, f64::from(b) - mean_b);
            (ab, aa, bb) = (ab + a * b, aa + a * a, bb + b * b);
        }
        ab / (aa * bb).sqrt()
    }

    #[test]
    fn correlates_with_published_software_on_foreign_data() {
        for (number, least) in [("02", 0.93), ("03", 0.86)] {
            let Some(frames) = reference::pages(&format!("peer/{number}_noisyvid.tif")) else {
                return;
            };
            let expected = reference::pages(&format!("peer/{number}_sofi2_linearized.tif")).unwrap();
            let distances = ndarray::array![[4.0, 1.0], [1.0, 2.0]];
            let method = flattening::Flattening::EqualMeans(flattening::PsfWidth::Known(1.15));
            let (flat, _) = flattening::flatten(&second_order(&frames), &distances, method).unwrap();
            let mut settings = LinearizationSettings::new(Psf::from_fwhm(2.7).unwrap());
            settings.iterations = 10;
            settings.acceleration = Acceleration::BiggsAndrews;
            settings.reconvolution = Reconvolution::None;
            let linear = linearize(&flat, 2, &settings).unwrap();
            let correlation = correlation(&linear, &expected[0]);
            let plain = {
                settings.acceleration = Acceleration::None;
                settings.iterations = 20;
                linearize(&flat, 2, &settings).unwrap()
            };
            let of_plain = self::correlation(&plain, &expected[0]);
            println!("peer {number}: correlation {correlation:.4}, 20 plain iterations {of_plain:.4}");
            assert!(correlation > least);
        }
    }

    #[test]
    #[ignore = "a measurement: run it alone, with --nocapture"]
    fn speed_of_a_large_image() {
        let image = spots(4096, 4096);
        let mut settings = LinearizationSettings::gaussian(1.0).unwrap();
        for acceleration in [Acceleration::None, Acceleration::BiggsAndrews] {
            settings.acceleration = acceleration;
            let start = Instant::now();
            linearize(&image, 2, &settings).unwrap();
            println!("{acceleration:?}: {:?}", start.elapsed());
        }
    }
}
