//! Weights by which pixels make a value between them.
//!
//! In: a place between pixels. Out: the first of the pixels around it and their weights, which sum to one.
//! Never: blurs where the place is on a pixel: then its weight is exactly one and all others are zero.

/// Pixels that make a value.
pub const TAPS: usize = 6;

/// Pixels before the one at or left of the place.
const BEFORE: i64 = TAPS as i64 / 2 - 1;

/// Places between two pixels that are told apart; half a step is 0.0005 pixels.
const PHASES: usize = 1024;

/// Shape of the Kaiser window.
const BETA: f64 = 5.0;

/// How T is brought onto the pixels of R.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Interpolation {
    /// Sinc under a Kaiser window: keeps the point-spread function; the noise that neighbors come to share is taken
    /// off the cumulants.
    #[default]
    UnbiasedSinc,
    /// Between the nearest pixels, all cumulants from frames so warped, as the paper's text says; for comparison.
    BilinearFrames,
}

impl Interpolation {
    /// Every way with the name it has in settings files.
    pub const NAMES: [(&'static str, Self); 2] =
        [("unbiased-sinc", Self::UnbiasedSinc), ("bilinear-frames", Self::BilinearFrames)];

    /// The name in settings files.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, way)| *way == self).map_or("", |(name, _)| name)
    }

    /// Whether shared noise is taken off.
    #[must_use]
    pub fn is_unbiased(self) -> bool {
        self == Self::UnbiasedSinc
    }
}

/// The weights for every phase.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Weights {
    by_phase: Vec<[f32; TAPS]>,
}

impl Weights {
    /// All weights times a factor.
    pub(super) fn new(interpolation: Interpolation, factor: f64) -> Self {
        let weights = |phase: usize| {
            let fraction = phase as f64 / PHASES as f64;
            match interpolation {
                Interpolation::UnbiasedSinc => windowed_sinc(fraction),
                Interpolation::BilinearFrames => {
                    std::array::from_fn(|tap| (1.0 - (tap as f64 - BEFORE as f64 - fraction).abs()).max(0.0))
                }
            }
        };
        Self {
            by_phase: (0..PHASES)
                .map(|phase| weights(phase).map(|weight| (factor * weight) as f32))
                .collect(),
        }
    }

    /// The first pixel and the weights for a place.
    #[inline(always)]
    pub(super) fn at(&self, place: f64) -> (i64, &[f32; TAPS]) {
        let phases = (place * PHASES as f64 + 0.5).floor() as i64;
        (phases.div_euclid(PHASES as i64) - BEFORE, &self.by_phase[phases.rem_euclid(PHASES as i64) as usize])
    }
}

/// Weights of the pixels around for a value at `fraction`, summing to one.
fn windowed_sinc(fraction: f64) -> [f64; TAPS] {
    if fraction == 0.0 {
        return std::array::from_fn(|tap| if tap as i64 == BEFORE { 1.0 } else { 0.0 });
    }
    let half = TAPS as f64 / 2.0;
    let raw: [f64; TAPS] = std::array::from_fn(|tap| {
        let distance = tap as f64 - BEFORE as f64 - fraction;
        let angle = std::f64::consts::PI * distance;
        let inside = (1.0 - (distance / half).powi(2)).max(0.0);
        libm::sin(angle) / angle * bessel_i0(BETA * inside.sqrt())
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|weight| weight / sum)
}

/// The modified Bessel function of order zero, by its series.
fn bessel_i0(x: f64) -> f64 {
    let quarter = x * x / 4.0;
    let (mut sum, mut term) = (1.0, 1.0);
    for k in 1..30 {
        term *= quarter / f64::from(k * k);
        sum += term;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_are_exact_on_a_pixel() {
        for (_, way) in Interpolation::NAMES {
            let weights = Weights::new(way, 1.0);
            let (first, on_a_pixel) = weights.at(7.0);
            assert_eq!((first, on_a_pixel[BEFORE as usize]), (7 - BEFORE, 1.0));
            assert_eq!(on_a_pixel.iter().filter(|weight| **weight == 0.0).count(), TAPS - 1);
            assert_eq!(weights.at(-3.0 + 1e-9).0, -3 - BEFORE);
            for step in 0..100 {
                let sum: f32 = weights.at(f64::from(step) * 0.01).1.iter().sum();
                assert!((sum - 1.0).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn a_wave_of_the_optical_passband_keeps_its_height() {
        // Half of the sampling limit is beyond what a point-spread function of 1.2 pixels passes at 2 %.
        let weights = Weights::new(Interpolation::UnbiasedSinc, 1.0);
        for step in 0..1000 {
            let place = 10.0 + f64::from(step) * 0.001;
            let (first, taps) = weights.at(place);
            let wave = |x: f64| (std::f64::consts::PI * 0.5 * x).cos();
            let value: f64 =
                taps.iter().enumerate().map(|(k, w)| f64::from(*w) * wave((first + k as i64) as f64)).sum();
            assert!((value - wave(place)).abs() < 0.015, "{place}: {value} against {}", wave(place));
        }
    }
}
