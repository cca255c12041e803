//! The whole chain against the simulated truth: dyes must not leak into each other's images.
//!
//! Bounds lie well above what the chain reaches and below what it reaches with one step left out.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use sofiscope::files::{ImageStack, StackHeader, StackInfo, StackWriter};
use tempfile::TempDir;

/// Camera T of the simulation, and the dichroic of both scenes.
const T: &str = "truth/transmission.ome.tif";
const DICHROIC: &str = "zt 594 RDC";

/// A scene, its dyes in the order of the truth, and the most crosstalk allowed, percent.
struct Case {
    scene: &'static str,
    dyes: &'static str,
    flattened: f64,
    linearized: f64,
}

const S4: Case = Case {
    scene: "figure-s4",
    dyes: "Alexa Fluor 488,Atto 565,Alexa Fluor 647",
    flattened: 0.5,
    linearized: 4.0,
};

const S10: Case = Case {
    scene: "figure-s10",
    dyes: "Alexa Fluor 568,Abberior Flip 565,Atto 565",
    flattened: 1.5,
    linearized: 11.0,
};

impl Case {
    /// Simulates the scene into a new folder.
    fn simulated(&self) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("truth");
        said(&["simulate", self.scene, "--frames", "1500", "--seed", "1", "--out", text(&out)]);
        folder
    }

    /// Analyzes R and T of `folder` into `folder/result`.
    fn analyze(&self, folder: &TempDir, t: &str, dichroic: &str, more: &[&str]) {
        let [result, r, t] = ["result", "truth/reflection.ome.tif", t].map(|name| folder.path().join(name));
        let analyze = ["analyze", text(&r), text(&t), "--species", self.dyes, "--dichroic", dichroic];
        said(&[&analyze[..], more, &["--subsequence", "150", "--out", text(&result)]].concat());
    }

    /// The worst crosstalk of the flattened and of the linearized images in `folder/result`, percent;
    /// infinite where a dye is not even brighter than the background.
    fn worst(&self, folder: &TempDir) -> [f64; 2] {
        let [result, truth] = ["result", "truth"].map(|name| folder.path().join(name));
        let output = sofiscope(&["score", text(&result), "--truth", text(&truth), "--json"]);
        let score: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        let worst = ["flattened", "linearized"]
            .map(|stage| score["worst_crosstalk_percent"][stage].as_f64().map_or(f64::INFINITY, f64::abs));
        println!("{}: flattened {:.2} %, linearized {:.2} %", self.scene, worst[0], worst[1]);
        worst
    }

    fn check(&self) {
        let folder = self.simulated();
        self.analyze(&folder, T, DICHROIC, &[]);
        let [flattened, linearized] = self.worst(&folder);
        assert!(flattened <= self.flattened, "flattened: {flattened} %");
        assert!(linearized <= self.linearized, "linearized: {linearized} %");
    }
}

fn sofiscope(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sofiscope")).args(arguments).output().unwrap()
}

fn said(arguments: &[&str]) {
    let output = sofiscope(arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Writes camera T without its first frame, and with its last one twice.
fn write_late(folder: &TempDir) {
    let mut stack = ImageStack::open(&folder.path().join(T)).unwrap();
    let StackInfo { frames, height, width, .. } = *stack.info();
    let header = StackHeader { frames, height, width, ..StackHeader::default() };
    let mut writer = StackWriter::create(&folder.path().join("late.ome.tif"), &header).unwrap();
    let mut counts = vec![0; height * width];
    for frame in 0..frames {
        stack.seek((frame + 1).min(frames - 1)).unwrap();
        stack.read_counts(&mut counts).unwrap();
        writer.push(&counts).unwrap();
    }
    writer.finish().unwrap();
}

/// How far the means of the sub-grids of one image lie apart, as a share of the smallest.
fn spread(values: &[f32], width: usize) -> f64 {
    let mean = |p: usize, q: usize| {
        let of_grid = values
            .iter()
            .enumerate()
            .filter(|(pixel, value)| pixel / width % 2 == p && pixel % 2 == q && value.is_finite())
            .map(|(_, &value)| f64::from(value));
        let (sum, count) = of_grid.fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
        sum / f64::from(count)
    };
    let means = [mean(0, 0), mean(0, 1), mean(1, 0), mean(1, 1)];
    let extreme = |choose: fn(f64, f64) -> f64| means.into_iter().reduce(choose).unwrap();
    extreme(f64::max) / extreme(f64::min) - 1.0
}

/// The spread of each dye's image at one stage.
fn spreads(folder: &TempDir, stage: &str) -> Vec<f64> {
    let mut stack = ImageStack::open(&folder.path().join(format!("result/{stage}.ome.tif"))).unwrap();
    let StackInfo { channels, height, width, .. } = *stack.info();
    let mut values = vec![0.0; height * width];
    let mut of_channel = |channel| {
        stack.select_channel(channel).unwrap();
        stack.seek(0).unwrap();
        stack.read_values(&mut values).unwrap();
        spread(&values, width)
    };
    (0..channels).map(&mut of_channel).collect()
}

#[test]
fn dyes_far_apart_do_not_leak_into_each_other() {
    S4.check();
}

#[test]
fn dyes_ten_nanometers_apart_hardly_leak_into_each_other() {
    S10.check();
}

#[test]
fn broken_steps_are_caught_by_these_bounds() {
    let folder = S4.simulated();
    write_late(&folder);
    for (step, t, dichroic, more) in [
        ("pairing: T is one exposure late", "late.ome.tif", DICHROIC, &[][..]),
        ("unmixing: another dichroic", T, "HC BS 640", &[]),
        ("linearization: a point-spread function twice as wide", T, DICHROIC, &["--psf-sigma", "2.5"]),
    ] {
        S4.analyze(&folder, t, dichroic, more);
        let [flattened, linearized] = S4.worst(&folder);
        assert!(flattened > S4.flattened || linearized > S4.linearized, "{step}");
        fs::remove_dir_all(folder.path().join("result")).unwrap();
    }
}

#[test]
fn flattening_makes_the_sub_grids_equal() {
    let folder = S4.simulated();
    S4.analyze(&folder, T, DICHROIC, &[]);
    let [before, after] = ["unmixed", "flattened"].map(|stage| spreads(&folder, stage));
    println!("{before:?} {after:?}");
    assert!(before.iter().all(|&spread| spread > 0.5), "{before:?}");
    assert!(after.iter().all(|&spread| spread < 0.01), "{after:?}");
}
