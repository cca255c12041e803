//! Poisson numbers, exact at every mean.
//!
//! In: a mean and a random stream. Out: a count.
//! Never: approximates by a Gaussian. Fails: never; a mean that is not above zero gives zero.

use rand::RngExt;
use rand_distr::Poisson;
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::random::uniform;

/// Below this mean one uniform number and a walk up the distribution is the fastest exact way.
const INVERSION_BELOW: f64 = 16.0;
/// A walk of this many steps is beyond the resolution of the uniform number at any mean below 16.
const MAX_STEPS: usize = 96;

/// `1 / (k + 1)` for the walk, so that it multiplies instead of dividing.
const RECIPROCALS: [f64; MAX_STEPS] = {
    let mut table = [0.0; MAX_STEPS];
    let mut k = 0;
    while k < MAX_STEPS {
        table[k] = 1.0 / (k + 1) as f64;
        k += 1;
    }
    table
};

/// Poisson numbers of one recurring mean (the background), with its exponential computed once.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FixedMean {
    mean: f64,
    exp_minus_mean: f64,
}

impl FixedMean {
    pub(crate) fn new(mean: f64) -> Self {
        Self { mean, exp_minus_mean: libm::exp(-mean) }
    }

    pub(crate) fn draw(&self, rng: &mut Xoshiro256PlusPlus) -> f64 {
        if self.mean < INVERSION_BELOW {
            invert(self.mean, self.exp_minus_mean, rng)
        } else {
            reject(self.mean, rng)
        }
    }
}

/// One Poisson number with this mean.
pub(crate) fn draw(mean: f64, rng: &mut Xoshiro256PlusPlus) -> f64 {
    FixedMean::new(mean).draw(rng)
}

/// Walks up the distribution until it passes a uniform number.
fn invert(mean: f64, exp_minus_mean: f64, rng: &mut Xoshiro256PlusPlus) -> f64 {
    let mut left = uniform(rng);
    let mut probability = exp_minus_mean;
    for (k, reciprocal_of_next) in RECIPROCALS.iter().enumerate() {
        if left < probability || mean <= 0.0 {
            return k as f64;
        }
        left -= probability;
        probability *= mean * reciprocal_of_next;
    }
    MAX_STEPS as f64
}

fn reject(mean: f64, rng: &mut Xoshiro256PlusPlus) -> f64 {
    // Only a mean that is not a number or beyond 1e19 is refused, and scenes exclude both.
    Poisson::new(mean).map_or(0.0, |poisson| rng.sample(poisson))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    #[test]
    fn mean_and_variance_equal_the_rate_at_every_method() {
        for mean in [0.01, 0.7, 2.5, 15.9, 16.1, 130.0, 5000.0] {
            let mut rng = Stream::Patches.generator(11);
            let n = 200_000_usize;
            let draws: Vec<f64> = (0..n).map(|_| draw(mean, &mut rng)).collect();
            let average = draws.iter().sum::<f64>() / n as f64;
            let variance = draws.iter().map(|d| (d - average).powi(2)).sum::<f64>() / n as f64;
            let error = (mean / n as f64).sqrt();
            assert!((average - mean).abs() < 4.0 * error, "mean {average} for {mean}");
            let error = ((mean + 2.0 * mean * mean) / n as f64).sqrt();
            assert!((variance - mean).abs() < 4.0 * error, "variance {variance} for {mean}");
        }
    }

    #[test]
    fn probabilities_are_those_of_the_distribution() {
        let (mean, n) = (2.5, 200_000);
        let mut rng = Stream::Patches.generator(3);
        let mut seen = [0_u32; 12];
        for _ in 0..n {
            seen[(draw(mean, &mut rng) as usize).min(11)] += 1;
        }
        let mut probability = f64::exp(-mean);
        for (k, &count) in seen.iter().take(8).enumerate() {
            let expected = probability * f64::from(n);
            assert!((f64::from(count) - expected).abs() < 4.0 * expected.sqrt(), "k = {k}");
            probability *= mean / (k + 1) as f64;
        }
    }

    #[test]
    fn no_light_gives_no_electrons() {
        let mut rng = Stream::Patches.generator(1);
        for mean in [0.0, -1.0, f64::NAN] {
            assert_eq!(draw(mean, &mut rng), 0.0);
        }
    }
}
