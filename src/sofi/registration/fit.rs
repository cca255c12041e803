//! The affine map between matched points, by least squares.
//!
//! In: pairs of points. Out: [`Affine`]. Never: fits fewer points than a map needs.
//! Fails: `None` for points on a line or too few of them.

use super::transform::Affine;
use nalgebra::{Matrix3, Vector3};

/// A point of flipped T and the point of R that it belongs to, both `[y, x]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointPair {
    /// In flipped T.
    pub from: [f64; 2],
    /// In R.
    pub to: [f64; 2],
    /// How much it counts.
    pub weight: f64,
}

/// The affine map of least squares.
#[must_use]
pub fn fit_affine(pairs: &[PointPair]) -> Option<Affine> {
    if pairs.len() < 3 {
        return None;
    }
    // About the middle, so that large coordinates cost no precision.
    let total: f64 = pairs.iter().map(|pair| pair.weight).sum();
    let middle: [f64; 2] =
        std::array::from_fn(|axis| pairs.iter().map(|p| p.weight * p.from[axis]).sum::<f64>() / total);
    let (mut matrix, mut right) = (Matrix3::zeros(), [Vector3::zeros(); 2]);
    for pair in pairs {
        let row = Vector3::new(pair.from[0] - middle[0], pair.from[1] - middle[1], 1.0);
        matrix += row * row.transpose() * pair.weight;
        for (axis, right) in right.iter_mut().enumerate() {
            *right += row * (pair.weight * pair.to[axis]);
        }
    }
    let decomposed = matrix.cholesky()?;
    let rows = right.map(|right| decomposed.solve(&right));
    let spread = (matrix[(0, 0)] * matrix[(1, 1)] - matrix[(0, 1)].powi(2)) / (total * total);
    if spread < 1.0 || !rows.iter().all(|row| row.iter().all(|entry| entry.is_finite())) {
        return None;
    }
    Some(Affine {
        matrix: rows.map(|row| [row[0], row[1]]),
        shift: rows.map(|row| row[2] - row[0] * middle[0] - row[1] * middle[1]),
    })
}

/// The rotation, magnification and shift that bring two points onto two others.
#[must_use]
pub(super) fn similarity(from: [[f64; 2]; 2], to: [[f64; 2]; 2]) -> Option<Affine> {
    let between = |[a, b]: [[f64; 2]; 2]| [b[0] - a[0], b[1] - a[1]];
    let (f, t) = (between(from), between(to));
    let squared = f[0] * f[0] + f[1] * f[1];
    if squared < 1e-9 {
        return None;
    }
    let along = (f[0] * t[0] + f[1] * t[1]) / squared;
    let aside = (f[1] * t[0] - f[0] * t[1]) / squared;
    let matrix = [[along, aside], [-aside, along]];
    let moved = Affine { matrix, shift: [0.0; 2] }.apply(from[0]);
    Some(Affine { matrix, shift: [to[0][0] - moved[0], to[0][1] - moved[1]] })
}

/// Root of the mean squared distance between the mapped points and their partners, pixels.
#[must_use]
pub fn root_mean_square(map: &Affine, pairs: &[PointPair]) -> f64 {
    let squared = |pair: &PointPair| distance(map.apply(pair.from), pair.to).powi(2);
    (pairs.iter().map(squared).sum::<f64>() / pairs.len().max(1) as f64).sqrt()
}

/// Distance of two points.
#[must_use]
pub fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn exact_points_give_the_exact_map(
            entries in prop::array::uniform4(-0.1..0.1), shift in prop::array::uniform2(-100.0..100.0)
        ) {
            let matrix = [[1.0 + entries[0], entries[1]], [entries[2], 1.0 + entries[3]]];
            let map = Affine { matrix, shift };
            let pairs: Vec<PointPair> = [[0.0, 0.0], [900.0, 30.0], [45.0, 700.0], [800.0, 800.0]]
                .map(|from| PointPair { from, to: map.apply(from), weight: 1.0 }).to_vec();
            let found = fit_affine(&pairs).unwrap();
            prop_assert!(root_mean_square(&found, &pairs) < 1e-8);
            prop_assert!((found.matrix[0][1] - matrix[0][1]).abs() < 1e-10);
        }

        #[test]
        fn two_points_give_rotation_and_scale(turn in -0.1..0.1, scale in 0.9..1.1) {
            let map = Affine { matrix: [[scale, turn], [-turn, scale]], shift: [3.0, -8.0] };
            let from = [[3.0, 4.0], [20.0, -7.0]];
            let found = similarity(from, from.map(|point| map.apply(point))).unwrap();
            prop_assert!((found.matrix[0][1] - turn).abs() < 1e-12 && (found.shift[0] - 3.0).abs() < 1e-9);
        }
    }

    #[test]
    fn points_on_a_line_give_no_map() {
        let on_line = |k: f64| PointPair { from: [k, 2.0 * k], to: [k, 2.0 * k], weight: 1.0 };
        assert_eq!(fit_affine(&[0.0, 1.0, 2.0, 3.0].map(on_line)), None);
    }
}
