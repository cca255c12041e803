//! Running sums of one subsequence: raw moments about a reference near the mean.
//!
//! Sums are kept in `f32` for at most [`CHUNK`] samples and then moved to `f64`, so that neither the length of a
//! subsequence nor the camera offset costs precision. The reference is the first exposure; after
//! a few samples the sums are moved, exactly, to the mean so far.
//!
//! In: blocks of samples. Out: sums in `f64`. Never: depends on how the samples were blocked.

use super::algebra::{ChannelAlgebra, LANES, Lanes, Polynomial};
use super::kernel::{Block, Count, Deltas, Planes, accumulate};
use super::layout::{Layout, load_row, registers, shifted};
use super::plan::{Element, PlacedSet, Plan};
use super::workers::Workers;
use pulp::{Simd, WithSimd};

/// Samples that an `f32` sum takes before it is moved to `f64`.
pub(super) const CHUNK: u64 = 256;

/// Numbers of samples after which the reference moves to the mean so far. High powers need a good one early.
fn recenterings(order: usize) -> &'static [u64] {
    if order == 2 { &[16] } else { &[4, 16] }
}

/// Accumulators by group, then band; see [`Layout`] and [`Plan::groups`].
type Groups<T> = Vec<Vec<Vec<T>>>;

/// The running sums of one subsequence.
#[derive(Debug, Clone)]
pub(super) struct RunMoments {
    /// Number of the subsequence: exposure index divided by its length.
    pub(super) run: u64,
    /// Samples in the sums.
    pub(super) samples: u64,
    /// First exposure that this state could have seen.
    pub(super) begin: u64,
    /// One past the last exposure that has been seen or is known to be lost.
    pub(super) end: u64,
    deltas: Deltas,
    reference: Vec<Vec<f32>>,
    /// Memory for a change of reference.
    shifts: Vec<Vec<f32>>,
    chunk: Groups<f32>,
    long: Option<Groups<f64>>,
}

impl RunMoments {
    /// State for subsequences of at most `longest` samples.
    pub(super) fn new(plan: &Plan, layout: &Layout, longest: u64) -> Self {
        let zeroed = |group: usize| layout.zeroed(plan.accumulators(group));
        Self {
            run: 0,
            samples: 0,
            begin: 0,
            end: 0,
            deltas: Deltas::new(plan, layout),
            reference: vec![vec![0.0; layout.height * layout.stride]; plan.algebra.channels()],
            shifts: vec![vec![0.0; layout.height * layout.stride]; plan.algebra.channels()],
            chunk: (0..=plan.order).map(zeroed).collect(),
            long: (longest > CHUNK)
                .then(|| (0..=plan.order).map(|group| layout.zeroed(plan.accumulators(group))).collect()),
        }
    }

    /// Empties the state for another subsequence, keeping its memory.
    pub(super) fn restart(&mut self, run: u64, begin: u64) {
        (self.run, self.samples, self.begin, self.end) = (run, 0, begin, begin);
        self.chunk.iter_mut().flatten().for_each(|sums| sums.fill(0.0));
        self.long.iter_mut().flatten().flatten().for_each(|sums| sums.fill(0.0));
    }

    /// Bytes of this state.
    pub(super) fn bytes(&self) -> usize {
        let long = self.long.iter().flatten().flatten().map(|sums| sums.len() * size_of::<f64>());
        let chunk = self.chunk.iter().flatten().map(|sums| sums.len() * size_of::<f32>());
        let pixels = self.reference.iter().chain(&self.shifts).map(|plane| plane.len() * size_of::<f32>());
        long.chain(chunk).chain(pixels).sum()
    }

    /// Adds samples in the order of time.
    pub(super) fn add<T: Count>(
        &mut self,
        workers: &impl Workers,
        plan: &Plan,
        layout: &Layout,
        mut samples: &[Planes<'_, T>],
    ) {
        if let (0, Some(first)) = (self.samples, samples.first()) {
            self.refer_to_frame(layout, first);
        }
        while !samples.is_empty() {
            let (now, later) = samples.split_at(samples.len().min(self.until_next_step(plan.order) as usize));
            let block = Block::new((plan, &self.deltas), *layout, &self.reference, now);
            let mut bands = bands_of(&mut self.chunk);
            workers.for_each(&mut bands, |band, sums| accumulate(&block, band, sums));
            self.samples += now.len() as u64;
            if recenterings(plan.order).contains(&self.samples) {
                self.recenter(workers, plan, layout);
            }
            if self.samples.is_multiple_of(CHUNK) {
                self.flush(workers);
            }
            samples = later;
        }
    }

    /// Samples until the sums are next moved in reference or precision.
    fn until_next_step(&self, order: usize) -> u64 {
        let next = recenterings(order).iter().find(|&&at| at > self.samples);
        next.map_or(CHUNK - self.samples % CHUNK, |at| at - self.samples)
    }

    fn refer_to_frame<T: Count>(&mut self, layout: &Layout, planes: &Planes<'_, T>) {
        for (reference, frame) in self.reference.iter_mut().zip(planes) {
            for (line, pixels) in
                reference.chunks_exact_mut(layout.stride).zip(frame.chunks_exact(layout.width))
            {
                line.iter_mut().zip(pixels).for_each(|(reference, pixel)| *reference = pixel.counts());
            }
        }
    }

    /// Moves the reference to the mean so far, in whole counts so that differences of counts stay exact.
    fn recenter(&mut self, workers: &impl Workers, plan: &Plan, layout: &Layout) {
        for (channel, shift) in self.shifts.iter_mut().enumerate() {
            for (y, line) in shift.chunks_exact_mut(layout.stride).enumerate() {
                for x in (0..layout.stride).step_by(LANES) {
                    let sums = layout.load(&self.chunk[1], channel, y as i64, x as i64);
                    for lane in 0..LANES {
                        let inside = x + lane < layout.width;
                        let mean = (sums[lane] / self.samples as f64).round();
                        line[x + lane] = if inside { mean as f32 } else { 0.0 };
                    }
                }
            }
        }
        shift_sums(&mut self.chunk, workers, plan, layout, &self.shifts, self.samples);
        for (reference, shift) in self.reference.iter_mut().zip(&self.shifts) {
            reference.iter_mut().zip(shift).for_each(|(reference, shift)| *reference += shift);
        }
    }

    /// Moves the `f32` sums into the `f64` ones, where there are any.
    fn flush(&mut self, workers: &impl Workers) {
        let Some(long) = &mut self.long else { return };
        for (chunk, long) in self.chunk.iter_mut().zip(long) {
            let mut pairs: Vec<_> = chunk.iter_mut().zip(long).collect();
            workers.for_each(&mut pairs, |_, (chunk, long)| {
                for (small, large) in chunk.iter_mut().zip(long.iter_mut()) {
                    *large += f64::from(std::mem::take(small));
                }
            });
        }
    }

    /// Adds the sums of a later part of the same subsequence, moved to this state's reference.
    pub(super) fn merge(&mut self, later: &Self, workers: &impl Workers, plan: &Plan, layout: &Layout) {
        (self.run, self.end) = (later.run, later.end);
        let mut later = later.clone();
        if self.samples == 0 {
            (self.samples, self.reference) = (later.samples, later.reference);
            (self.chunk, self.long) = (later.chunk, later.long);
            return;
        }
        let shifts: Vec<Vec<f32>> = self
            .reference
            .iter()
            .zip(&later.reference)
            .map(|(ours, theirs)| ours.iter().zip(theirs).map(|(ours, theirs)| ours - theirs).collect())
            .collect();
        self.flush(workers);
        later.flush(workers);
        match (&mut self.long, &mut later.long) {
            (Some(ours), Some(theirs)) => {
                shift_sums(theirs, workers, plan, layout, &shifts, later.samples);
                add_all(ours, theirs);
            }
            _ => {
                shift_sums(&mut later.chunk, workers, plan, layout, &shifts, later.samples);
                add_all(&mut self.chunk, &later.chunk);
            }
        }
        self.samples += later.samples;
    }

    /// Sums of one accumulator for neighboring pixels, in `f64`; zero outside the camera region.
    #[inline(always)]
    pub(super) fn sums(&self, layout: &Layout, group: usize, accumulator: usize, y: i64, x: i64) -> Lanes {
        let mut sums = layout.load(&self.chunk[group], accumulator, y, x);
        if let Some(long) = &self.long {
            let long = layout.load(&long[group], accumulator, y, x);
            (0..LANES).for_each(|lane| sums[lane] += long[lane]);
        }
        sums
    }

    /// One padded row of sums in `f64`; `false` outside the camera region.
    #[inline(always)]
    pub(super) fn sums_row(
        &self,
        layout: &Layout,
        group: usize,
        accumulator: usize,
        y: i64,
        sums: &mut [f64],
    ) -> bool {
        let Some(chunk) = layout.row(&self.chunk[group], accumulator, y) else { return false };
        sums.iter_mut().zip(chunk).for_each(|(sum, &chunk)| *sum = f64::from(chunk));
        if let Some(long) = self.long.as_ref().and_then(|long| layout.row(&long[group], accumulator, y)) {
            sums.iter_mut().zip(long).for_each(|(sum, long)| *sum += long);
        }
        true
    }

    /// Reference of one channel, counts.
    pub(super) fn reference(&self, channel: usize) -> &[f32] {
        &self.reference[channel]
    }
}

/// The groups of every band, for work on one band at a time.
fn bands_of(groups: &mut Groups<f32>) -> Vec<Vec<&mut [f32]>> {
    let mut bands: Vec<Vec<&mut [f32]>> = Vec::new();
    for group in groups {
        bands.resize_with(group.len(), Vec::new);
        bands.iter_mut().zip(group).for_each(|(band, sums)| band.push(sums));
    }
    bands
}

fn add_all<T: Copy + std::ops::AddAssign>(ours: &mut Groups<T>, theirs: &Groups<T>) {
    for (ours, theirs) in ours.iter_mut().flatten().zip(theirs.iter().flatten()) {
        ours.iter_mut().zip(theirs).for_each(|(ours, theirs)| *ours += *theirs);
    }
}

/// A stored sum.
trait Sum: Copy + Default + Into<f64> + Send + Sync {
    fn rounded(value: f64) -> Self;
}

impl Sum for f32 {
    #[inline(always)]
    fn rounded(value: f64) -> Self {
        value as Self
    }
}

impl Sum for f64 {
    #[inline(always)]
    fn rounded(value: f64) -> Self {
        value
    }
}

/// Moves sums of `samples` samples to a reference that is larger by `shifts` (binomial theorem, per pixel of a tuple).
///
/// The sum of a tuple about the new reference is the sum over all its subsets of their old sums times the
/// negative shifts of the pixels left out. Groups go from large to small, as each needs the old smaller ones.
fn shift_sums<T: Sum>(
    groups: &mut Groups<T>,
    workers: &impl Workers,
    plan: &Plan,
    layout: &Layout,
    shifts: &[Vec<f32>],
    samples: u64,
) {
    let shift = Shift { plan, layout, shifts, samples: samples as f64 };
    for degree in (2..=plan.order).rev() {
        let (smaller, current) = groups.split_at_mut(degree);
        workers.for_each(&mut current[0], |band, sums| shift.terms(smaller, degree, band, sums));
    }
    let (squares, rest) = groups.split_at_mut(1);
    workers.for_each(&mut squares[0], |band, sums| shift.squares(&rest[0], band, sums));
    workers.for_each(&mut rest[0], |band, sums| shift.terms(squares, 1, band, sums));
}

/// One change of reference.
struct Shift<'a> {
    plan: &'a Plan,
    layout: &'a Layout,
    shifts: &'a [Vec<f32>],
    samples: f64,
}

impl Shift<'_> {
    fn squares<T: Sum>(&self, first_moments: &[Vec<T>], band: usize, squares: &mut [T]) {
        for channel in 0..self.plan.algebra.channels() {
            let squares = &mut squares[channel * self.layout.plane_len(band)..];
            for (y, x, place) in registers(self.layout, band) {
                let sums = self.layout.load(first_moments, channel, y, x);
                let shift = self.shift(channel, y, x);
                for lane in 0..LANES {
                    let moved = (self.samples * shift[lane] - 2.0 * sums[lane]) * shift[lane];
                    squares[place + lane] = T::rounded(squares[place + lane].into() + moved);
                }
            }
        }
    }

    fn terms<T: Sum>(&self, smaller: &[Vec<Vec<T>>], degree: usize, band: usize, sums: &mut [T]) {
        if degree == 2 {
            let pairs = MovingPairs { shift: self, first_moments: &smaller[1], band, sums };
            return pulp::Arch::new().dispatch(pairs);
        }
        pulp::Arch::new().dispatch(MovingTerms { shift: self, smaller, degree, band, sums });
    }

    /// Terms of any number of pixels, one register of pixels at a time.
    #[inline(always)]
    fn terms_of_any_size<T: Sum>(&self, smaller: &[Vec<Vec<T>>], degree: usize, band: usize, sums: &mut [T]) {
        let mut products = Products::new(&self.plan.algebra, degree);
        for term in &self.plan.groups[degree] {
            for set in &term.sets {
                for (y, x, place) in registers(self.layout, band) {
                    let change = self.move_set(set, smaller, (y, x), &mut products);
                    for (coefficient, change) in change.iter().enumerate() {
                        let start = (term.first + coefficient) * self.layout.plane_len(band) + place;
                        for (sum, change) in sums[start..start + LANES].iter_mut().zip(change) {
                            *sum = T::rounded((*sum).into() + change);
                        }
                    }
                }
            }
        }
    }

    /// Pairs: the new sum is the old one less `shift_b S_a` and `shift_a S'_b`, `S'` the sum about the new reference.
    ///
    /// Row by row, as this is done for every subsequence at full camera size.
    #[inline(always)]
    fn pairs<T: Sum>(&self, first_moments: &[Vec<T>], band: usize, sums: &mut [T]) {
        let (algebra, layout) = (&self.plan.algebra, self.layout);
        let channels = algebra.channels();
        for term in &self.plan.groups[2] {
            for set in &term.sets {
                for (row, y) in layout.rows(band).enumerate() {
                    for a in 0..channels {
                        for b in if self.plan.symmetric() { 0 } else { a }..channels {
                            let plane = term.first + algebra.product_index(1, 1, a, b);
                            let start = plane * layout.plane_len(band) + row * layout.stride;
                            let sums = &mut sums[start..start + layout.stride];
                            self.pair_row(first_moments, set, (a, b), y as i64, sums);
                        }
                    }
                }
            }
        }
    }

    /// One row of one pair, its pixels from channels `a` and `b`.
    #[inline(always)]
    fn pair_row<T: Sum>(
        &self,
        first_moments: &[Vec<T>],
        set: &PlacedSet,
        (a, b): (usize, usize),
        y: i64,
        sums: &mut [T],
    ) {
        let [Element { dy: dy_a, dx: dx_a, .. }, Element { dy: dy_b, dx: dx_b, .. }] =
            [set.elements[0], set.elements[1]];
        let (ya, yb) = (y + i64::from(dy_a), y + i64::from(dy_b));
        let row = |accumulator, y| self.layout.row(first_moments, accumulator, y);
        let Some((sum_a, shift_a)) = row(set.subsets[1].first + a, ya).zip(self.shift_row(a, ya)) else {
            return;
        };
        let Some((sum_b, shift_b)) = row(set.subsets[2].first + b, yb).zip(self.shift_row(b, yb)) else {
            return;
        };
        let columns = self.layout.shared_columns(dx_a, dx_b);
        let of_a = shifted(sum_a, columns.clone(), dx_a).iter().zip(shifted(shift_a, columns.clone(), dx_a));
        let of_b = shifted(sum_b, columns.clone(), dx_b).iter().zip(shifted(shift_b, columns.clone(), dx_b));
        for ((sum, (sum_a, shift_a)), (sum_b, shift_b)) in sums[columns].iter_mut().zip(of_a).zip(of_b) {
            let (sum_a, shift_a): (f64, f64) = ((*sum_a).into(), f64::from(*shift_a));
            let (sum_b, shift_b): (f64, f64) = ((*sum_b).into(), f64::from(*shift_b));
            let moved = shift_b * sum_a + shift_a * (sum_b - self.samples * shift_b);
            *sum = T::rounded((*sum).into() - moved);
        }
    }

    fn shift_row(&self, channel: usize, y: i64) -> Option<&[f32]> {
        let y = usize::try_from(y).ok().filter(|&y| y < self.layout.height)?;
        Some(&self.shifts[channel][y * self.layout.stride..(y + 1) * self.layout.stride])
    }

    /// What the change of reference adds to one set's sum at one register of pixels.
    ///
    /// One pixel after the other takes the new reference: the sums that hold it become smaller by its shift times
    /// those that do not. In the end the sum of all pixels has met the old sums of all subsets.
    #[inline(always)]
    fn move_set<'p, T: Sum>(
        &self,
        set: &PlacedSet,
        smaller: &[Vec<Vec<T>>],
        (y, x): (i64, i64),
        products: &'p mut Products,
    ) -> &'p [Lanes] {
        let degree = set.elements.len();
        let full = (1usize << degree) - 1;
        self.load_subsets(set, smaller, (y, x), &mut products.subsets);
        for (pixel, element) in set.elements.iter().enumerate().rev() {
            let (y, x) = (y + i64::from(element.dy), x + i64::from(element.dx));
            for (channel, shift) in products.shift.iter_mut().enumerate() {
                *shift = self.shift(channel, y, x);
            }
            let (bit, moved) = (1 << pixel, full & !((2 << pixel) - 1));
            for rest in 0..bit {
                let (without, with) = products.subsets.split_at_mut(moved | bit | rest);
                let size = (moved | rest).count_ones() as usize;
                let (left, right) = ((&without[moved | rest][..], size), (&products.shift[..], 1));
                self.plan.algebra.add_product(left, right, -1.0, &mut with[0]);
            }
        }
        &products.subsets[full]
    }

    /// The old sums of all subsets of a set, by bit mask; zero for the whole set, so that only its change remains.
    #[inline(always)]
    fn load_subsets<T: Sum>(
        &self,
        set: &PlacedSet,
        smaller: &[Vec<Vec<T>>],
        (y, x): (i64, i64),
        subsets: &mut [Polynomial],
    ) {
        subsets[0][0] = [self.samples; LANES];
        for (mask, place) in set.subsets.iter().enumerate().skip(1) {
            let size = mask.count_ones() as usize;
            let (y, x) = place.seen_from(y, x);
            for (coefficient, sum) in subsets[mask].iter_mut().enumerate() {
                *sum = self.layout.load(&smaller[size], place.first + coefficient, y, x);
            }
        }
        subsets[set.subsets.len()].fill([0.0; LANES]);
    }

    #[inline(always)]
    fn shift(&self, channel: usize, y: i64, x: i64) -> Lanes {
        match usize::try_from(y) {
            Ok(y) if y < self.layout.height => {
                load_row(&self.shifts[channel][y * self.layout.stride..(y + 1) * self.layout.stride], x)
            }
            _ => [0.0; LANES],
        }
    }
}

/// The work of [`Shift::pairs`], compiled for the widest registers.
struct MovingPairs<'a, T> {
    shift: &'a Shift<'a>,
    first_moments: &'a [Vec<T>],
    band: usize,
    sums: &'a mut [T],
}

impl<T: Sum> WithSimd for MovingPairs<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.shift.pairs(self.first_moments, self.band, self.sums);
    }
}

/// The work of [`Shift::terms_of_any_size`], compiled for the widest registers.
struct MovingTerms<'a, T> {
    shift: &'a Shift<'a>,
    smaller: &'a [Vec<Vec<T>>],
    degree: usize,
    band: usize,
    sums: &'a mut [T],
}

impl<T: Sum> WithSimd for MovingTerms<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.shift.terms_of_any_size(self.smaller, self.degree, self.band, self.sums);
    }
}

/// Memory for the sums of a set's subsets, reused from register to register.
struct Products {
    /// By bit mask over the pixels of the set.
    subsets: Vec<Polynomial>,
    /// Per channel, of one pixel.
    shift: Polynomial,
}

impl Products {
    fn new(algebra: &ChannelAlgebra, degree: usize) -> Self {
        let of_mask = |mask: usize| vec![[0.0; LANES]; algebra.coefficients(mask.count_ones() as usize)];
        Self {
            subsets: (0..1 << degree).map(of_mask).collect(),
            shift: vec![[0.0; LANES]; algebra.channels()],
        }
    }
}
