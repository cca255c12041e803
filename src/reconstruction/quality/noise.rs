//! How far blinking stands above the noise of the camera, where that is known.
//!
//! In: mean and variance of a subsequence, the maps of a camera. Out: signal-to-noise of the blinking of bright pixels.
//! Never: guesses a gain. Fails: `None` where nothing blinks.

use crate::sofi::camera::CameraMaps;
use crate::sofi::quality::BRIGHT_QUANTILE;
use ndarray::Array2;

/// Variance of bright pixels beyond that of photon and read noise, over that of this noise: the median over the pixels
/// whose variance lies above half of the quantile [`BRIGHT_QUANTILE`].
///
/// `mean` in counts and `variance` in counts squared are those of `samples` exposures, as the camera gives its pixels.
pub(super) fn blinking_to_noise(
    mean: &Array2<f32>,
    variance: &Array2<f32>,
    samples: u64,
    maps: &CameraMaps,
) -> Option<f64> {
    let freedom = samples.checked_sub(1).filter(|&freedom| freedom > 0)? as f64;
    let unbiased = samples as f64 / freedom;
    let mut pixels: Vec<(f64, f64)> = variance
        .indexed_iter()
        .filter(|(_, variance)| variance.is_finite())
        .map(|(place, &variance)| {
            let noise = maps.noise_variance(place, f64::from(mean[place]));
            (f64::from(variance) * unbiased, noise)
        })
        .filter(|(_, noise)| *noise > 0.0)
        .collect();
    if pixels.is_empty() {
        return None;
    }
    let rank = ((pixels.len() as f64 * BRIGHT_QUANTILE) as usize).min(pixels.len() - 1);
    let (_, &mut (quantile, _), _) = pixels.select_nth_unstable_by(rank, |a, b| a.0.total_cmp(&b.0));
    let bright = pixels.iter().filter(|(variance, _)| *variance >= quantile / 2.0);
    let mut ratios: Vec<f64> = bright.map(|(variance, noise)| variance / noise - 1.0).collect();
    let middle = ratios.len() / 2;
    let (_, ratio, _) = ratios.select_nth_unstable_by(middle, f64::total_cmp);
    Some(*ratio)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_camera_adds_by_itself_is_not_blinking() {
        let map = |value: f32| Array2::from_elem((20, 20), value);
        let maps = CameraMaps::new(map(100.0), map(2.0), map(10.0), Array2::zeros((20, 20)));
        let mean = map(200.0);
        let noise = map(210.0 * 0.99);
        let steady = blinking_to_noise(&mean, &noise, 100, &maps).unwrap();
        assert!(steady.abs() < 1e-5, "{steady}");
        let mut blinking = noise;
        blinking.row_mut(3).fill(4.0 * 210.0 * 0.99);
        let found = blinking_to_noise(&mean, &blinking, 100, &maps).unwrap();
        assert!((found - 3.0).abs() < 1e-5, "{found}");
        assert_eq!(blinking_to_noise(&mean, &blinking, 1, &maps), None);
    }
}
