//! Camera rows of a few exposures as `f32` about the reference, only as many as the products of one row need.
//!
//! Products of one camera row need the rows above and below it. A ring holds just these, for a strip of columns and
//! a few exposures, so that it takes little of the second-level cache; when work moves down by one row, the next
//! row is converted into the place of the one that is no longer needed.
//!
//! In: pixels as the cameras gave them, the reference. Out: rows of numbers, zero outside the camera region.

use super::kernel::{Block, Count, Planes};
use super::plan::{Element, Halo, Plan};
use super::registered::TRANSMITTED;
use crate::sofi::prefetch::{LINE_BYTES, prefetch};
use crate::sofi::registration::{FRAMES_TOGETHER, LINES, REGISTER, Resampler, Stretch, TAPS};
use pulp::Simd;
use std::ops::Range;

/// Columns kept on either side of a strip: one register, so that they are converted like all others.
const PADDING: usize = LINE_BYTES / size_of::<f32>();

/// Where numbers are in a ring: exposure, then plane, then row, then column.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape {
    /// Distance between exposures.
    pub(super) frame: usize,
    /// Distance between the planes of one exposure.
    pub(super) plane: usize,
    row: usize,
    /// Columns of a strip.
    columns: usize,
    /// Rows that are kept.
    depth: usize,
    halo: Halo,
    channels: usize,
}

impl Shape {
    pub(super) fn new(plan: &Plan, columns: usize) -> Self {
        let halo = plan.halo;
        debug_assert!(halo.left.max(halo.right) <= PADDING, "all columns that products need are kept");
        let (row, depth, channels) =
            (columns + 2 * PADDING, halo.up + 1 + halo.down, plan.algebra.channels());
        let plane = row * depth;
        Self { frame: plane * plan.lags.len() * channels, plane, row, columns, depth, halo, channels }
    }

    /// Numbers of memory that hold this many exposures, wherever that memory begins.
    pub(super) fn numbers(&self, frames: usize) -> usize {
        self.frame * frames + PADDING
    }

    /// Columns of a strip.
    #[inline(always)]
    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    /// Channels of every exposure.
    #[inline(always)]
    pub(super) fn channels(&self) -> usize {
        self.channels
    }

    /// The ways in which the ring can be turned.
    pub(super) fn turns(&self) -> usize {
        self.depth
    }

    /// How the ring is turned when products are summed at this row of a band.
    #[inline(always)]
    pub(super) fn turn_at(&self, row: usize) -> usize {
        row % self.depth
    }

    /// Distance of the row `dy` below the one that is summed, at its first pixel, from the beginning of its plane.
    #[inline(always)]
    pub(super) fn line(&self, turn: usize, dy: isize) -> usize {
        (turn + self.halo.up).wrapping_add_signed(dy) % self.depth * self.row + PADDING
    }

    /// Distance of an element of a term, seen from the first pixel of a row, from the beginning of its exposure.
    pub(super) fn element(&self, turn: usize, element: &Element) -> usize {
        let line = self.line(turn, element.dy as isize) + element.lag * self.channels * self.plane;
        line.wrapping_add_signed(element.dx as isize)
    }
}

/// Part of a band with some of a block's samples.
pub(super) struct Part<'a, T> {
    pub(super) rows: Range<usize>,
    /// Columns of the padded rows.
    pub(super) columns: Range<usize>,
    pub(super) samples: &'a [Planes<'a, T>],
}

/// Rows of T that the first lines of a part need.
const FIRST_ROWS: usize = LINES + TAPS;

/// The memory of a ring, beginning on a cache line.
pub(super) fn aligned(memory: &mut Vec<f32>, numbers: usize) -> &mut [f32] {
    memory.resize(memory.len().max(numbers), 0.0);
    let unaligned = memory.as_ptr().align_offset(LINE_BYTES).min(PADDING);
    &mut memory[unaligned..]
}

impl<T: Count> Part<'_, T> {
    /// Lines that products of this part need: its rows, and those above and below.
    #[inline(always)]
    fn lines(&self, block: &Block<'_, T>) -> usize {
        self.rows.len() + block.plan.halo.up + block.plan.halo.down
    }

    /// The camera row of a line; `None` outside the camera region.
    #[inline(always)]
    fn camera_row(&self, block: &Block<'_, T>, line: usize) -> Option<usize> {
        (self.rows.start + line).checked_sub(block.plan.halo.up).filter(|&y| y < block.layout.height)
    }

    /// Columns that are converted: those of the strip and some beside it.
    #[inline(always)]
    fn padded(&self, block: &Block<'_, T>) -> Range<usize> {
        self.columns.start.saturating_sub(PADDING)..block.layout.width.min(self.columns.end + PADDING)
    }

    /// Asks for the pixels of a line.
    ///
    /// Those beside the strip lie on the next cache line; the strip before has asked for the first one.
    #[inline(always)]
    fn prefetch_line(&self, block: &Block<'_, T>, line: usize) {
        let (Some(y), width) = (self.camera_row(block, line), block.layout.width) else { return };
        let beside = LINE_BYTES / size_of::<T>();
        let end = width.min(self.columns.end + beside);
        let start = if self.columns.start == 0 { 0 } else { end.min(self.columns.start + beside) };
        let is_resampled =
            |index: usize| block.resampler.is_some() && index % block.shape.channels == TRANSMITTED;
        for sample in self.samples {
            for (_, pixels) in sample.iter().enumerate().filter(|(index, _)| !is_resampled(*index)) {
                prefetch(&pixels[y * width + start..y * width + end]);
            }
        }
    }

    /// Asks for the pixels of T around those of a row of R.
    #[inline(always)]
    fn prefetch_partner(&self, block: &Block<'_, T>, resampler: &Resampler, y: usize) {
        let beside = LINE_BYTES / size_of::<T>();
        let columns = self.padded(block);
        for x in (columns.start..columns.end + beside).step_by(beside) {
            let (row, column) = resampler.nearest(y, x);
            let pixel = row * block.layout.width + column;
            for sample in self.samples {
                for lag in 0..block.plan.lags.len() {
                    prefetch(&sample[lag * block.shape.channels + TRANSMITTED][pixel..pixel + 1]);
                }
            }
        }
    }
}

/// Converts the lines that the first row of a part needs, but for the last of them.
#[inline(always)]
pub(super) fn begin<S: Simd, T: Count>(
    simd: S,
    block: &Block<'_, T>,
    part: &Part<'_, T>,
    stretch: &mut Stretch,
    numbers: &mut [f32],
) {
    if let Some(resampler) = block.resampler {
        let Halo { up, down, .. } = block.plan.halo;
        let rows = part.rows.start.saturating_sub(up)..block.layout.height.min(part.rows.end + down);
        let columns = part.padded(block);
        let registers = (columns.start, columns.len().div_ceil(REGISTER));
        stretch.begin(resampler, rows, registers, part.samples.len() * block.plan.lags.len());
    }
    for line in 0..block.plan.halo.up + block.plan.halo.down {
        convert_line(simd, block, part, line, stretch, numbers);
    }
}

/// Converts the last line that products at `row` need, and asks for the pixels that are converted after it.
#[inline(always)]
pub(super) fn advance<S: Simd, T: Count>(
    simd: S,
    block: &Block<'_, T>,
    (part, next): (&Part<'_, T>, Option<&Part<'_, T>>),
    row: usize,
    stretch: &mut Stretch,
    numbers: &mut [f32],
) {
    let before = block.plan.halo.up + block.plan.halo.down;
    let line = row + before;
    if line + 1 < part.lines(block) {
        part.prefetch_line(block, line + 1);
    } else if let Some(next) = next {
        for line in 0..=before {
            next.prefetch_line(block, line);
        }
    }
    if let Some(resampler) = block.resampler {
        if line + LINES < part.lines(block) {
            part.prefetch_partner(block, resampler, part.rows.start + row + LINES + TAPS / 2 + 1);
        }
        if let Some(next) = next {
            let rows = [row, row + 1].map(|row| row * FIRST_ROWS / part.rows.len());
            for ahead in rows[0]..rows[1] {
                let y = (next.rows.start + ahead).saturating_sub(TAPS / 2);
                next.prefetch_partner(block, resampler, y);
            }
        }
    }
    convert_line(simd, block, part, line, stretch, numbers);
}

/// Converts one row of a part, lines counted from the first one above it; zero outside the camera region.
#[inline(always)]
fn convert_line<S: Simd, T: Count>(
    simd: S,
    block: &Block<'_, T>,
    part: &Part<'_, T>,
    line: usize,
    stretch: &mut Stretch,
    numbers: &mut [f32],
) {
    let (shape, layout) = (&block.shape, block.layout);
    let (y, columns) = match part.camera_row(block, line) {
        Some(y) => (y, part.padded(block)),
        None => (0, 0..0),
    };
    let left = (columns.start + PADDING).saturating_sub(part.columns.start);
    let start = line % shape.depth * shape.row;
    let resampler = block.resampler.filter(|_| !columns.is_empty());
    for (sample, frame) in part.samples.iter().zip((start..).step_by(shape.frame)) {
        for (index, (pixels, start)) in sample.iter().zip((frame..).step_by(shape.plane)).enumerate() {
            let (before, target) = numbers[start..start + shape.row].split_at_mut(left);
            let (target, behind) = target.split_at_mut(columns.len());
            before.fill(0.0);
            behind.fill(0.0);
            let channel = index % shape.channels;
            if resampler.is_none() || channel != TRANSMITTED {
                let reference = &block.reference[channel][y * layout.stride..][columns.clone()];
                subtract(target, &pixels[y * layout.width..][columns.clone()], reference);
            }
        }
    }
    if let Some(resampler) = resampler {
        let reference = &block.reference[TRANSMITTED][y * layout.stride..][columns];
        let lags = block.plan.lags.len();
        let plane = |lag: usize| lag * shape.channels + TRANSMITTED;
        let target =
            |frame: usize| start + left + frame / lags * shape.frame + plane(frame % lags) * shape.plane;
        let pixels = |frame: usize| part.samples[frame / lags][plane(frame % lags)];
        stretch.reach(simd, resampler, y, pixels, T::counts);
        let frames = part.samples.len() * lags;
        let together = frames - frames % FRAMES_TOGETHER;
        for first in (0..together).step_by(FRAMES_TOGETHER) {
            let targets: [_; FRAMES_TOGETHER] = std::array::from_fn(|frame| target(first + frame));
            stretch.row(simd, resampler, (y, first), reference, (&mut *numbers, targets));
        }
        for frame in together..frames {
            stretch.row(simd, resampler, (y, frame), reference, (&mut *numbers, [target(frame)]));
        }
    }
}

/// One register at a time, as the compiler's own division of the loop suits neither its length nor its alignment.
#[inline(always)]
fn subtract<T: Count>(target: &mut [f32], pixels: &[T], reference: &[f32]) {
    let (targets, target) = target.as_chunks_mut::<REGISTER>();
    let (many_pixels, pixels) = pixels.as_chunks::<REGISTER>();
    let (references, reference) = reference.as_chunks::<REGISTER>();
    for ((target, pixels), reference) in targets.iter_mut().zip(many_pixels).zip(references) {
        let mut register = [0.0; REGISTER];
        for (number, (pixel, zero)) in register.iter_mut().zip(pixels.iter().zip(reference)) {
            *number = pixel.counts() - zero;
        }
        *target = register;
    }
    for ((number, pixel), zero) in target.iter_mut().zip(pixels).zip(reference) {
        *number = pixel.counts() - zero;
    }
}
