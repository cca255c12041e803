//! Order 2 with all closest pairs: the four sub-positions of one register of pixels, every sum in a register.
//!
//! In: rows of a ring. Out: squares, sums and products added to the sums of one band.

use super::kernel::{Rows, read_sums, write_sums};
use pulp::Simd;

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
pub(super) fn one_channel<S: Simd>(
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
pub(super) fn two_channels<S: Simd>(
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
