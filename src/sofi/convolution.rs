//! Blurs an image by a point-spread function with mirrored borders, and applies the transpose of that.
//!
//! In: a float32 image and a [`Psf`] in its pixels.
//! Out: a float32 image of the same shape. Borders reflect about the edge of the last pixel
//! (`... b a | a b c | c b ...`), so a constant stays constant, and for a symmetric kernel the sum
//! is conserved and the operator is its own transpose.
//! Never: looks at the meaning of pixels; NaN spreads as far as the kernel reaches (everywhere for
//! an image kernel), so callers replace missing pixels first.
//! Fails: [`ConvolutionError`] when an image does not have the shape the blur was made for.
//!
//! Arithmetic is float32: against a float64 twin the largest error is below 1e-6 of the largest
//! value for Gaussians, and 3e-6 for image kernels through the Fourier transform.

use std::sync::Arc;

use ndarray::{Array2, ArrayRef2};
use pulp::Arch;
use rayon::prelude::*;
use rustfft::{Fft, FftPlanner, num_complex::Complex};
use thiserror::Error;

use super::psf::{GaussianPsf, Psf, PsfImage};

/// Rows that one task takes at least.
const ROWS_PER_TASK: usize = 8;
/// Columns summed at a time, so that the sums stay in the fastest cache.
const COLUMNS_PER_BLOCK: usize = 1024;
/// Side of the squares that a transposition moves at a time.
const TRANSPOSED_BLOCK: usize = 16;

/// Why a blur cannot be applied.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum ConvolutionError {
    /// The image has another shape than the blur was made for.
    #[error("this blur was made for images of {expected:?} pixels, not {got:?}")]
    Shape {
        /// Height and width it was made for.
        expected: (usize, usize),
        /// Height and width of the image.
        got: (usize, usize),
    },
}

/// Convolves one image with a point-spread function in its pixels, with mirrored borders.
#[must_use]
pub fn convolve(image: &ArrayRef2<f32>, psf: &Psf) -> Array2<f32> {
    let image = image.as_standard_layout();
    let mut blurred = Array2::zeros(image.dim());
    Blur::new(psf, image.dim()).apply_then(&image, &mut blurred, |_, _| {});
    blurred
}

/// The linear operator `H` of a point-spread function on images of one shape.
#[derive(Clone)]
pub struct Blur {
    shape: (usize, usize),
    kernel: Kernel,
}

#[derive(Clone)]
enum Kernel {
    Gaussian(GaussianKernel),
    Image(ImageKernel),
}

impl Blur {
    /// Prepares the kernel for images of `shape` (height, width).
    #[must_use]
    pub fn new(psf: &Psf, shape: (usize, usize)) -> Self {
        let kernel = match psf {
            Psf::Gaussian(gaussian) => Kernel::Gaussian(GaussianKernel::new(gaussian)),
            Psf::Image(image) => Kernel::Image(ImageKernel::new(image, shape)),
        };
        Self { shape, kernel }
    }

    /// `H image`.
    ///
    /// # Errors
    /// [`ConvolutionError::Shape`].
    pub fn apply(&self, image: &ArrayRef2<f32>) -> Result<Array2<f32>, ConvolutionError> {
        let mut blurred = self.checked_output(image)?;
        self.apply_then(&image.as_standard_layout(), &mut blurred, |_, _| {});
        Ok(blurred)
    }

    /// `H^T image`.
    ///
    /// # Errors
    /// [`ConvolutionError::Shape`].
    pub fn apply_transposed(&self, image: &ArrayRef2<f32>) -> Result<Array2<f32>, ConvolutionError> {
        let mut blurred = self.checked_output(image)?;
        self.apply_transposed_then(&image.as_standard_layout(), &mut blurred, |_, _| {});
        Ok(blurred)
    }

    /// Whether `H^T 1 = 1`: true for symmetric kernels, whose transpose is the operator itself.
    #[must_use]
    pub fn is_symmetric(&self) -> bool {
        matches!(self.kernel, Kernel::Gaussian(_))
    }

    /// Blurred values below this share of the largest are rounding, not signal.
    #[must_use]
    pub(super) fn rounding_floor(&self) -> f32 {
        match self.kernel {
            // Sums of terms that are not negative have no cancellation.
            Kernel::Gaussian(_) => 1e-30,
            Kernel::Image(_) => 1e-6,
        }
    }

    /// `H image` into `output` (both of the shape of this blur and in standard layout), each row
    /// handed to `finish` while it is still in the cache.
    pub(super) fn apply_then(
        &self,
        image: &ArrayRef2<f32>,
        output: &mut Array2<f32>,
        finish: impl Fn(usize, &mut [f32]) + Sync,
    ) {
        self.run(image, output, finish, Direction::Forward);
    }

    /// `H^T image` into `output`, as [`Blur::apply_then`].
    pub(super) fn apply_transposed_then(
        &self,
        image: &ArrayRef2<f32>,
        output: &mut Array2<f32>,
        finish: impl Fn(usize, &mut [f32]) + Sync,
    ) {
        self.run(image, output, finish, Direction::Transposed);
    }

    fn run(
        &self,
        image: &ArrayRef2<f32>,
        output: &mut Array2<f32>,
        finish: impl Fn(usize, &mut [f32]) + Sync,
        direction: Direction,
    ) {
        let (Some(input), Some(out)) = (image.as_slice(), output.as_slice_mut()) else {
            return;
        };
        if input.is_empty() || input.len() != out.len() {
            return;
        }
        match &self.kernel {
            Kernel::Gaussian(kernel) => kernel.run(input, self.shape, out, finish),
            Kernel::Image(kernel) => kernel.run(input, out, finish, direction),
        }
    }

    fn checked_output(&self, image: &ArrayRef2<f32>) -> Result<Array2<f32>, ConvolutionError> {
        if image.dim() != self.shape {
            return Err(ConvolutionError::Shape { expected: self.shape, got: image.dim() });
        }
        Ok(Array2::zeros(self.shape))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Direction {
    Forward,
    Transposed,
}

/// Mirrors an index about the edges of `0..size`, as often as it takes.
fn mirrored(index: isize, size: usize) -> usize {
    let period = 2 * size as isize;
    let within = index.rem_euclid(period);
    within.min(period - 1 - within) as usize
}

/// One half of a separable, symmetric kernel, from the center outward.
#[derive(Clone)]
struct GaussianKernel {
    half: Vec<f32>,
}

impl GaussianKernel {
    fn new(psf: &GaussianPsf) -> Self {
        Self { half: psf.sampled().into_iter().map(|v| v as f32).collect() }
    }

    fn run(
        &self,
        input: &[f32],
        (height, width): (usize, usize),
        output: &mut [f32],
        finish: impl Fn(usize, &mut [f32]) + Sync,
    ) {
        let arch = Arch::new();
        let radius = self.half.len() - 1;
        let rows = output.par_chunks_mut(width).enumerate();
        rows.with_min_len(ROWS_PER_TASK).for_each_init(
            || vec![0.0; width + 2 * radius],
            |padded, (y, row)| {
                arch.dispatch(|| {
                    self.sum_columns(input, height, y, &mut padded[radius..radius + width]);
                    self.mirror_ends(padded, width);
                    self.sum_row(padded, row);
                    finish(y, row);
                });
            },
        );
    }

    /// Convolves along y at row `y`.
    #[inline(always)]
    fn sum_columns(&self, input: &[f32], height: usize, y: usize, sums: &mut [f32]) {
        let width = sums.len();
        let row = |offset: isize| {
            let y = mirrored(y as isize + offset, height);
            &input[y * width..(y + 1) * width]
        };
        for start in (0..width).step_by(COLUMNS_PER_BLOCK) {
            let block = start..width.min(start + COLUMNS_PER_BLOCK);
            let sums = &mut sums[block.clone()];
            for (to, &from) in sums.iter_mut().zip(&row(0)[block.clone()]) {
                *to = self.half[0] * from;
            }
            for (k, &weight) in self.half.iter().enumerate().skip(1) {
                let below = &row(k as isize)[block.clone()];
                let above = &row(-(k as isize))[block.clone()];
                add_weighted(sums, weight, below, above);
            }
        }
    }

    fn mirror_ends(&self, padded: &mut [f32], width: usize) {
        let radius = self.half.len() - 1;
        for k in 0..radius {
            padded[radius - 1 - k] = padded[radius + mirrored(k as isize, width)];
            padded[radius + width + k] = padded[radius + mirrored((width + k) as isize, width)];
        }
    }

    /// Convolves along x.
    #[inline(always)]
    fn sum_row(&self, padded: &[f32], row: &mut [f32]) {
        let (radius, width) = (self.half.len() - 1, row.len());
        for start in (0..width).step_by(COLUMNS_PER_BLOCK) {
            let count = COLUMNS_PER_BLOCK.min(width - start);
            let sums = &mut row[start..start + count];
            let from = |offset: usize| &padded[start + offset..start + offset + count];
            for (to, &value) in sums.iter_mut().zip(from(radius)) {
                *to = self.half[0] * value;
            }
            for (k, &weight) in self.half.iter().enumerate().skip(1) {
                add_weighted(sums, weight, from(radius + k), from(radius - k));
            }
        }
    }
}

#[inline(always)]
fn add_weighted(sums: &mut [f32], weight: f32, one: &[f32], other: &[f32]) {
    for ((sum, a), b) in sums.iter_mut().zip(one).zip(other) {
        *sum += weight * (a + b);
    }
}

/// A kernel of any shape, applied by Fourier transforms of the mirrored image.
#[derive(Clone)]
struct ImageKernel {
    shape: (usize, usize),
    radius: (usize, usize),
    padded: (usize, usize),
    /// Transform of the kernel over the number of points, transposed: `[x, y]`.
    spectrum: Vec<Complex<f32>>,
    along_x: Transforms,
    along_y: Transforms,
}

#[derive(Clone)]
struct Transforms {
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
}

impl Transforms {
    fn new(length: usize) -> Self {
        let mut planner = FftPlanner::new();
        Self { forward: planner.plan_fft_forward(length), inverse: planner.plan_fft_inverse(length) }
    }
}

impl ImageKernel {
    fn new(psf: &PsfImage, shape: (usize, usize)) -> Self {
        let values = psf.values();
        let radius = (values.nrows() / 2, values.ncols() / 2);
        let padded = (smooth_length(shape.0 + 2 * radius.0), smooth_length(shape.1 + 2 * radius.1));
        let mut kernel = Self {
            shape,
            radius,
            padded,
            spectrum: Vec::new(),
            along_x: Transforms::new(padded.1),
            along_y: Transforms::new(padded.0),
        };
        let mut centered = vec![Complex::default(); padded.0 * padded.1];
        let points = centered.len() as f32;
        for ((y, x), &value) in values.indexed_iter() {
            let y = (y + padded.0 - radius.0) % padded.0;
            let x = (x + padded.1 - radius.1) % padded.1;
            centered[y * padded.1 + x] += Complex::from(value / points);
        }
        kernel.spectrum = kernel.transformed(centered);
        kernel
    }

    fn run(
        &self,
        input: &[f32],
        output: &mut [f32],
        finish: impl Fn(usize, &mut [f32]) + Sync,
        direction: Direction,
    ) {
        let embedded = match direction {
            Direction::Forward => self.mirrored_out(input),
            Direction::Transposed => self.surrounded_by_zeros(input),
        };
        let mut spectrum = self.transformed(embedded);
        spectrum.par_iter_mut().zip(&self.spectrum).for_each(|(value, kernel)| {
            *value *= match direction {
                Direction::Forward => *kernel,
                Direction::Transposed => kernel.conj(),
            };
        });
        let filtered = self.transformed_back(spectrum);
        match direction {
            Direction::Forward => self.cut_out(&filtered, output),
            Direction::Transposed => self.fold_in(&filtered, output),
        }
        let rows = output.par_chunks_mut(self.shape.1).enumerate();
        rows.for_each(|(y, row)| finish(y, row));
    }

    /// Where padded pixel `(y, x)` comes from.
    fn source(&self, y: usize, x: usize) -> (usize, usize) {
        let back = |i: usize, radius: usize, size| mirrored(i as isize - radius as isize, size);
        (back(y, self.radius.0, self.shape.0), back(x, self.radius.1, self.shape.1))
    }

    fn mirrored_out(&self, input: &[f32]) -> Vec<Complex<f32>> {
        let (height, width) = self.reach();
        let mut padded = vec![Complex::default(); self.padded.0 * self.padded.1];
        let rows = padded.par_chunks_mut(self.padded.1).enumerate();
        rows.take(height).for_each(|(y, row)| {
            for (x, to) in row[..width].iter_mut().enumerate() {
                let (y, x) = self.source(y, x);
                *to = Complex::from(input[y * self.shape.1 + x]);
            }
        });
        padded
    }

    fn surrounded_by_zeros(&self, input: &[f32]) -> Vec<Complex<f32>> {
        let mut padded = vec![Complex::default(); self.padded.0 * self.padded.1];
        let rows = padded.par_chunks_mut(self.padded.1).skip(self.radius.0);
        rows.zip(input.par_chunks(self.shape.1)).for_each(|(to, from)| {
            for (to, &from) in to[self.radius.1..].iter_mut().zip(from) {
                *to = Complex::from(from);
            }
        });
        padded
    }

    fn cut_out(&self, filtered: &[Complex<f32>], output: &mut [f32]) {
        let rows = filtered.par_chunks(self.padded.1).skip(self.radius.0);
        rows.zip(output.par_chunks_mut(self.shape.1)).for_each(|(from, to)| {
            for (to, from) in to.iter_mut().zip(&from[self.radius.1..]) {
                *to = from.re;
            }
        });
    }

    /// The transpose of mirroring: every padded pixel is added to where it came from.
    fn fold_in(&self, filtered: &[Complex<f32>], output: &mut [f32]) {
        let (height, width) = self.reach();
        output.fill(0.0);
        for y in 0..height {
            for x in 0..width {
                let (to_y, to_x) = self.source(y, x);
                output[to_y * self.shape.1 + to_x] += filtered[y * self.padded.1 + x].re;
            }
        }
    }

    /// Height and width of the mirrored image within the padding.
    fn reach(&self) -> (usize, usize) {
        (self.shape.0 + 2 * self.radius.0, self.shape.1 + 2 * self.radius.1)
    }

    fn transformed(&self, mut values: Vec<Complex<f32>>) -> Vec<Complex<f32>> {
        transform_rows(&*self.along_x.forward, &mut values);
        let mut turned = transposed(&values, self.padded.1);
        transform_rows(&*self.along_y.forward, &mut turned);
        turned
    }

    fn transformed_back(&self, mut values: Vec<Complex<f32>>) -> Vec<Complex<f32>> {
        transform_rows(&*self.along_y.inverse, &mut values);
        let mut turned = transposed(&values, self.padded.0);
        transform_rows(&*self.along_x.inverse, &mut turned);
        turned
    }
}

fn transform_rows(transform: &dyn Fft<f32>, values: &mut [Complex<f32>]) {
    let rows = values.par_chunks_mut(transform.len());
    rows.with_min_len(ROWS_PER_TASK).for_each_init(
        || vec![Complex::default(); transform.get_inplace_scratch_len()],
        |scratch, row| transform.process_with_scratch(row, scratch),
    );
}

fn transposed(values: &[Complex<f32>], width: usize) -> Vec<Complex<f32>> {
    let height = values.len() / width;
    let mut turned = vec![Complex::default(); values.len()];
    let bands = turned.par_chunks_mut(height * TRANSPOSED_BLOCK).enumerate();
    bands.for_each(|(band, rows)| {
        for start in (0..height).step_by(TRANSPOSED_BLOCK) {
            for (i, row) in rows.chunks_mut(height).enumerate() {
                let x = band * TRANSPOSED_BLOCK + i;
                let end = height.min(start + TRANSPOSED_BLOCK);
                for y in start..end {
                    row[y] = values[y * width + x];
                }
            }
        }
    });
    turned
}

/// Smallest length from `least` on that has no prime factor above 5.
fn smooth_length(least: usize) -> usize {
    let is_smooth = |length: &usize| {
        let mut rest = *length;
        for factor in [2, 3, 5] {
            while usize::is_multiple_of(rest, factor) {
                rest /= factor;
            }
        }
        rest == 1
    };
    (least.max(1)..).find(is_smooth).unwrap_or(least)
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use proptest::prelude::*;

    use super::*;

    /// The twin: every output pixel sums the mirrored image times the kernel, in float64.
    fn slowly(image: &Array2<f32>, kernel: &Array2<f64>) -> Array2<f64> {
        let (ry, rx) = (kernel.nrows() as isize / 2, kernel.ncols() as isize / 2);
        Array2::from_shape_fn(image.dim(), |(y, x)| {
            let mut sum = 0.0;
            for ((ky, kx), weight) in kernel.indexed_iter() {
                let sy = mirrored(y as isize - (ky as isize - ry), image.nrows());
                let sx = mirrored(x as isize - (kx as isize - rx), image.ncols());
                sum += weight * f64::from(image[[sy, sx]]);
            }
            sum
        })
    }

    fn outer(half: &[f64]) -> Array2<f64> {
        let radius = half.len() - 1;
        let side = 2 * radius + 1;
        Array2::from_shape_fn((side, side), |(y, x)| half[y.abs_diff(radius)] * half[x.abs_diff(radius)])
    }

    fn lopsided() -> Array2<f32> {
        Array2::from_shape_fn((5, 7), |(y, x)| {
            let d = (y as f32 - 2.2).powi(2) + (x as f32 - 3.3).powi(2) * 0.5;
            (-0.4 * d).exp()
        })
    }

    fn random_image(height: usize, width: usize, seed: u64) -> Array2<f32> {
        let mut state = seed | 1;
        Array2::from_shape_fn((height, width), |_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 40) as f32 / (1 << 24) as f32
        })
    }

    fn worst(a: &Array2<f32>, b: &Array2<f64>) -> f64 {
        let pairs = a.iter().zip(b);
        pairs.map(|(&a, b)| (f64::from(a) - b).abs()).fold(0.0, f64::max)
    }

    fn dot(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
        a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
    }

    proptest! {
        #[test]
        fn gaussians_agree_with_the_slow_twin(
            height in 1..24_usize, width in 1..24_usize, sigma in 0.1..4.0_f64, seed in any::<u64>(),
        ) {
            let image = random_image(height, width, seed);
            let psf = GaussianPsf::new(sigma).unwrap();
            let expected = slowly(&image, &outer(&psf.sampled()));
            let blurred = convolve(&image, &Psf::Gaussian(psf));
            prop_assert!(worst(&blurred, &expected) < 1e-6);
            let sums = (f64::from(image.sum()), f64::from(blurred.sum()));
            prop_assert!((sums.0 - sums.1).abs() < 1e-5 * sums.0.abs().max(1.0));
        }

        #[test]
        fn image_kernels_agree_with_the_slow_twin(
            height in 1..24_usize, width in 1..24_usize, seed in any::<u64>(),
        ) {
            let image = random_image(height, width, seed);
            let psf = PsfImage::new(&lopsided()).unwrap();
            let expected = slowly(&image, &psf.values().mapv(f64::from));
            let blurred = convolve(&image, &Psf::Image(psf));
            prop_assert!(worst(&blurred, &expected) < 3e-6);
        }

        #[test]
        fn the_transpose_is_the_transpose(
            height in 1..24_usize, width in 1..24_usize, seed in any::<u64>(),
        ) {
            let a = random_image(height, width, seed);
            let b = random_image(height, width, seed.rotate_left(20));
            for psf in [Psf::image(&lopsided()).unwrap(), Psf::gaussian(1.3).unwrap()] {
                let blur = Blur::new(&psf, a.dim());
                let left = dot(&blur.apply(&a).unwrap(), &b);
                let right = dot(&a, &blur.apply_transposed(&b).unwrap());
                prop_assert!((left - right).abs() < 1e-5 * left.abs().max(1.0));
            }
        }
    }

    #[test]
    fn wide_images_cross_the_blocks_of_columns_unseen() {
        let image = random_image(9, 2 * COLUMNS_PER_BLOCK + 7, 5);
        let psf = GaussianPsf::new(1.7).unwrap();
        let expected = slowly(&image, &outer(&psf.sampled()));
        assert!(worst(&convolve(&image, &Psf::Gaussian(psf)), &expected) < 1e-6);
    }

    #[test]
    fn constants_stay_constant() {
        let image = Array2::from_elem((31, 17), 3.0_f32);
        for psf in [Psf::image(&lopsided()).unwrap(), Psf::gaussian(2.5).unwrap()] {
            let blurred = convolve(&image, &psf);
            assert!(blurred.iter().all(|v| (v - 3.0).abs() < 1e-5));
        }
    }

    #[test]
    fn other_shapes_and_empty_images() {
        let blur = Blur::new(&Psf::gaussian(1.0).unwrap(), (4, 4));
        assert!(blur.apply(&Array2::zeros((4, 5))).is_err());
        assert!(blur.apply_transposed(&Array2::zeros((5, 4))).is_err());
        for psf in [Psf::image(&lopsided()).unwrap(), Psf::gaussian(1.0).unwrap()] {
            assert_eq!(convolve(&Array2::zeros((0, 3)), &psf).dim(), (0, 3));
        }
    }

    #[test]
    fn views_in_another_layout_blur_alike() {
        let image = random_image(12, 7, 3);
        let psf = Psf::gaussian(1.2).unwrap();
        let turned = convolve(&image.t(), &psf);
        let difference = &turned.t() - &convolve(&image, &psf);
        assert!(difference.iter().all(|d| d.abs() < 1e-6));
    }

    #[test]
    #[ignore = "a measurement: run it alone, with --nocapture"]
    fn speed_of_a_large_image() {
        let image = random_image(4096, 4096, 7);
        for psf in [Psf::gaussian(1.41).unwrap(), Psf::image(&lopsided()).unwrap()] {
            let blur = Blur::new(&psf, image.dim());
            for _ in 0..3 {
                let start = Instant::now();
                blur.apply(&image).unwrap();
                println!("sigma {:.2}: {:?}", psf.sigma(), start.elapsed());
            }
        }
    }
}
