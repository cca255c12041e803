//! Whether cumulants can come from the dyes that were named.
//!
//! Species are never negative, so the spectral channels of any mixture lie in the cone of the columns of M.
//! What lies outside, in the same direction wherever the same dye prevails, no mixture explains: a coefficient is
//! wrong, another dye is there, or the cameras do not see the same.
//!
//! In: the matrix and images of spectral channels. Out: [`Contradiction`]s, the largest first.
//! Never: takes noise for a contradiction: it must be larger than chance and worth correcting.

use super::{UnmixingError, UnmixingMatrix, UnmixingMethod};
use ndarray::{ArrayView2, s};

/// Side of the squares that are averaged, virtual pixels of one camera pixel each.
const SQUARE: usize = 4;
/// Share of the brightness of the brightest squares above which a square counts.
const BRIGHT: f64 = 0.25;
/// Place of the brightest squares among all.
const BRIGHTEST: f64 = 0.995;
/// Share of the light that no mixture explains above which it is worth saying.
const LARGE: f64 = 0.03;
/// Standard errors that it must be above zero.
const SURE: f64 = 5.0;
/// Fewest squares of a dye.
const LEAST_SQUARES: usize = 5;

/// What no mixture of the dyes explains.
#[derive(Debug, Clone, PartialEq)]
pub struct Contradiction {
    /// Index of the species that prevails there.
    pub species: usize,
    /// What is left over, as a share of the brightness there.
    pub share: f64,
    /// Its standard error, from how squares differ.
    pub error: f64,
}

/// What is left over where a species prevails.
#[derive(Debug, Clone, Default)]
struct Prevailing {
    residuals: Vec<Vec<f64>>,
    brightness: f64,
}

/// Where cumulants of the order of the matrix contradict it; `kappa` on the fine grid, in the order of its channels.
///
/// # Errors
/// [`UnmixingError`] for images that do not fit.
pub fn contradictions(
    matrix: &UnmixingMatrix,
    kappa: &[ArrayView2<f32>],
) -> Result<Vec<Contradiction>, UnmixingError> {
    let unmixer = matrix.unmixer(&UnmixingMethod::NonNegative)?;
    let squares = squares(kappa, matrix.order());
    let norm = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>().sqrt();
    let mut brightness: Vec<f64> = squares.iter().map(|square| norm(square)).collect();
    brightness.sort_by(f64::total_cmp);
    let brightest = brightness.get((brightness.len() as f64 * BRIGHTEST) as usize).copied().unwrap_or(0.0);
    let mut prevailing = vec![Prevailing::default(); matrix.species().len()];
    for square in squares.iter().filter(|square| norm(square) > BRIGHT * brightest) {
        let species = unmixer.pixel(square)?;
        let weight = |index: usize| {
            let mut alone = vec![0.0; species.len()];
            alone[index] = species[index];
            norm(&matrix.mix(&alone))
        };
        let Some(first) = (0..species.len()).max_by(|&a, &b| weight(a).total_cmp(&weight(b))) else {
            continue;
        };
        let fitted = matrix.mix(&species);
        prevailing[first]
            .residuals
            .push(square.iter().zip(&fitted).map(|(value, fit)| value - fit).collect());
        prevailing[first].brightness += norm(square);
    }
    let mut found: Vec<Contradiction> =
        prevailing.iter().enumerate().filter_map(|(species, group)| group.judged(species)).collect();
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    Ok(found)
}

impl Prevailing {
    fn judged(&self, species: usize) -> Option<Contradiction> {
        let number = self.residuals.len();
        if number < LEAST_SQUARES {
            return None;
        }
        let channels = self.residuals[0].len();
        let mean = |u: usize| self.residuals.iter().map(|r| r[u]).sum::<f64>() / number as f64;
        let means: Vec<f64> = (0..channels).map(mean).collect();
        let length = means.iter().map(|value| value * value).sum::<f64>().sqrt();
        // The spread along the direction of the mean.
        let along = |residual: &[f64]| residual.iter().zip(&means).map(|(r, m)| r * m).sum::<f64>() / length;
        let spread: f64 = self.residuals.iter().map(|r| (along(r) - length).powi(2)).sum();
        let brightness = self.brightness / number as f64;
        let share = length / brightness;
        let error = (spread / (number * (number - 1)) as f64).sqrt() / brightness;
        (share > LARGE && share > SURE * error).then_some(Contradiction { species, share, error })
    }
}

/// Means over squares of the virtual pixels that sit on camera pixels, one number per spectral channel.
fn squares(kappa: &[ArrayView2<f32>], order: usize) -> Vec<Vec<f64>> {
    let Some(first) = kappa.first() else { return Vec::new() };
    let (height, width) = (first.nrows() / order, first.ncols() / order);
    let mut all = Vec::new();
    for top in (0..height / SQUARE).map(|row| row * SQUARE * order) {
        for left in (0..width / SQUARE).map(|column| column * SQUARE * order) {
            let side = SQUARE * order;
            let mean = |image: &ArrayView2<f32>| {
                let square = image.slice(s![top..top + side;order, left..left + side;order]);
                square.iter().map(|&value| f64::from(value)).sum::<f64>() / (SQUARE * SQUARE) as f64
            };
            let square: Vec<f64> = kappa.iter().map(mean).collect();
            if square.iter().all(|value| value.is_finite()) {
                all.push(square);
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sofi::spectra::Species;
    use ndarray::Array2;

    fn matrix(shares: [f64; 3]) -> UnmixingMatrix {
        let names = ["a", "b", "c"];
        let species: Vec<Species> =
            names.iter().zip(shares).map(|(n, t)| Species::new(n, t).unwrap()).collect();
        UnmixingMatrix::new(2, &species).unwrap()
    }

    /// Thirds of an image for each dye, with some noise.
    fn images(truth: &UnmixingMatrix) -> Vec<Array2<f32>> {
        let mixed = |u: usize| {
            Array2::from_shape_fn((96, 96), |(y, x)| {
                let mut species = [0.0; 3];
                species[y / 32] = 100.0;
                let noise = ((y * 131 + x * 37 + u * 17) % 101) as f64 / 50.0 - 1.0;
                (truth.mix(&species)[u] + 10.0 * noise) as f32
            })
        };
        (0..3).map(mixed).collect()
    }

    #[test]
    fn right_coefficients_are_not_contradicted_and_wrong_ones_are_by_name() {
        let shares = [0.02, 0.35, 0.98];
        let images = images(&matrix(shares));
        let kappa: Vec<_> = images.iter().map(|image| image.view()).collect();
        assert_eq!(contradictions(&matrix(shares), &kappa).unwrap(), []);
        for (wrong, species) in [([0.02, 0.5, 0.98], 1), ([0.12, 0.35, 0.98], 0), ([0.02, 0.35, 0.85], 2)] {
            let found = contradictions(&matrix(wrong), &kappa).unwrap();
            assert_eq!(found.first().map(|first| first.species), Some(species), "{wrong:?}: {found:?}");
        }
    }
}
