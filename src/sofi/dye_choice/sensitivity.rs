//! How much of a dye shows in the images of the others when its share was taken a little wrong.
//!
//! In: an order, the true shares, an error. Out: crosstalk in percent. Never: a first-order guess; both signs are
//! tried in full. Fails: [`ChoiceError`].
//!
//! With `M'` the matrix of the wrong shares the images are `s' = M'^+ M s`. An error in the shares of dye `i` changes
//! column `i` of `M` alone, so only the light of dye `i` goes astray: `C[i, j] = 100 x_j / x_i`, `x = M'^+ m_i`.

use nalgebra::DVector;
use ndarray::{Array2, ArrayRef2};

use super::ChoiceError;
use super::merit::{condition, mixture};
use crate::sofi::unmixing::{MAX_CONDITION, SingularValues, pseudo_inverse};

/// Crosstalk after unmixing, percent, if the shares of one dye are wrong by `error` (`0..=1`): row `i` is the dye with
/// the error and whose light goes astray, column `j` the image; 100 on the diagonal.
///
/// The error moves light between every two channels in either direction; the entry of the largest magnitude counts,
/// with its sign. With two channels that is `T_i` wrong by plus and minus `error`. The images are those of the
/// cumulants: linearization takes the `n`-th root of brightness and makes faint crosstalk stronger.
/// NaN where the wrong shares could not be unmixed.
///
/// # Errors
/// [`ChoiceError`] as for [`Merit::of`](super::Merit::of).
pub fn crosstalk_percent(
    order: usize,
    shares: &ArrayRef2<f64>,
    error: f64,
) -> Result<Array2<f64>, ChoiceError> {
    let truth = mixture(order, shares)?;
    let (channels, dyes) = shares.dim();
    let mut worst = Array2::from_diag_elem(dyes, 100.0);
    for dye in 0..dyes {
        let column = truth.column(dye).into_owned();
        for (from, to) in (0..channels).flat_map(|a| (0..channels).map(move |b| (a, b))) {
            let moved = error.min(shares[[from, dye]]).min(1.0 - shares[[to, dye]]);
            if from == to || moved <= 0.0 {
                continue;
            }
            let mut wrong = shares.to_owned();
            wrong[[from, dye]] -= moved;
            wrong[[to, dye]] += moved;
            let seen = unmixed(order, &wrong, &column)?;
            for image in (0..dyes).filter(|&image| image != dye) {
                let percent = seen.as_ref().map_or(f64::NAN, |seen| 100.0 * seen[image] / seen[dye]);
                let entry: &mut f64 = &mut worst[[dye, image]];
                if percent.is_nan() || percent.abs() > entry.abs() {
                    *entry = percent;
                }
            }
        }
    }
    Ok(worst)
}

/// What unmixing with these shares makes of a signal; nothing where they cannot be unmixed.
fn unmixed(
    order: usize,
    shares: &ArrayRef2<f64>,
    signal: &DVector<f64>,
) -> Result<Option<DVector<f64>>, ChoiceError> {
    let matrix = mixture(order, shares)?;
    let is_solvable = condition(&SingularValues::of(&matrix).values) <= MAX_CONDITION;
    Ok(is_solvable.then(|| pseudo_inverse(&matrix) * signal))
}
