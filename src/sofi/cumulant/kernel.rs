//! The hot loop: adds the products of a block of exposures to the running sums of one band.
//!
//! A band is worked on strip by strip, row by row, on pixels that a ring holds as `f32` about the reference. For one
//! register's width of pixels at a time, every sum stays in registers while the exposures in the ring pass. Sums grow
//! exposure by exposure in the order of time, so the bits do not depend on how exposures were blocked, cut or threaded.
//!
//! In: pixels as the cameras gave them, the reference, the plan. Out: sums of one band.
//! Never: allocates for a band after the first call on a thread, uses `f64`.

use super::layout::Layout;
use super::plan::{Plan, Term};
use super::ring::{self, Part, Shape};
use super::second_order;
use super::terms::any_order;
use crate::sofi::grid::Combinations;
use crate::sofi::prefetch::prefetch;
use crate::sofi::registration::{Resampler, Stretch};
use pulp::{Arch, Simd, WithSimd};
use std::cell::RefCell;
use std::ops::Range;

/// A pixel as a camera or file gives it.
pub trait Count: Copy + Send + Sync + 'static {
    /// The value in counts.
    fn counts(self) -> f32;
}

impl Count for u16 {
    #[inline(always)]
    fn counts(self) -> f32 {
        f32::from(self)
    }
}

impl Count for f32 {
    #[inline(always)]
    fn counts(self) -> f32 {
        self
    }
}

/// The frames of one sample: one per lag and channel, channels fastest, each row-major without padding.
pub(super) type Planes<'a, T> = Vec<&'a [T]>;

/// Columns of a strip: few enough that a ring holds many exposures of them.
const STRIP_COLUMNS: usize = 128;

/// The same where columns beside the strip take longer to make, as for a camera that is registered.
const REGISTERED_STRIP_COLUMNS: usize = 256;

/// The most numbers that a ring holds; with what a registration keeps, about a second-level cache.
const RING_NUMBERS: usize = 64 * 1024;

/// Exposures that the many terms of a high order look at in turn: so few that they stay in the first-level cache.
const GROUP_FRAMES: usize = 8;

thread_local! {
    static RING: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
    static STRETCH: RefCell<Stretch> = RefCell::default();
}

/// What every band needs to know of a block.
pub(super) struct Block<'a, T> {
    pub(super) plan: &'a Plan,
    pub(super) layout: Layout,
    /// Reference per channel, `height * stride`, in counts.
    pub(super) reference: &'a [Vec<f32>],
    pub(super) samples: &'a [Planes<'a, T>],
    pub(super) shape: Shape,
    /// Brings the second channel onto the first, where they do not come aligned.
    pub(super) resampler: Option<&'a Resampler>,
    deltas: &'a Deltas,
}

impl<'a, T> Block<'a, T> {
    pub(super) fn new(
        (plan, deltas): (&'a Plan, &'a Deltas),
        layout: Layout,
        reference: &'a [Vec<f32>],
        samples: &'a [Planes<'a, T>],
    ) -> Self {
        Self { plan, layout, reference, samples, shape: deltas.shape, resampler: None, deltas }
    }

    /// The same, with the second channel brought onto the first.
    pub(super) fn registered(self, resampler: &'a Resampler) -> Self {
        Self { resampler: Some(resampler), ..self }
    }
}

/// Adds all samples of a block to the sums of one band; `sums[group]` as laid out by [`Layout`].
pub(super) fn accumulate<T: Count>(block: &Block<'_, T>, band: usize, sums: &mut [&mut [f32]]) {
    STRETCH.with_borrow_mut(|stretch| {
        RING.with_borrow_mut(|numbers| dispatch(BandWork { block, band, numbers, stretch, sums }));
    });
}

/// Runs the work on the widest registers this processor has.
pub(super) fn dispatch(work: impl WithSimd<Output = ()>) {
    match Arch::new() {
        Arch::Scalar => pulp::Scalar128b.vectorize(work),
        vectors => vectors.dispatch(work),
    }
}

/// The work on one band: its strips one after another, each with all exposures of the block.
struct BandWork<'a, 'b, T> {
    block: &'a Block<'a, T>,
    band: usize,
    numbers: &'a mut Vec<f32>,
    stretch: &'a mut Stretch,
    sums: &'a mut [&'b mut [f32]],
}

impl<T: Count> WithSimd for BandWork<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { block, band, numbers, stretch, sums } = self;
        let cutting = Cutting::new(block, band);
        let numbers = ring::aligned(numbers, block.shape.numbers(cutting.frames));
        for index in 0..cutting.parts() {
            let part = cutting.part(block, index);
            let next = (index + 1 < cutting.parts()).then(|| cutting.part(block, index + 1));
            ring::begin(simd, block, &part, stretch, numbers);
            for row in 0..part.rows.len() {
                if let Some(next) = next.as_ref().filter(|next| next.columns != part.columns) {
                    prefetch_sums(block, next, row, sums);
                }
                ring::advance(simd, block, (&part, next.as_ref()), row, stretch, numbers);
                let rows = Rows {
                    numbers,
                    shape: block.shape,
                    turn: block.shape.turn_at(row),
                    frames: 0..part.samples.len(),
                };
                sum_row(simd, block, &rows, &part, row, sums);
            }
        }
    }
}

/// How the columns of a band and the samples of a block are cut into parts, samples fastest.
struct Cutting {
    rows: Range<usize>,
    columns: usize,
    width: usize,
    frames: usize,
    chunks: usize,
}

impl Cutting {
    fn new<T>(block: &Block<'_, T>, band: usize) -> Self {
        let (width, samples) = (block.layout.stride, block.samples.len());
        let most = (RING_NUMBERS / block.shape.frame).max(4);
        let chunks = samples.div_ceil(most);
        let frames = samples.div_ceil(chunks.max(1));
        Self {
            rows: block.layout.rows(band),
            columns: width.min(block.shape.columns()),
            width,
            frames,
            chunks,
        }
    }

    fn parts(&self) -> usize {
        self.width.div_ceil(self.columns) * self.chunks
    }

    fn part<'a, T>(&self, block: &Block<'a, T>, index: usize) -> Part<'a, T> {
        let (column, sample) = (index / self.chunks * self.columns, index % self.chunks * self.frames);
        Part {
            rows: self.rows.clone(),
            columns: column..self.width.min(column + self.columns),
            samples: &block.samples[sample..block.samples.len().min(sample + self.frames)],
        }
    }
}

/// Asks for the sums of one row of a part.
#[inline(always)]
fn prefetch_sums<T: Count>(block: &Block<'_, T>, part: &Part<'_, T>, row: usize, sums: &[&mut [f32]]) {
    let band = block.layout.band_of(part.rows.start);
    let start = row * block.layout.stride + part.columns.start;
    for group in sums {
        for plane in group.chunks_exact(block.layout.plane_len(band)) {
            prefetch(&plane[start..start + part.columns.len()]);
        }
    }
}

/// The rows of a ring around the one that is summed.
pub(super) struct Rows<'a> {
    pub(super) numbers: &'a [f32],
    pub(super) shape: Shape,
    pub(super) turn: usize,
    frames: Range<usize>,
}

impl Rows<'_> {
    /// A register of numbers.
    #[inline(always)]
    pub(super) fn load<S: Simd>(&self, start: usize) -> S::f32s {
        S::as_simd_f32s(&self.numbers[start..start + S::F32_LANES]).0[0]
    }

    /// Where `column` of every exposure begins.
    #[inline(always)]
    pub(super) fn frames(&self, column: usize) -> impl Iterator<Item = usize> + use<> {
        let Range { start, end } = self.frames;
        (column + start * self.shape.frame..).step_by(self.shape.frame).take(end - start)
    }

    /// The same rows, a few exposures at a time.
    #[inline(always)]
    fn in_groups(&self) -> impl Iterator<Item = Rows<'_>> {
        let Range { start, end } = self.frames;
        (start..end).step_by(GROUP_FRAMES).map(move |start| {
            let frames = start..end.min(start + GROUP_FRAMES);
            Rows { numbers: self.numbers, shape: self.shape, turn: self.turn, frames }
        })
    }
}

/// Places in a ring of every element of every term, seen from the first pixel of a row, by turn of the ring.
#[derive(Debug, Clone)]
pub(super) struct Deltas {
    shape: Shape,
    turns: Vec<Vec<Vec<Vec<usize>>>>,
}

impl Deltas {
    pub(super) fn new(plan: &Plan, layout: &Layout, registered: bool) -> Self {
        let columns = if registered { REGISTERED_STRIP_COLUMNS } else { STRIP_COLUMNS };
        let shape = Shape::new(plan, layout.stride.min(columns));
        let of_term = |turn: usize, term: &Term| {
            let elements = term.sets.iter().flat_map(|set| &set.elements);
            elements.map(|element| shape.element(turn, element)).collect()
        };
        let of_turn = |turn: usize| {
            plan.groups.iter().map(|group| group.iter().map(|term| of_term(turn, term)).collect()).collect()
        };
        Self { shape, turns: (0..shape.turns()).map(of_turn).collect() }
    }
}

/// Adds the products of one row of a part to the sums.
#[inline(always)]
fn sum_row<S: Simd, T: Count>(
    simd: S,
    block: &Block<'_, T>,
    rows: &Rows<'_>,
    part: &Part<'_, T>,
    row: usize,
    sums: &mut [&mut [f32]],
) {
    let (plan, stride) = (block.plan, block.layout.stride);
    let plane = block.layout.plane_len(block.layout.band_of(part.rows.start));
    let pairs = plan.order == 2 && plan.lags.len() == 1 && plan.combinations == Combinations::AllClosest;
    for x in (0..part.columns.len()).step_by(S::F32_LANES) {
        let place = row * stride + part.columns.start + x;
        match (pairs, rows.shape.channels()) {
            (true, 1) => second_order::one_channel(simd, rows, x, sums, place, plane),
            (true, 2) => second_order::two_channels(simd, rows, x, sums, place, plane),
            _ => {
                for rows in rows.in_groups() {
                    any_order(simd, plan, &block.deltas.turns[rows.turn], &rows, x, sums, place, plane);
                }
            }
        }
    }
}

/// A running sum in memory: the register at `place` of plane `plane_index`.
#[inline(always)]
pub(super) fn at<S: Simd>(sums: &mut [f32], start: usize) -> &mut S::f32s {
    &mut S::as_mut_simd_f32s(&mut sums[start..start + S::F32_LANES]).0[0]
}

#[inline(always)]
pub(super) fn read_sums<S: Simd, const N: usize>(
    simd: S,
    sums: &mut [f32],
    place: usize,
    plane: usize,
) -> [S::f32s; N] {
    let mut registers = [simd.splat_f32s(0.0); N];
    for (index, register) in registers.iter_mut().enumerate() {
        *register = *at::<S>(sums, index * plane + place);
    }
    registers
}

#[inline(always)]
pub(super) fn write_sums<S: Simd, const N: usize>(
    registers: [S::f32s; N],
    sums: &mut [f32],
    place: usize,
    plane: usize,
) {
    for (index, register) in registers.into_iter().enumerate() {
        *at::<S>(sums, index * plane + place) = register;
    }
}
