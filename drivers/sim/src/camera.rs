//! A camera: photons in, counts out.
//!
//! In: expected photons per pixel and a random stream. Out: counts, 16 bit.
//! Never: keeps anything between frames. Fails: never; counts end at 0 and at saturation.
//! Paper, Materials and methods: Simulations: Poisson noise, quantum efficiency, gain, Gaussian noise.

use rand::RngExt;
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::poisson::{self, FixedMean};
use crate::scene::CameraModel;
use crate::sensor::Sensor;

/// Turns the photons of one camera into counts.
#[derive(Debug, Clone)]
pub(crate) struct Digitizer {
    model: CameraModel,
    /// Its pixels, where they differ.
    sensor: Option<Sensor>,
    /// Most pixels see nothing but background; their law is prepared once.
    background_photons: f32,
    background: FixedMean,
}

impl Digitizer {
    pub(crate) fn new(model: CameraModel, sensor: Option<Sensor>, background_photons: f32) -> Self {
        let background = FixedMean::new(mean_electrons(&model, background_photons));
        Self { model, sensor, background_photons, background }
    }

    /// The pixels, where they differ.
    pub(crate) fn sensor(&self) -> Option<&Sensor> {
        self.sensor.as_ref()
    }

    /// Draws one frame.
    ///
    /// Hot pixels have their dark electrons from a stream of their own, so that all other pixels give the counts that
    /// they would give without them.
    pub(crate) fn draw(&self, photons: &[f32], random: Generators<'_>, counts: &mut [u16]) {
        let (model, Generators { noise, dark }) = (&self.model, random);
        let alike = Pixel {
            offset: model.offset_counts,
            gain: model.gain_counts_per_electron,
            read_noise: model.read_noise_electrons,
        };
        let Some(sensor) = &self.sensor else {
            for (count, &photons) in counts.iter_mut().zip(photons) {
                *count = self.count(self.electrons(photons, noise), &alike, noise);
            }
            return;
        };
        for (pixel, (count, &photons)) in counts.iter_mut().zip(photons).enumerate() {
            let mut electrons = self.electrons(photons, noise);
            if sensor.is_hot[pixel] {
                let more = sensor.dark_electrons[pixel] - model.dark_electrons_per_exposure;
                electrons += poisson::draw(more, dark);
            }
            if sensor.is_dead[pixel] {
                electrons = 0.0;
            }
            let own = Pixel {
                offset: sensor.offset_counts[pixel],
                gain: sensor.gain_counts_per_electron[pixel],
                read_noise: sensor.read_noise_electrons[pixel],
            };
            *count = self.count(electrons, &own, noise);
        }
    }

    #[inline(always)]
    fn electrons(&self, photons: f32, rng: &mut Xoshiro256PlusPlus) -> f64 {
        if photons.to_bits() == self.background_photons.to_bits() {
            self.background.draw(rng)
        } else {
            poisson::draw(mean_electrons(&self.model, photons), rng)
        }
    }

    #[inline(always)]
    fn count(&self, electrons: f64, pixel: &Pixel, rng: &mut Xoshiro256PlusPlus) -> u16 {
        let noise: f64 = rng.sample(StandardNormal);
        let signal = electrons + pixel.read_noise * noise;
        let value = pixel.offset + pixel.gain * signal;
        (value.clamp(0.0, f64::from(self.model.saturation_counts)) + 0.5) as u16
    }
}

/// Random numbers of one exposure.
pub(crate) struct Generators<'a> {
    /// Of photons and read noise.
    pub(crate) noise: &'a mut Xoshiro256PlusPlus,
    /// Of the dark electrons of hot pixels.
    pub(crate) dark: &'a mut Xoshiro256PlusPlus,
}

/// What one pixel makes of electrons.
struct Pixel {
    offset: f64,
    gain: f64,
    read_noise: f64,
}

fn mean_electrons(model: &CameraModel, photons: f32) -> f64 {
    model.quantum_efficiency * f64::from(photons) + model.dark_electrons_per_exposure
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;
    use crate::scene::PixelSpread;

    fn frame(model: CameraModel, photons: f32, n: usize) -> Vec<u16> {
        let mut counts = vec![0; n];
        digitize(model, None, photons, &mut counts);
        counts
    }

    fn digitize(model: CameraModel, sensor: Option<Sensor>, photons: f32, counts: &mut [u16]) {
        let (mut noise, mut dark) = (Stream::Patches.generator(21), Stream::Patches.generator(22));
        let random = Generators { noise: &mut noise, dark: &mut dark };
        Digitizer::new(model, sensor, 2.5).draw(&vec![photons; counts.len()], random, counts);
    }

    #[test]
    fn hot_and_dead_pixels_leave_the_others_as_they_are() {
        let pixels = PixelSpread { hot_share: 0.01, dead_share: 0.01, ..PixelSpread::default() };
        let model = CameraModel { pixels, ..CameraModel::default() };
        let sensor = Sensor::new(&model, 0, 2000).unwrap();
        let (mut alike, mut broken) = (vec![0; 2000], vec![0; 2000]);
        digitize(model, None, 300.0, &mut alike);
        digitize(model, Some(sensor.clone()), 300.0, &mut broken);
        for (pixel, (alike, broken)) in alike.iter().zip(&broken).enumerate() {
            match (sensor.is_hot[pixel], sensor.is_dead[pixel]) {
                (true, _) => assert!(broken > &(alike + 200)),
                (_, true) => assert!((80..120).contains(broken)),
                _ => assert_eq!(alike, broken),
            }
        }
    }

    fn mean_and_variance(counts: &[u16]) -> (f64, f64) {
        let n = counts.len() as f64;
        let mean = counts.iter().map(|&c| f64::from(c)).sum::<f64>() / n;
        (mean, counts.iter().map(|&c| (f64::from(c) - mean).powi(2)).sum::<f64>() / n)
    }

    #[test]
    fn variance_against_mean_gives_gain_and_read_noise() {
        let model = CameraModel {
            quantum_efficiency: 0.7,
            gain_counts_per_electron: 2.2,
            offset_counts: 100.0,
            read_noise_electrons: 1.4,
            dark_electrons_per_exposure: 0.3,
            ..CameraModel::default()
        };
        let n = 100_000;
        for photons in [2.5_f32, 7.0, 90.0, 1500.0] {
            let (mean, variance) = mean_and_variance(&frame(model, photons, n));
            let electrons = 0.7 * f64::from(photons) + 0.3;
            // Rounding to whole counts adds 1/12.
            let expected = 2.2 * 2.2 * (electrons + 1.4 * 1.4) + 1.0 / 12.0;
            let error = (expected / n as f64).sqrt();
            assert!((mean - 100.0 - 2.2 * electrons).abs() < 4.0 * error, "{photons}: {mean}");
            let error = expected * (2.0 / n as f64).sqrt() * (1.0 + 1.0 / electrons);
            assert!((variance - expected).abs() < 4.0 * error, "{photons}: {variance}");
        }
    }

    #[test]
    fn counts_end_at_zero_and_at_saturation() {
        let model = CameraModel { saturation_counts: 4095, ..CameraModel::default() };
        assert!(frame(model, 1e5, 50).iter().all(|&count| count == 4095));
        let full = CameraModel::default();
        assert!(frame(full, 1e6, 50).iter().all(|&count| count == u16::MAX));
        let noisy = CameraModel { offset_counts: 0.0, read_noise_electrons: 5.0, ..CameraModel::default() };
        let counts = frame(noisy, 0.0, 1000);
        assert!(counts.iter().filter(|&&count| count == 0).count() > 400);
    }
}
