//! Where the values of camera T come from on the pixels of camera R.
//!
//! One row of R is a slightly inclined line on T. Values on that line, at every column of T, are made from [`TAPS`]
//! rows; values at the columns of R from as many of these. Columns are worked on in registers: within one, places
//! gain evenly on whole pixels and the first pixel moves by at most one, so one tap more per register is enough, no
//! pixel is looked up by itself, and the phase of a register's first column tells all its weights.
//!
//! In: the transform and how to interpolate. Out: pixels of T and their weights for every pixel of R, in counts of T
//! per pixel of R; [`Stretch`](super::Stretch) puts them to work.
//! Never: changes a value by whole-pixel shifts and mirrors.
//! Fails: [`TransformError`] for maps that are farther from a shift than registers can follow.

use super::interpolation::{Interpolation, PADDED_TAPS, PHASES, TAPS, Weights};
use super::transform::{ReflectedFromTransmitted, TransformError};
use ndarray::Array2;

/// Columns of one register.
pub const REGISTER: usize = 16;

/// Taps of a register: those of a value, and one for a place where the first pixel moves on.
pub(super) const REGISTER_TAPS: usize = TAPS + 1;

/// Most that a line may gain on its pixels from column to column, so that it gains less than a pixel in a register.
const STEEPEST: f64 = 0.06;

/// A place on T that grows evenly with column and row.
#[derive(Debug, Clone, PartialEq)]
struct Line {
    per_column: f64,
    per_row: f64,
    at_zero: f64,
    /// Whole pixels from column to column.
    step: i64,
    /// Phases that each column of a register has gained on whole pixels since its first one.
    gains: [i64; REGISTER],
    /// The least of them.
    least: i64,
}

impl Line {
    fn new(per_column: f64, per_row: f64, at_zero: f64, step: i64) -> Self {
        let gain = (per_column - step as f64) * PHASES as f64;
        let gains = std::array::from_fn(|lane| (gain * lane as f64).round() as i64);
        let least = gains[0].min(gains[REGISTER - 1]);
        Self { per_column, per_row, at_zero, step, gains, least }
    }

    #[inline(always)]
    fn at(&self, row: i64, column: i64) -> f64 {
        self.per_column * column as f64 + self.per_row * row as f64 + self.at_zero
    }

    /// First pixel and phase of the first column of a register.
    #[inline(always)]
    fn register(&self, row: i64, register: i64) -> (i64, usize) {
        Weights::place(self.at(row, register * REGISTER as i64))
    }

    /// First pixel that any column of a register needs, and the phase of its first column.
    #[inline(always)]
    fn needed(&self, row: i64, register: i64) -> (i64, usize) {
        let (first, phase) = self.register(row, register);
        (first + after(phase, self.least).0, phase)
    }

    /// First pixel and phase of a column.
    #[inline(always)]
    fn place(&self, row: i64, column: i64) -> (i64, usize) {
        const COLUMNS: i64 = REGISTER as i64;
        let lane = column.rem_euclid(COLUMNS);
        let (first, phase) = self.register(row, column.div_euclid(COLUMNS));
        let (gained, phase) = after(phase, self.gains[lane as usize]);
        (first + self.step * lane + gained, phase)
    }
}

/// Whole pixels and the phase that remains when a phase has gained some.
#[inline(always)]
fn after(phase: usize, gain: i64) -> (i64, usize) {
    let phases = phase as i64 + gain;
    (phases.div_euclid(PHASES as i64), phases.rem_euclid(PHASES as i64) as usize)
}

/// The weights of all columns of a register; on cache lines, as those across two of them take twice the time.
#[derive(Debug, Clone, Default, PartialEq)]
#[repr(C, align(64))]
pub(super) struct RegisterTaps(pub(super) [[f32; REGISTER]; REGISTER_TAPS]);

/// The weights of every register by the phase of its first column.
fn register_taps(line: &Line, weights: &Weights) -> Vec<RegisterTaps> {
    let taps = |phase: usize| {
        let (first, mut register) = (after(phase, line.least).0, RegisterTaps::default());
        for (lane, gain) in line.gains.into_iter().enumerate() {
            let (gained, phase) = after(phase, gain);
            // Lanes whose pixels have moved on begin with one of the zeros before the weights.
            let taps = &weights.padded(phase)[TAPS - (gained - first) as usize..][..REGISTER_TAPS];
            for (register, weight) in register.0.iter_mut().zip(taps) {
                register[lane] = *weight;
            }
        }
        register
    };
    (0..PHASES).map(taps).collect()
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
    down_taps: Vec<RegisterTaps>,
    across_taps: Vec<RegisterTaps>,
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
        let flips = transform.mirror.flips();
        let covered = (xx * yy - xy * yx).abs();
        let down = Line::new(slope, yy - slope * xy, inverse.shift[0] - slope * inverse.shift[1], 0);
        let across = Line::new(xx, xy, inverse.shift[1], 1);
        let weights = Weights::new(interpolation, 1.0);
        let light = Weights::new(interpolation, if interpolation.is_unbiased() { covered } else { 1.0 });
        Ok(Self {
            height: transform.size[0],
            width: transform.size[1],
            flips,
            down_taps: register_taps(&down, &weights),
            across_taps: register_taps(&across, &light),
            down,
            across,
            weights,
            light,
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
        let (first, phase) = self.across_place(row, column);
        (first, self.light.of_phase(phase))
    }

    /// First row of flipped T, and weights, of the line of a row of R at a column of flipped T.
    #[inline(always)]
    #[must_use]
    pub fn down(&self, row: i64, flipped_column: i64) -> (i64, &[f32; TAPS]) {
        let (first, phase) = self.down_place(row, flipped_column);
        (first, self.weights.of_phase(phase))
    }

    /// First column of flipped T for a pixel of R, and the phase that tells its [`across_weights`](Self::across_weights).
    #[inline(always)]
    #[must_use]
    pub fn across_place(&self, row: i64, column: i64) -> (i64, usize) {
        self.across.place(row, column)
    }

    /// First row of flipped T for the line of a row of R at a column of flipped T, and the phase that tells its
    /// [`down_weights`](Self::down_weights).
    #[inline(always)]
    #[must_use]
    pub fn down_place(&self, row: i64, flipped_column: i64) -> (i64, usize) {
        self.down.place(row, flipped_column)
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

    /// Row of T for that of flipped T, the nearest one of the sensor.
    #[inline(always)]
    pub(super) fn sensor_row(&self, row: i64) -> usize {
        onto(row, self.height, self.flips[0])
    }

    /// Row and column of T nearest to a pixel of R.
    #[inline(always)]
    #[must_use]
    pub fn nearest(&self, row: usize, column: usize) -> (usize, usize) {
        let column = rounded(self.across.at(row as i64, column as i64));
        self.sensor(rounded(self.down.at(row as i64, column)), column)
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

    /// First column of flipped T that a register of R's columns needs, and the phase of its weights.
    #[inline(always)]
    pub(super) fn across_register(&self, row: i64, register: i64) -> (i64, usize) {
        self.across.needed(row, register)
    }

    /// First row of flipped T that the line of a row of R needs in a register of flipped T's columns, and the phase
    /// of its weights.
    #[inline(always)]
    pub(super) fn down_register(&self, row: i64, register: i64) -> (i64, usize) {
        self.down.needed(row, register)
    }

    /// The weights of registers of R's columns by phase.
    #[inline(always)]
    pub(super) fn across_taps(&self, phase: usize) -> &RegisterTaps {
        &self.across_taps[phase]
    }

    /// The weights of registers of flipped T's columns by phase.
    #[inline(always)]
    pub(super) fn down_taps(&self, phase: usize) -> &RegisterTaps {
        &self.down_taps[phase]
    }

    /// Whether rows and columns of T are counted backwards.
    #[inline(always)]
    pub(super) fn flips(&self) -> [bool; 2] {
        self.flips
    }
}

/// The nearest whole number, without the call that it is where registers are narrow.
#[inline(always)]
fn rounded(place: f64) -> i64 {
    let place = place + 0.5;
    let toward_zero = place as i64;
    toward_zero - i64::from(place < toward_zero as f64)
}

/// The pixel of the sensor, the nearest one for those outside.
#[inline(always)]
fn onto(flipped: i64, side: usize, flips: bool) -> usize {
    let inside = flipped.clamp(0, side as i64 - 1) as usize;
    if flips { side - 1 - inside } else { inside }
}

#[cfg(test)]
mod tests {
    use super::super::Stretch;
    use super::super::transform::{Affine, Mirror};
    use super::*;
    use proptest::prelude::*;

    fn resampled(resampler: &Resampler, frame: &[u16]) -> Vec<f32> {
        let [height, width] = resampler.size();
        let mut all = Vec::new();
        let mut stretch = Stretch::default();
        stretch.begin(resampler, 0..height, (0, width.div_ceil(REGISTER)), 1);
        for y in 0..height {
            let (mut row, reference) = (vec![0.0; width], vec![0.0; width]);
            stretch.reach(pulp::Scalar128b, resampler, y, |_| frame, f32::from);
            stretch.row(pulp::Scalar128b, resampler, (y, 0), &reference, (&mut row[..], [0]));
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
