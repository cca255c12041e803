//! From beads, and from the blinking sample, to species images: cameras that are mirrored, apart, turned and stretched.
//!
//! The scenes are those of the paper in a larger field, so that both cameras see all of it.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

const SIDE: usize = 160;
/// From the scene's own field to the middle of the larger one.
const MOVED: f64 = 44.0;
const S4: &str = "Alexa Fluor 488,Atto 565,Alexa Fluor 647";
const S10: &str = "Alexa Fluor 568,Abberior Flip 565,Atto 565";
const VIEW: &str = "[camera.transmitted.view]\nmirror = \"horizontal\"\nshift_px = [40.4, -12.55]\n\
                    rotation_deg = 0.3\nscale = 1.002\n\n";

fn sofiscope(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sofiscope")).args(arguments).output().unwrap()
}

fn said(arguments: &[&str]) -> String {
    let output = sofiscope(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn shipped(scene: &str) -> String {
    let path = format!("{}/config/scenes/{scene}.toml", env!("CARGO_MANIFEST_DIR"));
    fs::read_to_string(path).unwrap()
}

/// A scene of filaments in the middle of a larger field.
fn larger(scene: &str, view: &str) -> String {
    let line = |line: &str| match line.split_once(" = [") {
        Some((key @ ("from_px" | "to_px"), point)) => {
            let numbers: Vec<f64> = point
                .trim_end_matches(']')
                .split(',')
                .map(|n| n.trim().parse::<f64>().unwrap() + MOVED)
                .collect();
            format!("{key} = [{}, {}]", numbers[0], numbers[1])
        }
        _ => line.replace("_px = 72", &format!("_px = {SIDE}")),
    };
    let moved: Vec<String> = shipped(scene).lines().map(line).collect();
    moved.join("\n").replacen("[[species]]", &format!("{view}[[species]]"), 1)
}

/// The beads of the same cameras.
fn beads(view: &str) -> String {
    let scene = shipped("beads").replace("_px = 256", &format!("_px = {SIDE}"));
    let (before, after) = scene.split_once("\n[camera.transmitted.view]\n").unwrap();
    let (_, after) = after.split_once("\n\n").unwrap();
    let beads = after
        .replace("[-32.0, -32.0]", "[-48.0, -48.0]")
        .replace("[288.0, 288.0]", "[208.0, 208.0]")
        .replace("emitters = 180", "emitters = 260")
        .replace("minimum_distance_px = 10.0", "minimum_distance_px = 9.0");
    format!("{before}\n{view}{beads}")
}

struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn simulate(&self, name: &str, scene: &str, frames: &str) {
        let file = self.path(&format!("{name}.toml"));
        fs::write(&file, scene).unwrap();
        said(&["simulate", text(&file), "--seed", "1", "--frames", frames, "--out", text(&self.path(name))]);
    }

    fn stacks(&self, name: &str) -> [PathBuf; 2] {
        ["reflection", "transmission"].map(|camera| self.path(name).join(format!("{camera}.ome.tif")))
    }

    fn calibrate(&self, name: &str, method: &str, out: &str) -> Value {
        let [r, t] = self.stacks(name);
        let (out, calibrate) = (self.path(out), ["calibrate", "registration"]);
        let more = [text(&r), text(&t), "--method", method, "--out", text(&out), "--json"];
        serde_json::from_str(&said(&[&calibrate[..], &more].concat())).unwrap()
    }

    /// The worst crosstalk unmixed and linearized, percent.
    fn worst(&self, name: &str, dyes: &str, more: &[&str]) -> [f64; 2] {
        let ([r, t], result) = (self.stacks(name), self.path("result"));
        let analyze = ["analyze", text(&r), text(&t), "--species", dyes, "--dichroic", "zt 594 RDC"];
        said(&[&analyze[..], more, &["--subsequence", "200", "--out", text(&result)]].concat());
        let score = said(&["score", text(&result), "--truth", text(&self.path(name)), "--json"]);
        fs::remove_dir_all(result).unwrap();
        let score: Value = serde_json::from_str(&score).unwrap();
        ["unmixed", "linearized"].map(|stage| score["worst_crosstalk_percent"][stage].as_f64().unwrap().abs())
    }
}

#[test]
fn beads_bring_the_cameras_together_for_dyes_near_and_far() {
    let bench = Bench::new();
    bench.simulate("beads", &beads(VIEW), "100");
    let told = bench.calibrate("beads", "beads", "beads-registration.toml");
    println!("{told}");
    assert_eq!(told["mirror"], "horizontal");
    assert!(told["residual_nm"].as_f64().unwrap() < 2.0, "{told}");
    let file = bench.path("beads-registration.toml");
    assert!(file.with_extension("png").is_file());
    said(&["check", text(&file)]);
    for (scene, dyes, most) in [("figure-s4", S4, [1.0, 5.5]), ("figure-s10", S10, [4.0, 18.0])] {
        bench.simulate(scene, &larger(scene, VIEW), "2000");
        let [unmixed, linearized] = bench.worst(scene, dyes, &["--registration", text(&file)]);
        println!("{scene}: unmixed {unmixed:.2} %, linearized {linearized:.2} %");
        assert!(unmixed < most[0] && linearized < most[1], "{scene}: {unmixed} %, {linearized} %");
    }
    let bilinear = ["--registration", text(&file), "--registration-method", "bilinear-frames"];
    let [unmixed, _] = bench.worst("figure-s10", S10, &bilinear);
    println!("bilinear frames: unmixed {unmixed:.2} %");
    assert!(unmixed > 20.0, "the obvious way would do: {unmixed} %");
}

#[test]
fn what_blinks_together_brings_the_cameras_together() {
    let bench = Bench::new();
    bench.simulate("figure-s4", &larger("figure-s4", VIEW), "2000");
    let told = bench.calibrate("figure-s4", "correlation", "registration.toml");
    println!("{told}");
    assert_eq!(told["mirror"], "horizontal");
    let file = bench.path("registration.toml");
    let [unmixed, linearized] = bench.worst("figure-s4", S4, &["--registration", text(&file)]);
    println!("unmixed {unmixed:.2} %, linearized {linearized:.2} %");
    assert!(unmixed < 1.5 && linearized < 6.0, "{unmixed} %, {linearized} %");
}

#[test]
fn a_run_and_its_replay_are_the_same_bits() {
    let bench = Bench::new();
    bench.simulate("beads", &beads(VIEW), "100");
    bench.calibrate("beads", "beads", "registration.toml");
    let (scene, instrument, plan) = (bench.path("scene.toml"), bench.path("i.toml"), bench.path("plan.yaml"));
    fs::write(&scene, larger("figure-s4", VIEW)).unwrap();
    let simulated =
        fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/simulated.toml")).unwrap();
    let simulated = simulated.replace("\"figure-s4\"", &format!("{:?}", text(&scene)));
    fs::write(&instrument, simulated.replace("speed = 1.0", "speed = 0.0")).unwrap();
    let registration = bench.path("registration.toml");
    let plan_text = format!(
        "time_plan: {{interval: 0, loops: 200}}\nkeep_shutter_open_across: [t]\nmetadata:\n  sofiscope:\n    \
         version: 1\n    cameras: {{exposure_ms: 20.0, period_ms: 20.0}}\n    analysis:\n      \
         subsequence_exposures: 100\n      registration_file: {:?}\n",
        text(&registration)
    );
    fs::write(&plan, plan_text).unwrap();
    let out = bench.path("run");
    said(&["run", text(&plan), "--instrument", text(&instrument), "--out", text(&out)]);
    let report = fs::read_to_string(out.join("results/report.json")).unwrap();
    let report: Value = serde_json::from_str(&report).unwrap();
    let used = report["settings"]["registration"].as_str().unwrap();
    // The way from T to R undoes the view: turned by 0.3 degrees and scaled by 1.002.
    assert!(used.starts_with("mirror horizontal, shift ("), "{used}");
    assert!(used.ends_with("rotation -0.300 degrees, scale 0.9980; unbiased-sinc"), "{used}");
    // The recording keeps the registration; the file may go.
    fs::remove_file(&registration).unwrap();
    said(&["replay", text(&out), "--verify", "--out", text(&bench.path("again"))]);
}

#[test]
fn a_registration_of_another_size_is_refused() {
    let bench = Bench::new();
    bench.simulate("beads", &beads(VIEW), "20");
    bench.calibrate("beads", "beads", "registration.toml");
    bench.simulate("small", &shipped("figure-s4"), "20");
    let ([r, t], file) = (bench.stacks("small"), bench.path("registration.toml"));
    let out = bench.path("result");
    let arguments = ["analyze", text(&r), text(&t), "--registration", text(&file), "--out", text(&out)];
    let output = sofiscope(&arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("160 x 160") && message.contains("72 x 72"), "{message}");
}
