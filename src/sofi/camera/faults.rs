//! Which pixels are broken.
//!
//! | fault | sign |
//! |---|---|
//! | hot | without light brighter or noisier than the others by far more than these differ |
//! | dead | in even light less than half as bright as its neighborhood, or never changing |
//! | saturated | at the limit without light, or already in the dimmest flat that most pixels can give |
//!
//! In: moments of a dark and of flats. Out: bits per pixel. Never: takes what even many good pixels show for a fault.

use super::{PixelMoments, median, robust_spread};
use ndarray::{Array2, s};

/// Robust standard deviations by which a pixel differs that is broken.
const FAR: f64 = 6.0;
/// Least counts by which a hot pixel is brighter.
const LEAST_COUNTS: f64 = 2.0;
/// Share of its neighborhood's light below which a pixel is dead.
const DEAD_SHARE: f64 = 0.5;
/// Share of saturated frames above which a pixel is saturated.
const SATURATED_SHARE: f32 = 0.01;
/// Side of the squares whose median is the light of a neighborhood, pixels.
const NEIGHBORHOOD: usize = 32;

/// What can be wrong with a pixel; the numbers are bits of a map of faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum PixelFault {
    /// Bright or noisy without light.
    Hot = 1,
    /// Blind.
    Dead = 2,
    /// At the limit of the camera.
    Saturated = 4,
}

impl PixelFault {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Hot, Self::Dead, Self::Saturated];

    /// The bit of this fault.
    #[must_use]
    pub fn bit(self) -> u8 {
        self as u8
    }
}

/// Faults of every pixel.
pub(super) fn faults(dark: &PixelMoments, flats: &[PixelMoments]) -> Array2<u8> {
    let mut found = Array2::zeros(dark.mean.dim());
    let mut note = |place: (usize, usize), fault: PixelFault| found[place] |= fault.bit();
    hot(dark, &mut note);
    dead(dark, flats, &mut note);
    let half_saturated = |flat: &&PixelMoments| {
        flat.saturated_share.iter().filter(|s| **s > 0.0).count() * 2 < flat.mean.len()
    };
    let light = |flat: &PixelMoments| median(flat.mean.iter().map(|&mean| f64::from(mean)));
    let dimmest = flats.iter().filter(half_saturated).min_by(|a, b| light(a).total_cmp(&light(b)));
    for recording in [dark].into_iter().chain(dimmest) {
        for (place, share) in recording.saturated_share.indexed_iter() {
            if *share > SATURATED_SHARE {
                note(place, PixelFault::Saturated);
            }
        }
    }
    found
}

fn hot(dark: &PixelMoments, note: &mut impl FnMut((usize, usize), PixelFault)) {
    let means: Vec<f64> = dark.mean.iter().map(|&mean| f64::from(mean)).collect();
    let level = median(means.iter().copied());
    let far = (FAR * robust_spread(&means)).max(LEAST_COUNTS);
    // Read noise differs by factors.
    let logarithms: Vec<f64> =
        dark.variance.iter().map(|&v| f64::from(v)).filter(|v| *v > 0.0).map(libm::log).collect();
    let typical = median(logarithms.iter().copied());
    let chance = (2.0 / dark.freedom.max(1) as f64).sqrt();
    let noisy = typical + FAR * robust_spread(&logarithms).max(chance);
    for ((place, &mean), &variance) in dark.mean.indexed_iter().zip(&dark.variance) {
        let is_noisy = variance > 0.0 && libm::log(f64::from(variance)) > noisy;
        if f64::from(mean) - level > far || is_noisy {
            note(place, PixelFault::Hot);
        }
    }
}

fn dead(dark: &PixelMoments, flats: &[PixelMoments], note: &mut impl FnMut((usize, usize), PixelFault)) {
    let light = |flat: &PixelMoments| flat.mean.mapv(f64::from) - dark.mean.mapv(f64::from);
    let is_within = |flat: &&PixelMoments| {
        flat.saturated_share.iter().filter(|share| **share > 0.0).count() * 10 < flat.mean.len()
    };
    let brightest = flats
        .iter()
        .filter(is_within)
        .map(light)
        .max_by(|a, b| median(a.iter().copied()).total_cmp(&median(b.iter().copied())));
    if let Some(light) = brightest {
        let (height, width) = light.dim();
        for top in (0..height).step_by(NEIGHBORHOOD) {
            for left in (0..width).step_by(NEIGHBORHOOD) {
                let (bottom, right) = ((top + NEIGHBORHOOD).min(height), (left + NEIGHBORHOOD).min(width));
                let square = light.slice(s![top..bottom, left..right]);
                let typical = median(square.iter().copied());
                for ((y, x), &value) in square.indexed_iter() {
                    if value < DEAD_SHARE * typical {
                        note((top + y, left + x), PixelFault::Dead);
                    }
                }
            }
        }
    }
    for (place, variance) in dark.variance.indexed_iter() {
        if *variance <= 0.0 && flats.iter().all(|flat| flat.variance[place] <= 0.0) {
            note(place, PixelFault::Dead);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recording(mean: f32, variance: f32) -> PixelMoments {
        let wavy =
            |value: f32| Array2::from_shape_fn((40, 40), |(y, x)| value + ((7 * y + 3 * x) % 5) as f32 * 0.5);
        PixelMoments {
            frames: 100,
            freedom: 97,
            mean: wavy(mean),
            variance: wavy(variance),
            saturated_share: Array2::zeros((40, 40)),
            flicker: 0.0,
        }
    }

    #[test]
    fn broken_pixels_are_found_and_no_others() {
        let (mut dark, mut flat) = (recording(100.0, 9.0), recording(500.0, 900.0));
        dark.mean[[3, 4]] = 300.0;
        dark.variance[[5, 6]] = 500.0;
        flat.mean[[20, 20]] = 102.0;
        dark.variance[[30, 2]] = 0.0;
        flat.variance[[30, 2]] = 0.0;
        dark.saturated_share[[39, 39]] = 1.0;
        let found = faults(&dark, &[flat]);
        let expected = [
            ([3, 4], PixelFault::Hot.bit() | PixelFault::Dead.bit()),
            ([5, 6], PixelFault::Hot.bit()),
            ([20, 20], PixelFault::Dead.bit()),
            ([30, 2], PixelFault::Dead.bit()),
            ([39, 39], PixelFault::Saturated.bit()),
        ];
        for (place, fault) in &expected[1..] {
            assert_eq!(found[*place], *fault, "{place:?}");
        }
        assert_ne!(found[[3, 4]] & PixelFault::Hot.bit(), 0);
        assert_eq!(found.iter().filter(|fault| **fault != 0).count(), expected.len());
    }
}
