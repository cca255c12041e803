//! Decorrelation analysis: up to which spatial frequency does one single image hold signal?
//!
//! In: one image. Out: [`Decorrelation`]. Never: needs a second image, or a threshold for noise.
//! Fails: `None` for images that are too small, hold nothing, or show no frequency at which signal ends.
//!
//! The image is correlated with itself, all amplitudes of one spectrum set to one and cut off at radius `r`:
//! `d(r) = sum_(k<r) |I(k)| / sqrt(sum |I|^2 N(r))`, `N(r)` the number of frequencies below `r`. Signal below
//! `r` raises it, noise lowers it, and the peak tells where one gives way to the other. High-pass filtered images
//! weigh fine structure more, and the peak that lies farthest out is the resolution (Descloux, Grußmayer and
//! Radenovic, Nature Methods 16, 918, 2019). As the filters depend on the radius alone, ring sums are enough.

use ndarray::{ArrayRef2, s};

use super::spectrum::{signed_frequency, transform_both, usable_part, windowed};

/// Images with shorter sides tell nothing.
const SHORTEST_SIDE: usize = 32;
/// High-pass filters, from nearly none to one that leaves the finest structure only.
const FILTERS: usize = 20;
/// Width of the strongest filter's Gaussian, pixels.
const NARROWEST_PX: f64 = 0.15;
/// A peak stands out by this much, or is none (the original's choice).
const LEAST_PROMINENCE: f64 = 5e-4;

/// Where the signal of an image ends.
#[derive(Debug, Clone, PartialEq)]
pub struct Decorrelation {
    /// Pixels per period of the finest structure.
    pub resolution_px: f64,
    /// Height of the peak without any filter, 0 to 1: how much of the image is signal.
    pub amplitude: f64,
    /// `d(r)` without any filter, from the mean to two pixels per period.
    pub curve: Vec<f64>,
}

/// Analyzes one image; single missing (NaN) pixels take the mean.
#[must_use]
pub fn decorrelation(image: &ArrayRef2<f32>) -> Option<Decorrelation> {
    let (rows, columns) = usable_part(image);
    if rows.len().min(columns.len()) < SHORTEST_SIDE {
        return None;
    }
    let rings = Rings::of(&windowed(&image.slice(s![rows, columns]))?);
    let curve = rings.curve(None);
    let (first, amplitude) = peak(&curve)?;
    let last = curve.len() - 1;
    // From a Gaussian as wide as the coarsest structure that counts to one that leaves single pixels.
    let widest = 2.0 * last as f64 / first.max(1) as f64;
    let farthest = (0..FILTERS)
        .filter_map(|number| {
            let share = number as f64 / (FILTERS - 1) as f64;
            peak(&rings.curve(Some(widest * (NARROWEST_PX / widest).powf(share))))
        })
        .map(|(place, _)| place)
        .fold(first, usize::max);
    Some(Decorrelation { resolution_px: 2.0 * last as f64 / farthest as f64, amplitude, curve })
}

/// What a spectrum holds, ring by ring, from the mean to half a cycle per pixel.
struct Rings {
    amplitudes: Vec<f64>,
    powers: Vec<f64>,
    counts: Vec<f64>,
}

impl Rings {
    fn of(image: &ndarray::Array2<f32>) -> Self {
        let (height, width) = image.dim();
        let spectrum = transform_both(image, &ndarray::Array2::zeros((height, width)));
        let side = height.min(width);
        let number = side / 2 + 1;
        let mut rings =
            Self { amplitudes: vec![0.0; number], powers: vec![0.0; number], counts: vec![0.0; number] };
        for ((y, x), value) in spectrum.indexed_iter() {
            let radius = signed_frequency(y, height).hypot(signed_frequency(x, width));
            let ring = (radius * side as f64).round() as usize;
            // The mean says nothing about structure.
            if (1..number).contains(&ring) {
                rings.amplitudes[ring] += f64::from(value.norm());
                rings.powers[ring] += f64::from(value.norm_sqr());
                rings.counts[ring] += 1.0;
            }
        }
        rings
    }

    /// `d(r)` of the image from which its blur by a Gaussian of this width was taken off.
    fn curve(&self, blur_px: Option<f64>) -> Vec<f64> {
        let number = self.amplitudes.len();
        let pass = |ring: usize| {
            let frequency = 0.5 * ring as f64 / (number - 1) as f64;
            let blur = |width: f64| (-2.0 * (std::f64::consts::PI * width * frequency).powi(2)).exp();
            1.0 - blur_px.map_or(0.0, blur)
        };
        let power: f64 = (0..number).map(|ring| self.powers[ring] * pass(ring).powi(2)).sum();
        let (mut below, mut frequencies) = (0.0, 0.0);
        (0..number)
            .map(|ring| {
                below += self.amplitudes[ring] * pass(ring);
                frequencies += self.counts[ring];
                let both = (power * frequencies).sqrt();
                if both > 0.0 { below / both } else { 0.0 }
            })
            .collect()
    }
}

/// The highest place of a curve that falls behind it, and its height; what only rises to the end has none.
fn peak(curve: &[f64]) -> Option<(usize, f64)> {
    let mut end = curve.len();
    while end > 1 {
        let place = (0..end).max_by(|&a, &b| curve[a].total_cmp(&curve[b]))?;
        if place == 0 {
            return None;
        }
        let lowest = curve[place..].iter().copied().fold(f64::INFINITY, f64::min);
        if place + 1 < end && curve[place] - lowest >= LEAST_PROMINENCE {
            return Some((place, curve[place]));
        }
        end = place;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    /// Structure of all periods longer than `period_px`, by waves of random direction and phase, and noise.
    fn limited(period_px: f64, noise: f64, seed: u64) -> Array2<f32> {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let tau = std::f64::consts::TAU;
        let waves: Vec<(f64, f64, f64)> = (0..600)
            .map(|_| {
                // Even in area, so that every frequency below the limit has its share.
                let radius = random.random::<f64>().sqrt() / period_px;
                let (sin, cos) = (random.random::<f64>() * tau).sin_cos();
                (radius * sin, radius * cos, random.random::<f64>() * tau)
            })
            .collect();
        Array2::from_shape_fn((128, 128), |(y, x)| {
            let wave = |(v, u, phase): &(f64, f64, f64)| (tau * (v * y as f64 + u * x as f64) + phase).cos();
            let structure: f64 = waves.iter().map(wave).sum();
            (structure / 17.0 + noise * (random.random::<f64>() - 0.5)) as f32
        })
    }

    #[test]
    fn the_limit_of_a_band_limited_image_is_found() {
        for period_px in [3.0, 4.0, 6.0, 10.0] {
            for noise in [0.2, 1.0] {
                let found = decorrelation(&limited(period_px, noise, 5)).unwrap();
                let error = found.resolution_px / period_px - 1.0;
                assert!(error.abs() < 0.12, "{period_px} px, noise {noise}: {}", found.resolution_px);
            }
        }
    }

    #[test]
    fn noise_takes_from_the_amplitude() {
        let amplitude = |noise| decorrelation(&limited(4.0, noise, 7)).unwrap().amplitude;
        assert!(amplitude(0.1) > amplitude(1.0) && amplitude(1.0) > amplitude(2.0));
    }

    #[test]
    fn images_that_hold_nothing_say_nothing() {
        assert_eq!(decorrelation(&Array2::zeros((64, 64))), None);
        assert_eq!(decorrelation(&Array2::from_elem((64, 64), f32::NAN)), None);
        assert_eq!(decorrelation(&limited(4.0, 0.1, 1).slice(s![..16, ..16])), None);
    }
}
