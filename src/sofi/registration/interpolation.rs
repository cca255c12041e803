//! Weights by which pixels make a value between them.
//!
//! In: a place between pixels. Out: the first of the pixels around it and their weights, which sum to one.
//! Never: blurs where the place is on a pixel: then its weight is exactly one and all others are zero.

/// Pixels that make a value.
pub const TAPS: usize = 8;

/// Pixels before the one at or left of the place.
const BEFORE: i64 = TAPS as i64 / 2 - 1;

/// The weights of a value between as many zeros on both sides, for products of weights that are apart.
pub const PADDED_TAPS: usize = 3 * TAPS;

/// Places between two pixels that are told apart; half a step is 0.0005 pixels.
pub(super) const PHASES: usize = 1024;

/// Standard deviation of the spots that the weights fit best, pixels; narrower than most that cameras see, as wide
/// spots are the easier ones.
const SPOT: f64 = 1.1;

/// Steps of the integrals over the frequencies.
const STEPS: usize = 256;

/// How T is brought onto the pixels of R.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Interpolation {
    /// The best approximation of a sinc by [`TAPS`] pixels for spots as wide as a point-spread function, which it
    /// keeps; the noise that neighbors come to share is taken off the cumulants.
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
    by_phase: Vec<[f32; PADDED_TAPS]>,
}

impl Weights {
    /// All weights times a factor.
    pub(super) fn new(interpolation: Interpolation, factor: f64) -> Self {
        let spots = SpotWeights::new();
        let weights = |phase: usize| {
            let fraction = phase as f64 / PHASES as f64;
            match interpolation {
                Interpolation::UnbiasedSinc => spots.at(fraction),
                Interpolation::BilinearFrames => {
                    std::array::from_fn(|tap| (1.0 - (tap as f64 - BEFORE as f64 - fraction).abs()).max(0.0))
                }
            }
        };
        let padded = |phase: usize| {
            let mut padded = [0.0; PADDED_TAPS];
            for (padded, weight) in padded[TAPS..].iter_mut().zip(weights(phase)) {
                *padded = (factor * weight) as f32;
            }
            padded
        };
        Self { by_phase: (0..PHASES).map(padded).collect() }
    }

    /// The first pixel and the phase of a place.
    #[inline(always)]
    pub(super) fn place(place: f64) -> (i64, usize) {
        // Rounding down without the call that it is where registers are narrow.
        let phases = place * PHASES as f64 + 0.5;
        let toward_zero = phases as i64;
        let phases = toward_zero - i64::from(phases < toward_zero as f64);
        (phases.div_euclid(PHASES as i64) - BEFORE, phases.rem_euclid(PHASES as i64) as usize)
    }

    /// The weights of a phase, between zeros.
    #[inline(always)]
    pub(super) fn padded(&self, phase: usize) -> &[f32; PADDED_TAPS] {
        &self.by_phase[phase]
    }

    /// The weights of a phase.
    #[inline(always)]
    pub(super) fn of_phase(&self, phase: usize) -> &[f32; TAPS] {
        self.by_phase[phase][TAPS..].first_chunk().unwrap_or(&[0.0; TAPS])
    }
}

/// Weights `w` that sum to one and make `integral of |sum_k w_k exp(i k f) - exp(i d f)|^2 exp(-(s f)^2) df` over the
/// frequencies of the pixel grid least, for places `d` and spots of standard deviation `s`.
struct SpotWeights {
    /// Frequencies and the power of a spot there, without its scale.
    spectrum: Vec<(f64, f64)>,
    /// The normal equations, factored: `L` of `L L^T`.
    factor: [[f64; TAPS]; TAPS],
}

impl SpotWeights {
    fn new() -> Self {
        let frequency = |step: usize| std::f64::consts::PI * (step as f64 + 0.5) / STEPS as f64;
        let power = |f: f64| (f, libm::exp(-(SPOT * f).powi(2)));
        let spectrum = (0..STEPS).map(|step| power(frequency(step))).collect();
        let mut spots = Self { spectrum, factor: [[0.0; TAPS]; TAPS] };
        for row in 0..TAPS {
            for column in 0..=row {
                let rest = spots.correlation((row - column) as f64);
                let factor = &mut spots.factor;
                let rest = rest - (0..column).map(|k| factor[row][k] * factor[column][k]).sum::<f64>();
                factor[row][column] = if row == column { rest.sqrt() } else { rest / factor[column][column] };
            }
        }
        spots
    }

    /// `integral of cos(distance f) exp(-(SPOT f)^2) df` over half the frequencies of the pixel grid, without its scale.
    fn correlation(&self, distance: f64) -> f64 {
        self.spectrum.iter().map(|(f, power)| libm::cos(distance * f) * power).sum()
    }

    fn solve(&self, mut values: [f64; TAPS]) -> [f64; TAPS] {
        for row in 0..TAPS {
            let before: f64 = (0..row).map(|k| self.factor[row][k] * values[k]).sum();
            values[row] = (values[row] - before) / self.factor[row][row];
        }
        for row in (0..TAPS).rev() {
            let after: f64 = (row + 1..TAPS).map(|k| self.factor[k][row] * values[k]).sum();
            values[row] = (values[row] - after) / self.factor[row][row];
        }
        values
    }

    /// Weights of the pixels around for a value at `fraction`.
    fn at(&self, fraction: f64) -> [f64; TAPS] {
        if fraction == 0.0 {
            return std::array::from_fn(|tap| if tap as i64 == BEFORE { 1.0 } else { 0.0 });
        }
        let wanted = std::array::from_fn(|tap| self.correlation(tap as f64 - BEFORE as f64 - fraction));
        let (free, constant) = (self.solve(wanted), self.solve([1.0; TAPS]));
        let missing = (1.0 - free.iter().sum::<f64>()) / constant.iter().sum::<f64>();
        std::array::from_fn(|tap| free[tap] + missing * constant[tap])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first pixel and the weights for a place.
    fn at(weights: &Weights, place: f64) -> (i64, &[f32; TAPS]) {
        let (first, phase) = Weights::place(place);
        (first, weights.of_phase(phase))
    }

    #[test]
    fn weights_sum_to_one_and_are_exact_on_a_pixel() {
        for (_, way) in Interpolation::NAMES {
            let weights = Weights::new(way, 1.0);
            let (first, on_a_pixel) = at(&weights, 7.0);
            assert_eq!((first, on_a_pixel[BEFORE as usize]), (7 - BEFORE, 1.0));
            assert_eq!(on_a_pixel.iter().filter(|weight| **weight == 0.0).count(), TAPS - 1);
            assert_eq!(at(&weights, -3.0 + 1e-9).0, -3 - BEFORE);
            for step in 0..100 {
                let sum: f32 = at(&weights, f64::from(step) * 0.01).1.iter().sum();
                assert!((sum - 1.0).abs() < 1e-6);
            }
        }
    }

    /// What the weights for a place do to a spot: change of its energy, and the error over its root mean square.
    fn change_of_spot(weights: &Weights, place: f64, deviation: f64) -> [f64; 2] {
        let (first, taps) = at(weights, place);
        let [mut energy, mut kept, mut error] = [0.0; 3];
        for step in 0..2000 {
            let f = std::f64::consts::PI * (f64::from(step) + 0.5) / 2000.0;
            let power = (-(deviation * f).powi(2)).exp();
            let [mut re, mut im] = [0.0; 2];
            for (pixel, weight) in (first..).zip(taps) {
                let (sin, cos) = (f * (pixel as f64 - place)).sin_cos();
                re += f64::from(*weight) * cos;
                im += f64::from(*weight) * sin;
            }
            energy += power;
            kept += power * (re * re + im * im);
            error += power * ((re - 1.0).powi(2) + im * im);
        }
        [kept / energy - 1.0, (error / energy).sqrt()]
    }

    #[test]
    fn spots_keep_their_energy_and_their_shape_wherever_they_fall() {
        let weights = Weights::new(Interpolation::UnbiasedSinc, 1.0);
        for (deviation, error) in [(0.85, 0.03), (0.95, 0.015), (1.1, 0.006), (1.3, 0.003), (1.8, 0.003)] {
            for step in 0..64 {
                let place = 10.0 + f64::from(step) / 64.0;
                let [energy, shape] = change_of_spot(&weights, place, deviation);
                assert!(energy.abs() < 0.002, "{deviation} at {place}: energy {energy}");
                assert!(shape < error, "{deviation} at {place}: shape {shape}");
            }
        }
        let [energy, _] = change_of_spot(&Weights::new(Interpolation::BilinearFrames, 1.0), 10.5, 1.1);
        // The mean of sin(f / 2)^2 over the power of the spot, (1 - exp(-1 / (4 s^2))) / 2 = 0.093.
        assert!((energy + 0.093).abs() < 0.002, "between two pixels bilinear values are blurred: {energy}");
    }
}
