//! Camera maps: recovered from darks and flats, and what masks do to crosstalk.

use crate::bench::{Bench, assert_same_bits, flat, pixels, shipped, sofiscope, text, with_cameras};
use sofiscope::sofi::camera::{PhotonTransfer, PixelFault, PixelMoments, PixelStatistics, photon_transfer};
use sofiscope_hal::{Channel, ExposureIndex};
use sofiscope_sim::{Scene, World};

/// One pixel in a thousand is hot.
const HOT: &str = "[camera.pixels]\nhot_share = 0.001\nhot_electrons = [200.0, 5000.0]\n";
const S4: &str = "Alexa Fluor 488,Atto 565,Alexa Fluor 647";

fn recorded(world: &World, offset: Option<&ndarray::Array2<f32>>) -> PixelMoments {
    let size = [world.scene().height_px(), world.scene().width_px()];
    let mut statistics = PixelStatistics::new(size, u16::MAX);
    let mut counts = vec![0; size[0] * size[1]];
    for exposure in 0..world.scene().frames() {
        world.frame(Channel::Reflected, ExposureIndex(exposure), &mut counts).unwrap();
        statistics.push(&counts);
    }
    statistics.finish(offset)
}

fn world(background: f64, frames: u64, seed: u64) -> World {
    let text = shipped("flat").replace("exposure = 400.0", &format!("exposure = {background:?}"));
    World::new(&Scene::from_toml(&text).unwrap().with_frames(frames).unwrap(), seed)
}

/// Errors of a map in standard errors, over good pixels: mean, root mean square, share beyond 4.
fn judge(
    found: &PhotonTransfer,
    maps: [&ndarray::Array2<f32>; 2],
    truth: impl Fn(usize) -> f64,
) -> (f64, f64, usize) {
    let [values, errors] = maps;
    let good = found.faults.iter().enumerate().filter(|(_, fault)| **fault == 0).map(|(pixel, _)| pixel);
    let (values, errors) = (values.as_slice().unwrap(), errors.as_slice().unwrap());
    let off: Vec<f64> =
        good.map(|pixel| (f64::from(values[pixel]) - truth(pixel)) / f64::from(errors[pixel])).collect();
    let number = off.len() as f64;
    let mean = off.iter().sum::<f64>() / number;
    let square = off.iter().map(|off| off * off).sum::<f64>() / number;
    (mean, square.sqrt(), off.iter().filter(|off| off.abs() > 4.0).count())
}

#[test]
fn maps_are_recovered_within_their_errors_and_broken_pixels_are_found() {
    let dark_world = world(0.0, 800, 11);
    let dark = recorded(&dark_world, None);
    let flats: Vec<PixelMoments> = [(200.0, 12), (1000.0, 13), (4000.0, 14)]
        .map(|(background, seed)| recorded(&world(background, 400, seed), Some(&dark.mean)))
        .into();
    let found = photon_transfer(&dark, &flats).unwrap();
    let sensor = dark_world.sensor(Channel::Reflected).unwrap();
    for (pixel, fault) in found.faults.iter().enumerate() {
        let bit = |is: bool, fault: PixelFault| if is { fault.bit() } else { 0 };
        let truth = bit(sensor.is_hot[pixel], PixelFault::Hot) | bit(sensor.is_dead[pixel], PixelFault::Dead);
        assert_eq!(*fault, truth, "pixel {pixel}");
    }
    let offset = judge(&found, [&found.offset, &found.offset_error], |p| sensor.dark_mean_counts(p));
    let gain =
        judge(&found, [&found.gain, &found.gain_error], |pixel| sensor.gain_counts_per_electron[pixel]);
    let variance = judge(&found, [&found.read_variance, &found.read_variance_error], |pixel| {
        sensor.dark_variance_counts2(pixel)
    });
    for (name, (mean, spread, beyond)) in [("offset", offset), ("gain", gain), ("variance", variance)] {
        println!("{name}: mean {mean:.4}, spread {spread:.4}, {beyond} of 16365 beyond 4 standard errors");
        // Of 16 thousand pixels, chance alone puts one beyond 4; variances are a little skewed.
        assert!(beyond <= 6, "{name}: {beyond} pixels");
        assert!((0.97..1.03).contains(&spread), "{name}: {spread}");
        // Low variances have small errors as well, which shifts the mean by the root of 2 over their number.
        let shift = if name == "variance" { 0.05 } else { 0.0 };
        assert!((mean + shift).abs() < 4.0 / 128.0, "{name}: {mean}");
    }
}

#[test]
fn masked_pixels_change_no_bit_and_linearized_crosstalk_by_less_than_a_tenth() {
    let bench = Bench::new();
    let scene = shipped("figure-s4");
    bench.simulate("even", &scene, &["--frames", "2000"]);
    bench.simulate("hot", &with_cameras(&scene, HOT), &["--frames", "2000"]);
    let maps = bench.camera_maps(&flat(72, HOT), "64");
    let files = maps.each_ref().map(|file| text(file)).join(",");
    let dyes = ["--species", S4, "--dichroic", "zt 594 RDC"];
    let masked = [&dyes[..], &["--camera-maps", &files]].concat();
    bench.analyze("even", "plain", &dyes);
    bench.analyze("even", "even-masked", &masked);
    bench.analyze("hot", "hot-masked", &masked);
    // Whatever hot pixels show, results are those of pixels that are not hot, but for what needs one of them.
    let missing = assert_same_bits(&bench.path("even-masked"), &bench.path("hot-masked"));
    let edges: usize =
        pixels(&bench.path("plain/cumulants.ome.tif")).iter().filter(|value| value.is_nan()).count();
    assert!(missing > edges, "nothing was left out: {missing} of {edges}");
    let [plain, masked] = ["plain", "hot-masked"].map(|result| bench.worst(result, "even"));
    println!("without hot pixels {plain:.3?} %, with hot pixels and masks {masked:.3?} %");
    let change = [0, 1].map(|stage: usize| (masked[stage] - plain[stage]).abs());
    assert!(change[1] < 0.1 * plain[1], "linearized: {} % became {} %", plain[1], masked[1]);
    // Unmixed, the crosstalk of this scene is a few hundredths of a percent and mostly chance, which the pixels that
    // are left out change by more than a tenth of so little.
    assert!(change[0] < 0.05, "unmixed: {} % became {} %", plain[0], masked[0]);
}

#[test]
fn maps_that_do_not_fit_are_refused() {
    let bench = Bench::new();
    bench.simulate("even", &shipped("figure-s4"), &["--frames", "100"]);
    let maps = bench.camera_maps(&flat(64, HOT), "16");
    let [r, t] = ["reflection", "transmission"].map(|c| bench.path("even").join(format!("{c}.ome.tif")));
    let refused = |maps: &str| {
        let out = bench.path("result");
        let output = sofiscope(&["analyze", text(&r), text(&t), "--camera-maps", maps, "--out", text(&out)]);
        assert_eq!(output.status.code(), Some(2));
        String::from_utf8(output.stderr).unwrap()
    };
    let message = refused(&maps.each_ref().map(|file| text(file)).join(","));
    assert!(message.contains("64 x 64") && message.contains("72 x 72"), "{message}");
    let message = refused(text(&maps[0]));
    assert!(message.contains("1 files for 2 cameras"), "{message}");
}
