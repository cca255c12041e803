//! The choice against the algebra of the paper, and against slow and obvious twins.

use ndarray::{Array2, array};
use proptest::prelude::*;

use super::*;
use crate::sofi::spectra::{EmissionShape, Species, SpectralResponse, Spectrum};
use crate::sofi::unmixing::UnmixingMatrix;

fn two_channels(transmissions: &[f64]) -> Array2<f64> {
    Array2::from_shape_fn((2, transmissions.len()), |(channel, dye)| {
        if channel == 0 { 1.0 - transmissions[dye] } else { transmissions[dye] }
    })
}

fn emission(peak_nm: f64) -> Spectrum {
    EmissionShape { peak_nm, short_half_width_nm: 16.0, long_half_width_nm: 27.0 }.spectrum().unwrap()
}

const RANGE: EdgeRange = EdgeRange { from_nm: 450.0, to_nm: 800.0 };

#[test]
fn table_s1_has_the_eigenvalues_of_the_correction() {
    // Alexa Fluor 488, Atto 565, Alexa Fluor 647 behind zt 594 RDC.
    let merit = Merit::of(2, &two_channels(&[0.02, 0.35, 0.98])).unwrap();
    let eigenvalues = merit.eigenvalues.unwrap();
    for (found, expected) in eigenvalues.iter().zip([0.975, 0.960, 0.213]) {
        assert!((found - expected).abs() < 5e-4, "{eigenvalues:?}");
    }
    assert!((merit.product - 0.200).abs() < 5e-4, "{}", merit.product);
    assert!((merit.determinant.unwrap() - 0.33 * 0.96 * 0.63).abs() < 1e-12);
}

#[test]
fn the_best_possible_product_is_a_quarter() {
    let merit = Merit::of(2, &two_channels(&[0.0, 0.5, 1.0])).unwrap();
    assert!((merit.product - 0.25).abs() < 1e-12);
}

#[test]
fn a_mixture_that_cannot_be_unmixed_has_no_merit_and_is_no_error() {
    let merit = Merit::of(2, &two_channels(&[0.3, 0.3, 0.9])).unwrap();
    assert!(merit.product < 1e-12 && merit.noise_gain.is_none());
    assert!(merit.condition > 1e12 && merit.worst_noise_gain().is_infinite());
    assert_eq!(merit.by(Criterion::Noise), 0.0);
}

#[test]
fn systems_without_a_meaning_are_refused() {
    let too_many = Merit::of(2, &two_channels(&[0.0, 0.2, 0.6, 1.0]));
    assert!(matches!(too_many, Err(ChoiceError::TooManyDyes { dyes: 4, spectral_channels: 3, .. })));
    assert!(Merit::of(3, &two_channels(&[0.0, 0.2, 0.6, 1.0])).is_ok());
    assert!(matches!(Merit::of(2, &array![[0.5], [f64::NAN]]), Err(ChoiceError::Share { dye: 0, .. })));
    assert!(Merit::of(0, &two_channels(&[0.5])).is_err());
    assert!(Merit::of(2, &Array2::zeros((2, 0))).is_err());
    assert!(Merit::of(2, &Array2::zeros((0, 2))).is_err());
    let split = EdgeSplit::alike(&[emission(520.0)], 2).unwrap();
    for (from_nm, to_nm) in [(800.0, 450.0), (f64::NAN, 800.0), (450.0, f64::INFINITY), (500.0, 500.0)] {
        assert!(split.best(2, EdgeRange { from_nm, to_nm }, Criterion::Product).is_err());
        assert!(split.sweep(2, EdgeRange { from_nm, to_nm }, 1.0).is_err());
    }
    assert!(EdgeSplit::alike(&[], 2).is_err() && EdgeSplit::alike(&[emission(520.0)], 0).is_err());
    let dark = Spectrum::new(vec![500.0, 600.0], vec![0.0, 0.0]).unwrap();
    let split = EdgeSplit::alike(&[emission(520.0), dark], 2).unwrap();
    assert_eq!(split.merit(2, &[550.0]), Err(ChoiceError::Dark { dye: 1 }));
}

#[test]
fn spectral_channels_are_combinations_with_repetition() {
    for (order, channels, expected) in [(2, 2, 3), (3, 2, 4), (4, 2, 5), (2, 3, 6), (4, 3, 15), (4, 8, 330)] {
        assert_eq!(spectral_channels(order, channels), expected);
    }
    assert_eq!((spectral_channels(2, 0), spectral_channels(0, 3)), (0, 1));
}

#[test]
fn edges_share_the_light_and_lose_none() {
    let split = EdgeSplit::alike(&[emission(520.0), emission(590.0), emission(668.0)], 4).unwrap();
    let shares = split.shares(&[540.0, 600.0, 660.0]).unwrap();
    for dye in 0..3 {
        assert!((shares.column(dye).sum() - 1.0).abs() < 1e-12);
    }
    assert!(shares[[0, 0]] > 0.5 && shares[[1, 1]] > 0.5 && shares[[3, 2]] > 0.5, "{shares}");
    // Edges at one place leave the channel between them dark.
    let same = split.shares(&[600.0, 600.0, 600.0]).unwrap();
    assert!(same.row(1).iter().chain(same.row(2)).all(|share| *share < 1e-12));
}

#[test]
fn shares_behind_an_edge_are_those_of_the_single_dye() {
    let (first, second) = (emission(520.0), emission(600.0));
    let split = EdgeSplit::alike(&[first.clone(), second.clone()], 2).unwrap();
    for edge in [300.0, 520.0, 571.3, 600.25, 900.0] {
        let shares = split.shares(&[edge]).unwrap();
        for (dye, emission) in [&first, &second].into_iter().enumerate() {
            let response = SpectralResponse::behind_ideal_edge(emission, edge).unwrap();
            assert!((shares[[1, dye]] - response.transmission()).abs() < 1e-12);
            assert!((shares[[0, dye]] - response.reflection()).abs() < 1e-12);
        }
    }
}

#[test]
fn the_best_edge_is_the_best_of_a_fine_sweep() {
    let split = EdgeSplit::alike(&[emission(520.0), emission(592.0), emission(668.0)], 2).unwrap();
    for criterion in [Criterion::Product, Criterion::SmallestSingularValue, Criterion::Noise] {
        let best = split.best(2, RANGE, criterion).unwrap();
        let sweep = split.sweep(2, RANGE, 0.1).unwrap();
        let (edge, merit) =
            sweep.iter().max_by(|a, b| a.1.by(criterion).total_cmp(&b.1.by(criterion))).unwrap();
        assert!((best.edges_nm[0] - edge).abs() < 0.3, "{criterion:?}: {:?} {edge}", best.edges_nm);
        assert!(best.merit.by(criterion) > merit.by(criterion) * (1.0 - 1e-4));
    }
}

#[test]
fn three_channels_take_five_dyes_at_order_two_and_their_edges_stand_between_them() {
    let peaks = [480.0, 530.0, 580.0, 630.0, 680.0];
    let emissions: Vec<Spectrum> = peaks.iter().map(|&peak| emission(peak)).collect();
    let split = EdgeSplit::alike(&emissions, 3).unwrap();
    let best = split.best(2, RANGE, Criterion::Product).unwrap();
    let [low, high] = best.edges_nm[..] else { panic!("{best:?}") };
    assert!((500.0..=600.0).contains(&low) && (580.0..=690.0).contains(&high), "{best:?}");
    assert!(best.merit.condition < 1e3 && best.merit.eigenvalues.is_none());
    // No neighbor on a grid of 5 nm is better.
    for (a, b) in [(-5.0, 0.0), (5.0, 0.0), (0.0, -5.0), (0.0, 5.0), (5.0, 5.0), (-5.0, -5.0)] {
        let merit = split.merit(2, &[low + a, high + b]).unwrap();
        assert!(merit.product <= best.merit.product * (1.0 + 1e-9));
    }
}

#[test]
fn many_channels_are_searched_without_losing_their_order() {
    let emissions: Vec<Spectrum> = (0..8).map(|k| emission(480.0 + 35.0 * f64::from(k))).collect();
    let split = EdgeSplit::alike(&emissions, 8).unwrap();
    let best = split.best(2, RANGE, Criterion::Product).unwrap();
    assert_eq!(best.edges_nm.len(), 7);
    assert!(best.edges_nm.is_sorted() && best.merit.product > 0.0, "{:?}", best.edges_nm);
}

#[test]
fn a_right_share_has_no_crosstalk_and_close_dyes_have_the_most() {
    let table_2 = two_channels(&[0.02, 0.35, 0.98]);
    let none = crosstalk_percent(2, &table_2, 0.0).unwrap();
    assert_eq!(none, Array2::from_diag_elem(3, 100.0));
    let worst = |shares: &Array2<f64>| {
        let percent = crosstalk_percent(2, shares, 0.02).unwrap();
        let beside = percent.indexed_iter().filter(|((i, j), _)| i != j);
        beside.map(|(_, value)| value.abs()).fold(0.0, f64::max)
    };
    assert!(worst(&two_channels(&[0.26, 0.35, 0.47])) > 2.0 * worst(&table_2));
}

proptest! {
    #[test]
    fn the_determinant_is_the_product_of_the_differences(
        t1 in 0.0..=1.0_f64, t2 in 0.0..=1.0_f64, t3 in 0.0..=1.0_f64,
    ) {
        let merit = Merit::of(2, &two_channels(&[t1, t2, t3])).unwrap();
        let identity = (t2 - t1) * (t3 - t1) * (t3 - t2);
        prop_assert!((merit.determinant.unwrap() - identity).abs() < 1e-12);
        prop_assert!((merit.product - identity.abs()).abs() < 1e-9);
        prop_assert!(merit.product <= 0.25 + 1e-12);
        let eigenvalues: f64 = merit.eigenvalues.unwrap().iter().product();
        prop_assert!((eigenvalues - identity.abs()).abs() < 1e-7);
    }

    #[test]
    fn the_merit_agrees_with_the_matrix_that_unmixes(
        t1 in 0.0..0.3_f64, t2 in 0.35..0.6_f64, t3 in 0.7..1.0_f64, order in 2..=4_usize,
    ) {
        let transmissions = [t1, t2, t3];
        let species: Vec<Species> =
            transmissions.iter().map(|&t| Species::new(&t.to_string(), t).unwrap()).collect();
        let matrix = UnmixingMatrix::new(order, &species).unwrap();
        let merit = Merit::of(order, &two_channels(&transmissions)).unwrap();
        prop_assert_eq!(merit.singular_values.as_slice(), matrix.singular_values());
        prop_assert_eq!(merit.noise_gain.unwrap(), matrix.noise_gain());
        prop_assert_eq!(merit.eigenvalues.is_some(), order == 2);
    }

    /// Against the derivative: `x_j = -(M^+ dm_i/dT)_j * error` for a small error.
    #[test]
    fn crosstalk_of_a_small_error_is_its_derivative(
        t1 in 0.05..0.25_f64, t2 in 0.4..0.6_f64, t3 in 0.75..0.95_f64, order in 2..=4_usize,
    ) {
        let (t, error) = ([t1, t2, t3], 1e-6);
        let species: Vec<Species> = t.iter().map(|&t| Species::new(&t.to_string(), t).unwrap()).collect();
        let inverse = UnmixingMatrix::new(order, &species).unwrap().pseudo_inverse();
        let percent = crosstalk_percent(order, &two_channels(&t), error).unwrap();
        for i in 0..3 {
            let slope = |u: usize| {
                let (n, r) = (order as i32, 1.0 - t[i]);
                let u = u as i32;
                f64::from(u) * t[i].powi(u - 1) * r.powi(n - u) - f64::from(n - u) * t[i].powi(u) * r.powi(n - u - 1)
            };
            for j in (0..3).filter(|&j| j != i) {
                let leak: f64 = (0..=order).map(|u| inverse[[j, u]] * slope(u)).sum();
                let expected = 100.0 * leak.abs() * error;
                prop_assert!((percent[[i, j]].abs() - expected).abs() < 1e-3 * expected + 1e-9);
            }
        }
    }
}
