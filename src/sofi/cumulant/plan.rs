//! Which running sums an order needs: the tuples themselves and every smaller tuple inside them.
//!
//! A cumulant about an arbitrary reference needs the raw moments of all subsets of its tuple. Subsets that differ
//! only by a whole-pixel shift share one sum, kept at the row-major first pixel of the subset.
//!
//! In: the virtual-pixel grid, channels and lags. Out: terms in groups of one degree, with their storage order.

use super::algebra::ChannelAlgebra;
use crate::sofi::grid::{Combinations, Offset, VirtualPixelGrid};
use std::collections::BTreeMap;

/// One pixel of a tuple: where, and how many exposures later.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Element {
    pub(super) dy: i32,
    pub(super) dx: i32,
    /// Index into [`Plan::lags`].
    pub(super) lag: usize,
}

/// A running sum: of the products over the pixels of its sets, one coefficient per sharing among the channels.
///
/// The terms of the largest group are the sub-positions of the fine grid, row by row; smaller ones have one set.
#[derive(Debug, Clone)]
pub(super) struct Term {
    pub(super) sets: Vec<PlacedSet>,
    /// First accumulator of this term within its group.
    pub(super) first: usize,
}

/// Where a subset's moment is kept: term of the group of its size, at a shifted pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub(super) first: usize,
    pub(super) dy: i32,
    pub(super) dx: i32,
}

impl Place {
    /// The pixel at which the subset's sum is kept, when the set's base pixel is `(y, x)`.
    #[inline(always)]
    pub(super) fn seen_from(&self, y: i64, x: i64) -> (i64, i64) {
        (y + i64::from(self.dy), x + i64::from(self.dx))
    }
}

/// One set of pixels with the places of all its proper subsets, by bit mask over its elements.
#[derive(Debug, Clone)]
pub(super) struct PlacedSet {
    pub(super) elements: Vec<Element>,
    pub(super) subsets: Vec<Place>,
}

/// The terms of an order: `groups[d]` holds those of `d` pixels, group 0 the squares for the variance.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    pub(super) order: usize,
    pub(super) algebra: ChannelAlgebra,
    pub(super) lags: Vec<u64>,
    pub(super) groups: Vec<Vec<Term>>,
    pub(super) combinations: Combinations,
    pub(super) halo: Halo,
}

/// How far pixels of any term lie from the base pixel, in camera pixels, all counted positive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Halo {
    pub(super) up: usize,
    pub(super) down: usize,
    pub(super) left: usize,
    pub(super) right: usize,
}

impl Plan {
    /// `lags[j]` delays the j-th pixel of every set, in row-major order; empty means no delay.
    pub(super) fn new(grid: &VirtualPixelGrid, channels: usize, lags: &[u64]) -> Self {
        let order = grid.order();
        let mut distinct: Vec<u64> = if lags.is_empty() { vec![0] } else { lags.to_vec() };
        distinct.sort_unstable();
        distinct.dedup();
        let lag_of =
            |pixel: usize| lags.get(pixel).map_or(0, |lag| distinct.partition_point(|known| known < lag));
        let top: Vec<Vec<Vec<Element>>> = grid
            .sub_grids()
            .iter()
            .map(|sub_grid| sub_grid.sets.iter().map(|set| with_lags(set, &lag_of)).collect())
            .collect();
        let mut terms = TermTable::new(order, channels);
        for lag in 0..distinct.len() {
            terms.place(&[Element { dy: 0, dx: 0, lag }]);
        }
        let top = top.iter().map(|sets| sets.iter().map(|set| terms.place_subsets(set)).collect()).collect();
        let groups = terms.into_groups(top);
        let halo = Halo::around(&groups);
        let (algebra, combinations) = (ChannelAlgebra::new(channels, order), grid.combinations());
        Self { order, algebra, lags: distinct, groups, combinations, halo }
    }

    /// Whether all ways to share a tuple among the channels count, or only "first pixel from R" (order 2).
    pub(super) fn symmetric(&self) -> bool {
        self.combinations != Combinations::Sofipackage
    }

    /// Number of accumulators per pixel in a group.
    pub(super) fn accumulators(&self, group: usize) -> usize {
        match group {
            0 => self.algebra.channels(),
            degree => self.groups[degree].len() * self.algebra.coefficients(degree),
        }
    }
}

impl Halo {
    fn around(groups: &[Vec<Term>]) -> Self {
        let elements =
            || groups.iter().flatten().flat_map(|term| term.sets.iter().flat_map(|set| &set.elements));
        let reach =
            |distance: &dyn Fn(&Element) -> i32| elements().map(distance).max().unwrap_or(0).max(0) as usize;
        Self {
            up: reach(&|element| -element.dy),
            down: reach(&|element| element.dy),
            left: reach(&|element| -element.dx),
            right: reach(&|element| element.dx),
        }
    }
}

/// Subsets met so far, up to a whole-pixel shift.
struct TermTable {
    by_size: Vec<BTreeMap<Vec<Element>, usize>>,
    coefficients: Vec<usize>,
}

impl TermTable {
    fn new(order: usize, channels: usize) -> Self {
        let algebra = ChannelAlgebra::new(channels, order);
        let coefficients = (0..=order).map(|degree| algebra.coefficients(degree)).collect();
        Self { by_size: vec![BTreeMap::new(); order + 1], coefficients }
    }

    fn place(&mut self, subset: &[Element]) -> Place {
        let Element { dy, dx, .. } = subset[0];
        let shifted = subset.iter().map(|e| Element { dy: e.dy - dy, dx: e.dx - dx, lag: e.lag }).collect();
        let known = &mut self.by_size[subset.len()];
        let next = known.len();
        let term = *known.entry(shifted).or_insert(next);
        Place { first: term * self.coefficients[subset.len()], dy, dx }
    }

    fn place_subsets(&mut self, set: &[Element]) -> PlacedSet {
        let full = (1usize << set.len()) - 1;
        let unused = Place { first: 0, dy: 0, dx: 0 };
        let subsets = (0..full)
            .map(|mask| match elements_in(set, mask) {
                subset if subset.is_empty() => unused,
                subset => self.place(&subset),
            })
            .collect();
        PlacedSet { elements: set.to_vec(), subsets }
    }

    /// The smaller terms in the order of their numbers, then one term per sub-position.
    fn into_groups(mut self, top: Vec<Vec<PlacedSet>>) -> Vec<Vec<Term>> {
        let order = self.by_size.len() - 1;
        let mut groups: Vec<Vec<Term>> = vec![Vec::new(); order + 1];
        for (size, group) in groups.iter_mut().enumerate().take(order) {
            let mut sets: Vec<_> = self.by_size[size].clone().into_iter().collect();
            sets.sort_unstable_by_key(|(_, term)| *term);
            let sets: Vec<_> = sets.into_iter().map(|(set, _)| vec![self.place_subsets(&set)]).collect();
            *group = numbered(sets, self.coefficients[size]);
        }
        groups[order] = numbered(top, self.coefficients[order]);
        groups
    }
}

fn numbered(sets: impl IntoIterator<Item = Vec<PlacedSet>>, coefficients: usize) -> Vec<Term> {
    sets.into_iter().enumerate().map(|(term, sets)| Term { sets, first: term * coefficients }).collect()
}

fn with_lags(set: &[Offset], lag_of: &dyn Fn(usize) -> usize) -> Vec<Element> {
    set.iter()
        .enumerate()
        .map(|(pixel, offset)| Element { dy: offset.dy, dx: offset.dx, lag: lag_of(pixel) })
        .collect()
}

/// The elements of a set whose bits are set in the mask, in order.
fn elements_in(set: &[Element], mask: usize) -> Vec<Element> {
    set.iter().enumerate().filter(|(bit, _)| mask & (1 << bit) != 0).map(|(_, element)| *element).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_order_keeps_four_products_and_one_sum_per_channel_combination() {
        let grid = VirtualPixelGrid::new(2, Combinations::AllClosest).unwrap();
        let plan = Plan::new(&grid, 2, &[]);
        assert_eq!([plan.accumulators(0), plan.accumulators(1), plan.accumulators(2)], [2, 2, 12]);
        assert_eq!(plan.halo, Halo { up: 1, down: 1, left: 1, right: 1 });
    }

    #[test]
    fn places_of_subsets_name_a_stored_term_shifted_onto_them() {
        let grid = VirtualPixelGrid::new(4, Combinations::AllClosest).unwrap();
        let plan = Plan::new(&grid, 2, &[0, 1, 0, 2]);
        for set in plan.groups.iter().flatten().flat_map(|term| &term.sets) {
            for mask in 1..set.subsets.len() {
                let (wanted, place) = (elements_in(&set.elements, mask), set.subsets[mask]);
                let term = plan.groups[wanted.len()].iter().find(|term| term.first == place.first).unwrap();
                let shift = |e: &Element| Element { dy: e.dy + place.dy, dx: e.dx + place.dx, lag: e.lag };
                assert_eq!(term.sets[0].elements.iter().map(shift).collect::<Vec<_>>(), wanted);
            }
        }
    }
}
