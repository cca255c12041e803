//! Frames of camera T on the pixels of camera R: a stretch of columns, row by row downwards, for some frames at a time.
//!
//! The first pass makes values on the line of a row, at the columns of T; the second makes the values at the columns
//! of R from these. Every pixel of T is converted once: each register of columns keeps the rows that the next line
//! needs again, wherever the line runs, so that inclined lines need no more memory than straight ones.
//!
//! In: rows of T as the camera gave them, the [`Resampler`]. Out: rows on the pixels of R about a reference, counts.
//! Never: allocates for a stretch no larger than one before it, makes lines in another order than downwards.

use super::resampling::{REGISTER, REGISTER_TAPS, Resampler};
use crate::sofi::prefetch::prefetch;
use pulp::Simd;
use std::ops::Range;

/// Most frames that are worked on together.
pub const FRAMES_TOGETHER: usize = 4;

/// Pixels of one register of columns in the order of the sensor, in the rows that its line needs now; a row is always
/// in the same place.
type Kept = [[f32; REGISTER]; REGISTER_TAPS];

/// One register of R's columns in the row that is made.
#[derive(Debug, Clone, Copy)]
struct Across {
    /// Where the values between the passes that it needs begin.
    start: usize,
    phase: usize,
}

/// One register of flipped T's columns on the line of the row that is made.
#[derive(Debug, Clone)]
struct Down {
    phase: usize,
    /// Weight of the first of the rows that are kept.
    turn: usize,
    /// Rows of flipped T that are needed for the first time.
    fresh: Range<i64>,
    /// Column of the sensor where its pixels begin; none where some are beyond it.
    column: Option<usize>,
}

/// Some columns of R on the way down, with what is needed from line to line.
#[derive(Debug, Default)]
pub struct Stretch {
    /// First register of R's columns.
    first: i64,
    /// First register of flipped T's columns.
    begin: i64,
    across: Vec<Across>,
    down: Vec<Down>,
    /// Frame by frame, the registers of flipped T.
    kept: Vec<Kept>,
    between: Vec<[f32; REGISTER]>,
    /// The same in the order of flipped T.
    flipped: Vec<f32>,
}

impl Stretch {
    /// Begins a stretch of `registers` registers, the first at `column`, in some rows of R and for so many frames.
    #[inline(always)]
    pub fn begin(
        &mut self,
        resampler: &Resampler,
        rows: Range<usize>,
        (column, registers): (usize, usize),
        frames: usize,
    ) {
        debug_assert!(column.is_multiple_of(REGISTER), "columns begin with a register");
        self.first = (column / REGISTER) as i64;
        let last = self.first + registers.saturating_sub(1) as i64;
        // What a register needs of the values between the passes grows evenly with the row.
        let ends = [rows.start, rows.end.saturating_sub(1)].map(|row| row as i64);
        let first = ends.map(|row| resampler.across_register(row, self.first).0);
        let last =
            ends.map(|row| resampler.across_register(row, last).0 + (REGISTER + REGISTER_TAPS - 1) as i64);
        self.begin = first[0].min(first[1]).div_euclid(REGISTER as i64);
        let end = last[0].max(last[1]).div_euclid(REGISTER as i64) + 1;
        let (begin, flips) = (self.begin, resampler.flips());
        let [_, width] = resampler.size();
        self.down.clear();
        self.down.extend((begin..end).map(|register| {
            let j = register * REGISTER as i64;
            let start = if flips[1] { (width as i64) - REGISTER as i64 - j } else { j };
            let column = usize::try_from(start).ok().filter(|start| start + REGISTER <= width);
            Down { phase: 0, turn: 0, fresh: Range { start: 0, end: i64::MIN }, column }
        }));
        self.across.clear();
        self.across.resize(registers, Across { start: 0, phase: 0 });
        self.between.resize(FRAMES_TOGETHER * self.down.len(), [0.0; REGISTER]);
        self.flipped.resize(FRAMES_TOGETHER * self.down.len() * REGISTER, 0.0);
        let kept = frames * self.down.len();
        self.kept.resize(self.kept.len().max(kept), Kept::default());
    }

    /// Makes ready for the next row of R.
    #[inline(always)]
    pub fn prepare(&mut self, resampler: &Resampler, row: usize) {
        let row = row as i64;
        for (register, across) in (self.first..).zip(&mut self.across) {
            let (first, phase) = resampler.across_register(row, register);
            *across = Across { start: (first - self.begin * REGISTER as i64) as usize, phase };
            prefetch(resampler.across_taps(phase)[..REGISTER_TAPS].as_flattened());
        }
        for (register, down) in (self.begin..).zip(&mut self.down) {
            let (first, phase) = resampler.down_register(row, register);
            let turn = REGISTER_TAPS - first.rem_euclid(REGISTER_TAPS as i64) as usize;
            let end = first + REGISTER_TAPS as i64;
            prefetch(resampler.down_taps(phase)[turn..][..REGISTER_TAPS].as_flattened());
            (down.phase, down.turn, down.fresh) = (phase, turn, down.fresh.end.max(first)..end);
        }
    }

    /// The values of some frames of T in the row that is ready, about the reference.
    ///
    /// `first` is the number of the first of them among the frames of this stretch; `numbers` has their rows at
    /// `starts`.
    #[inline(always)]
    pub fn rows<S: Simd, T: Copy, const FRAMES: usize>(
        &mut self,
        simd: S,
        resampler: &Resampler,
        (first, frames): (usize, [&[T]; FRAMES]),
        count: impl Fn(T) -> f32,
        reference: &[f32],
        (numbers, starts): (&mut [f32], [usize; FRAMES]),
    ) {
        let registers = self.down.len();
        let kept = &mut self.kept[first * registers..][..FRAMES * registers];
        // All fresh rows first: what was written just now is slow to read.
        for (index, (down, register)) in self.down.iter().zip(self.begin..).enumerate() {
            for row in down.fresh.clone() {
                let slot = row.rem_euclid(REGISTER_TAPS as i64) as usize;
                let place = Place::new(resampler, (row, register), down.column);
                for (frame, pixels) in frames.iter().enumerate() {
                    kept[frame * registers + index][slot] = place.pixels(pixels, &count);
                }
            }
            let later = Place::new(resampler, (down.fresh.end, register), down.column);
            frames.iter().for_each(|pixels| later.prefetch(pixels));
        }
        let flips = resampler.flips()[1];
        for (index, down) in self.down.iter().enumerate() {
            let weights = &resampler.down_taps(down.phase)[down.turn..];
            let pixels = std::array::from_fn(|frame| as_flat(&kept[frame * registers + index]));
            let sums = weighted::<S, FRAMES, KEPT, REGISTER>(simd, weights, pixels);
            let index = if flips { registers - 1 - index } else { index };
            for (frame, sums) in sums.into_iter().enumerate() {
                self.between[frame * registers + index] = sums;
            }
        }
        let mut between = self.between.as_flattened();
        if flips {
            let columns = registers * REGISTER;
            for (flipped, between) in
                self.flipped.chunks_mut(columns).zip(between.chunks(columns)).take(FRAMES)
            {
                for (flipped, value) in flipped.iter_mut().zip(between.iter().rev()) {
                    *flipped = *value;
                }
            }
            between = &self.flipped;
        }
        for (index, (across, reference)) in self.across.iter().zip(reference.chunks(REGISTER)).enumerate() {
            let weights = resampler.across_taps(across.phase);
            let pixels = std::array::from_fn(|frame| {
                let start = frame * registers * REGISTER + across.start;
                between[start..].first_chunk().unwrap_or(&[0.0; NEEDED])
            });
            let values = weighted::<S, FRAMES, NEEDED, 1>(simd, weights, pixels);
            for (values, start) in values.iter().zip(starts) {
                let target = &mut numbers[start + index * REGISTER..][..reference.len()];
                match (target.first_chunk_mut::<REGISTER>(), reference.first_chunk::<REGISTER>()) {
                    (Some(target), Some(reference)) => *target = about(values, reference),
                    _ => {
                        for ((target, value), reference) in target.iter_mut().zip(values).zip(reference) {
                            *target = value - reference;
                        }
                    }
                }
            }
        }
    }
}

/// Pixels that are kept of one register.
const KEPT: usize = REGISTER * REGISTER_TAPS;

/// Values between the passes that one register needs.
const NEEDED: usize = REGISTER + REGISTER_TAPS - 1;

#[inline(always)]
fn as_flat(kept: &Kept) -> &[f32; KEPT] {
    kept.as_flattened().first_chunk().unwrap_or(&[0.0; KEPT])
}

/// Where a register of one row of flipped T is on the sensor.
#[derive(Debug, Clone, Copy)]
struct Place<'a> {
    resampler: &'a Resampler,
    row: i64,
    first: i64,
    /// Its first pixel in a frame; none where some are beyond the sensor.
    start: Option<usize>,
}

impl<'a> Place<'a> {
    #[inline(always)]
    fn new(resampler: &'a Resampler, (row, register): (i64, i64), column: Option<usize>) -> Self {
        let first = register * REGISTER as i64;
        let [_, width] = resampler.size();
        let start = column.map(|column| resampler.sensor(row, first).0 * width + column);
        Self { resampler, row, first, start }
    }

    /// A register of pixels in counts, in the order of the sensor.
    #[inline(always)]
    fn pixels<T: Copy>(&self, frame: &[T], count: &impl Fn(T) -> f32) -> [f32; REGISTER] {
        let raw = self.start.and_then(|start| frame.get(start..)?.first_chunk::<REGISTER>());
        let Some(raw) = raw else { return self.pixels_at_the_edge(frame, count) };
        let mut pixels = [0.0; REGISTER];
        for (pixel, raw) in pixels.iter_mut().zip(raw) {
            *pixel = count(*raw);
        }
        pixels
    }

    /// The same where some are beyond the sensor: the nearest ones.
    #[cold]
    #[inline(never)]
    fn pixels_at_the_edge<T: Copy>(&self, frame: &[T], count: &impl Fn(T) -> f32) -> [f32; REGISTER] {
        let [_, width] = self.resampler.size();
        std::array::from_fn(|lane| {
            let lane = if self.resampler.flips()[1] { REGISTER - 1 - lane } else { lane };
            let (row, column) = self.resampler.sensor(self.row, self.first + lane as i64);
            count(frame[row * width + column])
        })
    }

    #[inline(always)]
    fn prefetch<T>(&self, frame: &[T]) {
        if let Some(pixel) = self.start.and_then(|start| frame.get(start..start + 1)) {
            prefetch(pixel);
        }
    }
}

/// Sums of weighted registers, frame by frame; the next one begins `STEP` pixels further.
///
/// A register of weights serves all frames, as weights come from farther away than pixels.
#[inline(always)]
fn weighted<S: Simd, const FRAMES: usize, const PIXELS: usize, const STEP: usize>(
    simd: S,
    weights: &[[f32; REGISTER]],
    pixels: [&[f32; PIXELS]; FRAMES],
) -> [[f32; REGISTER]; FRAMES] {
    let load = |numbers: &[f32], at: usize| S::as_simd_f32s(&numbers[at..at + S::F32_LANES]).0[0];
    let mut all = [[0.0; REGISTER]; FRAMES];
    let Some(weights) = weights.first_chunk::<REGISTER_TAPS>() else { return all };
    for lane in (0..REGISTER).step_by(S::F32_LANES) {
        let mut sums = [simd.splat_f32s(0.0); FRAMES];
        for (tap, weights) in weights.iter().enumerate() {
            let weight = load(weights, lane);
            for (sum, pixels) in sums.iter_mut().zip(pixels) {
                *sum = simd.mul_add_e_f32s(weight, load(pixels, tap * STEP + lane), *sum);
            }
        }
        for (all, sum) in all.iter_mut().zip(sums) {
            S::as_mut_simd_f32s(&mut all[lane..lane + S::F32_LANES]).0[0] = sum;
        }
    }
    all
}

#[inline(always)]
fn about(values: &[f32; REGISTER], reference: &[f32; REGISTER]) -> [f32; REGISTER] {
    let mut differences = [0.0; REGISTER];
    for (difference, (value, zero)) in differences.iter_mut().zip(values.iter().zip(reference)) {
        *difference = value - zero;
    }
    differences
}
