//! Virtual pixels: which camera pixels are multiplied to make which pixel of the fine image (paper, Fig. 1b).
//!
//! In: a cumulant order. Out: for each of the `n * n` sub-positions the sets of `n` distinct camera pixels.
//! Never: repeats a pixel in a set, so shot noise, which is independent from pixel to pixel, stays out of every cumulant.
//! Fails: [`GridError`] for orders outside 2..=6 or a combination rule that does not know the order.

use ndarray::Array2;

/// Smallest and largest cumulant order of the virtual-pixel grid.
pub const ORDERS: std::ops::RangeInclusive<usize> = 2..=6;

/// Smallest and largest pixel offset from which tuples are chosen, in camera pixels.
const OFFSETS: std::ops::RangeInclusive<i32> = -1..=2;

/// Position of a camera pixel relative to a base pixel, in whole pixels; ordered row by row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Offset {
    /// Rows down.
    pub dy: i32,
    /// Columns to the right.
    pub dx: i32,
}

/// The rule by which pixel sets are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Combinations {
    /// All sets of least summed squared pair distance; the value is their mean.
    #[default]
    AllClosest,
    /// Only the first of them per sub-position: fewer products for fast live use, more noise.
    OnePerPosition,
    /// The sets of the published MATLAB software of the paper's authors (order 2 only);
    /// the cross channel takes the first pixel from R and the second from T, in this order only.
    Sofipackage,
}

impl Combinations {
    /// Every rule with the name it has in settings files.
    pub const NAMES: [(&'static str, Self); 3] = [
        ("all-closest", Self::AllClosest),
        ("one-per-position", Self::OnePerPosition),
        ("sofipackage", Self::Sofipackage),
    ];

    /// The rule with that settings name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(known, _)| *known == name).map(|(_, rule)| *rule)
    }
}

/// One of the `n * n` sub-positions of the fine grid, and the pixel sets that make it.
#[derive(Debug, Clone, PartialEq)]
pub struct SubGrid {
    /// Row of the sub-position, in n-ths of a camera pixel.
    pub p: usize,
    /// Column of the sub-position, in n-ths of a camera pixel.
    pub q: usize,
    /// Sets of `n` distinct offsets, each in row-major order, whose offsets sum to `(p, q)`.
    pub sets: Vec<Vec<Offset>>,
    /// `D`, the summed squared pair distance that all sets share, in camera pixels squared (Eq. S6).
    pub squared_distance: f64,
}

/// The virtual-pixel grid of one cumulant order.
#[derive(Debug, Clone, PartialEq)]
pub struct VirtualPixelGrid {
    order: usize,
    combinations: Combinations,
    sub_grids: Vec<SubGrid>,
}

/// Why there is no grid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GridError {
    /// The order is outside [`ORDERS`].
    #[error("cumulant order {0} is not available; choose an order from 2 to 6")]
    Order(usize),
    /// The published software's pixel sets exist at order 2 only.
    #[error(
        "combinations = \"sofipackage\" exist at order 2 only, not at order {0}; choose order 2 or \"all-closest\""
    )]
    SofipackageOrder(usize),
}

impl VirtualPixelGrid {
    /// The grid of order `n` under a combination rule.
    ///
    /// # Errors
    /// [`GridError`] when the order is outside 2..=6, or not 2 under [`Combinations::Sofipackage`].
    pub fn new(order: usize, combinations: Combinations) -> Result<Self, GridError> {
        if !ORDERS.contains(&order) {
            return Err(GridError::Order(order));
        }
        let sub_grids = match combinations {
            Combinations::AllClosest => closest_sub_grids(order),
            Combinations::OnePerPosition => {
                let mut sub_grids = closest_sub_grids(order);
                sub_grids.iter_mut().for_each(|sub_grid| sub_grid.sets.truncate(1));
                sub_grids
            }
            Combinations::Sofipackage if order == 2 => sofipackage_sub_grids(),
            Combinations::Sofipackage => return Err(GridError::SofipackageOrder(order)),
        };
        Ok(Self { order, combinations, sub_grids })
    }

    /// The cumulant order `n`.
    #[must_use]
    pub fn order(&self) -> usize {
        self.order
    }

    /// The rule that chose the sets.
    #[must_use]
    pub fn combinations(&self) -> Combinations {
        self.combinations
    }

    /// The `n * n` sub-positions, row by row: `(p, q)` stands at `p * n + q`.
    #[must_use]
    pub fn sub_grids(&self) -> &[SubGrid] {
        &self.sub_grids
    }

    /// `D(p, q)` for all sub-positions, in camera pixels squared (Eq. S6).
    #[must_use]
    pub fn squared_distances(&self) -> Array2<f64> {
        Array2::from_shape_fn((self.order, self.order), |(p, q)| {
            self.sub_grids[p * self.order + q].squared_distance
        })
    }
}

fn closest_sub_grids(order: usize) -> Vec<SubGrid> {
    let mut tuples = Vec::new();
    extend_tuples(order, &candidate_offsets(), &mut Vec::new(), &mut tuples);
    (0..order * order)
        .map(|position| closest_sets(order, position / order, position % order, &tuples))
        .collect()
}

fn closest_sets(order: usize, p: usize, q: usize, tuples: &[Vec<Offset>]) -> SubGrid {
    let wanted = (p as i32, q as i32);
    debug_assert!(p < order && q < order, "sub-positions lie inside one camera pixel");
    let matching = || tuples.iter().filter(|tuple| offset_sum(tuple) == wanted);
    let least = matching().map(|tuple| squared_distance(tuple)).min().unwrap_or_default();
    let sets = matching().filter(|tuple| squared_distance(tuple) == least).cloned().collect();
    SubGrid { p, q, sets, squared_distance: f64::from(least) }
}

fn sofipackage_sub_grids() -> Vec<SubGrid> {
    let pairs = [[(-1, 0), (1, 0)], [(0, 0), (0, 1)], [(0, 0), (1, 0)], [(0, 0), (1, 1)]];
    let as_set = |pair: &[(i32, i32); 2]| pair.iter().map(|&(dy, dx)| Offset { dy, dx }).collect::<Vec<_>>();
    pairs
        .iter()
        .enumerate()
        .map(|(position, pair)| {
            let set = as_set(pair);
            let squared_distance = f64::from(squared_distance(&set));
            SubGrid { p: position / 2, q: position % 2, sets: vec![set], squared_distance }
        })
        .collect()
}

fn candidate_offsets() -> Vec<Offset> {
    OFFSETS.flat_map(|dy| OFFSETS.map(move |dx| Offset { dy, dx })).collect()
}

/// Appends every way to extend `chosen` to `order` offsets, in row-major order, to `tuples`.
fn extend_tuples(order: usize, rest: &[Offset], chosen: &mut Vec<Offset>, tuples: &mut Vec<Vec<Offset>>) {
    if chosen.len() == order {
        tuples.push(chosen.clone());
        return;
    }
    for (index, &offset) in rest.iter().enumerate() {
        chosen.push(offset);
        extend_tuples(order, &rest[index + 1..], chosen, tuples);
        chosen.pop();
    }
}

fn offset_sum(tuple: &[Offset]) -> (i32, i32) {
    tuple.iter().fold((0, 0), |(y, x), offset| (y + offset.dy, x + offset.dx))
}

fn squared_distance(tuple: &[Offset]) -> i32 {
    let pair = |a: &Offset, b: &Offset| (a.dy - b.dy).pow(2) + (a.dx - b.dx).pow(2);
    tuple
        .iter()
        .enumerate()
        .map(|(index, a)| tuple[index + 1..].iter().map(|b| pair(a, b)).sum::<i32>())
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(order: usize) -> VirtualPixelGrid {
        VirtualPixelGrid::new(order, Combinations::AllClosest).unwrap()
    }

    #[test]
    fn counts_of_sets_are_those_of_the_convention() {
        let sets = |order| grid(order).sub_grids().iter().map(|s| s.sets.len()).sum::<usize>();
        assert_eq!([sets(2), sets(3), sets(4)], [6, 18, 30]);
    }

    #[test]
    fn second_order_sets_are_those_of_the_convention() {
        let pair =
            |a: (i32, i32), b: (i32, i32)| vec![Offset { dy: a.0, dx: a.1 }, Offset { dy: b.0, dx: b.1 }];
        let sets: Vec<_> = grid(2).sub_grids().iter().map(|s| s.sets.clone()).collect();
        assert_eq!(sets[0], [pair((-1, 0), (1, 0)), pair((0, -1), (0, 1))]);
        assert_eq!(sets[1], [pair((0, 0), (0, 1))]);
        assert_eq!(sets[2], [pair((0, 0), (1, 0))]);
        assert_eq!(sets[3], [pair((0, 0), (1, 1)), pair((0, 1), (1, 0))]);
        assert_eq!(grid(2).squared_distances().into_raw_vec_and_offset().0, [4.0, 1.0, 1.0, 2.0]);
    }

    #[test]
    fn every_set_has_distinct_pixels_that_sum_to_its_sub_position() {
        for order in ORDERS {
            for sub_grid in grid(order).sub_grids() {
                assert!(!sub_grid.sets.is_empty(), "order {order} has no set at {sub_grid:?}");
                for set in &sub_grid.sets {
                    assert!(set.windows(2).all(|pair| pair[0] < pair[1]), "sorted, hence distinct");
                    assert_eq!(offset_sum(set), (sub_grid.p as i32, sub_grid.q as i32));
                }
            }
        }
    }

    #[test]
    fn orders_outside_the_range_are_refused() {
        for order in [0, 1, 7, 9] {
            assert_eq!(VirtualPixelGrid::new(order, Combinations::AllClosest), Err(GridError::Order(order)));
        }
        let refused = VirtualPixelGrid::new(3, Combinations::Sofipackage);
        assert_eq!(refused, Err(GridError::SofipackageOrder(3)));
    }
}
