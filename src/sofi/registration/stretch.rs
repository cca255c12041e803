//! Frames of camera T on the pixels of camera R: a stretch of columns, row by row downwards, for many frames at a time.
//!
//! The first pass makes values on the lines of some rows of R, at the columns of T; the second makes the values at the
//! columns of R from these, row by row. All frames are taken down a few registers of columns before the next ones, so that
//! their weights and pixels stay in the first-level cache, and each pixel is converted for many lines.
//!
//! In: rows of T as the camera gave them, the [`Resampler`]. Out: rows on the pixels of R about a reference, counts.
//! Never: allocates for a stretch no larger than one before it.

use super::resampling::{REGISTER, REGISTER_TAPS, RegisterTaps, Resampler};
use crate::sofi::prefetch::{LINE_BYTES, prefetch};
use pulp::Simd;
use std::ops::Range;

/// Most frames that share a register of weights.
pub const FRAMES_TOGETHER: usize = 4;

/// Rows of R whose lines are made together: the more, the fewer pixels are converted twice, but the more values between
/// the passes have to stay in the second-level cache.
pub const LINES: usize = 18;

/// Registers of columns that some frames are taken down one after another, so that a memory page of a row is looked at
/// once for all of them; their weights about fill a first-level cache.
const TILE: usize = 4;

/// A register of columns in one row of T, in counts, frame by frame.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C, align(64))]
struct Pixels([[f32; REGISTER]; FRAMES_TOGETHER]);

/// Where the lines of some rows of R are in a register of flipped T's columns.
#[derive(Debug, Clone, Copy)]
struct Lines<'a> {
    /// First row of flipped T, and the weights from there on, of every line.
    lines: [(i64, &'a RegisterTaps); LINES],
    count: usize,
}

impl<'a> Lines<'a> {
    #[inline(always)]
    fn new(resampler: &'a Resampler, rows: &Range<usize>, register: i64) -> Self {
        let lines = std::array::from_fn(|line| {
            let row = (rows.start + line).min(rows.end.saturating_sub(1));
            let (first, phase) = resampler.down_register(row as i64, register);
            (first, resampler.down_taps(phase))
        });
        Self { lines, count: rows.len().min(LINES) }
    }

    #[inline(always)]
    fn prefetch(&self) {
        for (_, taps) in &self.lines[..self.count] {
            prefetch(taps.0.as_flattened());
        }
    }

    /// Rows of flipped T that they need; lines go down with the rows of R.
    #[inline(always)]
    fn rows(&self) -> Range<i64> {
        self.lines[0].0..self.lines[LINES - 1].0 + REGISTER_TAPS as i64
    }
}

/// Some columns of R on the way down, with what is needed from line to line.
#[derive(Debug, Default)]
pub struct Stretch {
    /// Rows of R.
    rows: Range<usize>,
    /// First register of R's columns.
    first: i64,
    /// First register of flipped T's columns.
    begin: i64,
    /// Column of the sensor where each register's pixels begin; none where some are beyond it.
    columns: Vec<Option<usize>>,
    /// Of every register of R's columns in the row that is made: where the values on the line that it needs begin, and
    /// the phase of its weights.
    across: Vec<(usize, usize)>,
    frames: usize,
    /// Rows of R whose lines are made.
    made: Range<usize>,
    /// The rows of one register of T that these lines need.
    pixels: Vec<Pixels>,
    /// Values on the lines: row of R, then frame, then the registers of flipped T.
    between: Vec<f32>,
    /// Where these begin, so that registers do not lie across cache lines.
    aligned: usize,
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
        let last = ends.map(|row| resampler.across_register(row, last).0 + NEEDED as i64);
        self.begin = first[0].min(first[1]).div_euclid(REGISTER as i64);
        let end = last[0].max(last[1]).div_euclid(REGISTER as i64) + 1;
        let [_, width] = resampler.size();
        let flips = resampler.flips()[1];
        self.columns.clear();
        self.columns.extend((self.begin..end).map(|register| {
            let j = register * REGISTER as i64;
            let start = if flips { (width as i64) - REGISTER as i64 - j } else { j };
            usize::try_from(start).ok().filter(|start| start + REGISTER <= width)
        }));
        (self.rows, self.frames, self.made) = (rows, frames, 0..0);
        self.across.clear();
        self.across.resize(registers, (0, 0));
        let numbers = LINES * frames * self.columns.len() * REGISTER + LINE_BYTES / size_of::<f32>();
        self.between.resize(self.between.len().max(numbers), 0.0);
        self.aligned = self.between.as_ptr().align_offset(LINE_BYTES).min(LINE_BYTES / size_of::<f32>());
    }

    /// Gets ready for a row of R; makes the lines of it and of some after it, unless they are made.
    ///
    /// `frame` has the pixels of each of this stretch's frames.
    #[inline(always)]
    pub fn reach<'a, S: Simd, T: Copy + 'a>(
        &mut self,
        simd: S,
        resampler: &Resampler,
        row: usize,
        frame: impl Fn(usize) -> &'a [T],
        count: impl Fn(T) -> f32,
    ) {
        for (register, across) in (self.first..).zip(&mut self.across) {
            let (start, phase) = resampler.across_register(row as i64, register);
            *across = ((start - self.begin * REGISTER as i64) as usize, phase);
        }
        if self.made.contains(&row) {
            return;
        }
        self.made = row..self.rows.end.max(row + 1).min(row + LINES);
        let (made, begin) = (self.made.clone(), self.begin);
        let tile = |start: usize| -> [Lines<'_>; TILE] {
            std::array::from_fn(|index| Lines::new(resampler, &made, begin + (start + index) as i64))
        };
        let together = self.frames - self.frames % FRAMES_TOGETHER;
        let mut now = tile(0);
        for start in (0..self.columns.len()).step_by(TILE) {
            let later = tile(start + TILE);
            let registers = TILE.min(self.columns.len() - start);
            for first in (0..together).step_by(FRAMES_TOGETHER) {
                let many: [_; FRAMES_TOGETHER] = std::array::from_fn(|index| frame(first + index));
                for (index, lines) in now[..registers].iter().enumerate() {
                    self.down(simd, resampler, (start + index, lines), (first, many), &count);
                    if first == 0 {
                        later[index].prefetch();
                    }
                }
            }
            for first in together..self.frames {
                for (index, lines) in now[..registers].iter().enumerate() {
                    self.down(simd, resampler, (start + index, lines), (first, [frame(first)]), &count);
                }
            }
            now = later;
        }
    }

    /// Makes the values on the lines at a register of columns, for some frames.
    #[inline(always)]
    fn down<S: Simd, T: Copy, const FRAMES: usize>(
        &mut self,
        simd: S,
        resampler: &Resampler,
        (index, lines): (usize, &Lines<'_>),
        (first, frames): (usize, [&[T]; FRAMES]),
        count: &impl Fn(T) -> f32,
    ) {
        let rows = lines.rows();
        let needed = (rows.end - rows.start) as usize;
        self.pixels.resize(self.pixels.len().max(needed), Pixels::default());
        let pixels = &mut self.pixels[..needed];
        let place = Place { resampler, register: self.begin + index as i64, column: self.columns[index] };
        for (row, pixels) in rows.clone().zip(&mut *pixels) {
            place.pixels(row, frames, count, &mut pixels.0);
        }
        let registers = self.columns.len();
        let between = &mut self.between[self.aligned..];
        for (line, (top, weights)) in lines.lines[..lines.count].iter().enumerate() {
            let pixels = &pixels[(top - rows.start) as usize..];
            let Some(pixels) = pixels.first_chunk::<REGISTER_TAPS>() else { return };
            for lane in (0..REGISTER).step_by(S::F32_LANES) {
                let mut sums = [simd.splat_f32s(0.0); FRAMES];
                for (weights, pixels) in weights.0.iter().zip(pixels) {
                    let weight = load::<S>(weights, lane);
                    for (sum, pixels) in sums.iter_mut().zip(&pixels.0) {
                        *sum = simd.mul_add_e_f32s(weight, load::<S>(pixels, lane), *sum);
                    }
                }
                for (frame, sum) in sums.into_iter().enumerate() {
                    let register = (line * self.frames + first + frame) * registers + index;
                    let start = register * REGISTER + lane;
                    S::as_mut_simd_f32s(&mut between[start..start + S::F32_LANES]).0[0] = sum;
                }
            }
        }
    }

    /// The values of some frames of T in a row of R whose line is made, about the reference.
    ///
    /// `first` is the number of the first of them among the frames of this stretch; `numbers` has their rows at
    /// `starts`.
    #[inline(always)]
    pub fn row<S: Simd, const FRAMES: usize>(
        &self,
        simd: S,
        resampler: &Resampler,
        (row, first): (usize, usize),
        reference: &[f32],
        (numbers, starts): (&mut [f32], [usize; FRAMES]),
    ) {
        let columns = self.columns.len() * REGISTER;
        let line = ((row - self.made.start) * self.frames + first) * columns;
        let between = &self.between[self.aligned + line..][..FRAMES * columns];
        for ((index, reference), &(start, phase)) in reference.chunks(REGISTER).enumerate().zip(&self.across)
        {
            if first == 0 {
                let (_, phase) = resampler.across_register(row as i64 + 1, self.first + index as i64);
                prefetch(resampler.across_taps(phase).0.as_flattened());
            }
            let weights = &resampler.across_taps(phase).0;
            let pixels: [&[f32; NEEDED]; FRAMES] = std::array::from_fn(|frame| {
                between[frame * columns + start..].first_chunk().unwrap_or(&[0.0; NEEDED])
            });
            for lane in (0..REGISTER).step_by(S::F32_LANES) {
                let mut sums = [simd.splat_f32s(0.0); FRAMES];
                for (tap, weights) in weights.iter().enumerate() {
                    let weight = load::<S>(weights, lane);
                    for (sum, pixels) in sums.iter_mut().zip(pixels) {
                        *sum = simd.mul_add_e_f32s(weight, load::<S>(pixels, tap + lane), *sum);
                    }
                }
                for (sum, start) in sums.into_iter().zip(starts) {
                    let target = &mut numbers[start + index * REGISTER..][..reference.len()];
                    store_about(simd, sum, reference, lane, target);
                }
            }
        }
    }
}

/// Stores a register about the reference from a lane on, or as much of it as there is room for.
#[inline(always)]
fn store_about<S: Simd>(simd: S, values: S::f32s, reference: &[f32], lane: usize, target: &mut [f32]) {
    let lanes = lane..lane + S::F32_LANES;
    if let (Some(target), Some(reference)) = (target.get_mut(lanes.clone()), reference.get(lanes)) {
        S::as_mut_simd_f32s(target).0[0] = simd.sub_f32s(values, load::<S>(reference, 0));
        return;
    }
    let mut all = [0.0; REGISTER];
    S::as_mut_simd_f32s(&mut all[..S::F32_LANES]).0[0] = values;
    for ((target, zero), value) in target.iter_mut().zip(reference).skip(lane).zip(all) {
        *target = value - zero;
    }
}

/// Values between the passes that one register needs.
const NEEDED: usize = REGISTER + REGISTER_TAPS - 1;

#[inline(always)]
fn load<S: Simd>(numbers: &[f32], at: usize) -> S::f32s {
    S::as_simd_f32s(&numbers[at..at + S::F32_LANES]).0[0]
}

/// Where a register of flipped T's columns is on the sensor.
#[derive(Debug, Clone, Copy)]
struct Place<'a> {
    resampler: &'a Resampler,
    register: i64,
    /// Its first pixel in a row; none where some are beyond the sensor.
    column: Option<usize>,
}

impl Place<'_> {
    /// The pixels of some frames in a row of flipped T, in counts.
    #[inline(always)]
    fn pixels<T: Copy, const FRAMES: usize>(
        &self,
        row: i64,
        frames: [&[T]; FRAMES],
        count: &impl Fn(T) -> f32,
        pixels: &mut [[f32; REGISTER]; FRAMES_TOGETHER],
    ) {
        let [_, width] = self.resampler.size();
        let start = self.column.map(|column| self.resampler.sensor_row(row) * width + column);
        let flips = self.resampler.flips()[1];
        for (frame, pixels) in frames.iter().zip(pixels) {
            let raw = start.and_then(|start| frame.get(start..)?.first_chunk::<REGISTER>());
            match raw {
                None => self.pixels_at_the_edge(row, frame, count, pixels),
                Some(raw) if flips => *pixels = std::array::from_fn(|lane| count(raw[REGISTER - 1 - lane])),
                Some(raw) => *pixels = std::array::from_fn(|lane| count(raw[lane])),
            }
        }
    }

    /// The same where some are beyond the sensor: the nearest ones.
    #[cold]
    #[inline(never)]
    fn pixels_at_the_edge<T: Copy>(
        &self,
        row: i64,
        frame: &[T],
        count: &impl Fn(T) -> f32,
        pixels: &mut [f32; REGISTER],
    ) {
        let [_, width] = self.resampler.size();
        for (lane, pixel) in pixels.iter_mut().enumerate() {
            let column = self.register * REGISTER as i64 + lane as i64;
            let (row, column) = self.resampler.sensor(row, column);
            *pixel = count(frame[row * width + column]);
        }
    }
}
