//! The pixels of one camera, each with its own offset, gain and noise.
//!
//! In: a camera model, the side of the camera, its size. Out: [`Sensor`], which is also the truth of it.
//! Never: depends on the sample or its seed. Fails: never.

use rand::RngExt;
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::random::{Stream, between, uniform};
use crate::scene::CameraModel;

/// Variance that rounding to whole counts adds, counts squared.
const ROUNDING: f64 = 1.0 / 12.0;

/// All pixels of one camera, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Counts without any electron.
    pub offset_counts: Vec<f64>,
    /// Counts per electron.
    pub gain_counts_per_electron: Vec<f64>,
    /// Standard deviation of the read noise, electrons.
    pub read_noise_electrons: Vec<f64>,
    /// Mean dark electrons per exposure.
    pub dark_electrons: Vec<f64>,
    /// Pixels of far more dark electrons than the others.
    pub is_hot: Vec<bool>,
    /// Pixels that see no light.
    pub is_dead: Vec<bool>,
}

impl Sensor {
    /// The pixels of a camera; none where all are alike.
    pub(crate) fn new(model: &CameraModel, channel: usize, pixels: usize) -> Option<Self> {
        let spread = &model.pixels;
        if spread.is_even() {
            return None;
        }
        let mut rng = Stream::Pixels { channel: channel as u64 }.generator(spread.seed);
        let mut normal = || rng.sample::<f64, _>(StandardNormal);
        let mut sensor = Self {
            offset_counts: Vec::with_capacity(pixels),
            gain_counts_per_electron: Vec::with_capacity(pixels),
            read_noise_electrons: Vec::with_capacity(pixels),
            dark_electrons: vec![model.dark_electrons_per_exposure; pixels],
            is_hot: vec![false; pixels],
            is_dead: vec![false; pixels],
        };
        for _ in 0..pixels {
            let offset = model.offset_counts + spread.offset_spread_counts * normal();
            // A gain that is not positive would be no camera.
            let gain = model.gain_counts_per_electron * (1.0 + spread.gain_spread * normal()).max(0.1);
            let noise = model.read_noise_electrons * libm::exp(spread.read_noise_spread * normal());
            sensor.offset_counts.push(offset);
            sensor.gain_counts_per_electron.push(gain);
            sensor.read_noise_electrons.push(noise);
        }
        for pixel in chosen(spread.hot_share, &sensor.is_hot, &mut rng) {
            sensor.is_hot[pixel] = true;
            let [least, most] = spread.hot_electrons;
            sensor.dark_electrons[pixel] += between(&mut rng, least, most);
        }
        for pixel in chosen(spread.dead_share, &sensor.is_hot, &mut rng) {
            sensor.is_dead[pixel] = true;
        }
        Some(sensor)
    }

    /// Mean of a pixel in the dark, counts, as long as it is not saturated.
    #[must_use]
    pub fn dark_mean_counts(&self, pixel: usize) -> f64 {
        self.offset_counts[pixel] + self.gain_counts_per_electron[pixel] * self.dark(pixel)
    }

    /// Variance of a pixel in the dark, counts squared, with that of rounding to whole counts.
    #[must_use]
    pub fn dark_variance_counts2(&self, pixel: usize) -> f64 {
        let (gain, read) = (self.gain_counts_per_electron[pixel], self.read_noise_electrons[pixel]);
        gain * gain * (read * read + self.dark(pixel)) + ROUNDING
    }

    fn dark(&self, pixel: usize) -> f64 {
        if self.is_dead[pixel] { 0.0 } else { self.dark_electrons[pixel] }
    }
}

/// This share of the pixels, at random, none twice and none that is taken.
fn chosen(share: f64, taken: &[bool], rng: &mut Xoshiro256PlusPlus) -> Vec<usize> {
    let wanted = (share * taken.len() as f64).round() as usize;
    let mut taken = taken.to_vec();
    let mut pixels = Vec::with_capacity(wanted);
    while pixels.len() < wanted {
        let pixel = ((uniform(rng) * taken.len() as f64) as usize).min(taken.len() - 1);
        if !std::mem::replace(&mut taken[pixel], true) {
            pixels.push(pixel);
        }
    }
    pixels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::PixelSpread;

    #[test]
    fn pixels_differ_as_the_scene_says_and_stay_the_same() {
        let spread = PixelSpread {
            offset_spread_counts: 2.0,
            gain_spread: 0.01,
            hot_share: 0.001,
            dead_share: 0.0005,
            ..PixelSpread::default()
        };
        let model = CameraModel { pixels: spread, ..CameraModel::default() };
        let pixels = 40_000;
        let sensor = Sensor::new(&model, 0, pixels).unwrap();
        assert_eq!(Some(&sensor), Sensor::new(&model, 0, pixels).as_ref());
        assert_ne!(Some(&sensor), Sensor::new(&model, 1, pixels).as_ref());
        let number = |flags: &[bool]| flags.iter().filter(|flag| **flag).count();
        assert_eq!((number(&sensor.is_hot), number(&sensor.is_dead)), (40, 20));
        assert!(sensor.is_hot.iter().zip(&sensor.is_dead).all(|(hot, dead)| !(hot & dead)));
        for (values, mean, spread) in [
            (&sensor.offset_counts, model.offset_counts, 2.0),
            (&sensor.gain_counts_per_electron, model.gain_counts_per_electron, 0.01 / 0.46),
        ] {
            let n = pixels as f64;
            let found = values.iter().sum::<f64>() / n;
            let variance = values.iter().map(|&value| (value - found).powi(2)).sum::<f64>() / n;
            assert!((found - mean).abs() < 4.0 * spread / n.sqrt(), "{found}");
            assert!((variance.sqrt() / spread - 1.0).abs() < 4.0 / (2.0 * n).sqrt(), "{variance}");
        }
        assert_eq!(Sensor::new(&CameraModel::default(), 0, pixels), None);
    }
}
