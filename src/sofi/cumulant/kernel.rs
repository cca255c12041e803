//! The hot loop: adds the products of a block of exposures to the running sums of one band.
//!
//! A tile of a few exposures is converted to `f32` about the reference once; then, for one register's width of
//! pixels at a time, every sum stays in registers while the exposures of the tile pass. Sums grow exposure by
//! exposure in the order of time, so the bits do not depend on how exposures were blocked, tiled or threaded.
//!
//! In: pixels as the cameras gave them, the reference, the plan. Out: sums of one band.
//! Never: allocates after the first call on a thread, uses `f64`, reads a pixel of a frame twice per tile.

use super::layout::Layout;
use super::plan::{Plan, Term};
use super::prefetch::{LINE_BYTES, prefetch};
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

/// The most numbers that a tile may hold, so that it stays in the second-level cache.
const TILE_NUMBERS: usize = 160 * 1024;

/// Numbers before the first pixel of a tile row: the halo, padded so that the pixels begin on a cache line.
const LEFT_PADDING: usize = 16;

/// Columns of a tile.
const TILE_COLUMNS: usize = 128;

thread_local! {
    static TILE: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// What every band needs to know of a block.
pub(super) struct Block<'a, T> {
    pub(super) plan: &'a Plan,
    pub(super) layout: Layout,
    /// Reference per channel, `height * stride`, in counts.
    pub(super) reference: &'a [Vec<f32>],
    pub(super) samples: &'a [Planes<'a, T>],
}

/// Adds all samples of a block to the sums of one band; `sums[group]` as laid out by [`Layout`].
pub(super) fn accumulate<T: Count>(block: &Block<'_, T>, band: usize, sums: &mut [&mut [f32]]) {
    TILE.with_borrow_mut(|numbers| dispatch(BandWork { block, band, numbers, sums }));
}

/// Runs the work on the widest registers this processor has.
fn dispatch(work: impl WithSimd<Output = ()>) {
    match Arch::new() {
        Arch::Scalar => pulp::Scalar128b.vectorize(work),
        vectors => vectors.dispatch(work),
    }
}

/// The work on one band: its tiles one after another, each with all exposures of the block.
struct BandWork<'a, 'b, T> {
    block: &'a Block<'a, T>,
    band: usize,
    numbers: &'a mut Vec<f32>,
    sums: &'a mut [&'b mut [f32]],
}

/// Strides of a tile in numbers: exposure, then plane, then row, then column.
#[derive(Clone, Copy)]
struct Strides {
    frame: usize,
    plane: usize,
    row: usize,
}

impl<T: Count> WithSimd for BandWork<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { block, band, numbers, sums } = self;
        let (plan, layout) = (block.plan, block.layout);
        let cutting = Cutting::new(block, band);
        let strides = cutting.strides;
        numbers.resize(numbers.len().max(cutting.frames * strides.frame + LEFT_PADDING), 0.0);
        let unaligned = numbers.as_ptr().align_offset(LINE_BYTES).min(LEFT_PADDING);
        let numbers = &mut numbers[unaligned..];
        let deltas = Deltas::new(plan, strides);
        for part in 0..cutting.parts() {
            let (columns, samples) = cutting.part(part);
            let samples = &block.samples[samples];
            fill_tile(block, layout.rows(band), columns.clone(), strides, samples, numbers);
            let tile = Tile {
                numbers: &numbers[..samples.len() * strides.frame],
                strides,
                origin: plan.halo.up * strides.row + LEFT_PADDING,
                channels: block.reference.len(),
            };
            let target = Target { rows: layout.rows(band).len(), columns, layout };
            let mut upcoming = Upcoming::new(block, band, &cutting, part + 1);
            sum_tile(simd, plan, &deltas, &tile, &target, &mut upcoming, sums);
        }
    }
}

/// How the columns of a band and the samples of a block are cut into parts, samples fastest.
struct Cutting {
    strides: Strides,
    columns: usize,
    width: usize,
    frames: usize,
    samples: usize,
}

impl Cutting {
    fn new<T>(block: &Block<'_, T>, band: usize) -> Self {
        let (plan, width) = (block.plan, block.layout.stride);
        let columns = width.min(TILE_COLUMNS);
        let row = LEFT_PADDING + (columns + plan.halo.right).next_multiple_of(LEFT_PADDING);
        let plane = row * (plan.halo.up + block.layout.rows(band).len() + plan.halo.down);
        let strides = Strides { frame: plane * plan.lags.len() * block.reference.len(), plane, row };
        let frames = (TILE_NUMBERS / strides.frame).clamp(4, 32);
        Self { strides, columns, width, frames, samples: block.samples.len() }
    }

    fn parts(&self) -> usize {
        self.width.div_ceil(self.columns) * self.samples.div_ceil(self.frames)
    }

    fn part(&self, part: usize) -> (Range<usize>, Range<usize>) {
        let per_tile = self.samples.div_ceil(self.frames);
        let (column, sample) = (part / per_tile * self.columns, part % per_tile * self.frames);
        (column..self.width.min(column + self.columns), sample..self.samples.min(sample + self.frames))
    }
}

/// The pixels that the next part will need, brought closer row by row while this part is summed.
struct Upcoming<'a, T> {
    samples: &'a [Planes<'a, T>],
    rows: Range<usize>,
    columns: Range<usize>,
    width: usize,
    next: usize,
    per_step: usize,
}

impl<'a, T> Upcoming<'a, T> {
    fn new(block: &'a Block<'a, T>, band: usize, cutting: &Cutting, part: usize) -> Self {
        let layout = block.layout;
        let (part, band) = if part < cutting.parts() { (part, band) } else { (0, band + 1) };
        let (columns, samples) = cutting.part(part);
        let rows = layout.rows(band.min(layout.bands() - 1));
        let samples = if band < layout.bands() { &block.samples[samples] } else { &[] };
        let steps = rows.len() * (columns.len() / super::layout::COLUMN_PADDING);
        let columns = columns.start..layout.width.min(columns.end);
        let planes = samples.len() * samples.first().map_or(0, Vec::len);
        let per_step = (planes * rows.len()).div_ceil(steps.max(1));
        Self { samples, rows, columns, width: layout.width, next: 0, per_step }
    }

    /// Prefetches a fair share of the rows.
    #[inline(always)]
    fn step(&mut self) {
        for _ in 0..self.per_step {
            let planes = self.samples.first().map_or(1, Vec::len);
            let (image, row) = (self.next / self.rows.len(), self.next % self.rows.len());
            let Some(sample) = self.samples.get(image / planes) else { return };
            let start = (self.rows.start + row) * self.width;
            prefetch(&sample[image % planes][start + self.columns.start..start + self.columns.end]);
            self.next += 1;
        }
    }
}

/// Converts the samples of one tile to `f32` about the reference; zero outside the camera region.
#[inline(always)]
fn fill_tile<T: Count>(
    block: &Block<'_, T>,
    rows: Range<usize>,
    columns: Range<usize>,
    strides: Strides,
    samples: &[Planes<'_, T>],
    numbers: &mut [f32],
) {
    let (layout, halo) = (block.layout, block.plan.halo);
    let left = halo.left.saturating_sub(columns.start);
    let first = columns.start + left - halo.left;
    let last = layout.width.min(columns.end + halo.right).max(first);
    for (sample, frame) in samples.iter().zip(numbers.chunks_exact_mut(strides.frame)) {
        for (index, (pixels, plane)) in sample.iter().zip(frame.chunks_exact_mut(strides.plane)).enumerate() {
            let reference = &block.reference[index % block.reference.len()];
            for (line, target) in plane.chunks_exact_mut(strides.row).enumerate() {
                let target = &mut target[LEFT_PADDING - halo.left..];
                let Some(y) = (rows.start + line).checked_sub(halo.up).filter(|&y| y < layout.height) else {
                    target.fill(0.0);
                    continue;
                };
                target[..left].fill(0.0);
                target[left + last - first..].fill(0.0);
                let source = &pixels[y * layout.width + first..y * layout.width + last];
                let zero = &reference[y * layout.stride + first..y * layout.stride + last];
                for ((number, pixel), zero) in target[left..].iter_mut().zip(source).zip(zero) {
                    *number = pixel.counts() - zero;
                }
            }
        }
    }
}

/// Converted pixels of one tile.
struct Tile<'a> {
    numbers: &'a [f32],
    strides: Strides,
    /// Offset of the tile's first pixel inside a plane.
    origin: usize,
    channels: usize,
}

impl Tile<'_> {
    /// A register of pixels of the exposure that starts at `frame`, `delta` away from its first pixel.
    #[inline(always)]
    fn load<S: Simd>(&self, frame: usize, delta: isize) -> S::f32s {
        let start = frame.wrapping_add_signed(delta);
        S::as_simd_f32s(&self.numbers[start..start + S::F32_LANES]).0[0]
    }

    #[inline(always)]
    fn frames(&self, pixel: usize) -> impl Iterator<Item = usize> + use<> {
        (pixel..self.numbers.len()).step_by(self.strides.frame)
    }
}

/// Where in the band's sums a tile belongs.
struct Target {
    rows: usize,
    columns: Range<usize>,
    layout: Layout,
}

/// Distances of every element of every term from its base pixel, in numbers of the tile.
struct Deltas {
    groups: Vec<Vec<Vec<isize>>>,
}

impl Deltas {
    fn new(plan: &Plan, strides: Strides) -> Self {
        let channels = plan.algebra.channels();
        let of_term = |term: &Term| {
            let elements = term.sets.iter().flat_map(|set| &set.elements);
            elements
                .map(|e| {
                    let plane = (e.lag * channels * strides.plane) as isize;
                    plane + e.dy as isize * strides.row as isize + e.dx as isize
                })
                .collect()
        };
        Self { groups: plan.groups.iter().map(|group| group.iter().map(of_term).collect()).collect() }
    }
}

#[inline(always)]
fn sum_tile<S: Simd, T: Count>(
    simd: S,
    plan: &Plan,
    deltas: &Deltas,
    tile: &Tile<'_>,
    target: &Target,
    upcoming: &mut Upcoming<'_, T>,
    sums: &mut [&mut [f32]],
) {
    let plane = target.rows * target.layout.stride;
    let second_order =
        plan.order == 2 && plan.lags.len() == 1 && plan.combinations == Combinations::AllClosest;
    for y in 0..target.rows {
        for x in (0..target.columns.len()).step_by(S::F32_LANES) {
            upcoming.step();
            let pixel = tile.origin + y * tile.strides.row + x;
            let place = y * target.layout.stride + target.columns.start + x;
            match (second_order, tile.channels) {
                (true, 1) => second_order_one_channel(simd, tile, pixel, sums, place, plane),
                (true, 2) => second_order_two_channels(simd, tile, pixel, sums, place, plane),
                _ => any_order(simd, plan, deltas, tile, pixel, sums, place, plane),
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
    #[inline(always)]
    fn load<S: Simd<f32s = V>>(tile: &Tile<'_>, pixel: usize) -> Self {
        let (row, lanes) = (tile.strides.row, S::F32_LANES);
        let load = |line: &[f32], x: usize| S::as_simd_f32s(&line[x..x + lanes]).0[0];
        let here = &tile.numbers[pixel - 1..pixel + lanes + 1];
        let down = &tile.numbers[pixel + row..pixel + row + lanes + 1];
        Self {
            up: S::as_simd_f32s(&tile.numbers[pixel - row..pixel - row + lanes]).0[0],
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
    tile: &Tile<'_>,
    pixel: usize,
    sums: &mut [&mut [f32]],
    place: usize,
    plane: usize,
) {
    let [mut square] = read_sums::<S, 1>(simd, sums[0], place, plane);
    let [mut sum] = read_sums::<S, 1>(simd, sums[1], place, plane);
    let [mut s00, mut s01, mut s10, mut s11] = read_sums::<S, 4>(simd, sums[2], place, plane);
    for frame in tile.frames(pixel) {
        let r = Neighborhood::load::<S>(tile, frame);
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
    tile: &Tile<'_>,
    pixel: usize,
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
    let plane_t = tile.strides.plane;
    for frame in tile.frames(pixel) {
        let r = Neighborhood::load::<S>(tile, frame);
        let t = Neighborhood::load::<S>(tile, frame + plane_t);
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
    deltas: &Deltas,
    tile: &Tile<'_>,
    pixel: usize,
    sums: &mut [&mut [f32]],
    place: usize,
    plane: usize,
) {
    for channel in 0..tile.channels {
        let square = at::<S>(sums[0], channel * plane + place);
        for frame in tile.frames(pixel) {
            let x = tile.load::<S>(frame, (channel * tile.strides.plane) as isize);
            *square = simd.mul_add_e_f32s(x, x, *square);
        }
    }
    for (degree, (terms, deltas)) in plan.groups.iter().zip(&deltas.groups).enumerate() {
        for (term, deltas) in terms.iter().zip(deltas) {
            let (sums, place) = (&mut *sums[degree], term.first * plane + place);
            let work = TermWork { tile, deltas, pixel, place, plane };
            match (degree, tile.channels) {
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
    tile: &'a Tile<'a>,
    deltas: &'a [isize],
    pixel: usize,
    place: usize,
    plane: usize,
}

impl TermWork<'_> {
    /// Adds the coefficients of the product over the `M` pixels of `R` or, with two channels, of `R + z T`.
    #[inline(always)]
    fn add<S: Simd, const M: usize, const C: usize, const TWO: bool>(&self, simd: S, sums: &mut [f32]) {
        let plane_t = self.tile.strides.plane as isize;
        let mut sum: [S::f32s; C] = read_sums(simd, sums, self.place, self.plane);
        for frame in self.tile.frames(self.pixel) {
            for set in self.deltas.chunks_exact(M) {
                let mut product = [simd.splat_f32s(0.0); C];
                product[0] = self.tile.load::<S>(frame, set[0]);
                if TWO {
                    product[1] = self.tile.load::<S>(frame, set[0] + plane_t);
                }
                for (pixel, &delta) in set.iter().enumerate().skip(1) {
                    let r = self.tile.load::<S>(frame, delta);
                    if TWO {
                        let t = self.tile.load::<S>(frame, delta + plane_t);
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
        let plane_t = self.tile.strides.plane as isize;
        let mut sum: [S::f32s; 3] = read_sums(simd, sums, self.place, self.plane);
        for frame in self.tile.frames(self.pixel) {
            for set in self.deltas.chunks_exact(2) {
                let [r0, r1] = [0, 1].map(|pixel| self.tile.load::<S>(frame, set[pixel]));
                let [t0, t1] = [0, 1].map(|pixel| self.tile.load::<S>(frame, set[pixel] + plane_t));
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
        let channels = self.tile.channels;
        let plane = self.tile.strides.plane;
        for frame in self.tile.frames(self.pixel) {
            for share in 0..channels.pow(degree as u32) {
                let channel_of = |pixel: usize| share / channels.pow(pixel as u32) % channels;
                let (coefficient, _) = (1..degree).fold((channel_of(0), 1), |(coefficient, size), pixel| {
                    (plan.algebra.product_index(size, 1, coefficient, channel_of(pixel)), size + 1)
                });
                let sum = at::<S>(sums, coefficient * self.plane + self.place);
                for set in self.deltas.chunks_exact(degree) {
                    let mut product = simd.splat_f32s(1.0);
                    for (pixel, &delta) in set.iter().enumerate() {
                        let delta = delta + (channel_of(pixel) * plane) as isize;
                        product = simd.mul_f32s(product, self.tile.load::<S>(frame, delta));
                    }
                    *sum = simd.add_f32s(*sum, product);
                }
            }
        }
    }
}
