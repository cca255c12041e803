//! Running sums of one subsequence: raw moments about a reference near the mean.
//!
//! Sums are kept in `f32` for at most [`CHUNK`] samples and then moved to `f64`, so that neither the length of a
//! subsequence nor the camera offset costs precision. The reference is the first exposure; after
//! a few samples the sums are moved, exactly, to the mean so far.
//!
//! In: blocks of samples. Out: sums in `f64`. Never: depends on how the samples were blocked.

use super::algebra::{LANES, Lanes};
use super::kernel::{Block, Count, Deltas, Planes, accumulate};
use super::layout::Layout;
use super::plan::Plan;
use super::registered::{RawSums, Registered, TRANSMITTED, add_raw};
use super::shift::shift_sums;
use super::workers::Workers;

/// Samples that an `f32` sum takes before it is moved to `f64`.
pub(super) const CHUNK: u64 = 256;

/// Numbers of samples after which the reference moves to the mean so far. High powers need a good one early.
fn recenterings(order: usize) -> &'static [u64] {
    if order == 2 { &[16] } else { &[4, 16] }
}

/// Accumulators by group, then band; see [`Layout`] and [`Plan::groups`].
pub(super) type Groups<T> = Vec<Vec<Vec<T>>>;

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
    /// Sums of the raw pixels of a camera that is registered onto the other.
    raw: Option<RawSums>,
}

impl RunMoments {
    /// State for subsequences of at most `longest` samples.
    pub(super) fn new(plan: &Plan, layout: &Layout, longest: u64, registered: Option<&Registered>) -> Self {
        let zeroed = |group: usize| layout.zeroed(plan.accumulators(group));
        Self {
            run: 0,
            samples: 0,
            begin: 0,
            end: 0,
            deltas: Deltas::new(plan, layout, registered.is_some()),
            reference: vec![vec![0.0; layout.height * layout.stride]; plan.algebra.channels()],
            shifts: vec![vec![0.0; layout.height * layout.stride]; plan.algebra.channels()],
            chunk: (0..=plan.order).map(zeroed).collect(),
            long: (longest > CHUNK)
                .then(|| (0..=plan.order).map(|group| layout.zeroed(plan.accumulators(group))).collect()),
            raw: registered.map(|registered| registered.raw_sums(layout)),
        }
    }

    /// Empties the state for another subsequence, keeping its memory.
    pub(super) fn restart(&mut self, run: u64, begin: u64) {
        (self.run, self.samples, self.begin, self.end) = (run, 0, begin, begin);
        self.chunk.iter_mut().flatten().for_each(|sums| sums.fill(0.0));
        self.long.iter_mut().flatten().flatten().for_each(|sums| sums.fill(0.0));
        self.raw.iter_mut().for_each(RawSums::clear);
    }

    /// Bytes of this state.
    pub(super) fn bytes(&self) -> usize {
        let long = self.long.iter().flatten().flatten().map(|sums| sums.len() * size_of::<f64>());
        let chunk = self.chunk.iter().flatten().map(|sums| sums.len() * size_of::<f32>());
        let pixels = self.reference.iter().chain(&self.shifts).map(|plane| plane.len() * size_of::<f32>());
        let raw = self.raw.iter().map(RawSums::bytes);
        long.chain(chunk).chain(pixels).chain(raw).sum()
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
            match &mut self.raw {
                None => workers.for_each(&mut bands, |band, sums| accumulate(&block, band, sums)),
                Some(RawSums { registered, bands: raw }) => {
                    let block = block.registered(&registered.resampler);
                    // Rows of T are summed while they are still in the caches.
                    let partner = |band: usize| registered.raw_band(layout, band);
                    let mut raw: Vec<Option<&mut Vec<f64>>> = raw.iter_mut().map(Some).collect();
                    let mut bands: Vec<_> = bands
                        .into_iter()
                        .enumerate()
                        .map(|(band, sums)| (sums, raw[partner(band)].take()))
                        .collect();
                    workers.for_each(&mut bands, |band, (sums, raw)| {
                        accumulate(&block, band, sums);
                        if let Some(raw) = raw {
                            add_raw(now, layout, partner(band), raw);
                        }
                    });
                }
            }
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
        for (channel, (reference, frame)) in self.reference.iter_mut().zip(planes).enumerate() {
            if let (TRANSMITTED, Some(raw)) = (channel, &self.raw) {
                refer_to_nearest(&raw.registered, layout, frame, reference);
                continue;
            }
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
            (self.chunk, self.long, self.raw) = (later.chunk, later.long, later.raw);
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
        if let (Some(ours), Some(theirs)) = (&mut self.raw, &later.raw) {
            ours.merge(theirs);
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

    /// Sums of raw pixels, where a camera is registered.
    pub(super) fn raw(&self) -> Option<&RawSums> {
        self.raw.as_ref()
    }

    /// Reference of one channel, counts.
    pub(super) fn reference(&self, channel: usize) -> &[f32] {
        &self.reference[channel]
    }
}

/// The raw pixels nearest to those of R, in whole counts.
fn refer_to_nearest<T: Count>(registered: &Registered, layout: &Layout, frame: &[T], reference: &mut [f32]) {
    for (y, line) in reference.chunks_exact_mut(layout.stride).enumerate() {
        for (x, reference) in line.iter_mut().take(layout.width).enumerate() {
            let (row, column) = registered.resampler.nearest(y, x);
            *reference = frame[row * layout.width + column].counts();
        }
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
