use super::*;
use crate::scene::Scene;
use crate::world::World;

const FOLD: usize = 2;

fn truth_of(name: &str) -> Truth {
    let scene = Scene::from_toml(Scene::built_in(name).unwrap()).unwrap().with_frames(1).unwrap();
    World::new(&scene, 1).truth()
}

/// One image per species: Gaussian ridges along its places plus `mixing[species][image]` of the others.
fn images(truth: &Truth, sigma_px: f64, mixing: &[[f64; 3]; 3]) -> Vec<Vec<f32>> {
    let (height, width) = (truth.height_px * FOLD, truth.width_px * FOLD);
    let outlines: Vec<_> = (0..3).map(|species| truth.outline(species)).collect();
    let place = |pixel: usize| [(pixel / width) as f64 / FOLD as f64, (pixel % width) as f64 / FOLD as f64];
    let value = |pixel: usize, image: usize| {
        let ridges = outlines.iter().zip(mixing).map(|(outline, shares)| {
            let distance = outline.distance(place(pixel));
            shares[image] * (-0.5 * (distance / sigma_px).powi(2)).exp()
        });
        // A base and a ripple stand for background.
        (20.0 + 0.25 * ((pixel % 2) as f64) + 100.0 * ridges.sum::<f64>()) as f32
    };
    (0..3).map(|image| (0..height * width).map(|pixel| value(pixel, image)).collect()).collect()
}

fn planes<'a>(truth: &Truth, pixels: &'a [Vec<f32>]) -> Vec<Plane<'a>> {
    let (height, width) = (truth.height_px * FOLD, truth.width_px * FOLD);
    pixels.iter().map(|pixels| Plane { pixels, height, width, fold: FOLD }).collect()
}

const MIXING: [[f64; 3]; 3] = [[1.0, 0.05, -0.01], [0.02, 1.0, 0.03], [0.0, 0.14, 1.0]];

#[test]
fn known_crosstalk_is_found() {
    let truth = truth_of("figure-s4");
    let pixels = images(&truth, 0.8, &MIXING);
    let found = crosstalk_percent(&truth, &planes(&truth, &pixels)).unwrap();
    for (row, shares) in found.iter().zip(MIXING) {
        for (percent, share) in row.iter().zip(shares) {
            assert!((percent - 100.0 * share).abs() < 0.1, "{found:?}");
        }
    }
}

#[test]
fn missing_pixels_are_ignored_until_none_is_left() {
    let truth = truth_of("figure-s10");
    let mut pixels = images(&truth, 0.8, &MIXING);
    for image in &mut pixels {
        image.iter_mut().step_by(3).for_each(|pixel| *pixel = f32::NAN);
    }
    let found = crosstalk_percent(&truth, &planes(&truth, &pixels)).unwrap();
    assert!((found[0][1] - 5.0).abs() < 0.1);
    pixels[1].fill(f32::NAN);
    assert_eq!(crosstalk_percent(&truth, &planes(&truth, &pixels)), Err(ScoreError::NoBackground));
}

#[test]
fn the_three_filament_scenes_leave_room_for_the_score() {
    for name in ["figure-s4", "figure-s6", "figure-s7", "figure-s8", "figure-s10"] {
        let truth = truth_of(name);
        let pixels = images(&truth, 0.8, &MIXING);
        let planes = planes(&truth, &pixels);
        let free = |species: usize| {
            let clear = |point: [f64; 2]| {
                (0..3).all(|other| {
                    let distance = truth.distance_px(other, point[0], point[1]);
                    if other == species { distance <= 0.75 } else { distance >= 6.0 }
                })
            };
            (0..planes[0].pixels.len()).filter(|&pixel| clear(planes[0].position(pixel))).count()
        };
        assert!((0..3).all(|species| free(species) > 80), "{name}");
        let is_background =
            |point: [f64; 2]| (0..3).all(|species| truth.distance_px(species, point[0], point[1]) >= 7.0);
        let pixels = 0..planes[0].pixels.len();
        let background = pixels.filter(|&pixel| is_background(planes[0].position(pixel))).count();
        assert!(background > 3000, "{name}: {background}");
    }
}

#[test]
fn the_width_of_a_filament_is_measured() {
    let truth = truth_of("figure-s4");
    for sigma_px in [0.4, 0.8, 1.3] {
        let pixels = images(&truth, sigma_px, &MIXING);
        let expected_nm = 2.354_82 * sigma_px * 108.0;
        for found_nm in resolution_nm(&truth, &planes(&truth, &pixels)).unwrap() {
            assert!((found_nm / expected_nm - 1.0).abs() < 0.01, "{found_nm} for {expected_nm}");
        }
    }
}

#[test]
fn signal_to_noise_is_signal_over_background_spread() {
    let truth = truth_of("figure-s4");
    let pixels = images(&truth, 0.8, &MIXING);
    // The ripple of 0.25 has a standard deviation of 0.125; the ridge is 100 high at most.
    for ratio in signal_to_noise(&truth, &planes(&truth, &pixels)).unwrap() {
        assert!((600.0..=801.0).contains(&ratio), "{ratio}");
    }
}

#[test]
fn images_that_do_not_fit_are_refused() {
    let truth = truth_of("figure-s4");
    let pixels = images(&truth, 0.8, &MIXING);
    let mut planes = planes(&truth, &pixels);
    planes[2].width -= 1;
    assert_eq!(crosstalk_percent(&truth, &planes), Err(ScoreError::Size(2)));
    planes.pop();
    let expected = ScoreError::Images { expected: 3, found: 2 };
    assert_eq!(crosstalk_percent(&truth, &planes), Err(expected.clone()));
    assert_eq!(resolution_nm(&truth, &planes), Err(expected.clone()));
    assert_eq!(patch_score(&truth, &planes), Err(expected));
    let dark = vec![vec![0.0; pixels[0].len()]; 3];
    let error = crosstalk_percent(&truth, &self::planes(&truth, &dark)).unwrap_err();
    assert!(matches!(error, ScoreError::NoSignal(_)));
}

#[test]
fn patches_are_told_apart_as_well_as_the_images_do() {
    let truth = truth_of("figure-2");
    assert_eq!(truth.patches.len(), 23 * 23);
    let paint = |swapped: usize| {
        let (height, width) = (truth.height_px * FOLD, truth.width_px * FOLD);
        let mut pixels = vec![vec![0.0_f32; height * width]; 3];
        for (number, patch) in truth.patches.iter().enumerate() {
            let shown = if number < swapped { (patch.species + 1) % 3 } else { patch.species };
            let [y, x] = patch.center_px.map(|center| (center * FOLD as f64).round() as usize);
            for pixel in [0, 1, width, width + 1] {
                pixels[shown][y * width + x - pixel] = 1.0;
            }
        }
        pixels
    };
    let right = paint(0);
    let score = patch_score(&truth, &planes(&truth, &right)).unwrap();
    assert_eq!((score.correct_fraction, score.num_patches), (1.0, 529));
    assert!(score.correct_fraction_by_species.iter().all(|&fraction| fraction == 1.0));
    assert!(score.crosstalk_percent[0][1].abs() < 1e-9);
    let wrong = paint(100);
    let score = patch_score(&truth, &planes(&truth, &wrong)).unwrap();
    assert!((score.correct_fraction - 429.0 / 529.0).abs() < 1e-9);
    assert!(score.crosstalk_percent[0][1] > 5.0);
}
