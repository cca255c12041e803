//! A run with every calibration, its replay and its offline analysis are the same bits.

use crate::bench::{Bench, assert_same_bits, flat, said, shipped, single_stained, text, told, with_cameras};
use std::fs;

const SIDE: usize = 96;
/// From the scene's own field to the middle of the larger one.
const MOVED: f64 = 12.0;
const DYES: &str = "Alexa Fluor 488,Atto 565,Alexa Fluor 647";
const VIEW: &str = "[camera.transmitted.view]\nmirror = \"horizontal\"\nshift_px = [3.4, -2.55]\n\
                    rotation_deg = 0.3\nscale = 1.002\n";
const PIXELS: &str = "[camera.pixels]\noffset_spread_counts = 1.5\ngain_spread = 0.01\nread_noise_spread = 0.25\n\
                      hot_share = 0.001\nhot_electrons = [200.0, 5000.0]\ndead_share = 0.0003\n";

/// The three filaments in the middle of a larger field.
fn larger() -> String {
    let line = |line: &str| match line.split_once(" = [") {
        Some((key @ ("from_px" | "to_px"), point)) => {
            let point = point.trim_end_matches(']');
            let moved = point.split(',').map(|n| n.trim().parse::<f64>().unwrap() + MOVED);
            format!("{key} = {:?}", moved.collect::<Vec<_>>())
        }
        _ => line.replace("_px = 72", &format!("_px = {SIDE}")),
    };
    let scene: Vec<String> = shipped("figure-s4").lines().map(line).collect();
    scene.join("\n")
}

fn beads() -> String {
    let scene = shipped("beads").replace("_px = 256", &format!("_px = {SIDE}"));
    let (before, after) = scene.split_once("\n[camera.transmitted.view]\n").unwrap();
    let (_, after) = after.split_once("\n\n").unwrap();
    let after = after.replace("[-32.0, -32.0]", "[-16.0, -16.0]").replace("[288.0, 288.0]", "[112.0, 112.0]");
    let after = after.replace("emitters = 180", "emitters = 100").replace("px = 10.0", "px = 9.0");
    format!("{before}\n{VIEW}\n{after}")
}

#[test]
fn a_run_with_every_calibration_its_replay_and_its_offline_analysis_are_the_same_bits() {
    let bench = Bench::new();
    let tables = format!("{PIXELS}\n{VIEW}");
    let maps = bench.camera_maps(&flat(SIDE, &tables), "64");
    let both = maps.each_ref().map(|file| text(file)).join(",");
    let beads = bench.simulate("beads", &beads(), &["--frames", "100"]);
    let registration = bench.path("registration.toml");
    told(&["calibrate", "registration", text(&beads), "--out", text(&registration)]);
    let scene = with_cameras(&larger(), &tables);
    let (response, mut arguments) = (bench.path("response.toml"), vec!["calibrate", "response"]);
    let stained: Vec<String> = (0..3)
        .zip(DYES.split(','))
        .map(|(dye, name)| {
            let single = single_stained(&scene, dye);
            let folder = bench.simulate(&format!("dye-{dye}"), &single, &["--frames", "200", "--seed", "9"]);
            format!("{name}={}", text(&folder))
        })
        .collect();
    stained.iter().for_each(|stained| arguments.extend(["--stained", stained.as_str()]));
    let more = ["--registration", text(&registration), "--camera-maps", &both, "--out", text(&response)];
    let shares = told(&[&arguments[..], &more].concat());
    println!("{shares}");
    for (coefficient, truth) in shares["coefficients"].as_array().unwrap().iter().zip([0.02, 0.35, 0.98]) {
        let off = coefficient["transmission"].as_f64().unwrap() - truth;
        assert!(off.abs() < 0.01, "{coefficient}");
    }

    let scene_file = bench.write("scene.toml", &scene);
    let simulated =
        fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/simulated.toml")).unwrap();
    let simulated = simulated
        .replace("\"figure-s4\"", &format!("{:?}", text(&scene_file)))
        .replace("speed = 1.0", "speed = 0.0")
        .replace(
            "dichroic = \"zt 594 RDC\"",
            "registration_file = \"registration.toml\"\nresponse_file = \"response.toml\"",
        )
        .replace("serial = \"SIM-R\"", "serial = \"SIM-R\"\nmaps_file = \"reflected.toml\"")
        .replace("serial = \"SIM-T\"", "serial = \"SIM-T\"\nmaps_file = \"transmitted.toml\"");
    let instrument = bench.write("instrument.toml", &simulated);
    said(&["check", text(&instrument)]);
    let plan = format!(
        "time_plan: {{interval: 0, loops: 200}}\nkeep_shutter_open_across: [t]\nmetadata:\n  sofiscope:\n    \
         version: 1\n    cameras: {{exposure_ms: 20.0, period_ms: 20.0}}\n    analysis:\n      \
         subsequence_exposures: 100\n      species: [{DYES}]\n      dichroic: measured\n"
    );
    // The dichroic of a file of measured shares is known when the run begins.
    let plan = plan.replace("      dichroic: measured\n", "");
    let plan = bench.write("plan.yaml", &plan);
    let run = bench.path("run");
    let ended = told(&["run", text(&plan), "--instrument", text(&instrument), "--out", text(&run)]);
    let blinking = ended["quality"]["blinking_to_noise"][0].as_f64().unwrap();
    assert!(blinking > 1.0, "{ended}");

    // The same frames as files, with the same calibrations.
    let [r, t] = ["reflection", "transmission"].map(|camera| run.join(format!("{camera}.ome.tif")));
    let offline = bench.path("offline");
    let analyze = ["analyze", text(&r), text(&t), "--species", DYES, "--subsequence", "100", "--out"];
    let calibrated = ["--registration", text(&registration), "--response", text(&response)];
    said(&[&analyze[..], &[text(&offline), "--camera-maps", &both], &calibrated].concat());
    let missing = assert_same_bits(&run.join("results"), &offline);
    assert!(missing > 0, "no pixel was left out");

    // The recording keeps all calibrations; their files may go.
    for file in [&registration, &response, &maps[0], &maps[1]] {
        fs::remove_file(file).unwrap();
    }
    said(&["replay", text(&run), "--verify", "--out", text(&bench.path("again"))]);
    let zarr = bench.path("zarr");
    said(&["export", text(&run), "--format", "ome-zarr", "--out", text(&zarr)]);
    said(&["replay", text(&zarr), "--speed", "max", "--out", text(&bench.path("from-zarr"))]);
    assert_same_bits(&run.join("results"), &bench.path("from-zarr"));
}
