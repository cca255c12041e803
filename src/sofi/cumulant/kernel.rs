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
use super::prefetch::prefetch;
use super::ring::{self, Part, Shape};
use crate::sofi::grid::Combinations;
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

/// The most numbers that a ring holds, a quarter of the second-level cache.
const RING_NUMBERS: usize = 64 * 1024;

/// Exposures that the many terms of a high order look at in turn: so few that they stay in the first-level cache.
const GROUP_FRAMES: usize = 8;

thread_local! {
    static RING: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// What every band needs to know of a block.
pub(super) struct Block<'a, T> {
    pub(super) plan: &'a Plan,
    pub(super) layout: Layout,
    /// Reference per channel, `height * stride`, in counts.
    pub(super) reference: &'a [Vec<f32>],
    pub(super) samples: &'a [Planes<'a, T>],
    pub(super) shape: Shape,
    deltas: &'a Deltas,
}

impl<'a, T> Block<'a, T> {
    pub(super) fn new(
        (plan, deltas): (&'a Plan, &'a Deltas),
        layout: Layout,
        reference: &'a [Vec<f32>],
        samples: &'a [Planes<'a, T>],
    ) -> Self {
        Self { plan, layout, reference, samples, shape: deltas.shape, deltas }
    }
}

/// Adds all samples of a block to the sums of one band; `sums[group]` as laid out by [`Layout`].
pub(super) fn accumulate<T: Count>(block: &Block<'_, T>, band: usize, sums: &mut [&mut [f32]]) {
    RING.with_borrow_mut(|numbers| dispatch(BandWork { block, band, numbers, sums }));
}

/// Runs the work on the widest registers this processor has.
fn dispatch(work: impl WithSimd<Output = ()>) {
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
    sums: &'a mut [&'b mut [f32]],
}

impl<T: Count> WithSimd for BandWork<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { block, band, numbers, sums } = self;
        let cutting = Cutting::new(block, band);
        let numbers = ring::aligned(numbers, block.shape.numbers(cutting.frames));
        for index in 0..cutting.parts() {
            let part = cutting.part(block, index);
            let next = (index + 1 < cutting.parts()).then(|| cutting.part(block, index + 1));
            ring::begin(block, &part, numbers);
            for row in 0..part.rows.len() {
                if let Some(next) = next.as_ref().filter(|next| next.columns != part.columns) {
                    prefetch_sums(block, next, row, sums);
                }
                ring::advance(block, (&part, next.as_ref()), row, numbers);
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
        Self { rows: block.layout.rows(band), columns: width.min(STRIP_COLUMNS), width, frames, chunks }
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
struct Rows<'a> {
    numbers: &'a [f32],
    shape: Shape,
    turn: usize,
    frames: Range<usize>,
}

impl Rows<'_> {
    /// A register of numbers.
    #[inline(always)]
    fn load<S: Simd>(&self, start: usize) -> S::f32s {
        S::as_simd_f32s(&self.numbers[start..start + S::F32_LANES]).0[0]
    }

    /// Where `column` of every exposure begins.
    #[inline(always)]
    fn frames(&self, column: usize) -> impl Iterator<Item = usize> + use<> {
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
    pub(super) fn new(plan: &Plan, layout: &Layout) -> Self {
        let shape = Shape::new(plan, layout.stride.min(STRIP_COLUMNS));
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
    let second_order =
        plan.order == 2 && plan.lags.len() == 1 && plan.combinations == Combinations::AllClosest;
    for x in (0..part.columns.len()).step_by(S::F32_LANES) {
        let place = row * stride + part.columns.start + x;
        match (second_order, rows.shape.channels()) {
            (true, 1) => second_order_one_channel(simd, rows, x, sums, place, plane),
            (true, 2) => second_order_two_channels(simd, rows, x, sums, place, plane),
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
fn at<S: Simd>(sums: &mut [f32], start: usize) -> &mut S::f32s {
    &mut S::as_mut_simd_f32s(&mut sums[start..start + S::F32_LANES]).0[0]
}

#[inline(always)]
fn read_sums<S: Simd, const N: usize>(simd: S, sums: &mut [f32], place: usize, plane: usize) -> [S::f32s; N] {
    let mut registers = [simd.splat_f32s(0.0); N];
    for (index, register) in registers.iter_mut().enumerate() {
        *register = *at::<S>(sums, index * plane + place);
    }
    registers
}

#[inline(always)]
fn write_sums<S: Simd, const N: usize>(
    registers: [S::f32s; N],
    sums: &mut [f32],
    place: usize,
    plane: usize,
) {
    for (index, register) in registers.into_iter().enumerate() {
        *at::<S>(sums, index * plane + place) = register;
    }
}

/// The neighborhood of one register of pixels at order 2: rows above, at and below.
struct Neighborhood<V> {
    up: V,
    left: V,
    here: V,
    right: V,
    down: V,
    down_right: V,
}

impl<V: Copy> Neighborhood<V> {
    /// Loads the pixels around `start`, a column of the plane and exposure.
    #[inline(always)]
    fn load<S: Simd<f32s = V>>(rows: &Rows<'_>, start: usize) -> Self {
        let lanes = S::F32_LANES;
        let [up, here, down] = [-1, 0, 1].map(|dy| start + rows.shape.line(rows.turn, dy));
        let load = |line: &[f32], x: usize| S::as_simd_f32s(&line[x..x + lanes]).0[0];
        let here = &rows.numbers[here - 1..here + lanes + 1];
        let down = &rows.numbers[down..down + lanes + 1];
        Self {
            up: rows.load::<S>(up),
            left: load(here, 0),
            here: load(here, 1),
            right: load(here, 2),
            down: load(down, 0),
            down_right: load(down, 1),
        }
    }

    /// The products of a's and b's pixels at the four sub-positions, added to the sums (spec of order 2).
    #[inline(always)]
    fn add_products<S: Simd<f32s = V>>(simd: S, a: &Self, b: &Self, sums: [&mut V; 4]) {
        let [between_two, beside, below, diagonal] = sums;
        *between_two = simd.mul_add_e_f32s(a.up, b.down, *between_two);
        *between_two = simd.mul_add_e_f32s(a.left, b.right, *between_two);
        *beside = simd.mul_add_e_f32s(a.here, b.right, *beside);
        *below = simd.mul_add_e_f32s(a.here, b.down, *below);
        *diagonal = simd.mul_add_e_f32s(a.here, b.down_right, *diagonal);
        *diagonal = simd.mul_add_e_f32s(a.right, b.down, *diagonal);
    }
}

#[inline(always)]
fn second_order_one_channel<S: Simd>(
    simd: S,
    rows: &Rows<'_>,
    x: usize,
    sums: &mut [&mut [f32]],
    place: usize,
    plane: usize,
) {
    let [mut square] = read_sums::<S, 1>(simd, sums[0], place, plane);
    let [mut sum] = read_sums::<S, 1>(simd, sums[1], place, plane);
    let [mut s00, mut s01, mut s10, mut s11] = read_sums::<S, 4>(simd, sums[2], place, plane);
    for frame in rows.frames(x) {
        let r = Neighborhood::load::<S>(rows, frame);
        sum = simd.add_f32s(sum, r.here);
        square = simd.mul_add_e_f32s(r.here, r.here, square);
        Neighborhood::add_products(simd, &r, &r, [&mut s00, &mut s01, &mut s10, &mut s11]);
    }
    write_sums::<S, 1>([square], sums[0], place, plane);
    write_sums::<S, 1>([sum], sums[1], place, plane);
    write_sums::<S, 4>([s00, s01, s10, s11], sums[2], place, plane);
}

#[inline(always)]
fn second_order_two_channels<S: Simd>(
    simd: S,
    rows: &Rows<'_>,
    x: usize,
    sums: &mut [&mut [f32]],
    place: usize,
    plane: usize,
) {
    let [mut square_r, mut square_t] = read_sums::<S, 2>(simd, sums[0], place, plane);
    let [mut sum_r, mut sum_t] = read_sums::<S, 2>(simd, sums[1], place, plane);
    let [
        mut rr00,
        mut tr00,
        mut tt00,
        mut rr01,
        mut tr01,
        mut tt01,
        mut rr10,
        mut tr10,
        mut tt10,
        mut rr11,
        mut tr11,
        mut tt11,
    ] = read_sums::<S, 12>(simd, sums[2], place, plane);
    let plane_t = rows.shape.plane;
    for frame in rows.frames(x) {
        let r = Neighborhood::load::<S>(rows, frame);
        let t = Neighborhood::load::<S>(rows, frame + plane_t);
        sum_r = simd.add_f32s(sum_r, r.here);
        sum_t = simd.add_f32s(sum_t, t.here);
        square_r = simd.mul_add_e_f32s(r.here, r.here, square_r);
        square_t = simd.mul_add_e_f32s(t.here, t.here, square_t);
        Neighborhood::add_products(simd, &r, &r, [&mut rr00, &mut rr01, &mut rr10, &mut rr11]);
        Neighborhood::add_products(simd, &r, &t, [&mut tr00, &mut tr01, &mut tr10, &mut tr11]);
        Neighborhood::add_products(simd, &t, &r, [&mut tr00, &mut tr01, &mut tr10, &mut tr11]);
        Neighborhood::add_products(simd, &t, &t, [&mut tt00, &mut tt01, &mut tt10, &mut tt11]);
    }
    write_sums::<S, 2>([square_r, square_t], sums[0], place, plane);
    write_sums::<S, 2>([sum_r, sum_t], sums[1], place, plane);
    let products = [rr00, tr00, tt00, rr01, tr01, tt01, rr10, tr10, tt10, rr11, tr11, tt11];
    write_sums::<S, 12>(products, sums[2], place, plane);
}

#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "one flat inner step of the hot loop, called in one place")]
fn any_order<S: Simd>(
    simd: S,
    plan: &Plan,
    deltas: &[Vec<Vec<usize>>],
    rows: &Rows<'_>,
    x: usize,
    sums: &mut [&mut [f32]],
    place: usize,
    plane: usize,
) {
    for channel in 0..rows.shape.channels() {
        let square = at::<S>(sums[0], channel * plane + place);
        for frame in rows.frames(x + rows.shape.line(rows.turn, 0) + channel * rows.shape.plane) {
            let x = rows.load::<S>(frame);
            *square = simd.mul_add_e_f32s(x, x, *square);
        }
    }
    for (degree, (terms, deltas)) in plan.groups.iter().zip(deltas).enumerate() {
        for (term, deltas) in terms.iter().zip(deltas) {
            let (sums, place) = (&mut *sums[degree], term.first * plane + place);
            let work = TermWork { rows, deltas, x, place, plane };
            match (degree, rows.shape.channels()) {
                (2, 2) if !plan.symmetric() => work.first_pixel_from_first_channel(simd, sums),
                (1, 1) => work.add::<S, 1, 1, false>(simd, sums),
                (2, 1) => work.add::<S, 2, 1, false>(simd, sums),
                (3, 1) => work.add::<S, 3, 1, false>(simd, sums),
                (4, 1) => work.add::<S, 4, 1, false>(simd, sums),
                (5, 1) => work.add::<S, 5, 1, false>(simd, sums),
                (6, 1) => work.add::<S, 6, 1, false>(simd, sums),
                (1, 2) => work.add::<S, 1, 2, true>(simd, sums),
                (2, 2) => work.add::<S, 2, 3, true>(simd, sums),
                (3, 2) => work.add::<S, 3, 4, true>(simd, sums),
                (4, 2) => work.add::<S, 4, 5, true>(simd, sums),
                (5, 2) => work.add::<S, 5, 6, true>(simd, sums),
                (6, 2) => work.add::<S, 6, 7, true>(simd, sums),
                _ => work.add_many_channels(simd, plan, degree, sums),
            }
        }
    }
}

/// One term at one register of pixels.
struct TermWork<'a> {
    rows: &'a Rows<'a>,
    deltas: &'a [usize],
    x: usize,
    place: usize,
    plane: usize,
}

impl TermWork<'_> {
    /// Adds the coefficients of the product over the `M` pixels of `R` or, with two channels, of `R + z T`.
    #[inline(always)]
    fn add<S: Simd, const M: usize, const C: usize, const TWO: bool>(&self, simd: S, sums: &mut [f32]) {
        let plane_t = self.rows.shape.plane;
        let mut sum: [S::f32s; C] = read_sums(simd, sums, self.place, self.plane);
        for frame in self.rows.frames(self.x) {
            for set in self.deltas.chunks_exact(M) {
                let mut product = [simd.splat_f32s(0.0); C];
                product[0] = self.rows.load::<S>(frame + set[0]);
                if TWO {
                    product[1] = self.rows.load::<S>(frame + set[0] + plane_t);
                }
                for (pixel, &delta) in set.iter().enumerate().skip(1) {
                    let r = self.rows.load::<S>(frame + delta);
                    if TWO {
                        let t = self.rows.load::<S>(frame + delta + plane_t);
                        product[pixel + 1] = simd.mul_f32s(product[pixel], t);
                        for u in (1..=pixel).rev() {
                            let taken_from_t = simd.mul_f32s(product[u - 1], t);
                            product[u] = simd.mul_add_e_f32s(product[u], r, taken_from_t);
                        }
                    }
                    product[0] = simd.mul_f32s(product[0], r);
                }
                for (sum, product) in sum.iter_mut().zip(product) {
                    *sum = simd.add_f32s(*sum, product);
                }
            }
        }
        write_sums::<S, C>(sum, sums, self.place, self.plane);
    }

    /// RR, RT and TT with the first pixel of RT from R and the second from T, as the published software has it.
    #[inline(always)]
    fn first_pixel_from_first_channel<S: Simd>(&self, simd: S, sums: &mut [f32]) {
        let plane_t = self.rows.shape.plane;
        let mut sum: [S::f32s; 3] = read_sums(simd, sums, self.place, self.plane);
        for frame in self.rows.frames(self.x) {
            for set in self.deltas.chunks_exact(2) {
                let [r0, r1] = [0, 1].map(|pixel| self.rows.load::<S>(frame + set[pixel]));
                let [t0, t1] = [0, 1].map(|pixel| self.rows.load::<S>(frame + set[pixel] + plane_t));
                sum[0] = simd.mul_add_e_f32s(r0, r1, sum[0]);
                sum[1] = simd.mul_add_e_f32s(r0, t1, sum[1]);
                sum[2] = simd.mul_add_e_f32s(t0, t1, sum[2]);
            }
        }
        write_sums::<S, 3>(sum, sums, self.place, self.plane);
    }

    /// Any number of channels: every way to share the pixels among them, one product at a time.
    #[inline(always)]
    fn add_many_channels<S: Simd>(&self, simd: S, plan: &Plan, degree: usize, sums: &mut [f32]) {
        let channels = self.rows.shape.channels();
        let plane = self.rows.shape.plane;
        for frame in self.rows.frames(self.x) {
            for share in 0..channels.pow(degree as u32) {
                let channel_of = |pixel: usize| share / channels.pow(pixel as u32) % channels;
                let (coefficient, _) = (1..degree).fold((channel_of(0), 1), |(coefficient, size), pixel| {
                    (plan.algebra.product_index(size, 1, coefficient, channel_of(pixel)), size + 1)
                });
                let sum = at::<S>(sums, coefficient * self.plane + self.place);
                for set in self.deltas.chunks_exact(degree) {
                    let mut product = simd.splat_f32s(1.0);
                    for (pixel, &delta) in set.iter().enumerate() {
                        let delta = delta + channel_of(pixel) * plane;
                        product = simd.mul_f32s(product, self.rows.load::<S>(frame + delta));
                    }
                    *sum = simd.add_f32s(*sum, product);
                }
            }
        }
    }
}
