//! Which bead of T is which bead of R, when nothing is known but that the cameras are alike.
//!
//! Every mirror is tried. Short edges between neighboring beads that are about as long and point about as far in both
//! cameras suggest a map; the suggestions that bring most beads near them onto beads are widened over the whole field
//! while their map is fitted. All edges are tried in a fixed order, so the result hangs on no chance.
//!
//! In: beads of both cameras. Out: [`BeadMatch`]. Never: draws a random number, keeps a pair that does not fit.
//! Fails: [`MatchError`] where too few beads agree.

use super::beads::Bead;
use super::fit::{PointPair, distance, fit_affine, root_mean_square, similarity};
use super::transform::{Affine, Mirror, ReflectedFromTransmitted};

/// Brightest beads that suggestions are made from.
const MOST_BEADS: usize = 200;
/// Neighbors of a bead that edges lead to.
const NEIGHBORS: usize = 10;
/// Largest rotation between the cameras, radians, and stretch.
const MOST_TURN: f64 = 0.065;
const MOST_STRETCH: f64 = 0.065;
/// Suggestions that are widened, of each mirror.
const KEPT: usize = 12;
/// Beads must come this near to count at a suggestion's edge, pixels; farther away this much more per pixel.
const NEAR: f64 = 0.8;
const NEAR_PER_PIXEL: f64 = 0.015;
/// Beads around an edge that judge a suggestion, pixels.
const JUDGED_WITHIN: f64 = 120.0;
/// Pairs that are needed.
const LEAST_PAIRS: usize = 6;
/// Pairs farther off than this many spreads do not count.
const OUTLYING: f64 = 4.0;

/// A map and the beads that agree with it.
#[derive(Debug, Clone, PartialEq)]
pub struct BeadMatch {
    /// Where R sees what T sees.
    pub transform: ReflectedFromTransmitted,
    /// The pairs that were used.
    pub pairs: Vec<PointPair>,
    /// Pairs that were left out as they do not fit.
    pub outliers: usize,
    /// Root mean square of the distances between partners, pixels.
    pub residual_px: f64,
}

/// Why beads were not matched.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MatchError {
    /// Too few beads.
    #[error(
        "camera R shows {reflected} beads and camera T {transmitted}; at least {LEAST_PAIRS} are needed in both: \
         use a denser sample, more light or more frames"
    )]
    TooFewBeads {
        /// In R.
        reflected: usize,
        /// In T.
        transmitted: usize,
    },
    /// No map brings enough beads onto each other.
    #[error(
        "of {reflected} beads in camera R and {transmitted} in camera T only {agreeing} agree; \
         check that both files show the same sample and that the cameras differ by less than 3 degrees and 5 %"
    )]
    NoAgreement {
        /// In R.
        reflected: usize,
        /// In T.
        transmitted: usize,
        /// Pairs of the best map.
        agreeing: usize,
    },
}

/// Matches the beads of both cameras, whose regions have this height and width.
///
/// # Errors
/// [`MatchError`] when too few beads agree.
pub fn match_beads(
    reflected: &[Bead],
    transmitted: &[Bead],
    size: [usize; 2],
) -> Result<BeadMatch, MatchError> {
    let to: Vec<[f64; 2]> = reflected.iter().map(|bead| [bead.y, bead.x]).collect();
    let counts = (reflected.len(), transmitted.len());
    if counts.0.min(counts.1) < LEAST_PAIRS {
        return Err(MatchError::TooFewBeads { reflected: counts.0, transmitted: counts.1 });
    }
    let lattice = Lattice::new(&to);
    let edges_to = edges(&to[..to.len().min(MOST_BEADS)]);
    let mut best: Option<(Mirror, Vec<PointPair>)> = None;
    for (_, mirror) in Mirror::NAMES {
        let from: Vec<[f64; 2]> = transmitted.iter().map(|b| mirror.apply([b.y, b.x], size)).collect();
        for suggestion in suggestions(&from[..from.len().min(MOST_BEADS)], &edges_to, &lattice) {
            let Some(pairs) = widened(&suggestion, &from, &lattice, size) else { continue };
            if best.as_ref().is_none_or(|(_, most)| pairs.len() > most.len()) {
                best = Some((mirror, pairs));
            }
        }
    }
    let agreeing = best.as_ref().map_or(0, |(_, pairs)| pairs.len());
    let refused = MatchError::NoAgreement { reflected: counts.0, transmitted: counts.1, agreeing };
    let Some((mirror, pairs)) = best.filter(|_| agreeing >= LEAST_PAIRS) else { return Err(refused) };
    let (affine, inliers) = without_outliers(&pairs).ok_or(refused)?;
    Ok(BeadMatch {
        transform: ReflectedFromTransmitted { mirror, affine, size },
        outliers: pairs.len() - inliers.len(),
        residual_px: root_mean_square(&affine, &inliers),
        pairs: inliers,
    })
}

/// Two neighboring beads.
#[derive(Debug, Clone, Copy)]
struct Edge {
    ends: [[f64; 2]; 2],
    length: f64,
    angle: f64,
}

/// Edges from every bead to its nearest neighbors, by length.
fn edges(points: &[[f64; 2]]) -> Vec<Edge> {
    let mut edges = Vec::new();
    for (index, &a) in points.iter().enumerate() {
        let mut others: Vec<(f64, [f64; 2])> = points
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != index)
            .map(|(_, &b)| (distance(a, b), b))
            .filter(|(length, _)| *length > 4.0)
            .collect();
        others.sort_by(|a, b| a.0.total_cmp(&b.0));
        edges.extend(others.into_iter().take(NEIGHBORS).map(|(length, b)| Edge {
            ends: [a, b],
            length,
            angle: libm::atan2(b[0] - a[0], b[1] - a[1]),
        }));
    }
    edges.sort_by(|a, b| a.length.total_cmp(&b.length));
    edges
}

struct Suggestion {
    map: Affine,
    /// Where its edge lies in T.
    center: [f64; 2],
    agreeing: usize,
}

/// The best maps that one edge in each camera suggest.
fn suggestions(from: &[[f64; 2]], edges_to: &[Edge], lattice: &Lattice<'_>) -> Vec<Suggestion> {
    let mut all: Vec<Suggestion> = Vec::new();
    for edge in edges(from) {
        let slack = MOST_STRETCH * edge.length + 0.5;
        let first = edges_to.partition_point(|other| other.length < edge.length - slack);
        for other in edges_to[first..].iter().take_while(|other| other.length <= edge.length + slack) {
            let turn = (other.angle - edge.angle).rem_euclid(std::f64::consts::TAU);
            let turn = turn.min(std::f64::consts::TAU - turn);
            if turn > MOST_TURN + 0.5 / edge.length {
                continue;
            }
            let Some(map) = similarity(edge.ends, other.ends) else { continue };
            let agreeing = agreeing(&map, edge.ends[0], from, lattice);
            all.push(Suggestion { map, center: edge.ends[0], agreeing });
        }
    }
    // Stable, so equal ones stay in the order of their edges.
    all.sort_by_key(|suggestion| std::cmp::Reverse(suggestion.agreeing));
    all.truncate(KEPT);
    all
}

fn agreeing(map: &Affine, center: [f64; 2], from: &[[f64; 2]], lattice: &Lattice<'_>) -> usize {
    let near = |point: &&[f64; 2]| {
        let away = distance(**point, center);
        away < JUDGED_WITHIN && lattice.nearest(map.apply(**point), NEAR + NEAR_PER_PIXEL * away).is_some()
    };
    from.iter().filter(near).count()
}

/// Fits the map to the pairs around a suggestion's edge, then to those of an ever larger field.
fn widened(
    suggestion: &Suggestion,
    from: &[[f64; 2]],
    lattice: &Lattice<'_>,
    size: [usize; 2],
) -> Option<Vec<PointPair>> {
    let mut map = suggestion.map;
    let whole = (size[0] as f64).hypot(size[1] as f64);
    let mut within = JUDGED_WITHIN / 2.0;
    let mut slack = NEAR_PER_PIXEL * within;
    loop {
        let pairs = pairs(&map, suggestion.center, within, NEAR + slack, from, lattice);
        if pairs.len() < LEAST_PAIRS && within > whole {
            return None;
        }
        if pairs.len() >= LEAST_PAIRS {
            map = fit_affine(&pairs)?;
            slack *= 0.5;
        }
        if within > whole && slack < 0.05 {
            let is_alike = {
                let [[yy, yx], [xy, xx]] = map.matrix;
                (yy - 1.0).abs().max((xx - 1.0).abs()) < MOST_STRETCH && yx.abs().max(xy.abs()) < MOST_TURN
            };
            let all = self::pairs(&map, suggestion.center, within, NEAR, from, lattice);
            return is_alike.then_some(all);
        }
        within *= 1.4;
    }
}

fn pairs(
    map: &Affine,
    center: [f64; 2],
    within: f64,
    near: f64,
    from: &[[f64; 2]],
    lattice: &Lattice<'_>,
) -> Vec<PointPair> {
    let close = from.iter().filter(|point| distance(**point, center) < within);
    let mut pairs: Vec<PointPair> = close
        .filter_map(|&from| {
            let to = lattice.nearest(map.apply(from), near)?;
            Some(PointPair { from, to, weight: 1.0 })
        })
        .collect();
    // A bead of R belongs to one bead of T at most.
    let doubles: Vec<bool> =
        pairs.iter().map(|pair| pairs.iter().filter(|other| other.to == pair.to).count() > 1).collect();
    let mut doubles = doubles.into_iter();
    pairs.retain(|_| !doubles.next().unwrap_or(false));
    pairs
}

/// Leaves out pairs far beyond the spread of all, until none is; the map of the others, and them.
#[must_use]
pub fn without_outliers(pairs: &[PointPair]) -> Option<(Affine, Vec<PointPair>)> {
    let mut inliers = pairs.to_vec();
    for _ in 0..10 {
        let map = fit_affine(&inliers)?;
        let mut distances: Vec<f64> = inliers.iter().map(|p| distance(map.apply(p.from), p.to)).collect();
        let middle = distances.len() / 2;
        // The median distance of a Gaussian in two dimensions is 1.18 standard deviations of one.
        let spread = *distances.select_nth_unstable_by(middle, f64::total_cmp).1 / 1.18;
        let limit = OUTLYING * spread.max(1e-6);
        let kept: Vec<PointPair> =
            pairs.iter().copied().filter(|p| distance(map.apply(p.from), p.to) <= limit).collect();
        if kept == inliers || kept.len() < LEAST_PAIRS {
            break;
        }
        inliers = kept;
    }
    Some((fit_affine(&inliers)?, inliers))
}

/// Points in squares, for the nearest one.
struct Lattice<'a> {
    points: &'a [[f64; 2]],
    squares: std::collections::BTreeMap<(i64, i64), Vec<usize>>,
}

impl<'a> Lattice<'a> {
    const SIDE: f64 = 8.0;

    fn new(points: &'a [[f64; 2]]) -> Self {
        let mut squares = std::collections::BTreeMap::<_, Vec<usize>>::new();
        for (index, point) in points.iter().enumerate() {
            squares.entry(Self::square(*point)).or_default().push(index);
        }
        Self { points, squares }
    }

    fn square([y, x]: [f64; 2]) -> (i64, i64) {
        ((y / Self::SIDE).floor() as i64, (x / Self::SIDE).floor() as i64)
    }

    /// The nearest point within a distance of at most one side.
    fn nearest(&self, point: [f64; 2], within: f64) -> Option<[f64; 2]> {
        let (row, column) = Self::square(point);
        let around = (row - 1..=row + 1).flat_map(|row| (column - 1..=column + 1).map(move |c| (row, c)));
        around
            .filter_map(|square| self.squares.get(&square))
            .flatten()
            .map(|&index| (distance(self.points[index], point), self.points[index]))
            .filter(|(away, _)| *away <= within.min(Self::SIDE))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, point)| point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Points that a small generator scatters, at least 6 pixels apart.
    fn scattered(seed: u64, number: usize, side: f64) -> Vec<[f64; 2]> {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut points: Vec<[f64; 2]> = Vec::new();
        while points.len() < number {
            let point = [next() * side, next() * side];
            if points.iter().all(|other| distance(*other, point) > 6.0) {
                points.push(point);
            }
        }
        points
    }

    fn bead([y, x]: [f64; 2]) -> Bead {
        Bead { y, x, sigma: 1.2, height: 100.0 }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn any_mirror_shift_rotation_and_scale_is_found(
            seed in 1u64..1000, mirror in 0..4usize, number in 24usize..200,
            turn in -0.035..0.035, scale in 0.98..1.02, y in -60.0..60.0, x in -60.0..60.0
        ) {
            let size = [256, 256];
            let (sin, cos) = (libm::sin(turn) * scale, libm::cos(turn) * scale);
            let truth = ReflectedFromTransmitted {
                mirror: Mirror::NAMES[mirror].1,
                affine: Affine { matrix: [[cos, sin], [-sin, cos]], shift: [y, x] },
                size,
            };
            let sample = scattered(seed, number, 256.0);
            let inside = |p: &[f64; 2]| p.iter().all(|v| (0.0..256.0).contains(v));
            let seen: Vec<[f64; 2]> =
                sample.iter().map(|&point| truth.apply(point)).filter(inside).collect();
            prop_assume!(seen.len() >= 12);
            // One in ten beads is seen by one camera only, and one in ten is none.
            let r: Vec<Bead> = seen.iter().skip(seen.len() / 10).copied()
                .chain(scattered(seed + 7, number / 10, 256.0)).map(bead).collect();
            let t: Vec<Bead> = sample.iter().take(number - number / 10).copied()
                .chain(scattered(seed + 9, number / 10, 256.0)).map(bead).collect();
            let found = match_beads(&r, &t, size);
            let found = found.unwrap();
            for corner in [[64.0, 64.0], [64.0, 192.0], [192.0, 64.0], [192.0, 192.0]] {
                let error = distance(found.transform.apply(corner), truth.apply(corner));
                prop_assert!(error < 0.02, "{}: {:?} for {:?}", error, found.transform, truth);
            }
        }
    }

    #[test]
    fn unlike_samples_are_refused() {
        let beads = |seed| -> Vec<Bead> { scattered(seed, 60, 256.0).into_iter().map(bead).collect() };
        let refused = match_beads(&beads(3), &beads(4), [256, 256]);
        assert!(matches!(refused, Err(MatchError::NoAgreement { .. })), "{refused:?}");
        let few = match_beads(&beads(3)[..4], &beads(4), [256, 256]);
        assert!(matches!(few, Err(MatchError::TooFewBeads { reflected: 4, .. })));
    }
}
