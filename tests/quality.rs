//! Quality of live results against simulated measurements, and what watching it costs.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use sofiscope::reconstruction::{AllCores, Quality, QualityMonitor, QualitySettings};
use sofiscope::sofi::cumulant::{CumulantEngine, CumulantSettings, Exposure};
use sofiscope::sofi::spectra::Species;
use sofiscope::sofi::unmixing::UnmixingMatrix;
use sofiscope_sim::{Scene, World};
use std::time::Duration;

const SUBSEQUENCE: u64 = 100;

fn scene(name: &str) -> String {
    let path = format!("{}/config/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(path).unwrap()
}

/// Watches a simulated measurement; T may come some exposures late.
fn watched(scene: &str, frames: u64, late: u64, known_offset: Option<f64>) -> Vec<Quality> {
    let scene = Scene::from_toml(scene).unwrap();
    let (height, width, pixels) = (scene.height_px(), scene.width_px(), scene.num_pixels());
    let species: Vec<Species> =
        scene.species().iter().map(|dye| Species::new(&dye.name, dye.transmission).unwrap()).collect();
    let mut settings = QualitySettings::new(CumulantSettings::new(2, 2, SUBSEQUENCE), height, width);
    settings.matrix = Some(UnmixingMatrix::new(2, &species).unwrap());
    settings.pixel_pitch_nm = Some(scene.optics().pixel_pitch_nm);
    settings.period = Some(Duration::from_secs_f64(scene.exposure_ms() * 1e-3));
    settings.offset_counts = known_offset.map(|offset| vec![offset; 2]);
    let mut monitor = QualityMonitor::new(settings).unwrap();
    let world = World::new(&scene, 1);
    let block = 50;
    let (mut reflected, mut transmitted) = (Vec::new(), vec![0; late as usize * pixels]);
    for first in (0..frames).step_by(block) {
        let end = (first + block as u64).min(frames);
        let mut new = [(); 2].map(|()| vec![0_u16; (end - first) as usize * pixels]);
        let [r, t] = &mut new;
        world.render_block(first..end, r, t).unwrap();
        reflected = std::mem::take(r);
        transmitted.extend_from_slice(t);
        let planes: Vec<[&[u16]; 2]> =
            reflected.chunks(pixels).zip(transmitted.chunks(pixels)).map(|(r, t)| [r, t]).collect();
        let exposures: Vec<Exposure<'_, u16>> = (first..)
            .zip(&planes)
            .filter(|(index, _)| *index >= late)
            .map(|(index, planes)| Exposure { index, planes })
            .collect();
        monitor.push(&exposures).unwrap();
        transmitted.drain(..(end - first) as usize * pixels);
    }
    drop(reflected);
    monitor.into_history()
}

fn numbers(values: &[Option<f64>]) -> Vec<f64> {
    values.iter().map(|value| value.unwrap()).collect()
}

/// The signal-to-noise of all images has grown by a factor, to 15 %.
fn assert_growth(early: &Quality, late: &Quality, factor: f64) {
    for (early, late) in [(&early.snr_channels, &late.snr_channels), (&early.snr_species, &late.snr_species)]
    {
        for (early, late) in numbers(early).into_iter().zip(numbers(late)) {
            assert!((late / early / factor - 1.0).abs() < 0.15, "{early}, then {late}, not {factor} times");
        }
    }
}

#[test]
fn without_bleaching_signal_to_noise_grows_with_the_square_root() {
    let history = watched(&scene("figure-s4").replace("tau_bleach_s = 80.0", ""), 2000, 0, None);
    let last = &history[19];
    println!("{:?} {:?}", history[4].snr_species, last.snr_species);
    assert_growth(&history[4], last, 2.0);
    assert!(last.bleaching.iter().all(|bleaching| bleaching.is_none_or(|b| b.left > 0.8)), "{last:?}");
}

#[test]
fn quality_of_three_filaments_grows_as_it_should() {
    let history = watched(&scene("figure-s4"), 2000, 0, Some(100.0 + 2.5 * 2.174));
    for quality in &history {
        let nm: Vec<_> = quality.resolution.iter().map(|resolution| resolution.nm).collect();
        println!("{} {:?} {nm:?}", quality.subsequences, quality.snr_species);
    }
    assert_eq!(history.len(), 20);
    assert_eq!((history[0].snr_channels[0], history[0].resolution[0].nm), (None, None));
    let (early, last) = (&history[4], &history[19]);
    assert_eq!((last.subsequences, last.exposures), (20, 2000));
    let lag = last.lag.unwrap();
    assert_eq!((lag.peak, lag.in_step), (0, Some(true)), "{lag:?}");
    for (early, late) in [(&early.snr_channels, &last.snr_channels), (&early.snr_species, &last.snr_species)]
    {
        for (early, late) in numbers(early).into_iter().zip(numbers(late)) {
            // Four times the subsequences give twice the signal-to-noise; bleaching takes some of it.
            assert!((1.5..2.5).contains(&(late / early)), "{early} then {late}");
        }
    }
    for (early, late) in early.resolution.iter().zip(&last.resolution) {
        let (early, late) = (early.nm.unwrap(), late.nm.unwrap());
        assert!((100.0..400.0).contains(&late) && late < 1.05 * early, "{early} nm, then {late} nm");
    }
    println!("lag {lag:?}; bleaching {:?}", last.bleaching);
    println!("more: {:?} {:?}", last.exposures_for_snr(20.0), last.exposures_for_resolution(1.5, 2));
    assert_eq!((&last.saturated_share[..], &last.dead_pixels[..]), (&[0.0; 2][..], &[0; 2][..]));
    assert!(serde_json::to_string(last).unwrap().contains("\"in_step\":true"));
}

#[test]
fn a_camera_that_is_one_exposure_late_is_found() {
    let late = watched(&scene("figure-s4"), 1000, 1, None);
    let lag = late.last().unwrap().lag.unwrap();
    assert_eq!((lag.peak, lag.in_step), (1, Some(false)), "{lag:?}");
}

#[test]
fn cameras_that_moved_apart_are_found() {
    let view = "[camera.transmitted.view]\nshift_px = [0.3, -0.2]\n\n[[species]]";
    let moved = watched(&scene("figure-s4").replacen("[[species]]", view, 1), 2000, 0, None);
    let drift = moved.last().unwrap().drift.unwrap();
    println!("moved: {drift:?}");
    assert!(drift.is_too_far(), "{drift:?}");
    for (found, truth) in drift.shift_px.into_iter().zip([0.3, -0.2]) {
        assert!((found - truth).abs() < 0.06, "{drift:?}");
    }
    let aligned = watched(&scene("figure-s4"), 2000, 0, None);
    let drift = aligned.last().unwrap().drift.unwrap();
    println!("aligned: {drift:?}");
    assert!(!drift.is_too_far() && drift.distance_px() < 0.06, "{drift:?}");
}

#[test]
fn the_half_time_of_bleaching_is_found() {
    let text = scene("figure-s4")
        .replace("tau_bleach_s = 80.0", "tau_bleach_s = 10.0")
        .replace("density_per_um2 = 1000.0", "density_per_um2 = 6000.0");
    let expected = 10.0 * std::f64::consts::LN_2;
    for offset in [None, Some(100.0 + 2.5 * 2.174)] {
        let history = watched(&text, 2000, 0, offset);
        for bleaching in &history.last().unwrap().bleaching {
            let bleaching = bleaching.unwrap();
            println!("{offset:?} {bleaching:?}");
            let found = bleaching.half_time_s.unwrap();
            assert!((found / expected - 1.0).abs() < 0.15, "{found} s, not {expected} s");
        }
    }
}

/// Processor time of this program so far, all threads, seconds.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

#[test]
#[ignore = "measures; run it alone, on a quiet computer"]
fn watching_costs_little_beside_the_engine() {
    let dyes = [("a", 0.02), ("b", 0.35), ("c", 0.98)].map(|(name, t)| Species::new(name, t).unwrap());
    for side in [2048, 512] {
        let film: Vec<Vec<u16>> = (0..16_usize)
            .map(|frame| {
                (0..side * side).map(|pixel| 100 + (pixel * (frame + 7) * 7919 % 251) as u16).collect()
            })
            .collect();
        let settings = CumulantSettings::new(2, 2, 200);
        let mut engine = CumulantEngine::new(settings.clone(), side, side).unwrap();
        let mut quality = QualitySettings::new(settings, side, side);
        quality.matrix = Some(UnmixingMatrix::new(2, &dyes).unwrap());
        let mut monitor = QualityMonitor::new(quality).unwrap();
        let (mut of_engine, mut of_monitor) = (0.0, 0.0);
        for block in 0..25_u64 {
            let planes: Vec<[&[u16]; 2]> = (0..16).map(|k| [&film[k][..], &film[15 - k][..]]).collect();
            let exposures: Vec<Exposure<'_, u16>> =
                (block * 16..).zip(&planes).map(|(index, planes)| Exposure { index, planes }).collect();
            let begun = cpu_seconds();
            engine.push(&AllCores, &exposures).unwrap();
            let between = cpu_seconds();
            monitor.push(&exposures).unwrap();
            of_engine += between - begun;
            of_monitor += cpu_seconds() - between;
        }
        let share = of_monitor / of_engine;
        println!("{side}: engine {of_engine:.3} s, watching {of_monitor:.3} s, {:.1} %", 100.0 * share);
        assert!(side < 2048 || share < 0.1, "{share}");
    }
}
