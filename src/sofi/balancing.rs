//! Maps on-time ratio, brightness and number of emitters from orders 2 to 4 (balanced SOFI;
//! Geissbuehler et al. 2012; Eq. S5).
//!
//! In: one species' cumulants of orders 2, 3 and 4 at the same positions, before any root, with
//! the distance factors of all orders divided out (`Flattening::DistanceFactor`; equal means leave
//! each order at the unknown scale of its own sub-grid (0, 0)).
//! Out: [`PhotophysicalMaps`], NaN where the three numbers have no solution.
//! Never: smooths, clips, or guesses; noise in order 4 shows as scatter and NaN.
//! Fails: [`BalancingError`].
//!
//! With `kappa_n = epsilon^n f_n(rho) N w_n` (Eq. S5, `w_n` standing for the powers of the
//! point-spread function, [`PsfWeights`]) and
//! `f_2 = rho (1 - rho)`, `f_3 = f_2 (1 - 2 rho)`, `f_4 = f_2 (1 - 6 rho + 6 rho^2)`, the ratios
//! `K_1 = (kappa_3 / w_3) / (kappa_2 / w_2)` and `K_2 = (kappa_4 / w_4) / (kappa_2 / w_2)` give
//! `epsilon = sqrt(3 K_1^2 - 2 K_2)`, `rho = (1 - K_1 / epsilon) / 2`,
//! `N = (kappa_2 / w_2) / (epsilon^2 rho (1 - rho))`.
//!
//! Valid where `kappa_2 > 0` and `K_1^2 > K_2`, which together mean `epsilon > 0` and
//! `0 < rho < 1`. As `rho` goes to 0 or 1, `K_2` goes to `K_1^2`, and noise decides.

use ndarray::{Array2, ArrayRef2, Zip, s};
use thiserror::Error;

/// Why the maps cannot be made.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum BalancingError {
    /// The three images do not have one shape.
    #[error("the images of orders 2, 3 and 4 differ in shape: {shapes:?}")]
    Shapes {
        /// Height and width of orders 2, 3 and 4.
        shapes: [(usize, usize); 3],
    },
    /// A weight is not a positive number.
    #[error("the weights of the point-spread function must be positive numbers")]
    Weights,
}

/// `w_n` for orders 2, 3, 4: what the point-spread function contributes to each cumulant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PsfWeights([f64; 3]);

impl PsfWeights {
    /// All emitters at the peak of the point-spread function: `w_n = U(0)^n = 1`.
    ///
    /// Right for isolated spots, read at their centers; `N` is a number of emitters.
    #[must_use]
    pub fn at_peak() -> Self {
        Self([1.0; 3])
    }

    /// Emitters spread evenly over more than the point-spread function:
    /// `w_n = integral U^n = 2 pi sigma^2 / n` for a Gaussian of peak 1.
    ///
    /// Right for extended structures; with `sigma` in pixels, `N` is emitters per pixel area.
    ///
    /// # Errors
    /// [`BalancingError::Weights`] unless `sigma` is a positive number.
    pub fn evenly_spread(sigma: f64) -> Result<Self, BalancingError> {
        let area = 2.0 * std::f64::consts::PI * sigma * sigma;
        Self::new([area / 2.0, area / 3.0, area / 4.0])
    }

    /// Any positive weights for orders 2, 3 and 4.
    ///
    /// # Errors
    /// [`BalancingError::Weights`] unless all are positive numbers.
    pub fn new(weights: [f64; 3]) -> Result<Self, BalancingError> {
        if weights.iter().all(|w| w.is_finite() && *w > 0.0) {
            Ok(Self(weights))
        } else {
            Err(BalancingError::Weights)
        }
    }
}

/// Maps of one species, all of the shape of the input; NaN where there is no solution.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotophysicalMaps {
    /// `rho = tau_on / (tau_on + tau_off)`, above 0 and below 1.
    pub on_time_ratio: Array2<f32>,
    /// `epsilon`, brightness of one emitter at its peak while on, in units of the first-order image.
    pub brightness: Array2<f32>,
    /// `N`, emitters, or emitters per pixel area (see [`PsfWeights`]).
    pub density: Array2<f32>,
}

/// On-time ratio, brightness and number of emitters of one position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Photophysics {
    /// `rho`, above 0 and below 1.
    pub on_time_ratio: f64,
    /// `epsilon`, positive.
    pub brightness: f64,
    /// `N`, positive.
    pub density: f64,
}

/// `f_2`, `f_3`, `f_4`: cumulants of an emitter of brightness 1 that is on for the share `rho` of time.
#[must_use]
pub fn bernoulli_cumulants(rho: f64) -> [f64; 3] {
    let variance = rho * (1.0 - rho);
    let fourth = 1.0 - 6.0 * rho + 6.0 * rho * rho;
    [variance, variance * (1.0 - 2.0 * rho), variance * fourth]
}

/// Solves one position; nothing where there is no solution.
#[must_use]
pub fn photophysics(kappa: [f64; 3], weights: PsfWeights) -> Option<Photophysics> {
    let [second, third, fourth] = [0, 1, 2].map(|i| kappa[i] / weights.0[i]);
    let (first_ratio, second_ratio) = (third / second, fourth / second);
    let square = 3.0 * first_ratio * first_ratio - 2.0 * second_ratio;
    let solvable = second > 0.0 && first_ratio * first_ratio > second_ratio && square.is_finite();
    if !solvable {
        return None;
    }
    let brightness = square.sqrt();
    let on_time_ratio = 0.5 * (1.0 - first_ratio / brightness);
    let density = second / (square * on_time_ratio * (1.0 - on_time_ratio));
    // Rounding may still bring the ratio to 0 or 1.
    density.is_finite().then_some(Photophysics { on_time_ratio, brightness, density })
}

/// Solves every position of three images of one shape.
///
/// # Errors
/// [`BalancingError::Shapes`].
pub fn balance(
    second: &ArrayRef2<f32>,
    third: &ArrayRef2<f32>,
    fourth: &ArrayRef2<f32>,
    weights: PsfWeights,
) -> Result<PhotophysicalMaps, BalancingError> {
    let shapes = [second.dim(), third.dim(), fourth.dim()];
    if shapes.iter().any(|shape| *shape != shapes[0]) {
        return Err(BalancingError::Shapes { shapes });
    }
    let missing = Array2::from_elem(shapes[0], f32::NAN);
    let mut maps =
        PhotophysicalMaps { on_time_ratio: missing.clone(), brightness: missing.clone(), density: missing };
    Zip::indexed(&mut maps.on_time_ratio).and(&mut maps.brightness).and(&mut maps.density).for_each(
        |at, ratio, brightness, density| {
            let kappa = [second[at], third[at], fourth[at]].map(f64::from);
            if let Some(solved) = photophysics(kappa, weights) {
                *ratio = solved.on_time_ratio as f32;
                *brightness = solved.brightness as f32;
                *density = solved.density as f32;
            }
        },
    );
    Ok(maps)
}

/// The pixels of an image of order `n` at whole camera positions, the one grid all orders share.
#[must_use]
pub fn on_camera_grid(image: &ArrayRef2<f32>, order: usize) -> Array2<f32> {
    let step = order.max(1) as isize;
    image.slice(s![..;step, ..;step]).to_owned()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn cumulants(rho: f64, epsilon: f64, density: f64, weights: PsfWeights) -> [f64; 3] {
        let of_one = bernoulli_cumulants(rho);
        [0, 1, 2].map(|i| epsilon.powi(i as i32 + 2) * of_one[i] * density * weights.0[i])
    }

    proptest! {
        #[test]
        fn known_emitters_are_found_again(
            rho in 0.01..0.99_f64, epsilon in 1.0..2000.0_f64, density in 0.1..100.0_f64, sigma in 0.5..3.0_f64,
        ) {
            for weights in [PsfWeights::at_peak(), PsfWeights::evenly_spread(sigma).unwrap()] {
                let solved = photophysics(cumulants(rho, epsilon, density, weights), weights).unwrap();
                prop_assert!((solved.on_time_ratio - rho).abs() < 1e-6);
                prop_assert!((solved.brightness / epsilon - 1.0).abs() < 1e-6);
                prop_assert!((solved.density / density - 1.0).abs() < 1e-6);
            }
        }

        #[test]
        fn solutions_are_physical(
            second in -10.0..10.0_f64, third in -10.0..10.0_f64, fourth in -10.0..10.0_f64,
        ) {
            if let Some(solved) = photophysics([second, third, fourth], PsfWeights::at_peak()) {
                prop_assert!(solved.on_time_ratio > 0.0 && solved.on_time_ratio < 1.0);
                prop_assert!(solved.brightness > 0.0 && solved.density > 0.0);
                let back = cumulants(
                    solved.on_time_ratio, solved.brightness, solved.density, PsfWeights::at_peak(),
                );
                prop_assert!((back[0] - second).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn cumulants_of_a_switch_by_its_moments() {
        for rho in [0.05, 0.3, 0.5, 0.9] {
            let moment = |n: i32| rho * (1.0_f64 - rho).powi(n) + (1.0 - rho) * (-rho).powi(n);
            let expected = [moment(2), moment(3), moment(4) - 3.0 * moment(2).powi(2)];
            for (a, b) in bernoulli_cumulants(rho).iter().zip(expected) {
                assert!((a - b).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn constant_images_give_constant_maps_and_holes_stay() {
        let weights = PsfWeights::evenly_spread(1.0).unwrap();
        let kappa = cumulants(0.1, 400.0, 5.0, weights);
        let image = |i: usize| Array2::from_elem((3, 4), kappa[i] as f32);
        let (mut second, third, mut fourth) = (image(0), image(1), image(2));
        second[[0, 0]] = f32::NAN;
        second[[0, 1]] = -1.0;
        fourth[[0, 2]] = f32::MAX;
        let maps = balance(&second, &third, &fourth, weights).unwrap();
        for x in 0..3 {
            assert!(maps.density[[0, x]].is_nan() && maps.brightness[[0, x]].is_nan());
        }
        assert!((maps.on_time_ratio[[2, 3]] - 0.1).abs() < 1e-5);
        assert!((maps.brightness[[2, 3]] - 400.0).abs() < 1e-2);
        assert!((maps.density[[2, 3]] - 5.0).abs() < 1e-3);
    }

    #[test]
    fn bad_input_is_refused() {
        let (small, large) = (Array2::zeros((2, 2)), Array2::zeros((2, 3)));
        let at_peak = PsfWeights::at_peak();
        assert!(balance(&small, &small, &large, at_peak).is_err());
        assert!(PsfWeights::new([1.0, 0.0, 1.0]).is_err());
        assert!(PsfWeights::evenly_spread(f64::NAN).is_err());
    }

    #[test]
    fn the_camera_grid_is_shared_by_all_orders() {
        for order in 2..=4 {
            let fine = Array2::from_shape_fn((5 * order, 7 * order), |(y, x)| {
                (y as f32 / order as f32) * 100.0 + x as f32 / order as f32
            });
            let camera = on_camera_grid(&fine, order);
            assert_eq!(camera.dim(), (5, 7));
            assert_eq!(camera[[3, 4]], 304.0);
        }
    }
}
