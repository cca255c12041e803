//! Terms of any order and number of channels, one after another, for one register of pixels.
//!
//! In: rows of a ring, the places of every term's pixels in it. Out: products added to the sums of one band.

use super::kernel::{Rows, at, read_sums, write_sums};
use super::plan::Plan;
use pulp::Simd;

#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "one flat inner step of the hot loop, called in one place")]
pub(super) fn any_order<S: Simd>(
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
