//! Describes the point-spread function `U` and what becomes of it at order `n` (Eq. S5: `U^n`).
//!
//! In: a width in pixels, the optics, or a measured image of odd size.
//! Out: [`Psf`], and normalized kernels to convolve with.
//! Never: reads files or fits beads; an image that cannot be a point-spread function is refused.
//! Fails: [`PsfError`].

use ndarray::{Array2, ArrayRef2};
use thiserror::Error;

/// Widest Gaussian accepted, standard deviation in pixels.
pub const MAX_SIGMA: f64 = 1000.0;
/// Full width at half maximum over standard deviation of a Gaussian, `2 sqrt(2 ln 2)`.
pub const FWHM_PER_SIGMA: f64 = 2.354_820_045_030_949_3;
/// Kernels reach to this many standard deviations.
pub const KERNEL_REACH: f64 = 5.0;

/// Why something is not a point-spread function.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PsfError {
    /// The width is not in `0 < sigma <= MAX_SIGMA` pixels.
    #[error("standard deviation {0} px is not above 0 and at most {MAX_SIGMA} px")]
    Sigma(f64),
    /// Aperture, wavelength or pixel pitch is not a positive number.
    #[error("numerical aperture, wavelength and pixel pitch must be positive numbers")]
    Optics,
    /// Height or width is even or zero, so there is no center pixel.
    #[error("an image of {height} x {width} pixels has no center pixel: both must be odd")]
    Size {
        /// Height, pixels.
        height: usize,
        /// Width, pixels.
        width: usize,
    },
    /// A value is negative or not finite, or all are zero.
    #[error("the image holds negative or missing values, or no light")]
    Values,
    /// The center of mass is more than half a pixel from the center pixel.
    #[error("the center of mass is ({dy:.2}, {dx:.2}) px away from the center pixel")]
    OffCenter {
        /// Offset along y, pixels.
        dy: f64,
        /// Offset along x, pixels.
        dx: f64,
    },
    /// Order 0.
    #[error("the order must be at least 1")]
    Order,
}

/// A point-spread function in the pixels of the image it belongs to.
#[derive(Debug, Clone, PartialEq)]
pub enum Psf {
    /// A rotationally symmetric Gaussian.
    Gaussian(GaussianPsf),
    /// A measured or computed image.
    Image(PsfImage),
}

/// A Gaussian of standard deviation `0 < sigma <= MAX_SIGMA` pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GaussianPsf {
    sigma: f64,
}

/// An image of odd height and width, not negative, of sum 1, its center of mass within half a
/// pixel of the center pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct PsfImage {
    values: Array2<f32>,
}

impl Psf {
    /// A Gaussian of standard deviation `sigma`, pixels.
    ///
    /// # Errors
    /// [`PsfError::Sigma`] unless `0 < sigma <= MAX_SIGMA`.
    pub fn gaussian(sigma: f64) -> Result<Self, PsfError> {
        GaussianPsf::new(sigma).map(Self::Gaussian)
    }

    /// A Gaussian of the given full width at half maximum, pixels.
    ///
    /// # Errors
    /// [`PsfError::Sigma`].
    pub fn from_fwhm(fwhm: f64) -> Result<Self, PsfError> {
        Self::gaussian(fwhm / FWHM_PER_SIGMA)
    }

    /// The Gaussian nearest to the image of a point: `sigma = 0.21 lambda / NA`, in pixels of the
    /// given pitch in the sample (all lengths in nanometers).
    ///
    /// # Errors
    /// [`PsfError::Optics`] or [`PsfError::Sigma`].
    pub fn from_optics(
        numerical_aperture: f64,
        wavelength_nm: f64,
        pixel_pitch_nm: f64,
    ) -> Result<Self, PsfError> {
        let all = [numerical_aperture, wavelength_nm, pixel_pitch_nm];
        if !all.iter().all(|v| v.is_finite() && *v > 0.0) {
            return Err(PsfError::Optics);
        }
        Self::gaussian(0.21 * wavelength_nm / numerical_aperture / pixel_pitch_nm)
    }

    /// An image, normalized to sum 1.
    ///
    /// # Errors
    /// [`PsfError::Size`], [`PsfError::Values`], [`PsfError::OffCenter`].
    pub fn image(values: &ArrayRef2<f32>) -> Result<Self, PsfError> {
        PsfImage::new(values).map(Self::Image)
    }

    /// `U^n` on the `n`-fold grid: the point-spread function of the `n`-th order image, in *its*
    /// pixels. A Gaussian narrows by `sqrt(n)` and the grid is `n` times finer, so `sigma sqrt(n)`;
    /// an image is interpolated by cubics before the power is taken.
    ///
    /// # Errors
    /// [`PsfError::Order`] for order 0; those of the constructors.
    pub fn narrowed(&self, order: usize) -> Result<Self, PsfError> {
        if order == 0 {
            return Err(PsfError::Order);
        }
        match self {
            Self::Gaussian(gaussian) => Self::gaussian(gaussian.sigma * (order as f64).sqrt()),
            Self::Image(image) => Self::image(&image.power_on_finer_grid(order)),
        }
    }

    /// Standard deviation along one axis, pixels (of an image: root mean of both axes' variances).
    #[must_use]
    pub fn sigma(&self) -> f64 {
        match self {
            Self::Gaussian(gaussian) => gaussian.sigma,
            Self::Image(image) => image.sigma(),
        }
    }
}

impl GaussianPsf {
    /// A Gaussian of standard deviation `sigma`, pixels.
    ///
    /// # Errors
    /// [`PsfError::Sigma`] unless `0 < sigma <= MAX_SIGMA`.
    pub fn new(sigma: f64) -> Result<Self, PsfError> {
        if sigma > 0.0 && sigma <= MAX_SIGMA { Ok(Self { sigma }) } else { Err(PsfError::Sigma(sigma)) }
    }

    /// Standard deviation, pixels.
    #[must_use]
    pub fn sigma(&self) -> f64 {
        self.sigma
    }

    /// Profile at the pixel centers from 0 outward to `ceil(5 sigma)`; the sum over both sides is 1.
    #[must_use]
    pub fn sampled(&self) -> Vec<f64> {
        self.half_profile(|x| (-0.5 * (x / self.sigma).powi(2)).exp())
    }

    /// The same, integrated over each pixel.
    #[must_use]
    pub fn pixel_integrated(&self) -> Vec<f64> {
        let below = |x: f64| libm::erf(x / (self.sigma * std::f64::consts::SQRT_2));
        self.half_profile(|x| below(x + 0.5) - below(x - 0.5))
    }

    fn half_profile(&self, value_at: impl Fn(f64) -> f64) -> Vec<f64> {
        let radius = (KERNEL_REACH * self.sigma).ceil() as usize;
        let half: Vec<f64> = (0..=radius).map(|x| value_at(x as f64)).collect();
        let sum = half[0] + 2.0 * half[1..].iter().sum::<f64>();
        half.into_iter().map(|v| v / sum).collect()
    }
}

impl PsfImage {
    /// Checks and normalizes an image.
    ///
    /// # Errors
    /// [`PsfError::Size`], [`PsfError::Values`], [`PsfError::OffCenter`].
    pub fn new(values: &ArrayRef2<f32>) -> Result<Self, PsfError> {
        let (height, width) = values.dim();
        if height % 2 == 0 || width % 2 == 0 {
            return Err(PsfError::Size { height, width });
        }
        let sum: f64 = values.iter().map(|&v| f64::from(v)).sum();
        if values.iter().any(|v| *v < 0.0) || !(sum > 0.0 && sum.is_finite()) {
            return Err(PsfError::Values);
        }
        let image = Self { values: values.mapv(|v| (f64::from(v) / sum) as f32) };
        let dy = image.moment(|y, _| y);
        let dx = image.moment(|_, x| x);
        if dy.abs() > 0.5 || dx.abs() > 0.5 {
            return Err(PsfError::OffCenter { dy, dx });
        }
        Ok(image)
    }

    /// The values, sum 1, the center pixel at `(height / 2, width / 2)`.
    #[must_use]
    pub fn values(&self) -> &ArrayRef2<f32> {
        &self.values
    }

    fn sigma(&self) -> f64 {
        let (dy, dx) = (self.moment(|y, _| y), self.moment(|_, x| x));
        let square = self.moment(|y, x| (y - dy).powi(2) + (x - dx).powi(2));
        (0.5 * square).sqrt()
    }

    /// Mean of a function of the offset from the center pixel.
    fn moment(&self, of: impl Fn(f64, f64) -> f64) -> f64 {
        let (height, width) = self.values.dim();
        let centered = |i: usize, size: usize| i as f64 - (size / 2) as f64;
        self.values
            .indexed_iter()
            .map(|((y, x), &v)| f64::from(v) * of(centered(y, height), centered(x, width)))
            .sum()
    }

    fn power_on_finer_grid(&self, order: usize) -> Array2<f32> {
        let (height, width) = self.values.dim();
        let peak = self.values.iter().copied().fold(0.0_f32, f32::max);
        let shape = (order * (height - 1) + 1, order * (width - 1) + 1);
        Array2::from_shape_fn(shape, |(y, x)| {
            let value = self.interpolated(y as f64 / order as f64, x as f64 / order as f64);
            (value / f64::from(peak)).max(0.0).powi(order as i32) as f32
        })
    }

    /// Cubic (Catmull-Rom) interpolation, zero outside.
    fn interpolated(&self, y: f64, x: f64) -> f64 {
        let (wy, wx) = (catmull_rom(y.fract()), catmull_rom(x.fract()));
        let mut sum = 0.0;
        for (j, wy) in wy.iter().enumerate() {
            for (i, wx) in wx.iter().enumerate() {
                let row = (y as usize + j).wrapping_sub(1);
                let column = (x as usize + i).wrapping_sub(1);
                let value = self.values.get((row, column)).copied().unwrap_or(0.0);
                sum += wy * wx * f64::from(value);
            }
        }
        sum
    }
}

/// Weights of the points -1, 0, 1, 2 at position `t` in `0..1`.
fn catmull_rom(t: f64) -> [f64; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn gaussian_image(sigma: f64, radius: i32) -> Array2<f32> {
        let side = 2 * radius as usize + 1;
        Array2::from_shape_fn((side, side), |(y, x)| {
            let (y, x) = (y as i32 - radius, x as i32 - radius);
            (-f64::from(y * y + x * x) / (2.0 * sigma * sigma)).exp() as f32
        })
    }

    #[test]
    fn width_from_the_optics() {
        let psf = Psf::from_optics(1.27, 670.0, 108.0).unwrap();
        assert!((psf.sigma() - 1.025_809).abs() < 1e-5);
        let psf = Psf::from_fwhm(2.7).unwrap();
        assert!((psf.sigma() - 1.146_58).abs() < 1e-5);
        assert!(Psf::from_optics(0.0, 670.0, 108.0).is_err());
        assert!(Psf::from_optics(1.27, f64::NAN, 108.0).is_err());
    }

    #[test]
    fn widths_out_of_range_are_refused() {
        for bad in [0.0, -1.0, 1e4, f64::NAN, f64::INFINITY] {
            assert!(Psf::gaussian(bad).is_err());
        }
        assert!(Psf::gaussian(1.0).unwrap().narrowed(0).is_err());
    }

    #[test]
    fn images_that_are_no_psf_are_refused() {
        let even = Psf::image(&Array2::ones((4, 5)));
        assert!(matches!(even, Err(PsfError::Size { .. })));
        let dark = Psf::image(&Array2::zeros((3, 3)));
        assert_eq!(dark, Err(PsfError::Values));
        let mut corner = Array2::zeros((5, 5));
        corner[[0, 0]] = 1.0;
        let off_center = Psf::image(&corner);
        assert!(matches!(off_center, Err(PsfError::OffCenter { .. })));
        corner[[2, 2]] = f32::NAN;
        assert_eq!(Psf::image(&corner), Err(PsfError::Values));
        corner[[2, 2]] = -1.0;
        assert_eq!(Psf::image(&corner), Err(PsfError::Values));
    }

    #[test]
    fn an_image_of_a_gaussian_behaves_like_the_gaussian() {
        let image = Psf::image(&gaussian_image(1.5, 9)).unwrap();
        assert!((image.sigma() - 1.5).abs() < 1e-3);
        for order in 2..=4 {
            let narrowed = image.narrowed(order).unwrap();
            let expected = 1.5 * (order as f64).sqrt();
            assert!((narrowed.sigma() - expected).abs() < 0.02 * expected, "{narrowed:?}");
        }
    }

    #[test]
    fn integration_over_pixels_widens_by_a_twelfth() {
        let psf = GaussianPsf::new(2.0).unwrap();
        let variance =
            |half: Vec<f64>| -> f64 { half.iter().enumerate().map(|(x, v)| 2.0 * v * (x * x) as f64).sum() };
        let wider = variance(psf.pixel_integrated()) - variance(psf.sampled());
        assert!((wider - 1.0 / 12.0).abs() < 1e-3);
    }

    proptest! {
        #[test]
        fn kernels_have_sum_one_and_reach_five_sigma(sigma in 0.05..20.0_f64) {
            let psf = GaussianPsf::new(sigma).unwrap();
            for half in [psf.sampled(), psf.pixel_integrated()] {
                prop_assert_eq!(half.len(), (5.0 * sigma).ceil() as usize + 1);
                let sum = half[0] + 2.0 * half[1..].iter().sum::<f64>();
                prop_assert!((sum - 1.0).abs() < 1e-12);
            }
        }

        #[test]
        fn order_n_narrows_by_root_n_on_the_finer_grid(sigma in 0.5..5.0_f64, order in 1..6_usize) {
            let narrowed = Psf::gaussian(sigma).unwrap().narrowed(order).unwrap();
            prop_assert!((narrowed.sigma() - sigma * (order as f64).sqrt()).abs() < 1e-12);
        }
    }
}
