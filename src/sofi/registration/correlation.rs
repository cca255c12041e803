//! Registration from the sample itself: the same emitters blink in both cameras at the same moments.
//!
//! What fluctuates together shows where the cameras look at the same place, whatever share of a dye each of them has;
//! dyes that only one camera sees, and everything that does not blink, drop out. First the covariance of whole frames
//! over all shifts, for every mirror, by Fourier transforms; then patch by patch over a few pixels, where a pair of
//! pixels belongs to the patch that its middle lies in, so that the peak stands at the shift of the patch's emitters.
//!
//! In: blocks of frames of both cameras. Out: mirror and shift; pairs of points for an affine map.
//! Never: takes a peak that is not clear of the noise. Fails: `None` where nothing fluctuates together.

use super::beads::fit_spot;
use super::fit::PointPair;
use super::transform::{Affine, Mirror, ReflectedFromTransmitted};
use ndarray::Array2;
use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// A peak of the coarse covariance must be this many robust spreads high.
const CLEAR: f64 = 10.0;

/// Shifts to all sides that a patch is looked at over, pixels.
const REACH: usize = 6;

/// Side of a patch, pixels; its middle counts most.
const PATCH: usize = 24;

/// Most patches along a side.
const MOST_PATCHES: usize = 10;

/// A patch's peak must be this many times its fit's scatter high.
const CLEAR_PATCH: f64 = 5.0;

/// Covariance of whole frames over all shifts.
pub struct CoarseCorrelation {
    size: [usize; 2],
    padded: [usize; 2],
    transforms: [Arc<dyn Fft<f32>>; 4],
    /// Per mirror, the cross spectrum summed over frames.
    spectra: Vec<Vec<Complex32>>,
}

impl std::fmt::Debug for CoarseCorrelation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CoarseCorrelation").field("size", &self.size).finish_non_exhaustive()
    }
}

impl CoarseCorrelation {
    /// For frames of `[height, width]` pixels.
    #[must_use]
    pub fn new(size: [usize; 2]) -> Self {
        let padded = size.map(|side| (side + side / 2).next_power_of_two());
        let mut planner = FftPlanner::new();
        let transforms = [
            planner.plan_fft_forward(padded[0]),
            planner.plan_fft_forward(padded[1]),
            planner.plan_fft_inverse(padded[0]),
            planner.plan_fft_inverse(padded[1]),
        ];
        let spectra = vec![vec![Complex32::default(); padded[0] * padded[1]]; Mirror::NAMES.len()];
        Self { size, padded, transforms, spectra }
    }

    /// Adds frames from which their mean over time was taken.
    pub fn push(&mut self, reflected: &[f32], transmitted: &[f32]) {
        let r = self.spectrum(reflected, Mirror::None);
        for (index, (_, mirror)) in Mirror::NAMES.into_iter().enumerate() {
            let t = self.spectrum(transmitted, mirror);
            for ((sum, r), t) in self.spectra[index].iter_mut().zip(&r).zip(&t) {
                *sum += r.conj() * t;
            }
        }
    }

    /// Mirror and shift of the highest peak: flipped T shows at `p + shift` what R shows at `p`.
    #[must_use]
    pub fn best(&self) -> Option<(Mirror, [f64; 2])> {
        let mut best: Option<(f64, Mirror, [f64; 2])> = None;
        for ((_, mirror), spectrum) in Mirror::NAMES.into_iter().zip(&self.spectra) {
            let covariance = self.smooth_covariance(spectrum);
            let (height, shift) = self.peak(&covariance);
            let mut all: Vec<f64> = covariance.iter().map(|value| f64::from(value.re).abs()).collect();
            let middle = all.len() / 2;
            let spread = 1.4826 * *all.select_nth_unstable_by(middle, f64::total_cmp).1;
            let clearness = height / spread.max(f64::MIN_POSITIVE);
            if clearness >= CLEAR && best.as_ref().is_none_or(|(most, ..)| height > *most) {
                best = Some((height, mirror, shift));
            }
        }
        best.map(|(_, mirror, shift)| (mirror, shift))
    }

    fn spectrum(&self, frame: &[f32], mirror: Mirror) -> Vec<Complex32> {
        let ([height, width], [_, stride]) = (self.size, self.padded);
        let flips = mirror.flips();
        let mut spectrum = vec![Complex32::default(); self.padded[0] * stride];
        for y in 0..height {
            let row = if flips[0] { height - 1 - y } else { y };
            for x in 0..width {
                let column = if flips[1] { width - 1 - x } else { x };
                spectrum[y * stride + x].re = frame[row * width + column];
            }
        }
        self.transform(&mut spectrum, 0);
        spectrum
    }

    /// Both axes, one after the other; `first` is 0 for forward and 2 for back.
    fn transform(&self, values: &mut Vec<Complex32>, first: usize) {
        let [rows, columns] = self.padded;
        self.transforms[first + 1].process(values);
        let mut turned = transposed(values, rows, columns);
        self.transforms[first].process(&mut turned);
        *values = transposed(&turned, columns, rows);
    }

    /// The covariance over all shifts, smoothed by two pixels, as a small rotation spreads its peak.
    fn smooth_covariance(&self, spectrum: &[Complex32]) -> Vec<Complex32> {
        let [rows, columns] = self.padded;
        let frequency = |index: usize, side: usize| {
            let signed = if index > side / 2 { index as f64 - side as f64 } else { index as f64 };
            signed / side as f64
        };
        let mut values: Vec<Complex32> = spectrum
            .iter()
            .enumerate()
            .map(|(index, value)| {
                let (y, x) = (frequency(index / columns, rows), frequency(index % columns, columns));
                let passed = libm::exp(-2.0 * std::f64::consts::PI.powi(2) * 4.0 * (y * y + x * x));
                value * passed as f32
            })
            .collect();
        self.transform(&mut values, 2);
        values
    }

    fn peak(&self, covariance: &[Complex32]) -> (f64, [f64; 2]) {
        let [_, columns] = self.padded;
        let signed = |index: usize, axis: usize| {
            let side = self.padded[axis];
            if index > side / 2 { index as f64 - side as f64 } else { index as f64 }
        };
        let mut best = (0.0, [0.0; 2]);
        for (index, value) in covariance.iter().enumerate() {
            let shift = [signed(index / columns, 0), signed(index % columns, 1)];
            let fits = (0..2).all(|axis| shift[axis].abs() <= self.size[axis] as f64 / 2.0);
            if fits && f64::from(value.re) > best.0 {
                best = (f64::from(value.re), shift);
            }
        }
        best
    }
}

fn transposed(values: &[Complex32], rows: usize, columns: usize) -> Vec<Complex32> {
    (0..rows * columns).map(|index| values[index % rows * columns + index / rows]).collect()
}

/// The map that a mirror and a shift make.
#[must_use]
pub fn shifted(mirror: Mirror, shift: [f64; 2], size: [usize; 2]) -> ReflectedFromTransmitted {
    let affine = Affine { shift: shift.map(|pixels| -pixels), ..Affine::IDENTITY };
    ReflectedFromTransmitted { mirror, affine, size }
}

/// Covariance of patches around a map that is nearly right.
#[derive(Debug, Clone)]
pub struct PatchCorrelation {
    map: ReflectedFromTransmitted,
    patches: Vec<Patch>,
    /// For every shift, the weight of every pixel of a patch.
    weights: Vec<Vec<f32>>,
}

#[derive(Debug, Clone)]
struct Patch {
    /// First row and column in R.
    reflected: [usize; 2],
    /// First row and column in flipped T, at no shift.
    transmitted: [i64; 2],
    covariance: Vec<f64>,
}

/// Shifts along an axis.
const SHIFTS: usize = 2 * REACH + 1;

impl PatchCorrelation {
    /// Patches over the field that both cameras see.
    #[must_use]
    pub fn new(map: ReflectedFromTransmitted) -> Self {
        Self::with_patches(map, MOST_PATCHES)
    }

    /// The same with at most so many patches along a side.
    #[must_use]
    pub fn with_patches(map: ReflectedFromTransmitted, most: usize) -> Self {
        let inverse = map.affine.inverse().unwrap_or(Affine::IDENTITY);
        let starts = |side: usize| -> Vec<usize> {
            let last = side.saturating_sub(PATCH);
            let number = (last / (PATCH / 2) + 1).min(most);
            (0..number).map(|k| last * k / (number - 1).max(1)).collect()
        };
        let (rows, columns) = (starts(map.size[0]), starts(map.size[1]));
        let patch = |reflected: [usize; 2]| {
            let half = (PATCH as f64 - 1.0) / 2.0;
            let middle = inverse.apply(reflected.map(|start| start as f64 + half));
            Patch {
                reflected,
                transmitted: middle.map(|middle| (middle - half).round() as i64),
                covariance: vec![0.0; SHIFTS * SHIFTS],
            }
        };
        let patches = rows.iter().flat_map(|&y| columns.iter().map(move |&x| patch([y, x]))).collect();
        Self { map, patches, weights: (0..SHIFTS * SHIFTS).map(weights).collect() }
    }

    /// Adds a block of frames, whose mean is taken from them first.
    pub fn push(&mut self, reflected: &[&[u16]], transmitted: &[&[u16]]) {
        let Self { map, patches, weights } = self;
        for patch in patches {
            let r = fluctuations(
                reflected,
                |pixel| {
                    let (y, x) = (patch.reflected[0] + pixel / PATCH, patch.reflected[1] + pixel % PATCH);
                    y.min(map.size[0] - 1) * map.size[1] + x.min(map.size[1] - 1)
                },
                PATCH * PATCH,
            );
            let side = PATCH + 2 * REACH;
            let t = fluctuations(
                transmitted,
                |pixel| {
                    let at = [pixel / side, pixel % side];
                    let [y, x] = std::array::from_fn(|axis| {
                        let flipped = patch.transmitted[axis] + at[axis] as i64 - REACH as i64;
                        let inside = flipped.clamp(0, map.size[axis] as i64 - 1) as usize;
                        if map.mirror.flips()[axis] { map.size[axis] - 1 - inside } else { inside }
                    });
                    y * map.size[1] + x
                },
                side * side,
            );
            for (r, t) in r.chunks_exact(PATCH * PATCH).zip(t.chunks_exact(side * side)) {
                for (shift, (sum, weights)) in patch.covariance.iter_mut().zip(weights.iter()).enumerate() {
                    *sum += f64::from(weighted_product(r, t, weights, [shift / SHIFTS, shift % SHIFTS]));
                }
            }
        }
    }

    /// The places of patches whose peak is clear, in flipped T and in R.
    #[must_use]
    pub fn pairs(&self) -> Vec<PointPair> {
        self.patches.iter().filter_map(|patch| self.pair(patch)).collect()
    }

    fn pair(&self, patch: &Patch) -> Option<PointPair> {
        let covariance =
            Array2::from_shape_fn((SHIFTS, SHIFTS), |(dy, dx)| patch.covariance[dy * SHIFTS + dx] as f32);
        let highest = covariance.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1))?.0;
        let (spot, scatter) = fit_spot(&covariance.view(), highest.0, highest.1)?;
        if spot.height < CLEAR_PATCH * scatter {
            return None;
        }
        // Half of the shift to either side, as pairs of pixels are sorted by their middle.
        let shift = [spot.y - REACH as f64, spot.x - REACH as f64];
        let half = (PATCH as f64 - 1.0) / 2.0;
        let to: [f64; 2] =
            std::array::from_fn(|axis| patch.reflected[axis] as f64 + half - shift[axis] / 2.0);
        let from: [f64; 2] =
            std::array::from_fn(|axis| patch.transmitted[axis] as f64 + half + shift[axis] / 2.0);
        let is_inside = (0..2).all(|axis| (0.0..self.map.size[axis] as f64).contains(&from[axis]));
        let weight = (spot.height / scatter.max(1e-9)).min(1e3).powi(2);
        is_inside.then_some(PointPair { from, to, weight })
    }
}

/// How much the pixels of a patch count at a shift: a hill over the middle of both pixels.
fn weights(shift: usize) -> Vec<f32> {
    let shift = [shift / SHIFTS, shift % SHIFTS].map(|at| at as f64 - REACH as f64);
    let hill = |at: usize, shift: f64| {
        let place = (at as f64 + shift / 2.0 + 0.5) / PATCH as f64;
        if (0.0..1.0).contains(&place) { libm::sin(std::f64::consts::PI * place).powi(2) } else { 0.0 }
    };
    (0..PATCH * PATCH)
        .map(|pixel| (hill(pixel / PATCH, shift[0]) * hill(pixel % PATCH, shift[1])) as f32)
        .collect()
}

/// The chosen pixels of all frames, less their means over the frames.
fn fluctuations(frames: &[&[u16]], place: impl Fn(usize) -> usize, pixels: usize) -> Vec<f32> {
    let places: Vec<usize> = (0..pixels).map(place).collect();
    let mean = |&place: &usize| {
        frames.iter().map(|frame| f64::from(frame[place])).sum::<f64>() / frames.len().max(1) as f64
    };
    let means: Vec<f32> = places.iter().map(|place| mean(place) as f32).collect();
    frames
        .iter()
        .flat_map(|frame| places.iter().zip(&means).map(|(&place, mean)| f32::from(frame[place]) - mean))
        .collect()
}

fn weighted_product(r: &[f32], t: &[f32], weights: &[f32], [dy, dx]: [usize; 2]) -> f32 {
    let side = PATCH + 2 * REACH;
    let mut sums = [0.0; PATCH];
    for (y, (r, weights)) in r.chunks_exact(PATCH).zip(weights.chunks_exact(PATCH)).enumerate() {
        let t = &t[(y + dy) * side + dx..][..PATCH];
        for (x, sum) in sums.iter_mut().enumerate() {
            *sum += weights[x] * r[x] * t[x];
        }
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::super::fit::{distance, fit_affine};
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    /// Frames of emitters that blink, half of their light on each camera.
    fn blinking(map: &ReflectedFromTransmitted, frames: usize) -> [Vec<Vec<u16>>; 2] {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
        let [height, width] = map.size;
        let side = height as f64;
        let emitters: Vec<[f64; 2]> = (0..400)
            .map(|_| {
                [
                    random.random::<f64>() * 1.6 * side - 0.3 * side,
                    random.random::<f64>() * 1.6 * side - 0.3 * side,
                ]
            })
            .collect();
        let frame = |random: &mut Xoshiro256PlusPlus| {
            let mut images = [vec![100.0; height * width], vec![100.0; height * width]];
            for &emitter in emitters.iter().filter(|_| random.random::<f64>() < 0.1) {
                let places = [emitter, map.undo(emitter).unwrap()];
                for (image, [y, x]) in images.iter_mut().zip(places) {
                    for j in (y.round() as i64 - 4).max(0)..(y.round() as i64 + 5).min(height as i64) {
                        for i in (x.round() as i64 - 4).max(0)..(x.round() as i64 + 5).min(width as i64) {
                            let squared = (j as f64 - y).powi(2) + (i as f64 - x).powi(2);
                            image[j as usize * width + i as usize] += 60.0 * (-squared / 2.6).exp();
                        }
                    }
                }
            }
            images.map(|image| {
                let noisy = |value: f64| (value + 8.0 * (random.random::<f64>() - 0.5)).round() as u16;
                image.into_iter().map(noisy).collect::<Vec<u16>>()
            })
        };
        let (mut r, mut t) = (Vec::new(), Vec::new());
        for _ in 0..frames {
            let [a, b] = frame(&mut random);
            r.push(a);
            t.push(b);
        }
        [r, t]
    }

    #[test]
    fn blinking_emitters_show_mirror_shift_and_rotation() {
        let (sin, cos) = (0.01_f64.sin() * 1.004, 0.01_f64.cos() * 1.004);
        let truth = ReflectedFromTransmitted {
            mirror: Mirror::Horizontal,
            affine: Affine { matrix: [[cos, sin], [-sin, cos]], shift: [11.4, -6.7] },
            size: [96, 96],
        };
        let [r, t] = blinking(&truth, 192);
        let mut coarse = CoarseCorrelation::new(truth.size);
        let mean = |frames: &[Vec<u16>]| -> Vec<f32> {
            let sum = |place: usize| frames.iter().map(|frame| f32::from(frame[place])).sum::<f32>();
            (0..96 * 96).map(|place| sum(place) / frames.len() as f32).collect()
        };
        let means = [mean(&r), mean(&t)];
        let centered = |frame: &[u16], mean: &[f32]| -> Vec<f32> {
            frame.iter().zip(mean).map(|(&count, mean)| f32::from(count) - mean).collect()
        };
        for (r, t) in r.iter().zip(&t).take(64) {
            coarse.push(&centered(r, &means[0]), &centered(t, &means[1]));
        }
        let (mirror, shift) = coarse.best().unwrap();
        assert_eq!(mirror, truth.mirror);
        let mut map = shifted(mirror, shift, truth.size);
        for _ in 0..2 {
            let mut patches = PatchCorrelation::new(map);
            for (r, t) in r.chunks(16).zip(t.chunks(16)) {
                let (r, t): (Vec<&[u16]>, Vec<&[u16]>) =
                    (r.iter().map(Vec::as_slice).collect(), t.iter().map(Vec::as_slice).collect());
                patches.push(&r, &t);
            }
            map.affine = fit_affine(&patches.pairs()).unwrap();
        }
        for place in [[48.0, 48.0], [30.0, 30.0], [70.0, 60.0]] {
            let error = distance(map.apply(place), truth.apply(place));
            println!("{place:?}: {error:.3} px");
            assert!(error < 0.08, "{error}");
        }
    }
}
