//! Frames of camera T on the pixels of camera R, row by row, in two passes.
//!
//! One row of R is a slightly inclined line on T. The first pass makes the values on that line, at every column of T,
//! from [`TAPS`] rows; the second makes the values at the columns of R from as many of these. Columns are worked on in
//! registers: within one, the first of these pixels moves by at most one, so one tap more per register is enough and
//! no pixel is looked up by itself.
//!
//! In: the transform and how to interpolate; rows of T as the camera gave them. Out: rows on the pixels of R, in
//! counts of T per pixel of R.
//! Never: allocates after the first row on a thread, changes a value by whole-pixel shifts and mirrors.
//! Fails: [`TransformError`] for maps that are farther from a shift than registers can follow.

use super::interpolation::{Interpolation, PADDED_TAPS, TAPS, Weights};
use super::transform::{ReflectedFromTransmitted, TransformError};
use ndarray::Array2;
use pulp::Simd;
use std::ops::Range;

/// Columns of one register.
pub const REGISTER: usize = 16;

/// Taps of a register: those of a value, and one for a place where the first pixel moves on.
const REGISTER_TAPS: usize = TAPS + 1;

/// Most that a line may gain on its pixels from column to column, so that it gains less than a pixel in a register.
const STEEPEST: f64 = 0.06;

/// A place on T that grows evenly with column and row.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Line {
    per_column: f64,
    per_row: f64,
    at_zero: f64,
}

impl Line {
    #[inline(always)]
    fn at(&self, row: i64, column: i64) -> f64 {
        self.per_column * column as f64 + self.per_row * row as f64 + self.at_zero
    }
}

/// Brings T onto R; made once for a transform.
#[derive(Debug, Clone, PartialEq)]
pub struct Resampler {
    height: usize,
    width: usize,
    flips: [bool; 2],
    /// Row of flipped T at a row of R and a column of flipped T.
    down: Line,
    /// Column of flipped T at a row and a column of R.
    across: Line,
    weights: Weights,
    /// The same times the pixels of T that one pixel of R covers, so that all light of a spot arrives.
    light: Weights,
}

/// The weights of one register of columns.
#[derive(Debug, Clone, Copy, Default)]
struct RegisterTaps {
    first: i64,
    weights: [[f32; REGISTER]; REGISTER_TAPS],
}

/// The weights of a stretch of one row, and memory for the values between the passes.
#[derive(Debug, Default)]
pub struct RowTaps {
    down: Vec<RegisterTaps>,
    across: Vec<RegisterTaps>,
    /// The column of flipped T at which the values between the passes begin.
    begin: i64,
    between: Vec<f32>,
}

impl Resampler {
    /// Weights for a transform between frames of its size.
    ///
    /// # Errors
    /// [`TransformError`] when the transform is farther from a mirror and a shift than can be followed.
    pub fn new(
        transform: &ReflectedFromTransmitted,
        interpolation: Interpolation,
    ) -> Result<Self, TransformError> {
        let inverse = transform.affine.inverse().ok_or(TransformError::Singular)?;
        let [[yy, yx], [xy, xx]] = inverse.matrix;
        let too_far = || TransformError::TooFar {
            rotation_deg: transform.rotation_deg(),
            stretch_percent: 100.0 * (xx - 1.0).abs().max((yy - 1.0).abs()),
        };
        if !(xx - 1.0).abs().max((yy - 1.0).abs()).max(xy.abs()).max(yx.abs()).le(&STEEPEST) {
            return Err(too_far());
        }
        // At column j of T, a row of R has x = (j - xy * y - shift) / xx.
        let slope = yx / xx;
        if slope.abs() > STEEPEST {
            return Err(too_far());
        }
        let covered = (xx * yy - xy * yx).abs();
        Ok(Self {
            height: transform.size[0],
            width: transform.size[1],
            flips: transform.mirror.flips(),
            down: Line {
                per_column: slope,
                per_row: yy - slope * xy,
                at_zero: inverse.shift[0] - slope * inverse.shift[1],
            },
            across: Line { per_column: xx, per_row: xy, at_zero: inverse.shift[1] },
            weights: Weights::new(interpolation, 1.0),
            light: Weights::new(interpolation, if interpolation.is_unbiased() { covered } else { 1.0 }),
        })
    }

    /// Height and width of the frames, pixels.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        [self.height, self.width]
    }

    /// First column of flipped T, and weights, of a pixel of R; the columns are those of the line of its row.
    #[inline(always)]
    #[must_use]
    pub fn across(&self, row: i64, column: i64) -> (i64, &[f32; TAPS]) {
        self.light.at(self.across.at(row, column))
    }

    /// First row of flipped T, and weights, of the line of a row of R at a column of flipped T.
    #[inline(always)]
    #[must_use]
    pub fn down(&self, row: i64, flipped_column: i64) -> (i64, &[f32; TAPS]) {
        self.weights.at(self.down.at(row, flipped_column))
    }

    /// First column of flipped T for a pixel of R, and the phase that tells its [`across_weights`](Self::across_weights).
    #[inline(always)]
    #[must_use]
    pub fn across_place(&self, row: i64, column: i64) -> (i64, usize) {
        Weights::place(self.across.at(row, column))
    }

    /// First row of flipped T for the line of a row of R at a column of flipped T, and the phase that tells its
    /// [`down_weights`](Self::down_weights).
    #[inline(always)]
    #[must_use]
    pub fn down_place(&self, row: i64, flipped_column: i64) -> (i64, usize) {
        Weights::place(self.down.at(row, flipped_column))
    }

    /// Weights of [`TAPS`] columns from the first one on, between as many zeros on both sides.
    #[inline(always)]
    #[must_use]
    pub fn across_weights(&self, phase: usize) -> &[f32; PADDED_TAPS] {
        self.light.padded(phase)
    }

    /// Weights of [`TAPS`] rows from the first one on, between as many zeros on both sides.
    #[inline(always)]
    #[must_use]
    pub fn down_weights(&self, phase: usize) -> &[f32; PADDED_TAPS] {
        self.weights.padded(phase)
    }

    /// Row and column of T for those of flipped T, the nearest ones of the sensor.
    #[inline(always)]
    #[must_use]
    pub fn sensor(&self, row: i64, column: i64) -> (usize, usize) {
        (onto(row, self.height, self.flips[0]), onto(column, self.width, self.flips[1]))
    }

    /// Row and column of T nearest to a pixel of R.
    #[inline(always)]
    #[must_use]
    pub fn nearest(&self, row: usize, column: usize) -> (usize, usize) {
        let x = self.across.at(row as i64, column as i64);
        let column = x.round() as i64;
        self.sensor(self.down.at(row as i64, column).round() as i64, column)
    }

    /// Pixels of R for which a pixel of T outside its sensor, or one that is masked, would be needed.
    #[must_use]
    pub fn missing(&self, masked: Option<&Array2<bool>>) -> Option<Array2<bool>> {
        let missing = Array2::from_shape_fn((self.height, self.width), |(y, x)| {
            self.needs(y as i64, x as i64, &|row, column| {
                !(0..self.height as i64).contains(&row)
                    || !(0..self.width as i64).contains(&column)
                    || masked.is_some_and(|masked| masked[self.sensor(row, column)])
            })
        });
        missing.iter().any(|&missing| missing).then_some(missing)
    }

    /// Whether any pixel of flipped T that a pixel of R needs is of that kind.
    fn needs(&self, y: i64, x: i64, is: &impl Fn(i64, i64) -> bool) -> bool {
        let (first_column, across) = self.across(y, x);
        (first_column..).zip(across).filter(|(_, weight)| **weight != 0.0).any(|(column, _)| {
            let (first_row, down) = self.down(y, column);
            (first_row..).zip(down).any(|(row, weight)| *weight != 0.0 && is(row, column))
        })
    }

    /// Puts the weights for a row of R and `registers` registers from a column on into `taps`.
    #[inline(always)]
    pub fn prepare(&self, row: i64, column: usize, registers: usize, taps: &mut RowTaps) {
        let columns = (column as i64..).step_by(REGISTER).take(registers);
        taps.across.clear();
        for x in columns {
            taps.across.push(register(&self.light, |lane| self.across.at(row, x + lane), 1));
        }
        let begin = taps.across.first().map_or(0, |first| first.first);
        let end = taps.across.last().map_or(0, |last| last.first) + (TAPS + REGISTER) as i64;
        taps.begin = begin;
        taps.down.clear();
        for j in (begin..end).step_by(REGISTER) {
            // Pixels are read in the order of the sensor; where that is flipped, so are the lanes.
            let (first, step) = if self.flips[1] { (j + REGISTER as i64 - 1, -1) } else { (j, 1) };
            taps.down.push(register(&self.weights, |lane| self.down.at(row, first + step * lane), 0));
        }
        taps.between.resize(taps.down.len() * REGISTER, 0.0);
    }

    /// The values of a frame of T where `taps` was prepared for; `count` gives the counts of a pixel.
    #[inline(always)]
    pub fn row<S: Simd, T: Copy>(
        &self,
        simd: S,
        taps: &mut RowTaps,
        frame: &[T],
        count: impl Fn(T) -> f32,
        values: &mut [f32],
    ) {
        let RowTaps { down, across, begin, between } = taps;
        let (between_registers, _) = between.as_chunks_mut::<REGISTER>();
        for ((taps, between), j) in down.iter().zip(between_registers).zip((*begin..).step_by(REGISTER)) {
            let mut sums = zeros(simd);
            match self.columns(j).zip(self.rows(taps)) {
                Some((column, rows)) => {
                    // The weights follow the rows of flipped T, the lines those of the sensor.
                    let (mut line, step) = if self.flips[0] {
                        ((rows.end - 1) * self.width + column, self.width.wrapping_neg())
                    } else {
                        (rows.start * self.width + column, self.width)
                    };
                    for weights in &taps.weights {
                        if let Some(raw) = frame.get(line..).and_then(|raw| raw.first_chunk::<REGISTER>()) {
                            add_weighted(simd, &mut sums, weights, &converted(raw, &count));
                        }
                        line = line.wrapping_add(step);
                    }
                }
                None => {
                    for (row, weights) in (taps.first..).zip(&taps.weights) {
                        let pixels = std::array::from_fn(|lane| {
                            let lane = if self.flips[1] { REGISTER - 1 - lane } else { lane };
                            let (row, column) = self.sensor(row, j + lane as i64);
                            count(frame[row * self.width + column])
                        });
                        add_weighted(simd, &mut sums, weights, &pixels);
                    }
                }
            }
            store(simd, &sums, between);
            if self.flips[1] {
                between.reverse();
            }
        }
        for (taps, values) in across.iter().zip(values.chunks_mut(REGISTER)) {
            let mut sums = zeros(simd);
            let start = (taps.first - *begin) as usize;
            if let Some(between) = between[start..].first_chunk::<{ REGISTER + REGISTER_TAPS - 1 }>() {
                for (tap, weights) in taps.weights.iter().enumerate() {
                    if let Some(between) = between[tap..].first_chunk::<REGISTER>() {
                        add_weighted(simd, &mut sums, weights, between);
                    }
                }
            }
            let mut register = [0.0; REGISTER];
            store(simd, &sums, &mut register);
            match values.first_chunk_mut::<REGISTER>() {
                Some(values) => *values = register,
                None => values.copy_from_slice(&register[..values.len()]),
            }
        }
    }

    /// Rows of the sensor that a register needs, if all are there.
    #[inline(always)]
    fn rows(&self, taps: &RegisterTaps) -> Option<Range<usize>> {
        let first = usize::try_from(taps.first).ok()?;
        let end = first + REGISTER_TAPS;
        match self.flips[0] {
            _ if end > self.height => None,
            true => Some(self.height - end..self.height - first),
            false => Some(first..end),
        }
    }

    /// First column of the sensor of a register of flipped T, if all are there.
    #[inline(always)]
    fn columns(&self, j: i64) -> Option<usize> {
        let start = if self.flips[1] { self.width as i64 - REGISTER as i64 - j } else { j };
        usize::try_from(start).ok().filter(|start| start + REGISTER <= self.width)
    }
}

/// A register of pixels in counts.
#[inline(always)]
fn converted<T: Copy>(raw: &[T; REGISTER], count: &impl Fn(T) -> f32) -> [f32; REGISTER] {
    let mut pixels = [0.0; REGISTER];
    for (pixel, raw) in pixels.iter_mut().zip(raw) {
        *pixel = count(*raw);
    }
    pixels
}

/// The vectors of one register; those beyond it are not used.
type Vectors<S> = [<S as Simd>::f32s; MOST_VECTORS];

/// Vectors of a register where they are shortest.
const MOST_VECTORS: usize = 4;

#[inline(always)]
fn zeros<S: Simd>(simd: S) -> Vectors<S> {
    [simd.splat_f32s(0.0); MOST_VECTORS]
}

#[inline(always)]
fn add_weighted<S: Simd>(
    simd: S,
    sums: &mut Vectors<S>,
    weights: &[f32; REGISTER],
    pixels: &[f32; REGISTER],
) {
    let (weights, pixels) = (S::as_simd_f32s(weights).0, S::as_simd_f32s(pixels).0);
    for ((sum, weight), pixel) in sums.iter_mut().zip(weights).zip(pixels) {
        *sum = simd.mul_add_e_f32s(*weight, *pixel, *sum);
    }
}

#[inline(always)]
fn store<S: Simd>(_: S, sums: &Vectors<S>, register: &mut [f32; REGISTER]) {
    for (target, sum) in S::as_mut_simd_f32s(register).0.iter_mut().zip(sums) {
        *target = *sum;
    }
}

/// The pixel of the sensor, the nearest one for those outside.
#[inline(always)]
fn onto(flipped: i64, side: usize, flips: bool) -> usize {
    let inside = flipped.clamp(0, side as i64 - 1) as usize;
    if flips { side - 1 - inside } else { inside }
}

/// Taps of all lanes with one first pixel; from lane to lane the pixels move on by `step`.
#[inline(always)]
fn register(weights: &Weights, place: impl Fn(i64) -> f64, step: i64) -> RegisterTaps {
    let mut places = [(0, 0); REGISTER];
    for (lane, place_of_lane) in (0..).zip(&mut places) {
        let (first, phase) = Weights::place(place(lane));
        *place_of_lane = (first - step * lane, phase);
    }
    let first = places.iter().fold(i64::MAX, |least, (first, _)| least.min(*first));
    let mut register = RegisterTaps { first, ..RegisterTaps::default() };
    for (lane, (own, phase)) in places.into_iter().enumerate() {
        // Lanes whose pixels have moved on begin with one of the zeros before the weights.
        let late = ((own - first) as usize).min(REGISTER_TAPS - TAPS);
        let taps = &weights.padded(phase)[TAPS - late..];
        for (register, weight) in register.weights.iter_mut().zip(taps) {
            register[lane] = *weight;
        }
    }
    register
}

#[cfg(test)]
mod tests {
    use super::super::transform::{Affine, Mirror};
    use super::*;
    use proptest::prelude::*;

    fn resampled(resampler: &Resampler, frame: &[u16]) -> Vec<f32> {
        let [height, width] = resampler.size();
        let mut all = Vec::new();
        let mut taps = RowTaps::default();
        for y in 0..height {
            let mut row = vec![0.0; width];
            resampler.prepare(y as i64, 0, width.div_ceil(REGISTER), &mut taps);
            resampler.row(pulp::Scalar128b, &mut taps, frame, f32::from, &mut row);
            all.extend(row);
        }
        all
    }

    fn map(matrix: [[f64; 2]; 2], shift: [f64; 2], mirror: Mirror) -> ReflectedFromTransmitted {
        ReflectedFromTransmitted { mirror, affine: Affine { matrix, shift }, size: [37, 53] }
    }

    fn noise(pixels: usize) -> Vec<u16> {
        (0..pixels as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 20) as u16).collect()
    }

    #[test]
    fn whole_pixels_and_mirrors_are_exact() {
        let frame = noise(37 * 53);
        for (_, mirror) in Mirror::NAMES {
            let map = map(Affine::IDENTITY.matrix, [5.0, -7.0], mirror);
            for (_, way) in Interpolation::NAMES {
                let resampler = Resampler::new(&map, way).unwrap();
                let (image, missing) = (resampled(&resampler, &frame), resampler.missing(None).unwrap());
                for ((y, x), &missing) in missing.indexed_iter() {
                    let [ty, tx] = map.undo([y as f64, x as f64]).unwrap();
                    let inside = (0.0..37.0).contains(&ty) && (0.0..53.0).contains(&tx);
                    assert_eq!(inside, !missing, "{mirror:?} {y} {x}");
                    if inside {
                        assert_eq!(image[y * 53 + x], f32::from(frame[ty as usize * 53 + tx as usize]));
                    }
                }
            }
        }
    }

    #[test]
    fn what_cannot_be_followed_is_refused() {
        let turned = map([[1.0, 0.1], [-0.1, 1.0]], [0.0; 2], Mirror::None);
        assert!(matches!(
            Resampler::new(&turned, Interpolation::default()),
            Err(TransformError::TooFar { .. })
        ));
    }

    proptest! {
        #[test]
        fn registers_give_what_single_pixels_give(
            turn in -0.035..0.035, scale in 0.98..1.02, y in -30.0..30.0, x in -30.0..30.0, mirror in 0..4usize
        ) {
            let frame = noise(37 * 53);
            let map = map([[scale, turn], [-turn, scale]], [y, x], Mirror::NAMES[mirror].1);
            let resampler = Resampler::new(&map, Interpolation::UnbiasedSinc).unwrap();
            let image = resampled(&resampler, &frame);
            for y in 0..37_i64 {
                for x in 0..53_i64 {
                    let (first_column, across) = resampler.across(y, x);
                    let mut value = 0.0;
                    for (column, a) in (first_column..).zip(across) {
                        let (first_row, down) = resampler.down(y, column);
                        for (row, d) in (first_row..).zip(down) {
                            let (row, column) = resampler.sensor(row, column);
                            value += f64::from(a * d) * f64::from(frame[row * 53 + column]);
                        }
                    }
                    let got = f64::from(image[(y * 53 + x) as usize]);
                    prop_assert!((got - value).abs() < 0.01, "{} {}: {} {}", y, x, got, value);
                }
            }
        }

        #[test]
        fn light_lands_where_it_belongs(

            turn in -0.035..0.035, scale in 0.98..1.02, y in -4.0..4.0, x in -4.0..4.0, mirror in 0..4usize
        ) {
            let map = map([[scale, turn], [-turn, scale]], [y, x], Mirror::NAMES[mirror].1);
            let spot = |[y, x]: [f64; 2]| {
                let squared = (y - 18.3).powi(2) + (x - 26.6).powi(2);
                1000.0 + 20_000.0 * libm::exp(-squared / (2.0 * 1.3 * 1.3))
            };
            let frame: Vec<u16> = (0..37 * 53)
                .map(|at| spot(map.apply([(at / 53) as f64, (at % 53) as f64])).round() as u16)
                .collect();
            let resampler = Resampler::new(&map, Interpolation::UnbiasedSinc).unwrap();
            let (image, missing) = (resampled(&resampler, &frame), resampler.missing(None));
            for y in 0..37 {
                for x in 0..53 {
                    if missing.as_ref().is_none_or(|missing| !missing[[y, x]]) {
                        let wanted = spot([y as f64, x as f64]) / (scale * scale + turn * turn);
                        let got = f64::from(image[y * 53 + x]);
                        prop_assert!((got - wanted).abs() < 150.0, "{} {}: {} {}", y, x, got, wanted);
                    }
                }
            }
        }
    }
}
