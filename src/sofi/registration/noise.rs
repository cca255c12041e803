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

/// Fewest pixels that a line is fitted to.
const LEAST_PIXELS: usize = 100;

impl NoiseLine {
    /// The line through temporal variances over means of pixels whose light is steady.
    ///
    /// Each pixel counts less the more its variance scatters, and pixels that blink or drift are left out.
    /// `None` for too few pixels or such that all have the same mean.
    #[must_use]
    pub fn fit(means: &[f32], variances: &[f32]) -> Option<Self> {
        let pixels: Vec<(f64, f64)> = means
            .iter()
            .zip(variances)
            .map(|(&mean, &variance)| (f64::from(mean), f64::from(variance)))
            .filter(|(mean, variance)| mean.is_finite() && *variance > 0.0)
            .collect();
        if pixels.len() < LEAST_PIXELS {
            return None;
        }
        let mut line = weighted_line(&pixels, |_, _| 1.0)?;
        for _ in 0..10 {
            let floor = 0.1 * median(pixels.iter().map(|(_, variance)| *variance));
            let expected = |mean: f64| line.variance(mean).max(floor);
            // Ratios to the line scatter alike at all means.
            let spread = 1.4826 * median(pixels.iter().map(|(m, v)| (v / expected(*m) - 1.0).abs()));
            let weight = |mean: f64, variance: f64| {
                let off = (variance / expected(mean) - 1.0).abs();
                if off > 4.0 * spread { 0.0 } else { expected(mean).powi(-2) }
            };
            line = weighted_line(&pixels, weight)?;
        }
        (line.slope > 0.0).then_some(line)
    }
}

fn weighted_line(pixels: &[(f64, f64)], weight: impl Fn(f64, f64) -> f64) -> Option<NoiseLine> {
    let weights: Vec<f64> = pixels.iter().map(|&(mean, variance)| weight(mean, variance)).collect();
    let total: f64 = weights.iter().sum();
    let center = |part: fn(&(f64, f64)) -> f64| {
        pixels.iter().zip(&weights).map(|(pixel, weight)| weight * part(pixel)).sum::<f64>() / total
    };
    let (mean, variance) = (center(|pixel| pixel.0), center(|pixel| pixel.1));
    let (mut squared, mut mixed) = (0.0, 0.0);
    for (&(m, v), weight) in pixels.iter().zip(&weights) {
        squared += weight * (m - mean) * (m - mean);
        mixed += weight * (m - mean) * (v - variance);
    }
    let slope = mixed / squared;
    slope.is_finite().then_some(NoiseLine { slope, at_zero: variance - slope * mean })
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_of_steady_pixels_is_found_beside_blinking_ones() {
        let truth = NoiseLine::of_camera(2.2, 100.0, 3.0);
        let mean = |i: usize| 110.0 + (i % 97) as f32 * 5.0;
        let means: Vec<f32> = (0..5000).map(mean).collect();
        let variances: Vec<f32> = (0..5000)
            .map(|i| {
                let scatter = 1.0 + 0.14 * (((i * 7919) % 101) as f64 / 50.0 - 1.0);
                let blinks = if i % 20 == 0 { 5.0 } else { 1.0 };
                (truth.variance(f64::from(mean(i))) * scatter * blinks) as f32
            })
            .collect();
        let line = NoiseLine::fit(&means, &variances).unwrap();
        assert!((line.slope / truth.slope - 1.0).abs() < 0.01, "{line:?}");
        assert!((line.variance(300.0) / truth.variance(300.0) - 1.0).abs() < 0.01, "{line:?}");
    }

    #[test]
    fn even_light_gives_no_line() {
        assert_eq!(NoiseLine::fit(&[100.0; 500], &[10.0; 500]), None);
    }
}
