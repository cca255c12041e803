//! Signal-to-noise of an image from the spread between subsequences.
//!
//! In: the image of one subsequence after another. Out: their mean, halves, and signal-to-noise.
//! Never: keeps the images: memory does not grow with their number. Fails: `None` before the second image.
//!
//! Per pixel, with `k` images of mean `m` and sample standard deviation `s`: `SNR = m / (s / sqrt(k))`, mean over
//! standard error of the mean. Mean and squared deviations run on as images come (Welford 1962).

use ndarray::{Array2, ArrayRef2, Zip};

/// Pixels above half of this quantile of the mean image enter the signal-to-noise of the image: its structure,
/// also where that is a small part of the image.
pub const BRIGHT_QUANTILE: f64 = 0.995;

/// Running sums of one image over subsequences; halves are the subsequences of even and of odd number.
#[derive(Debug, Clone)]
pub struct RunningImage {
    count: u64,
    mean: Array2<f32>,
    squares: Array2<f32>,
    halves: [Array2<f32>; 2],
}

impl RunningImage {
    /// No image yet.
    #[must_use]
    pub fn new(shape: (usize, usize)) -> Self {
        let zeros = || Array2::zeros(shape);
        Self { count: 0, mean: zeros(), squares: zeros(), halves: [zeros(), zeros()] }
    }

    /// Adds the image of the next subsequence.
    ///
    /// # Panics
    /// When the image has another shape.
    pub fn push(&mut self, image: &ArrayRef2<f32>) {
        let half = &mut self.halves[(self.count % 2) as usize];
        self.count += 1;
        let share = 1.0 / self.count as f32;
        Zip::from(&mut self.mean).and(&mut self.squares).and(half).and(image).for_each(
            |mean, squares, half, &value| {
                let difference = value - *mean;
                *mean += difference * share;
                *squares += difference * (value - *mean);
                *half += value;
            },
        );
    }

    /// Images so far.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Mean over all images; zero before the first.
    #[must_use]
    pub fn mean(&self) -> &Array2<f32> {
        &self.mean
    }

    /// Sums over the first, third, ... and over the second, fourth, ... image.
    #[must_use]
    pub fn halves(&self) -> &[Array2<f32>; 2] {
        &self.halves
    }

    /// Median signal-to-noise of the bright pixels; see [`signal_to_noise`].
    #[must_use]
    pub fn signal_to_noise(&self) -> Option<f64> {
        signal_to_noise(&self.mean, &self.squares, self.count)
    }
}

/// Median of the signal-to-noise over the pixels whose mean lies above half of the quantile
/// [`BRIGHT_QUANTILE`] of all means.
///
/// `squares` are the sums of squared deviations of `count` images from their mean. With few images the standard
/// error scatters, and the median of the quotient lies too high; the median of the chi-squared distribution,
/// `nu (1 - 2 / (9 nu))^3` (Wilson and Hilferty 1931), takes that out.
/// The brightest pixels of an image that is noise alone were chosen for their noise and give about 1.6.
/// `None` below two images, or where nothing varies.
#[must_use]
pub fn signal_to_noise(mean: &ArrayRef2<f32>, squares: &ArrayRef2<f32>, count: u64) -> Option<f64> {
    let freedom = count.checked_sub(1).filter(|&freedom| freedom > 0)? as f64;
    let mut pixels: Vec<(f32, f32)> = mean
        .iter()
        .zip(squares)
        .filter(|(mean, squares)| mean.is_finite() && **squares > 0.0)
        .map(|(&mean, &squares)| (mean, squares))
        .collect();
    if pixels.is_empty() {
        return None;
    }
    let rank = (pixels.len() as f64 * BRIGHT_QUANTILE) as usize;
    let (_, &mut (quantile, _), _) = pixels.select_nth_unstable_by(rank, |a, b| a.0.total_cmp(&b.0));
    let mut ratios: Vec<f64> = pixels
        .iter()
        .filter(|(mean, _)| *mean >= quantile / 2.0)
        .map(|&(mean, squares)| f64::from(mean) / (f64::from(squares) / freedom / count as f64).sqrt())
        .collect();
    if quantile <= 0.0 || ratios.is_empty() {
        return None;
    }
    let middle = ratios.len() / 2;
    let (_, median, _) = ratios.select_nth_unstable_by(middle, f64::total_cmp);
    let median_of_variance = (1.0 - 2.0 / (9.0 * freedom)).powi(3);
    Some(*median * median_of_variance.sqrt())
}

#[cfg(test)]
mod tests {
    use super::super::frc::tests::noise;
    use super::*;

    fn running(images: u64, signal: f32) -> RunningImage {
        let mut running = RunningImage::new((64, 64));
        for image in 0..images {
            running.push(&(noise(64, image) + signal));
        }
        running
    }

    #[test]
    fn known_signal_to_noise_is_found_and_grows_with_the_square_root() {
        for images in [2, 3, 5, 10, 40] {
            let expected = 20.0 * (images as f64).sqrt();
            let found = running(images, 20.0).signal_to_noise().unwrap();
            assert!((found / expected - 1.0).abs() < 0.15, "{images}: {found}, not {expected}");
        }
    }

    #[test]
    fn noise_alone_gives_little_and_one_image_nothing() {
        let found = running(20, 0.0).signal_to_noise().unwrap();
        assert!((1.3..2.0).contains(&found), "{found}");
        assert_eq!(running(1, 5.0).signal_to_noise(), None);
        assert_eq!(RunningImage::new((8, 8)).signal_to_noise(), None);
    }

    #[test]
    fn the_halves_are_the_first_and_the_second_in_turn_and_missing_pixels_stay_missing() {
        let mut running = RunningImage::new((1, 2));
        for value in [1.0, 10.0, 2.0, 20.0] {
            running.push(&ndarray::array![[value, f32::NAN]]);
        }
        assert_eq!(running.halves().each_ref().map(|half| half[[0, 0]]), [3.0, 30.0]);
        assert!(running.mean()[[0, 1]].is_nan() && (running.mean()[[0, 0]] - 8.25).abs() < 1e-6);
    }
}
