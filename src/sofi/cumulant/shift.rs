//! Changes of reference: sums about one reference become sums about another, exactly but for rounding.
//!
//! In: sums of all groups, how much larger the new reference is. Out: the same sums about the new reference.

use super::algebra::{ChannelAlgebra, LANES, Lanes, Polynomial};
use super::layout::{Layout, load_row, registers, shifted};
use super::moments::Groups;
use super::plan::{Element, PlacedSet, Plan};
use super::workers::Workers;
use pulp::{Simd, WithSimd};

/// A stored sum.
pub(super) trait Sum: Copy + Default + Into<f64> + Send + Sync {
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
pub(super) fn shift_sums<T: Sum>(
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
