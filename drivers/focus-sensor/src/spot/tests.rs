//! Found places against those that were rendered.

use std::time::Duration;

use proptest::prelude::*;
use sofiscope_hal::Region;
use sofiscope_virtual::spot::{FocusSpot, SpotPattern, SpotScene};
use sofiscope_virtual::table::{OpticalTable, Quantity};

use super::*;

const REGION: Region = Region { left: 0, top: 0, width: 200, height: 64 };

fn scene(zero_px: f64, row_px: f64, sigma_px: f64) -> SpotScene {
    SpotScene { zero_px, row_px, sigma_px, ..SpotScene::default() }
}

fn render(scene: &SpotScene, exposure: u64) -> Vec<u16> {
    let mut counts = vec![0; REGION.num_pixels()];
    let table = OpticalTable::private().unwrap();
    FocusSpot::new(table, scene.clone()).render(REGION, exposure, Duration::ZERO, &mut counts);
    counts
}

fn finder(method: SpotMethod, sigma_px: f64) -> SpotFinder {
    SpotFinder::new(method, SpotForm { width: 200, height: 64, sigma_px, saturation_counts: 4095 })
}

fn assert_sound(found: &Measured) {
    let Measured { signal, light, saturated, shape } = *found;
    assert!(signal.is_finite() && light.is_finite() && light >= 0.0, "{found:?}");
    assert!((0.0..=1.0).contains(&saturated) && (0.0..=1.0).contains(&shape), "{found:?}");
}

/// Deviation of 16 readings from the truth: root of the mean square, and the largest.
fn deviation(finder: &mut SpotFinder, scene: &SpotScene, truth: f64) -> (f64, f64) {
    let errors = (0..16).map(|exposure| {
        let found = finder.measure(&render(scene, exposure));
        assert_sound(&found);
        assert!(found.shape > 0.7, "a spot looks like one: {found:?}");
        found.signal - truth
    });
    let errors: Vec<f64> = errors.collect();
    let square = errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64;
    (square.sqrt(), errors.iter().fold(0.0_f64, |most, error| most.max(error.abs())))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_spot_of_1000_photons_is_found_to_a_twentieth_of_a_pixel(
        x in 25.0..175.0, y in 25.0..39.0, sigma in 1.5..7.0, seed: u64, background_counts in 0.0..40.0,
    ) {
        let scene = SpotScene { seed, background_counts, ..scene(x, y, sigma) };
        let (rms, most) = deviation(&mut finder(SpotMethod::Centroid, sigma), &scene, x);
        prop_assert!(rms <= 0.05 && most <= 0.1, "{rms} px rms, {most} px at most");
    }

    #[test]
    fn the_distance_of_two_spots_is_found(
        middle in 92.0..108.0, distance in 60.0..110.0, sigma in 1.5..6.0, seed: u64,
    ) {
        let scene = SpotScene { seed, pattern: SpotPattern::Two(distance), ..scene(middle, 32.0, sigma) };
        let (rms, most) = deviation(&mut finder(SpotMethod::TwoSpots, sigma), &scene, distance);
        prop_assert!(rms <= 0.07 && most <= 0.14, "{rms} px rms, {most} px at most");
    }

    #[test]
    fn whatever_the_camera_shows_every_number_is_sound(
        specks in proptest::collection::vec((0_usize..12_800, any::<u16>()), 0..40),
        level: u16, sigma in 0.3..300.0, two: bool,
    ) {
        let mut counts = vec![level; 12_800];
        for (place, count) in specks {
            counts[place] = count;
        }
        let method = if two { SpotMethod::TwoSpots } else { SpotMethod::Centroid };
        assert_sound(&finder(method, sigma).measure(&counts));
    }

    #[test]
    fn regions_of_any_size_are_sound(width in 2_usize..40, height in 1_usize..40, sigma in 0.3..30.0, seed: u64) {
        let region = Region { left: 0, top: 0, width: width as u32, height: height as u32 };
        let mut counts = vec![0; region.num_pixels()];
        let scene = SpotScene { seed, ..scene(width as f64 / 2.0, height as f64 / 2.0, sigma) };
        FocusSpot::new(OpticalTable::private().unwrap(), scene).render(region, 0, Duration::ZERO, &mut counts);
        for method in [SpotMethod::Centroid, SpotMethod::TwoSpots] {
            let form = SpotForm { width, height, sigma_px: sigma, saturation_counts: 4095 };
            assert_sound(&SpotFinder::new(method, form).measure(&counts));
        }
    }
}

#[test]
fn without_noise_the_place_is_exact() {
    for tenths in 0..10 {
        let truth = 77.0 + f64::from(tenths) / 10.0;
        let mut counts = vec![20; 12_800];
        for (place, count) in counts.iter_mut().enumerate() {
            let (x, y) = ((place % 200) as f64 - truth, (place / 200) as f64 - 30.3);
            *count += (60_000.0 * (-(x * x + y * y) / 32.0).exp()).round() as u16;
        }
        let found = finder(SpotMethod::Centroid, 4.0).measure(&counts);
        assert!((found.signal - truth).abs() < 1e-3, "{truth}: {found:?}");
    }
}

#[test]
fn a_spot_far_off_keeps_its_light_and_a_wide_one_loses_shape() {
    let full = 1000.0 * std::f64::consts::TAU * 16.0;
    let found = finder(SpotMethod::Centroid, 4.0).measure(&render(&scene(40.3, 30.0, 4.0), 0));
    assert!(
        (found.light / full - 1.0).abs() < 0.03 && found.saturated == 0.0 && found.shape > 0.9,
        "{found:?}"
    );
    for sigma in [1.5, 12.0] {
        let other = finder(SpotMethod::Centroid, 4.0).measure(&render(&scene(100.0, 32.0, sigma), 0));
        assert!(other.shape < 0.5, "σ is {sigma} px where 4 are expected: {other:?}");
    }
}

#[test]
fn darkness_has_no_shape_and_hardly_light() {
    let full = 1000.0 * std::f64::consts::TAU * 16.0;
    for method in [SpotMethod::Centroid, SpotMethod::TwoSpots] {
        for exposure in 0..200 {
            let dark = SpotScene { peak_counts: 0.0, ..scene(100.0, 32.0, 4.0) };
            let found = finder(method, 4.0).measure(&render(&dark, exposure));
            assert_sound(&found);
            assert!(found.shape == 0.0 && found.signal == 0.0 && found.light < 0.02 * full, "{found:?}");
        }
    }
}

#[test]
fn saturation_is_told_as_a_share_of_the_spot() {
    let bright = |peak_counts| {
        let scene = SpotScene { peak_counts, ..scene(100.0, 32.0, 4.0) };
        finder(SpotMethod::Centroid, 4.0).measure(&render(&scene, 0)).saturated
    };
    assert_eq!(bright(3500.0), 0.0);
    // Above the saturation of 4095 lie ln(8000/4095) of 2σ²π, above half of it ln(8000/2048) of it.
    let expected = (8000.0_f64 / 4095.0).ln() / (8000.0_f64 / 2048.0).ln();
    assert!((bright(8000.0) - expected).abs() < 0.05, "{} instead of {expected}", bright(8000.0));
}

#[test]
fn specks_are_no_spot_and_do_not_pull_one() {
    let dark = SpotScene { peak_counts: 0.0, ..scene(100.0, 32.0, 4.0) };
    let mut counts = render(&dark, 0);
    (counts[20 * 200 + 50], counts[40 * 200 + 150]) = (4095, 4095);
    let found = finder(SpotMethod::Centroid, 4.0).measure(&counts);
    assert!(found.shape < 0.5, "two specks are no spot: {found:?}");

    let mut counts = render(&scene(100.4, 32.0, 4.0), 0);
    (counts[20 * 200 + 50], counts[40 * 200 + 150]) = (4095, 4095);
    let found = finder(SpotMethod::Centroid, 4.0).measure(&counts);
    assert!((found.signal - 100.4).abs() < 0.05 && found.shape > 0.8, "{found:?}");

    let mut two = SpotScene { pattern: SpotPattern::Two(80.0), ..scene(100.0, 32.0, 4.0) };
    two.seed = 5;
    let found = finder(SpotMethod::Centroid, 4.0).measure(&render(&two, 0));
    assert!(found.shape < 0.55, "of two equal spots neither is the one: {found:?}");
    let table = OpticalTable::private().unwrap();
    table.set(Quantity::FocusBeamBlocked, 1.0);
    let mut counts = render(&two, 0);
    FocusSpot::new(table, two).render(REGION, 0, Duration::ZERO, &mut counts);
    assert_eq!(finder(SpotMethod::TwoSpots, 4.0).measure(&counts).shape, 0.0);
}

#[test]
fn spots_that_leave_the_image_lose_their_shape() {
    let mut before = 1.1;
    for x in [30.0, 5.0, 2.0, 0.0, -3.0] {
        let found = finder(SpotMethod::Centroid, 4.0).measure(&render(&scene(x, 32.0, 4.0), 0));
        assert!(found.shape <= before + 0.03, "at {x} px: {found:?}, before {before}");
        before = found.shape;
    }
    assert!(before < 0.3, "{before}");
}
