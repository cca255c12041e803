//! The simulated measurement against what its scene asks for.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use sofiscope_hal::{Channel, ExposureIndex};
use sofiscope_sim::{Scene, Truth, TruthError, World, WorldError};

const SIDE: usize = 48;

/// A scene of one filament in the middle; `more` ends the table of the species.
fn scene_text(frames: u64, background: f64, camera: &str, more: &str) -> String {
    format!(
        r#"
name = "test"
frames = {frames}
exposure_ms = 20.0
height_px = {SIDE}
width_px = {SIDE}
seed = 1
background_photons_per_exposure = {background}
background_transmission = 0.25
[optics]
pixel_pitch_nm = 108.0
numerical_aperture = 1.27
{camera}
[[species]]
name = "Dye"
transmission = 0.35
emission_nm = 592.0
i_on_photons = 400.0
{more}
[[species.filament]]
from_px = [24.0, 14.0]
to_px = [24.0, 34.0]
width_px = 0.4
density_per_um2 = 20000.0
"#
    )
}

const BLINKING: &str = "tau_on_ms = 20.0\ntau_off_ms = 180.0";

fn world(text: &str, seed: u64) -> World {
    let scene = Scene::from_toml(text).unwrap_or_else(|error| panic!("{error}"));
    World::new(&scene, seed)
}

fn photons(world: &World, channel: Channel, exposure: u64) -> Vec<f32> {
    let mut plane = vec![0.0; world.scene().num_pixels()];
    world.photons_at(channel, ExposureIndex(exposure), &mut plane).unwrap();
    plane
}

fn frame(world: &World, channel: Channel, exposure: u64) -> Vec<u16> {
    let mut counts = vec![0; world.scene().num_pixels()];
    world.frame(channel, ExposureIndex(exposure), &mut counts).unwrap();
    counts
}

fn sum(plane: &[f32]) -> f64 {
    plane.iter().map(|&value| f64::from(value)).sum()
}

#[test]
fn mean_intensity_is_on_ratio_times_photons_and_splits_as_asked() {
    let frames = 400;
    let world = world(&scene_text(frames, 0.0, "", BLINKING), 3);
    let emitters = world.truth().species[0].num_emitters as f64;
    let total = |channel| (0..frames).map(|k| sum(&photons(&world, channel, k))).sum::<f64>();
    let (reflected, transmitted) = (total(Channel::Reflected), total(Channel::Transmitted));
    let mean_on = (reflected + transmitted) / (400.0 * emitters * frames as f64);
    // Variance of the time average of a two-state process: 2 rho (1 - rho) tau_c / duration.
    let tau_c = 1.0 / (1.0 / 1.0 + 1.0 / 9.0);
    let error = (2.0 * 0.1 * 0.9 * tau_c / frames as f64 / emitters).sqrt();
    assert!((mean_on - 0.1).abs() < 4.0 * error, "{mean_on} +- {error}");
    assert!((transmitted / (reflected + transmitted) - 0.35).abs() < 1e-6);
}

#[test]
fn the_first_exposure_is_as_bright_as_the_last() {
    let world = world(&scene_text(300, 0.0, "", BLINKING), 4);
    let emitters = world.truth().species[0].num_emitters as f64;
    let error = (0.1 * 0.9 / emitters).sqrt();
    for exposure in [0, 1, 150, 299] {
        let on = sum(&photons(&world, Channel::Reflected, exposure)) / (400.0 * 0.65 * emitters);
        assert!((on - 0.1).abs() < 4.0 * error, "exposure {exposure}: {on} +- {error}");
    }
}

#[test]
fn brightness_decays_with_the_bleaching_time() {
    let bleaching = format!("{BLINKING}\ntau_bleach_s = 4.0");
    let world = world(&scene_text(400, 0.0, "", &bleaching), 5);
    let emitters = world.truth().species[0].num_emitters as f64;
    for exposure in [0_u64, 100, 200, 399] {
        let on = sum(&photons(&world, Channel::Reflected, exposure)) / (400.0 * 0.65 * emitters);
        let expected = 0.1 * (-(exposure as f64 + 0.5) * 0.02 / 4.0).exp();
        let error = (expected / emitters).sqrt();
        assert!((on - expected).abs() < 4.0 * error, "exposure {exposure}: {on}");
    }
}

#[test]
fn background_is_split_and_counted_as_the_cameras_are_built() {
    let camera =
        "[camera]\ngain_counts_per_electron = 2.0\nquantum_efficiency = 0.8\nread_noise_electrons = 1.5";
    let world = world(&scene_text(20, 40.0, camera, "steady = true"), 6);
    for (channel, light) in [(Channel::Reflected, 30.0), (Channel::Transmitted, 10.0)] {
        let counts: Vec<f64> = (0..20)
            .flat_map(|exposure| frame(&world, channel, exposure)[..SIDE * 10].to_vec())
            .map(f64::from)
            .collect();
        let n = counts.len() as f64;
        let mean = counts.iter().sum::<f64>() / n;
        let variance = counts.iter().map(|count| (count - mean).powi(2)).sum::<f64>() / n;
        let electrons = 0.8 * light;
        let expected = 4.0 * (electrons + 1.5 * 1.5) + 1.0 / 12.0;
        assert!((mean - 100.0 - 2.0 * electrons).abs() < 4.0 * (expected / n).sqrt());
        assert!((variance / expected - 1.0).abs() < 4.0 * ((2.0 + 1.0 / electrons) / n).sqrt());
    }
}

#[test]
fn both_cameras_have_their_own_noise_and_each_exposure_too() {
    // With equal light in both, one stream for both would give the same frame twice.
    let text = scene_text(2, 20.0, "", "steady = true")
        .replace("background_transmission = 0.25", "background_transmission = 0.5");
    let world = world(&text, 6);
    assert_ne!(frame(&world, Channel::Reflected, 0), frame(&world, Channel::Reflected, 1));
    let [reflected, transmitted] = Channel::BOTH.map(|channel| {
        let counts = frame(&world, channel, 0)[..SIDE * 12].to_vec();
        let mean = counts.iter().map(|&c| f64::from(c)).sum::<f64>() / counts.len() as f64;
        counts.into_iter().map(|c| f64::from(c) - mean).collect::<Vec<f64>>()
    });
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let norm = (dot(&reflected, &reflected) * dot(&transmitted, &transmitted)).sqrt();
    let correlation = dot(&reflected, &transmitted) / norm;
    assert!(correlation.abs() < 4.0 / (reflected.len() as f64).sqrt(), "{correlation}");
}

fn blocks(threads: usize, order: &[u64]) -> Vec<u16> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let world = world(&scene_text(40, 5.0, "", BLINKING), 9);
        let pixels = world.scene().num_pixels();
        let mut all = vec![0; 2 * 40 * pixels];
        let (reflected, transmitted) = all.split_at_mut(40 * pixels);
        for &first in order {
            let place = first as usize * pixels..(first as usize + 10) * pixels;
            world
                .render_block(first..first + 10, &mut reflected[place.clone()], &mut transmitted[place])
                .unwrap();
        }
        all
    })
}

#[test]
fn threads_and_order_do_not_matter() {
    let once = blocks(1, &[0, 10, 20, 30]);
    assert!(once == blocks(2, &[30, 0, 20, 10]));
    let world = world(&scene_text(40, 5.0, "", BLINKING), 9);
    let pixels = world.scene().num_pixels();
    assert!(frame(&world, Channel::Reflected, 17) == once[17 * pixels..18 * pixels]);
    assert!(frame(&world, Channel::Transmitted, 3) == once[43 * pixels..44 * pixels]);
}

#[test]
fn a_longer_measurement_begins_like_a_shorter_one_and_another_seed_differs() {
    let short = world(&scene_text(10, 5.0, "", BLINKING), 2);
    let long = world(&scene_text(50, 5.0, "", BLINKING), 2);
    let other = world(&scene_text(10, 5.0, "", BLINKING), 3);
    for channel in Channel::BOTH {
        assert!(frame(&short, channel, 9) == frame(&long, channel, 9));
        assert!(frame(&short, channel, 9) != frame(&other, channel, 9));
    }
}

#[test]
fn camera_t_sees_each_bead_where_the_view_puts_it() {
    for (mirror, sign) in [("none", 1.0), ("horizontal", -1.0), ("vertical", 1.0)] {
        let view = format!(
            "[camera.transmitted.view]\nmirror = \"{mirror}\"\nshift_px = [2.5, -1.25]\nrotation_deg = 5.0\nscale = 1.02"
        );
        let text = scene_text(1, 0.0, &view, "steady = true");
        let one_bead = "[[species.random]]\nemitters = 1\nfrom_px = [19.0, 27.0]\nto_px = [21.0, 29.0]\n";
        let text = format!("{}{one_bead}", text.split_once("[[species.filament]]").unwrap().0);
        let world = world(&text, 8);
        let truth = world.truth();
        let bead = truth.species[0].positions_px[0];
        let centroid = |channel| {
            let plane = photons(&world, channel, 0);
            let moment = |axis: usize| {
                plane
                    .iter()
                    .enumerate()
                    .map(|(pixel, &light)| f64::from(light) * [pixel / SIDE, pixel % SIDE][axis] as f64)
                    .sum::<f64>()
                    / sum(&plane)
            };
            [moment(0), moment(1)]
        };
        let close =
            |found: [f64; 2], wanted: [f64; 2]| (found[0] - wanted[0]).hypot(found[1] - wanted[1]) < 1e-3;
        assert!(close(centroid(Channel::Reflected), bead));
        // By hand: rotation and scale about (23.5, 23.5), shift, mirror.
        let (sin, cos) = 5.0_f64.to_radians().sin_cos();
        let (dy, dx) = (bead[0] - 23.5, bead[1] - 23.5);
        let moved_y = 1.02 * (cos * dy + sin * dx) + 2.5;
        let moved_x = 1.02 * (-sin * dy + cos * dx) - 1.25;
        let flip_y = if mirror == "vertical" { -1.0 } else { 1.0 };
        let wanted = [23.5 + flip_y * moved_y, 23.5 + sign * moved_x];
        assert!(close(centroid(Channel::Transmitted), wanted), "{mirror}: {wanted:?}");
        let [row_y, row_x] = truth.transmitted_from_reflected;
        let by_truth = [row_y, row_x].map(|[a_y, a_x, b]| a_y * bead[0] + a_x * bead[1] + b);
        assert!(close(by_truth, wanted));
    }
}

#[test]
fn figure_2_ramps_photons_and_on_ratio() {
    let scene = Scene::from_toml(Scene::built_in("figure-2").unwrap()).unwrap();
    let truth = World::new(&scene.with_frames(1).unwrap(), 1).truth();
    let (first, last) = (truth.patches.first().unwrap(), truth.patches.last().unwrap());
    assert_eq!((first.i_on_photons, first.on_ratio), (200.0, 0.01));
    assert_eq!((last.i_on_photons, last.on_ratio), (1100.0, 0.1));
    let emitters: u64 = truth.species.iter().map(|species| species.num_emitters).sum();
    assert_eq!(emitters, 2 * truth.patches.len() as u64);
    // Three species at random over 529 patches: 176 each, with a spread of 11.
    assert!(truth.species.iter().all(|species| (266..=440).contains(&species.num_emitters)));
    let patch = truth.patches[100];
    let [y, x] = patch.center_px;
    assert_eq!(truth.distance_px(patch.species, y, x), 0.0);
    assert!(truth.distance_px((patch.species + 1) % 3, y, x) > 2.0);
}

#[test]
fn the_cell_and_the_beads_shine() {
    for name in ["cell", "beads"] {
        let scene = Scene::from_toml(Scene::built_in(name).unwrap()).unwrap();
        let world = World::new(&scene.with_frames(2).unwrap(), scene.seed());
        for channel in Channel::BOTH {
            let brightest = frame(&world, channel, 1).into_iter().max().unwrap();
            assert!((250..u16::MAX).contains(&brightest), "{name}: {brightest}");
        }
        assert!(world.truth().species.iter().all(|species| species.num_emitters > 100));
    }
}

#[test]
fn requests_beyond_the_scene_are_refused() {
    let world = world(&scene_text(10, 5.0, "", BLINKING), 1);
    let pixels = world.scene().num_pixels();
    let mut counts = vec![0; pixels];
    let late = world.frame(Channel::Reflected, ExposureIndex(10), &mut counts);
    assert_eq!(late, Err(WorldError::BeyondEnd { exposure: 10, frames: 10 }));
    let huge = world.frame(Channel::Reflected, ExposureIndex(u64::MAX), &mut counts);
    assert!(matches!(huge, Err(WorldError::BeyondEnd { .. })));
    let small = world.frame(Channel::Reflected, ExposureIndex(0), &mut counts[1..]);
    assert_eq!(small, Err(WorldError::WrongLength { expected: pixels, found: pixels - 1 }));
    let mut other = counts.clone();
    assert!(world.render_block(9..11, &mut counts, &mut other).is_err());
    assert!(world.render_block(0..2, &mut counts, &mut other).is_err());
    assert!(world.render_block(5..5, &mut [], &mut []).is_ok());
    assert!(world.render_block(0..u64::MAX, &mut counts, &mut other).is_err());
}

#[test]
fn truth_survives_its_file() {
    let truth = world(&scene_text(10, 5.0, "", BLINKING), 1).truth();
    assert_eq!(Truth::from_json(&truth.to_json().unwrap()).unwrap(), truth);
    assert!(matches!(Truth::from_json("{}"), Err(TruthError::Json(_))));
    assert!(matches!(Truth::from_json("[[["), Err(TruthError::Json(_))));
    let newer = truth.to_json().unwrap().replacen("\"format\": 1", "\"format\": 2", 1);
    assert!(matches!(Truth::from_json(&newer), Err(TruthError::Format(2))));
    let flat = Truth { pixel_pitch_nm: -1.0, ..truth };
    assert!(matches!(Truth::from_json(&flat.to_json().unwrap()), Err(TruthError::Value { .. })));
}

#[test]
fn distance_is_measured_from_the_axis() {
    let truth = world(&scene_text(10, 5.0, "", BLINKING), 1).truth();
    assert_eq!(truth.distance_px(0, 27.0, 20.0), 3.0);
    assert_eq!(truth.distance_px(0, 27.0, 38.0), 5.0);
    assert_eq!(truth.distance_px(7, 27.0, 38.0), f64::INFINITY);
}

#[test]
fn a_drawing_is_filled_as_it_says() {
    let drawing = "[[species.drawing]]\nfrom_px = [10.0, 10.0]\ncell_px = 6.0\nrows = [\"9.3\", \"...\"]\ndensity_per_um2 = 10000.0\n";
    let text = scene_text(1, 0.0, "", "steady = true");
    let text = format!("{}{drawing}", text.split_once("[[species.filament]]").unwrap().0);
    let truth = world(&text, 8).truth();
    let positions = &truth.species[0].positions_px;
    // Four thirds of a cell of 36 px of (0.108 um)^2.
    assert_eq!(positions.len(), 5599);
    assert!(positions.iter().all(|&[y, x]| truth.distance_px(0, y, x) == 0.0));
    let left = positions.iter().filter(|[_, x]| *x < 16.0).count() as f64;
    let error = (0.25 * 0.75 * 5599.0_f64).sqrt();
    assert!((left - 0.75 * 5599.0).abs() < 4.0 * error, "{left}");
    assert_eq!(truth.distance_px(0, 19.0, 12.0), 3.0);
    let empty = text.replace("9.3", "...");
    assert!(Scene::from_toml(&empty).is_err());
}
