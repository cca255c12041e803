//! Can the dyes be told apart? Conditioning, and the names of those that cannot.
//!
//! In: the matrix and the names of its columns. Out: singular values and condition number.
//! Never: lets a matrix pass whose condition is not a number.
//! Fails: [`UnmixingError::Indistinguishable`] with the groups of species that look alike.

use nalgebra::{DMatrix, DVector};

use super::jacobi::SingularValues;
use super::{MAX_CONDITION, UnmixingError};

/// Two unit columns closer than this count as one and the same spectrum.
const PARALLEL: f64 = 1e-4;

pub(super) fn checked_singular_values(
    matrix: &DMatrix<f64>,
    names: &[String],
) -> Result<Vec<f64>, UnmixingError> {
    let svd = SingularValues::of(matrix);
    let condition = condition(&svd.values);
    // Not "greater than": the condition of a singular matrix may be NaN.
    if condition <= MAX_CONDITION {
        return Ok(svd.values);
    }
    let mut groups = parallel_columns(matrix);
    if groups.is_empty() {
        groups = vec![null_members(&svd)];
    }
    let named = |group: Vec<usize>| group.into_iter().map(|i| names[i].clone()).collect();
    Err(UnmixingError::Indistinguishable { groups: groups.into_iter().map(named).collect(), condition })
}

/// Largest over smallest of values sorted from large to small.
pub(super) fn condition(singular_values: &[f64]) -> f64 {
    let largest = singular_values.first().copied().unwrap_or(f64::NAN);
    let smallest = singular_values.last().copied().unwrap_or(f64::NAN);
    largest / smallest
}

/// Groups of two or more species whose columns point the same way.
fn parallel_columns(matrix: &DMatrix<f64>) -> Vec<Vec<usize>> {
    let units: Vec<DVector<f64>> =
        matrix.column_iter().map(|column| column.into_owned().normalize()).collect();
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (i, unit) in units.iter().enumerate() {
        let same = |group: &&mut Vec<usize>| (&units[group[0]] - unit).norm() < PARALLEL;
        match groups.iter_mut().find(same) {
            Some(group) => group.push(i),
            None => groups.push(vec![i]),
        }
    }
    groups.retain(|group| group.len() > 1);
    groups
}

/// Species that take part in the combinations the channels cannot see.
fn null_members(svd: &SingularValues) -> Vec<usize> {
    let unseen = svd.values[0] / MAX_CONDITION;
    let weight = |i: usize| -> f64 {
        (0..svd.values.len()).filter(|&k| svd.values[k] < unseen).map(|k| svd.right[(i, k)].powi(2)).sum()
    };
    let weights: Vec<f64> = (0..svd.values.len()).map(weight).collect();
    let most = weights.iter().copied().fold(0.0, f64::max);
    (0..weights.len()).filter(|&i| weights[i] >= 0.01 * most).collect()
}
