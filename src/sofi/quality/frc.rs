//! Fourier ring correlation: up to which spatial frequency do two independent images agree?
//!
//! In: two images of one sample with independent noise, as from odd and even subsequences.
//! Out: [`FourierRingCorrelation`]. Never: takes the edge of the image for structure.
//! Fails: `None` for images that differ in shape, are too small or hold nothing.
//!
//! `FRC(q) = Re sum F_1 F_2* / sqrt(sum |F_1|^2 sum |F_2|^2)`, sums over the ring of frequency `q`
//! (Saxton and Baumeister 1982; van Heel 1987); the resolution is `1 / q` where the smoothed curve first
//! falls below 1/7 (Rosenthal and Henderson 2003; Nieuwenhuizen et al., Nature Methods 10, 557, 2013).
//! Noise that repeats from half to half, as that of a pixel with a gain of its own, counts as structure.

use ndarray::{Array2, ArrayRef2, s};
use rustfft::num_complex::Complex32;

use super::spectrum::{
    hann, quick_part, signed_frequency, transform_both, usable_part, valid_rectangle, windowed,
};

/// Correlation at which the resolution is read.
pub const THRESHOLD: f64 = 1.0 / 7.0;

/// Images with shorter sides tell nothing.
const SHORTEST_SIDE: usize = 16;

/// Rings to either side that are averaged into the smoothed curve, as a share of all.
const SMOOTHING: f64 = 0.02;

/// Rings must agree by this many standard deviations of chance.
const CLEARLY: f64 = 3.0;

/// Longest side, pixels, of the part on which sub-grids are balanced.
const BALANCED_SIDE: usize = 256;

/// From this frequency on, cycles per pixel, all sub-grids together should hold next to nothing.
const EMPTY_FROM: f64 = 0.4;

/// Agreement of two images, ring by ring.
#[derive(Debug, Clone, PartialEq)]
pub struct FourierRingCorrelation {
    /// Correlation of ring `r`, whose frequency is `r * frequency_step`; ring 0 is the mean and holds 1.
    pub curve: Vec<f64>,
    /// The same, averaged over neighboring rings by their number of frequencies.
    pub smoothed: Vec<f64>,
    /// Frequency from ring to ring, per pixel of the images.
    pub frequency_step: f64,
    /// Pixels of the images per period of the finest detail both agree on; `None` when nothing agrees,
    /// or everything does, see [`reaches_limit`](Self::reaches_limit).
    pub resolution_px: Option<f64>,
}

impl FourierRingCorrelation {
    /// Whether even details of two pixels agree, so that the pixels are the limit.
    #[must_use]
    pub fn reaches_limit(&self) -> bool {
        self.smoothed.iter().all(|&value| value >= THRESHOLD)
    }

    /// Smoothed correlation at a frequency, cycles per pixel; `None` beyond the curve.
    #[must_use]
    pub fn at(&self, frequency: f64) -> Option<f64> {
        let place = frequency / self.frequency_step;
        let ring = place.floor() as usize;
        let (low, high) = (self.smoothed.get(ring)?, self.smoothed.get(ring + 1)?);
        Some(low + (high - low) * place.fract())
    }
}

/// Correlates two images of equal shape ring by ring.
///
/// Lines at the border that miss more than a tenth of their pixels are cut off, and some more so that the
/// transform is quick; single missing (NaN) pixels take the mean.
#[must_use]
pub fn fourier_ring_correlation(
    first: &ArrayRef2<f32>,
    second: &ArrayRef2<f32>,
) -> Option<FourierRingCorrelation> {
    if first.dim() != second.dim() {
        return None;
    }
    let (rows, columns) = usable_part(first);
    if rows.len().min(columns.len()) < SHORTEST_SIDE {
        return None;
    }
    let part = |image: &ArrayRef2<f32>| windowed(&image.slice(s![rows.clone(), columns.clone()]));
    let (first, second) = (part(first)?, part(second)?);
    Some(correlate_rings(&first, &second))
}

/// Factors that give the `order * order` interleaved sub-grids of an image equal weight, `(order, order)`, 1 at (0, 0).
///
/// What is left of unequal weights repeats the coarse structure around the corners of the spectrum, in both halves
/// alike, and would pass for fine structure: a mismatch of one percent is enough where the signal is strong.
/// The factors make the power that both halves share beyond `EMPTY_FROM` least (least squares, free of the noise
/// of either half). `None` where that does not say what they are.
#[must_use]
pub fn balance_sub_grids(
    first: &ArrayRef2<f32>,
    second: &ArrayRef2<f32>,
    order: usize,
) -> Option<Array2<f64>> {
    let (rows, columns) = valid_rectangle(first);
    let part = |range: std::ops::Range<usize>| {
        let length = range.len().min(BALANCED_SIDE);
        let start = range.start + (range.len() - length) / 2;
        quick_part(start..start + length)
    };
    let (rows, columns) = (part(rows), part(columns));
    if rows.len().min(columns.len()) < SHORTEST_SIDE || first.dim() != second.dim() {
        return None;
    }
    let (vertical, horizontal) = (hann(rows.len()), hann(columns.len()));
    let spectra: Vec<Array2<Complex32>> = (0..order * order)
        .map(|grid| {
            let masked = |image: &ArrayRef2<f32>| {
                Array2::from_shape_fn((rows.len(), columns.len()), |(y, x)| {
                    let at = [rows.start + y, columns.start + x];
                    let is_here = (at[0] % order) * order + at[1] % order == grid && image[at].is_finite();
                    if is_here { image[at] * (vertical[y] * horizontal[x]) as f32 } else { 0.0 }
                })
            };
            transform_both(&masked(first), &masked(second))
        })
        .collect();
    let shared = shared_power(&spectra);
    let others = order * order - 1;
    let matrix = nalgebra::DMatrix::from_fn(others, others, |a, b| shared[(a + 1, b + 1)]);
    let right = nalgebra::DVector::from_fn(others, |a, _| -shared[(a + 1, 0)]);
    let factors = matrix.lu().solve(&right)?;
    let all = std::iter::once(1.0).chain(factors.iter().copied());
    let all: Vec<f64> = all.filter(|factor| (0.5..2.0).contains(factor)).collect();
    Array2::from_shape_vec((order, order), all).ok()
}

/// Power beyond [`EMPTY_FROM`] that sub-grid `a` of one half shares with `b` of the other.
fn shared_power(spectra: &[Array2<Complex32>]) -> nalgebra::DMatrix<f64> {
    let (height, width) = spectra[0].dim();
    let mut shared = nalgebra::DMatrix::zeros(spectra.len(), spectra.len());
    for y in 0..height {
        for x in 0..=width / 2 {
            if signed_frequency(y, height).hypot(signed_frequency(x, width)) < EMPTY_FROM {
                continue;
            }
            let halves: Vec<_> = spectra.iter().map(|spectrum| both_halves(spectrum, y, x)).collect();
            for (a, (first, other)) in halves.iter().enumerate() {
                for (b, (first_of_b, second)) in halves.iter().enumerate() {
                    let power = (first * second.conj()).re + (first_of_b * other.conj()).re;
                    shared[(a, b)] += f64::from(power);
                }
            }
        }
    }
    shared
}

/// Both images' frequencies from one transform that held them as real and as imaginary part.
fn both_halves(spectrum: &Array2<Complex32>, y: usize, x: usize) -> (Complex32, Complex32) {
    let (height, width) = spectrum.dim();
    let (here, mirrored) = (spectrum[[y, x]], spectrum[[(height - y) % height, (width - x) % width]].conj());
    ((here + mirrored) * 0.5, (here - mirrored) * Complex32::new(0.0, -0.5))
}

fn correlate_rings(first: &Array2<f32>, second: &Array2<f32>) -> FourierRingCorrelation {
    let (height, width) = first.dim();
    let spectrum = transform_both(first, second);
    let side = height.min(width);
    let rings = side / 2 + 1;
    let (mut cross, mut powers) = (vec![0.0; rings], vec![[0.0; 2]; rings]);
    let mut counts = vec![0.0; rings];
    for y in 0..height {
        let vertical = signed_frequency(y, height);
        // The other half plane holds the complex conjugates of this one.
        for x in 0..=width / 2 {
            let ring = (vertical.hypot(signed_frequency(x, width)) * side as f64).round() as usize;
            if ring >= rings {
                continue;
            }
            let (a, b) = both_halves(&spectrum, y, x);
            cross[ring] += f64::from((a * b.conj()).re);
            powers[ring][0] += f64::from(a.norm_sqr());
            powers[ring][1] += f64::from(b.norm_sqr());
            counts[ring] += 1.0;
        }
    }
    let mut curve: Vec<f64> = cross
        .iter()
        .zip(&powers)
        .map(|(cross, [first, second])| {
            let both = (first * second).sqrt();
            if both > 0.0 { cross / both } else { 0.0 }
        })
        .collect();
    curve[0] = 1.0;
    let smoothed = smooth(&curve, &counts);
    let frequency_step = 1.0 / side as f64;
    let agrees = |ring: &f64| more_than_chance(&curve, &counts, *ring);
    let resolution_px = crossing(&smoothed).filter(agrees).map(|ring| 1.0 / (ring * frequency_step));
    FourierRingCorrelation { curve, smoothed, frequency_step, resolution_px }
}

/// Averages over neighboring rings; the mean image, ring 0, stays out.
fn smooth(curve: &[f64], counts: &[f64]) -> Vec<f64> {
    let reach = ((curve.len() as f64 * SMOOTHING).round() as usize).max(1);
    let average = |ring: usize| {
        if ring == 0 {
            return curve[0];
        }
        let rings = ring.saturating_sub(reach).max(1)..(ring + reach + 1).min(curve.len());
        let weight: f64 = rings.clone().map(|ring| counts[ring]).sum();
        rings.map(|ring| curve[ring] * counts[ring]).sum::<f64>() / weight.max(1.0)
    };
    (0..curve.len()).map(average).collect()
}

/// The first ring, as a broken number, where the curve falls below the threshold; `None` if it never does.
fn crossing(smoothed: &[f64]) -> Option<f64> {
    let below = smoothed.iter().skip(1).position(|&value| value < THRESHOLD)? + 1;
    if below < 3 {
        return None;
    }
    let (before, after) = (smoothed[below - 1], smoothed[below]);
    Some(below as f64 - 1.0 + (before - THRESHOLD) / (before - after))
}

/// Whether the rings up to the crossing agree more than independent noise would: the correlation of `k`
/// frequencies of a half plane has a standard deviation of `1 / sqrt(2 k)` then, and the window makes four
/// neighbors share what one would tell.
fn more_than_chance(curve: &[f64], counts: &[f64], crossing: f64) -> bool {
    let rings = 1..=crossing as usize;
    let frequencies: f64 = rings.clone().map(|ring| counts[ring]).sum();
    let agreement: f64 = rings.map(|ring| curve[ring] * counts[ring]).sum();
    agreement > CLEARLY * (2.0 * frequencies).sqrt()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;

    pub(in crate::sofi::quality) fn noise(side: usize, seed: u64) -> Array2<f32> {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        Array2::from_shape_simple_fn((side, side), || StandardNormal.sample(&mut random))
    }

    /// White noise without frequencies above a cutoff, cycles per pixel.
    fn band_limited(side: usize, seed: u64, cutoff: f64) -> Array2<f32> {
        let image = noise(side, seed);
        let mut spectrum = transform_both(&image, &Array2::zeros(image.dim()));
        for ((y, x), value) in spectrum.indexed_iter_mut() {
            let frequency = signed_frequency(y, side).hypot(signed_frequency(x, side));
            // Conjugated, so that transforming again is the way back.
            *value = if frequency < cutoff { value.conj() } else { Complex32::ZERO };
        }
        let (real, imaginary) = (spectrum.mapv(|value| value.re), spectrum.mapv(|value| value.im));
        let scale = 1.0 / (side * side) as f32;
        transform_both(&real, &imaginary).mapv(|value| value.re * scale)
    }

    #[test]
    fn the_bandwidth_of_images_is_found() {
        for cutoff in [0.1, 0.2, 0.35] {
            let image = band_limited(200, 1, cutoff);
            let [first, second] = [2, 3].map(|seed| &image + &(noise(200, seed) * 0.1));
            let frc = fourier_ring_correlation(&first, &second).unwrap();
            let found = frc.resolution_px.unwrap();
            // Window and smoothing widen an edge in the spectrum by up to four of the hundred rings.
            assert!((0.0..4.0).contains(&(200.0 / found - 200.0 * cutoff)), "{cutoff}: {found} px");
        }
    }

    #[test]
    fn more_noise_makes_the_resolution_worse() {
        let image = band_limited(128, 1, 0.1) + band_limited(128, 4, 0.3) * 0.3;
        let resolution = |noise_level: f32| {
            let [first, second] = [2, 3].map(|seed| &image + &(noise(128, seed) * noise_level));
            fourier_ring_correlation(&first, &second).unwrap().resolution_px.unwrap()
        };
        assert!(resolution(0.02) < 3.6 && resolution(1.0) > 8.0);
    }

    #[test]
    fn independent_noise_and_equal_images_have_no_resolution() {
        let (first, second) = (noise(96, 1), noise(96, 2));
        assert_eq!(fourier_ring_correlation(&first, &second).unwrap().resolution_px, None);
        assert_eq!(fourier_ring_correlation(&first, &first).unwrap().resolution_px, None);
        assert_eq!(fourier_ring_correlation(&first, &noise(95, 2)), None);
        assert_eq!(fourier_ring_correlation(&Array2::zeros((96, 96)), &first), None);
    }

    #[test]
    fn missing_borders_and_single_pixels_change_little() {
        let image = band_limited(200, 1, 0.2);
        let [mut first, mut second] = [2, 3].map(|seed| &image + &(noise(200, seed) * 0.1));
        for image in [&mut first, &mut second] {
            image.slice_mut(s![..3, ..]).fill(f32::NAN);
            image.slice_mut(s![.., 198..]).fill(f32::NAN);
            image[[77, 30]] = f32::NAN;
        }
        assert_eq!(valid_rectangle(&first), (3..200, 0..198));
        let found = fourier_ring_correlation(&first, &second).unwrap().resolution_px.unwrap();
        assert!((4.5..5.0).contains(&found), "{found}");
    }

    #[test]
    fn unequal_sub_grids_are_balanced_and_change_nothing_then() {
        let image = band_limited(200, 1, 0.15);
        let uneven = |image: &Array2<f32>, by: f32| {
            Array2::from_shape_fn(image.dim(), |(y, x)| {
                image[[y, x]] * if (y + x) % 2 == 1 { by } else { 1.0 }
            })
        };
        let halves = [2, 3].map(|seed| uneven(&(&image + &(noise(200, seed) * 0.1)), 0.8));
        let factors = balance_sub_grids(&halves[0], &halves[1], 2).unwrap();
        for (at, expected) in [([0, 0], 1.0), ([0, 1], 1.25), ([1, 0], 1.25), ([1, 1], 1.0)] {
            assert!((factors[at] - expected).abs() < 0.02, "{factors}");
        }
    }
}
