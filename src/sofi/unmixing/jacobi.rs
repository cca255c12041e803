//! Singular values and pseudo-inverses of the small matrices of this room.
//!
//! In: a matrix with at least as many rows as columns. Out: values, both sides' vectors, the pseudo-inverse.
//! Never: drops a small singular value; whoever asks has judged the conditioning. Fails: not at all.

use nalgebra::{DMatrix, DVector};

/// Sweeps of rotations that no matrix of this kind needs.
const MAX_SWEEPS: usize = 60;

/// Singular values (largest first) and both sides' vectors: `matrix V = scaled`, whose columns are
/// orthogonal and have the singular values as norms.
pub(in crate::sofi) struct SingularValues {
    pub(in crate::sofi) values: Vec<f64>,
    pub(super) scaled: DMatrix<f64>,
    pub(super) right: DMatrix<f64>,
}

impl SingularValues {
    /// One-sided Jacobi rotations (Hestenes 1958): for matrices this small the most accurate way.
    pub(in crate::sofi) fn of(matrix: &DMatrix<f64>) -> Self {
        let count = matrix.ncols();
        let (mut scaled, mut right) = (matrix.clone(), DMatrix::identity(count, count));
        for _ in 0..MAX_SWEEPS {
            let mut is_settled = true;
            for p in 0..count {
                for q in p + 1..count {
                    is_settled &= !make_orthogonal(&mut scaled, &mut right, p, q);
                }
            }
            if is_settled {
                break;
            }
        }
        let norms: Vec<f64> = scaled.column_iter().map(|column| column.norm()).collect();
        let mut by_size: Vec<usize> = (0..count).collect();
        by_size.sort_by(|&a, &b| norms[b].total_cmp(&norms[a]));
        Self {
            values: by_size.iter().map(|&k| norms[k]).collect(),
            scaled: scaled.select_columns(&by_size),
            right: right.select_columns(&by_size),
        }
    }
}

/// Rotates columns `p` and `q` until they are orthogonal; false if they were.
fn make_orthogonal(scaled: &mut DMatrix<f64>, right: &mut DMatrix<f64>, p: usize, q: usize) -> bool {
    let product = scaled.column(p).dot(&scaled.column(q));
    let (norm_p, norm_q) = (scaled.column(p).norm(), scaled.column(q).norm());
    if product.abs() <= f64::EPSILON * norm_p * norm_q {
        return false;
    }
    let zeta = (norm_q - norm_p) * (norm_q + norm_p) / (2.0 * product);
    let tangent = 1.0_f64.copysign(zeta) / (zeta.abs() + zeta.hypot(1.0));
    let cosine = 1.0 / tangent.hypot(1.0);
    let sine = cosine * tangent;
    for matrix in [scaled, right] {
        for row in 0..matrix.nrows() {
            let (a, b) = (matrix[(row, p)], matrix[(row, q)]);
            matrix[(row, p)] = cosine * a - sine * b;
            matrix[(row, q)] = sine * a + cosine * b;
        }
    }
    true
}

/// `V S^-1 U^T`; the columns are known to be independent, so no singular value is dropped.
pub(in crate::sofi) fn pseudo_inverse(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let svd = SingularValues::of(matrix);
    let inverse_squares = svd.values.iter().map(|s| 1.0 / (s * s));
    let diagonal = DVector::from_iterator(svd.values.len(), inverse_squares);
    svd.right * DMatrix::from_diagonal(&diagonal) * svd.scaled.transpose()
}
