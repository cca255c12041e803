use std::time::Instant;

use proptest::prelude::*;

use super::matrix::channel_sets;
use super::reference;
use super::*;
use crate::sofi::spectra::Species;
use nalgebra::{DMatrix, DVector};
use ndarray::Array2;

fn dyes(transmissions: &[f64]) -> Vec<Species> {
    let named = |(i, &t): (usize, &f64)| Species::new(&format!("dye {i}"), t).unwrap();
    transmissions.iter().enumerate().map(named).collect()
}

fn table_s1() -> Vec<Species> {
    let zt_594 = [("Alexa Fluor 488", 0.02), ("Atto 565", 0.35), ("Alexa Fluor 647", 0.98)];
    zt_594.map(|(name, t)| Species::new(name, t).unwrap()).to_vec()
}

fn names(count: usize) -> Vec<String> {
    (0..count).map(|i| format!("dye {i}")).collect()
}

/// The twin: every subset of species, solved by its normal equations; the least misfit wins.
fn by_all_subsets(matrix: &UnmixingMatrix, kappa: &[f64]) -> (Vec<f64>, f64) {
    let m = &matrix.matrix;
    let mut best = (vec![0.0; m.ncols()], kappa.iter().map(|k| k * k).sum::<f64>());
    for set in 1..1_usize << m.ncols() {
        let members: Vec<usize> = (0..m.ncols()).filter(|i| set & (1 << i) != 0).collect();
        let part = m.select_columns(&members);
        let right = part.transpose() * DVector::from_column_slice(kappa);
        let Some(inverse) = (part.transpose() * &part).try_inverse() else {
            continue;
        };
        let solved = inverse * right;
        if solved.iter().all(|&s| s >= 0.0) {
            let mut species = vec![0.0; m.ncols()];
            members.iter().zip(solved.iter()).for_each(|(&i, &s)| species[i] = s);
            let misfit = misfit(matrix, &species, kappa);
            if misfit < best.1 {
                best = (species, misfit);
            }
        }
    }
    best
}

fn misfit(matrix: &UnmixingMatrix, species: &[f64], kappa: &[f64]) -> f64 {
    let fitted = matrix.mix(species);
    fitted.iter().zip(kappa).map(|(f, k)| (f - k).powi(2)).sum()
}

/// Transmissions at least 0.15 apart, in random order of size.
fn spread_transmissions(count: usize) -> impl Strategy<Value = Vec<f64>> {
    proptest::collection::vec(0.0..1.0_f64, count).prop_map(move |mut gaps| {
        let free = 1.0 - 0.15 * (count - 1) as f64;
        let sum: f64 = gaps.iter().sum::<f64>() + 0.1;
        let mut at = 0.0;
        for (i, gap) in gaps.iter_mut().enumerate() {
            at += *gap / sum * free + if i > 0 { 0.15 } else { 0.0 };
            *gap = at.min(1.0);
        }
        gaps
    })
}

proptest! {
    #[test]
    fn determinant_of_three_species_at_order_two(t in spread_transmissions(3)) {
        let matrix = UnmixingMatrix::new(2, &dyes(&t)).unwrap();
        let expected = (t[1] - t[0]) * (t[2] - t[0]) * (t[2] - t[1]);
        prop_assert!((matrix.determinant().unwrap() - expected).abs() < 1e-12);
        prop_assert!(expected.abs() <= 0.25);
    }

    #[test]
    fn unmixing_undoes_mixing(
        t in spread_transmissions(3),
        order in 2..=4_usize,
        s in proptest::collection::vec(-10.0..10.0_f64, 3),
    ) {
        let matrix = UnmixingMatrix::new(order, &dyes(&t)).unwrap();
        let methods = [
            UnmixingMethod::PseudoInverse,
            UnmixingMethod::Weighted { weights: (0..=order).map(|u| 1.0 + u as f64).collect() },
            UnmixingMethod::Regularized { strength: 0.0 },
        ];
        for method in methods {
            let unmixer = matrix.unmixer(&method).unwrap();
            let back = unmixer.pixel(&matrix.mix(&s)).unwrap();
            for (a, b) in back.iter().zip(&s) {
                prop_assert!((a - b).abs() < 1e-9 * matrix.condition(), "{method:?}");
            }
        }
    }

    #[test]
    fn non_negative_finds_the_best_of_all_subsets(
        t in spread_transmissions(4),
        order in 3..=5_usize,
        noise in proptest::collection::vec(-1.0..1.0_f64, 6),
    ) {
        let matrix = UnmixingMatrix::new(order, &dyes(&t)).unwrap();
        let kappa = &noise[..=order];
        let unmixer = matrix.unmixer(&UnmixingMethod::NonNegative).unwrap();
        let species = unmixer.pixel(kappa).unwrap();
        let (expected, least) = by_all_subsets(&matrix, kappa);
        prop_assert!(species.iter().all(|&s| s >= 0.0));
        prop_assert!((misfit(&matrix, &species, kappa) - least).abs() < 1e-9);
        let scale = expected.iter().copied().fold(1.0, f64::max);
        for (a, b) in species.iter().zip(&expected) {
            prop_assert!((a - b).abs() < 1e-6 * scale, "{species:?} {expected:?}");
        }
    }

    #[test]
    fn two_channels_reduce_to_powers_of_t_and_r(t in spread_transmissions(3), order in 2..=6_usize) {
        let matrix = UnmixingMatrix::new(order, &dyes(&t)).unwrap();
        for u in 0..=order {
            prop_assert_eq!(matrix.spectral_channels()[u].iter().sum::<usize>(), u);
            for (i, t) in t.iter().enumerate() {
                let expected = t.powi(u as i32) * (1.0 - t).powi((order - u) as i32);
                prop_assert!((matrix.matrix()[[u, i]] - expected).abs() < 1e-14);
            }
        }
    }
}

#[test]
fn the_pseudo_inverse_is_exact_to_rounding() {
    // A case that a general-purpose decomposition solved to eight digits only.
    let t = [0.037_001_195_345_244_59, 0.565_080_417_060_820_9, 0.961_669_960_954_710_6];
    let matrix = UnmixingMatrix::new(4, &dyes(&t)).unwrap();
    let identity = &matrix.pseudo_inverse * &matrix.matrix;
    assert!((identity - DMatrix::identity(3, 3)).amax() < 1e-14);
    let squares: f64 = matrix.singular_values().iter().map(|s| s * s).sum();
    assert!((squares - matrix.matrix.norm_squared()).abs() < 1e-14);
}

#[test]
fn eigenvalues_of_table_s1() {
    let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
    let eigenvalues = matrix.eigenvalue_magnitudes().unwrap();
    for (value, expected) in eigenvalues.iter().zip([0.975, 0.960, 0.213]) {
        assert!((value - expected).abs() < 5e-4, "{eigenvalues:?}");
    }
    assert!((eigenvalues.iter().product::<f64>() - 0.200).abs() < 5e-4);
}

#[test]
fn swapping_two_rows_only_changes_the_sign_of_the_determinant() {
    let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
    let mut swapped = matrix.matrix.clone();
    swapped.swap_rows(0, 2);
    assert!((swapped.determinant() + matrix.determinant().unwrap()).abs() < 1e-12);
}

#[test]
fn general_channels_are_counted_and_ordered() {
    assert_eq!(channel_sets(2, 3), [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]]);
    assert_eq!(channel_sets(3, 1), [[0, 0, 0]]);
    assert_eq!(channel_sets(4, 3).len(), 15);
    let one = Array2::from_elem((1, 1), 0.5);
    let matrix = UnmixingMatrix::from_proportions(3, &names(1), &one).unwrap();
    assert!((matrix.matrix()[[0, 0]] - 0.125).abs() < 1e-15);
    let three = Array2::from_shape_vec((3, 1), vec![0.5, 0.3, 0.2]).unwrap();
    let matrix = UnmixingMatrix::from_proportions(2, &names(1), &three).unwrap();
    assert!((matrix.matrix()[[4, 0]] - 0.06).abs() < 1e-15);
}

#[test]
fn noise_gain_is_the_spread_of_unmixed_unit_noise() {
    let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
    let inverse = matrix.pseudo_inverse();
    for (gain, row) in matrix.noise_gain().iter().zip(inverse.rows()) {
        let expected: f64 = row.iter().map(|v| v * v).sum();
        assert!((gain - expected.sqrt()).abs() < 1e-12);
    }
    assert!(matrix.condition() < 10.0);
}

#[test]
fn dyes_of_the_same_color_are_refused_by_name() {
    let mut species = table_s1();
    species[2] = Species::new("Atto 594", 0.35).unwrap();
    let Err(error) = UnmixingMatrix::new(2, &species) else { panic!() };
    let message = error.to_string();
    assert!(message.contains("Atto 565 and Atto 594"), "{message}");
    assert!(!message.contains("488"), "{message}");
}

#[test]
fn dependent_but_not_parallel_columns_are_refused_by_name() {
    // The third dye is the mean of the first two; the fourth stands apart.
    let shares = Array2::from_shape_vec(
        (4, 4),
        vec![0.8, 0.2, 0.5, 0.0, 0.2, 0.8, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1],
    )
    .unwrap();
    let Err(UnmixingError::Indistinguishable { groups, .. }) =
        UnmixingMatrix::from_proportions(1, &names(4), &shares)
    else {
        panic!()
    };
    assert_eq!(groups, [["dye 0", "dye 1", "dye 2"]]);
}

#[test]
fn impossible_systems_are_refused() {
    let refused = |order, shares: &[f64]| UnmixingMatrix::new(order, &dyes(shares)).unwrap_err();
    assert_eq!(refused(2, &[]), UnmixingError::NoSpecies);
    let too_many = UnmixingError::TooManySpecies { species: 4, spectral_channels: 3 };
    assert_eq!(refused(2, &[0.0, 0.3, 0.6, 0.9]), too_many);
    assert!(matches!(refused(0, &[0.5]), UnmixingError::Order { .. }));
    assert!(matches!(refused(99, &[0.5]), UnmixingError::Order { .. }));
    let shares = |value| Array2::from_elem((2, 1), value);
    for bad in [f64::NAN, -0.1, 1.1] {
        let error = UnmixingMatrix::from_proportions(2, &names(1), &shares(bad));
        assert!(matches!(error, Err(UnmixingError::Coefficient { .. })));
    }
    let dark = UnmixingMatrix::from_proportions(2, &names(1), &shares(0.0));
    assert!(matches!(dark, Err(UnmixingError::Invisible { .. })));
    let unnamed = UnmixingMatrix::from_proportions(2, &[], &shares(0.5));
    assert!(unnamed.is_err());
}

#[test]
fn bad_images_and_methods_are_refused() {
    let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
    let (small, large) = (Array2::zeros((2, 2)), Array2::zeros((2, 3)));
    assert!(matrix.unmix(&[small.view(), small.view()]).is_err());
    assert!(matrix.unmix(&[small.view(), small.view(), large.view()]).is_err());
    let weighted = |weights| matrix.unmixer(&UnmixingMethod::Weighted { weights });
    assert!(weighted(vec![1.0, 1.0]).is_err());
    assert!(weighted(vec![1.0, 0.0, 1.0]).is_err());
    assert!(matrix.unmixer(&UnmixingMethod::Regularized { strength: -1.0 }).is_err());
    assert!(matrix.unmixer(&UnmixingMethod::NonNegative).unwrap().pixel(&[1.0]).is_err());
    let empty: Array2<f32> = Array2::zeros((0, 0));
    let species = matrix.unmix(&[empty.view(), empty.view(), empty.view()]).unwrap();
    assert_eq!(species[2].dim(), (0, 0));
}

#[test]
fn a_missing_channel_is_missing_in_every_species() {
    let matrix = UnmixingMatrix::new(2, &dyes(&[0.0, 0.5, 1.0])).unwrap();
    let full = Array2::from_elem((2, 3), 1.0_f32);
    let mut holed = full.clone();
    holed[[1, 2]] = f32::NAN;
    for method in [UnmixingMethod::PseudoInverse, UnmixingMethod::NonNegative] {
        let kappa = [full.view(), full.view(), holed.view()];
        for species in matrix.unmix_with(&method, &kappa).unwrap() {
            assert!(species[[1, 2]].is_nan());
            assert_eq!(species.iter().filter(|v| v.is_nan()).count(), 1);
        }
    }
}

#[test]
fn transposed_views_unmix_alike() {
    let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
    let image = Array2::from_shape_fn((5, 4), |(y, x)| (y * 7 + x) as f32);
    let kappa = [image.view(), image.view(), image.view()];
    let turned = [image.t(), image.t(), image.t()];
    let (plain, turned) = (matrix.unmix(&kappa).unwrap(), matrix.unmix(&turned).unwrap());
    assert_eq!(plain[1].t(), turned[1]);
}

#[test]
fn agrees_with_the_reference_of_two_cameras() {
    for order in 2..=4 {
        let folder = "twocamera/expected_";
        let Some(kappa) = reference::pages(&format!("{folder}cumulants_order{order}.tif")) else {
            return;
        };
        let expected = reference::pages(&format!("{folder}unmixed_order{order}.tif")).unwrap();
        check_against(order, &kappa, &expected);
    }
}

#[test]
fn agrees_with_the_published_software() {
    let Some(kappa) = reference::pages("sofipackage/expected_order2.tif") else {
        return;
    };
    let expected = reference::pages("sofipackage/expected_unmixed_order2.tif").unwrap();
    check_against(2, &kappa, &expected);
}

fn check_against(order: usize, kappa: &[Array2<f32>], expected: &[Array2<f32>]) {
    let matrix = UnmixingMatrix::new(order, &table_s1()).unwrap();
    let views: Vec<_> = kappa.iter().map(|image| image.view()).collect();
    for (species, expected) in matrix.unmix(&views).unwrap().iter().zip(expected) {
        let difference = reference::disagreement(species, expected);
        println!("order {order}: {difference:.2e}");
        assert!(difference < 1e-5);
    }
}

#[test]
#[ignore = "a measurement: run it alone, with --nocapture"]
fn speed_of_a_large_image() {
    let matrix = UnmixingMatrix::new(2, &table_s1()).unwrap();
    let image = Array2::from_shape_fn((4096, 4096), |(y, x)| ((y * 31 + x * 17) % 101) as f32);
    for method in [UnmixingMethod::PseudoInverse, UnmixingMethod::NonNegative] {
        for _ in 0..2 {
            let start = Instant::now();
            let kappa = [image.view(), image.view(), image.view()];
            matrix.unmix_with(&method, &kappa).unwrap();
            println!("{method:?}: {:?}", start.elapsed());
        }
    }
}
