//! Noise of a camera's pixels: a line over their mean.
//!
//! In: means and temporal variances of pixels whose light is steady. Out: [`NoiseLine`].
//! Never: lets a few pixels whose light is not steady decide.

/// Variance of a pixel's noise: `slope * mean + at_zero`, counts squared.
///
/// With a gain `g` in counts per electron, an offset and a read noise in counts it is `g * (mean - offset) + read^2`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseLine {
    /// Counts squared per count: the gain in counts per electron.
    pub slope: f64,
    /// Counts squared: `read^2 - gain * offset`.
    pub at_zero: f64,
}

impl NoiseLine {
    /// The noise of a camera whose gain, offset and read noise are known.
    #[must_use]
    pub fn of_camera(gain_counts_per_electron: f64, offset_counts: f64, read_noise_counts: f64) -> Self {
        Self {
            slope: gain_counts_per_electron,
            at_zero: read_noise_counts * read_noise_counts - gain_counts_per_electron * offset_counts,
        }
    }

    /// Variance of a pixel with this mean, counts squared.
    #[inline(always)]
    #[must_use]
    pub fn variance(&self, mean: f64) -> f64 {
        (self.slope * mean + self.at_zero).max(0.0)
    }
}
