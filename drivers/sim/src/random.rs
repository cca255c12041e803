//! Independent random streams, each named by what it is for.
//!
//! In: the seed of the world and the name of a stream. Out: a generator that depends on nothing else.
//! Never: hands one generator to two purposes, so any order and any number of threads gives the same numbers.

use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// What a stream of random numbers is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stream {
    /// Positions of the emitters on one shape of one species.
    Placement { species: u64, shape: u64 },
    /// Species and emitter positions of the patch grid.
    Patches,
    /// Blinking and bleaching of one emitter.
    Trajectory { species: u64, emitter: u64 },
    /// Photon and read noise of one exposure of one camera.
    Noise { channel: u64, exposure: u64 },
    /// What befalls one exposure of one camera on its way to the reader.
    Mishap { channel: u64, exposure: u64 },
    /// The order in which a camera delivers one window of frames.
    Order { channel: u64, window: u64 },
    /// The error of the camera's clock at one exposure.
    Jitter { channel: u64, exposure: u64 },
    /// Dark electrons of the hot pixels in one exposure of one camera.
    Dark { channel: u64, exposure: u64 },
    /// How the pixels of one camera differ; its seed is the camera's, not the sample's.
    Pixels { channel: u64 },
    /// The counts of one frame of a film of noise.
    Film { channel: u64, frame: u64 },
}

impl Stream {
    fn words(self) -> [u64; 3] {
        match self {
            Self::Placement { species, shape } => [1, species, shape],
            Self::Patches => [2, 0, 0],
            Self::Trajectory { species, emitter } => [3, species, emitter],
            Self::Noise { channel, exposure } => [4, channel, exposure],
            Self::Mishap { channel, exposure } => [5, channel, exposure],
            Self::Order { channel, window } => [6, channel, window],
            Self::Film { channel, frame } => [7, channel, frame],
            Self::Jitter { channel, exposure } => [8, channel, exposure],
            Self::Pixels { channel } => [9, channel, 0],
            Self::Dark { channel, exposure } => [10, channel, exposure],
        }
    }

    /// The generator of this stream in the world with this seed.
    pub(crate) fn generator(self, seed: u64) -> Xoshiro256PlusPlus {
        let key = self
            .words()
            .iter()
            .fold(mix(seed), |hash, &word| mix(hash ^ word.wrapping_mul(0x9e37_79b9_7f4a_7c15)));
        Xoshiro256PlusPlus::seed_from_u64(key)
    }
}

/// One step of splitmix64 (Steele, Lea, Flood 2014): every input bit moves every output bit.
fn mix(word: u64) -> u64 {
    let word = word.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^ (word >> 31)
}

/// A number uniform in [0, 1).
pub(crate) fn uniform(rng: &mut Xoshiro256PlusPlus) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
}

/// A number uniform in [from, to).
pub(crate) fn between(rng: &mut Xoshiro256PlusPlus, from: f64, to: f64) -> f64 {
    from + (to - from) * uniform(rng)
}

/// An exponentially distributed number with this mean.
pub(crate) fn exponential(rng: &mut Xoshiro256PlusPlus, mean: f64) -> f64 {
    // 1 - u lies in (0, 1], so the logarithm is finite.
    -mean * libm::log(1.0 - uniform(rng))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_by_every_part_of_their_name() {
        let names = [
            (1, Stream::Patches),
            (2, Stream::Patches),
            (1, Stream::Noise { channel: 0, exposure: 1 }),
            (1, Stream::Noise { channel: 1, exposure: 0 }),
            (1, Stream::Trajectory { species: 0, emitter: 1 }),
            (1, Stream::Trajectory { species: 1, emitter: 0 }),
            (1, Stream::Placement { species: 0, shape: 1 }),
        ];
        let mut first: Vec<u64> = names.iter().map(|(seed, name)| name.generator(*seed).next_u64()).collect();
        first.sort_unstable();
        first.dedup();
        assert_eq!(first.len(), names.len());
    }

    #[test]
    fn exponential_has_its_mean_and_variance() {
        let mut rng = Stream::Patches.generator(5);
        let n = 100_000;
        let draws: Vec<f64> = (0..n).map(|_| exponential(&mut rng, 3.0)).collect();
        let mean = draws.iter().sum::<f64>() / n as f64;
        let variance = draws.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n as f64;
        assert!((mean - 3.0).abs() < 4.0 * 3.0 / (n as f64).sqrt());
        // The fourth central moment of an exponential is 9 times the variance squared.
        assert!((variance - 9.0).abs() < 4.0 * 9.0 * (8.0 / n as f64).sqrt());
    }
}
