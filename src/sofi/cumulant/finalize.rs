//! From running sums to cumulants (Eq. 2, S2, S4): the only place where sums are divided by the number of samples.
//!
//! For every set of a sub-position the joint cumulant follows from the raw moments of its subsets,
//! `kappa(S) = m(S) - sum over A of kappa(A) m(S \ A)`, A running over the proper subsets that hold S's first pixel.
//!
//! In: sums of a subsequence. Out: cumulants, means and variances of one band, in `f64`.

use super::algebra::{LANES, Lanes, Polynomial};
use super::bias::BiasRows;
use super::layout::{Layout, load_row, registers, shifted};
use super::moments::RunMoments;
use super::plan::{PlacedSet, Plan, Term};
use super::registered::TRANSMITTED;
use pulp::{Simd, WithSimd};

/// Number of result planes: cumulants by sub-position and spectral channel, then means, then variances.
pub(super) fn result_planes(plan: &Plan) -> usize {
    plan.accumulators(plan.order) + 2 * plan.algebra.channels()
}

/// Adds `weight` times every result of a subsequence to the results of one band.
pub(super) fn add_results(
    plan: &Plan,
    layout: &Layout,
    moments: &RunMoments,
    weight: f64,
    band: usize,
    results: &mut [f32],
) {
    pulp::Arch::new().dispatch(Finalizing { plan, layout, moments, weight, band, results });
}

/// The work on one band, compiled for the widest registers.
struct Finalizing<'a> {
    plan: &'a Plan,
    layout: &'a Layout,
    moments: &'a RunMoments,
    weight: f64,
    band: usize,
    results: &'a mut [f32],
}

impl WithSimd for Finalizing<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { plan, layout, moments, weight, band, results } = self;
        if plan.order == 2 {
            return pair_cumulants(plan, layout, moments, weight, band, results);
        }
        let mut scratch = Scratch::new(plan);
        let plane = layout.plane_len(band);
        for (y, x, place) in registers(layout, band) {
            let mut add = |result: usize, values: &Lanes| {
                let start = result * plane + place;
                for (sum, value) in results[start..start + LANES].iter_mut().zip(values) {
                    *sum += (weight * value) as f32;
                }
            };
            cumulants(plan, layout, moments, (y, x), &mut scratch, &mut add);
            means_and_variances(plan, layout, moments, (y, x), &mut add);
        }
        take_off_shared_noise(plan, layout, moments, weight, band, results);
    }
}

/// Orders above 2: the noise that values between pixels share is taken off the cumulants of pure T.
fn take_off_shared_noise(
    plan: &Plan,
    layout: &Layout,
    moments: &RunMoments,
    weight: f64,
    band: usize,
    results: &mut [f32],
) {
    let Some(raw) = moments.raw() else { return };
    let mut bias = BiasRows::default();
    for (row, y) in layout.rows(band).enumerate() {
        bias.restart(y as i64);
        for term in &plan.groups[plan.order] {
            if bias.fill(raw, layout, moments.samples, term, y as i64) {
                let result = term.first + plan.algebra.coefficients(plan.order) - 1;
                let start = result * layout.plane_len(band) + row * layout.stride;
                for (sum, bias) in results[start..start + layout.stride].iter_mut().zip(&bias.row) {
                    *sum -= (weight * bias) as f32;
                }
            }
        }
    }
}

/// Polynomials of one register of pixels, by bit mask over the elements of a set.
struct Scratch {
    moments: Vec<Polynomial>,
    cumulants: Vec<Polynomial>,
    total: Polynomial,
    /// One over the number of ways to share a tuple among the channels, per spectral channel.
    shares: Vec<f64>,
}

impl Scratch {
    fn new(plan: &Plan) -> Self {
        let of_mask = |mask: usize| vec![[0.0; LANES]; plan.algebra.coefficients(mask.count_ones() as usize)];
        let all: Vec<Polynomial> = (0..1 << plan.order).map(of_mask).collect();
        let total = vec![[0.0; LANES]; plan.algebra.coefficients(plan.order)];
        Self { moments: all.clone(), cumulants: all, total, shares: shares(plan) }
    }
}

/// Order 2, where `kappa = m(ab) - m(a) m(b)`, row by row, as this is done at full camera size.
#[inline(always)]
fn pair_cumulants(
    plan: &Plan,
    layout: &Layout,
    moments: &RunMoments,
    weight: f64,
    band: usize,
    results: &mut [f32],
) {
    let (mut rows, mut bias) = (PairRows::new(plan, layout), BiasRows::default());
    let (channels, per_sample) = (plan.algebra.channels(), 1.0 / moments.samples as f64);
    let first = plan.accumulators(2);
    for (row, y) in layout.rows(band).enumerate() {
        let mut add = |result: usize, values: &[f64], scale: f64| {
            let start = result * layout.plane_len(band) + row * layout.stride;
            for (sum, value) in results[start..start + layout.stride].iter_mut().zip(values) {
                *sum += (weight * scale * value) as f32;
            }
        };
        bias.restart(y as i64);
        for term in &plan.groups[2] {
            rows.sum_term(plan, layout, moments, term, y as i64);
            for (coefficient, total) in rows.totals.iter().enumerate() {
                let scale = per_sample * rows.shares[coefficient] / term.sets.len() as f64;
                add(term.first + coefficient, total, scale);
            }
            if let Some(raw) = moments.raw()
                && bias.fill(raw, layout, moments.samples, term, y as i64)
            {
                let both = plan.algebra.product_index(1, 1, TRANSMITTED, TRANSMITTED);
                add(term.first + both, &bias.row, -1.0);
            }
        }
        for channel in 0..channels {
            rows.mean_and_variance(layout, moments, channel, y);
            add(first + channel, &rows.a, 1.0);
            add(first + channels + channel, &rows.b, 1.0);
        }
    }
}

/// Memory for the rows of one camera row's pairs.
struct PairRows {
    /// Per spectral channel: summed products less the products of sums per sample.
    totals: Vec<Vec<f64>>,
    a: Vec<f64>,
    b: Vec<f64>,
    shares: Vec<f64>,
}

impl PairRows {
    fn new(plan: &Plan, layout: &Layout) -> Self {
        let row = vec![0.0; layout.stride];
        let shares = shares(plan);
        Self { totals: vec![row.clone(); shares.len()], a: row.clone(), b: row, shares }
    }

    #[inline(always)]
    fn sum_term(&mut self, plan: &Plan, layout: &Layout, moments: &RunMoments, term: &Term, y: i64) {
        let channels = plan.algebra.channels();
        for (coefficient, total) in self.totals.iter_mut().enumerate() {
            moments.sums_row(layout, 2, term.first + coefficient, y, total);
        }
        for set in &term.sets {
            for channel_a in 0..channels {
                for channel_b in if plan.symmetric() { 0 } else { channel_a }..channels {
                    let total = plan.algebra.product_index(1, 1, channel_a, channel_b);
                    self.subtract_product(layout, moments, set, (channel_a, channel_b), total, y);
                }
            }
        }
    }

    #[inline(always)]
    fn subtract_product(
        &mut self,
        layout: &Layout,
        moments: &RunMoments,
        set: &PlacedSet,
        (channel_a, channel_b): (usize, usize),
        total: usize,
        y: i64,
    ) {
        let [a, b] = [set.subsets[1], set.subsets[2]];
        let per_sample = 1.0 / moments.samples as f64;
        let ((ya, _), (yb, _)) = (a.seen_from(y, 0), b.seen_from(y, 0));
        if !moments.sums_row(layout, 1, a.first + channel_a, ya, &mut self.a)
            || !moments.sums_row(layout, 1, b.first + channel_b, yb, &mut self.b)
        {
            return;
        }
        let columns = layout.shared_columns(a.dx, b.dx);
        let pairs =
            shifted(&self.a, columns.clone(), a.dx).iter().zip(shifted(&self.b, columns.clone(), b.dx));
        for (total, (a, b)) in self.totals[total][columns].iter_mut().zip(pairs) {
            *total -= a * b * per_sample;
        }
    }

    /// Puts the mean into `a` and the variance into `b`.
    #[inline(always)]
    fn mean_and_variance(&mut self, layout: &Layout, moments: &RunMoments, channel: usize, y: usize) {
        let per_sample = 1.0 / moments.samples as f64;
        moments.sums_row(layout, 1, channel, y as i64, &mut self.a);
        moments.sums_row(layout, 0, channel, y as i64, &mut self.b);
        let reference = &moments.reference(channel)[y * layout.stride..(y + 1) * layout.stride];
        for ((mean, variance), reference) in self.a.iter_mut().zip(&mut self.b).zip(reference) {
            let shift = *mean * per_sample;
            *variance = (*variance * per_sample - shift * shift).max(0.0);
            *mean = f64::from(*reference) + shift;
        }
    }
}

/// One over the number of ways to share a tuple among the channels, per spectral channel.
fn shares(plan: &Plan) -> Vec<f64> {
    let ways = |u| if plan.symmetric() { plan.algebra.multiplicity(plan.order, u) } else { 1.0 };
    (0..plan.algebra.coefficients(plan.order)).map(|u| 1.0 / ways(u)).collect()
}

#[inline(always)]
fn cumulants(
    plan: &Plan,
    layout: &Layout,
    moments: &RunMoments,
    (y, x): (i64, i64),
    scratch: &mut Scratch,
    add: &mut impl FnMut(usize, &Lanes),
) {
    let per_sample = 1.0 / moments.samples as f64;
    for term in &plan.groups[plan.order] {
        for (coefficient, total) in scratch.total.iter_mut().enumerate() {
            *total =
                moments.sums(layout, plan.order, term.first + coefficient, y, x).map(|sum| sum * per_sample);
        }
        for set in &term.sets {
            load_moments(plan, layout, moments, set, (y, x), &mut scratch.moments);
            subtract_products_of_subsets(plan, scratch);
        }
        for (coefficient, total) in scratch.total.iter().enumerate() {
            let share = scratch.shares[coefficient] / term.sets.len() as f64;
            add(term.first + coefficient, &total.map(|value| value * share));
        }
    }
}

#[inline(always)]
fn load_moments(
    plan: &Plan,
    layout: &Layout,
    moments: &RunMoments,
    set: &PlacedSet,
    (y, x): (i64, i64),
    loaded: &mut [Polynomial],
) {
    let per_sample = 1.0 / moments.samples as f64;
    for (mask, place) in set.subsets.iter().enumerate().skip(1) {
        let size = mask.count_ones() as usize;
        let (y, x) = place.seen_from(y, x);
        for (coefficient, moment) in loaded[mask].iter_mut().enumerate().take(plan.algebra.coefficients(size))
        {
            *moment = moments.sums(layout, size, place.first + coefficient, y, x).map(|sum| sum * per_sample);
        }
    }
}

/// Takes one set's lower-order products off the total, which starts as the sum of the full products of all sets.
#[inline(always)]
fn subtract_products_of_subsets(plan: &Plan, scratch: &mut Scratch) {
    let Scratch { moments, cumulants, total, .. } = scratch;
    let full = (1usize << plan.order) - 1;
    for mask in (1..full).step_by(2) {
        let (smaller, rest) = cumulants.split_at_mut(mask);
        rest[0].clone_from(&moments[mask]);
        subtract_proper_subsets(plan, mask, smaller, moments, &mut rest[0]);
    }
    subtract_proper_subsets(plan, full, cumulants, moments, total);
}

/// `kappa -= sum over A of kappa(A) m(mask \ A)`, A running over proper subsets of `mask` that hold element 0.
#[inline(always)]
fn subtract_proper_subsets(
    plan: &Plan,
    mask: usize,
    cumulants: &[Polynomial],
    moments: &[Polynomial],
    kappa: &mut [Lanes],
) {
    for part in (1..mask).step_by(2).filter(|part| part & !mask == 0) {
        let left_out = mask & !part;
        let size = |mask: usize| mask.count_ones() as usize;
        let (cumulant, moment) =
            ((&cumulants[part][..], size(part)), (&moments[left_out][..], size(left_out)));
        plan.algebra.add_product(cumulant, moment, -1.0, kappa);
    }
}

#[inline(always)]
fn means_and_variances(
    plan: &Plan,
    layout: &Layout,
    moments: &RunMoments,
    (y, x): (i64, i64),
    add: &mut impl FnMut(usize, &Lanes),
) {
    let channels = plan.algebra.channels();
    let (first, per_sample) = (plan.accumulators(plan.order), 1.0 / moments.samples as f64);
    for channel in 0..channels {
        let sums = moments.sums(layout, 1, channel, y, x);
        let squares = moments.sums(layout, 0, channel, y, x);
        let start = y as usize * layout.stride;
        let reference = load_row(&moments.reference(channel)[start..start + layout.stride], x);
        add(first + channel, &std::array::from_fn(|lane| reference[lane] + sums[lane] * per_sample));
        add(
            first + channels + channel,
            &std::array::from_fn(|lane| {
                let mean = sums[lane] * per_sample;
                (squares[lane] * per_sample - mean * mean).max(0.0)
            }),
        );
    }
}
