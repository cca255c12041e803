//! The program at work in a folder of its own.

use serde_json::Value;
use sofiscope::files::ImageStack;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// Result files that hold numbers.
pub(crate) const RESULTS: [&str; 6] = ["mean", "variance", "cumulants", "unmixed", "flattened", "linearized"];

pub(crate) struct Bench {
    folder: TempDir,
}

pub(crate) fn sofiscope(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sofiscope")).args(arguments).output().unwrap()
}

/// What the program says on stdout and on stderr; it must succeed.
pub(crate) fn said(arguments: &[&str]) -> [String; 2] {
    let output = sofiscope(arguments);
    let [out, err] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
    assert!(output.status.success(), "{arguments:?}: {err}");
    [out, err]
}

/// What the program says as JSON.
pub(crate) fn told(arguments: &[&str]) -> Value {
    serde_json::from_str(&said(&[arguments, &["--json"]].concat())[0]).unwrap()
}

pub(crate) fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The text of a scene that ships.
pub(crate) fn shipped(scene: &str) -> String {
    let path = format!("{}/config/scenes/{scene}.toml", env!("CARGO_MANIFEST_DIR"));
    fs::read_to_string(path).unwrap()
}

/// A scene of only one of its species.
pub(crate) fn single_stained(scene: &str, species: usize) -> String {
    let mut parts = scene.split("\n[[species]]");
    let head = parts.next().unwrap();
    format!("{head}\n[[species]]{}", parts.nth(species).unwrap())
}

/// A scene with tables of its cameras before its sample.
pub(crate) fn with_cameras(scene: &str, tables: &str) -> String {
    scene.replacen("\n[[species]]", &format!("\n{tables}\n[[species]]"), 1)
}

/// Even light on cameras of this side with these tables.
pub(crate) fn flat(side: usize, tables: &str) -> String {
    let scene = shipped("flat").replace("_px = 128", &format!("_px = {side}"));
    let (before, _) = scene.rsplit_once("\n[camera.pixels]\n").unwrap();
    format!("{before}\n{tables}")
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, text).unwrap();
        path
    }

    /// Simulates the text of a scene into the folder `name`.
    pub(crate) fn simulate(&self, name: &str, scene: &str, more: &[&str]) -> PathBuf {
        let (file, out) = (self.write(&format!("{name}.toml"), scene), self.path(name));
        said(&[&["simulate", text(&file), "--out", text(&out)], more].concat());
        out
    }

    /// Darks and flats of two cameras, and maps of both from them.
    pub(crate) fn camera_maps(&self, flat: &str, frames: &str) -> [PathBuf; 2] {
        let dark = self.simulate("dark", flat, &["--background", "0", "--seed", "101", "--frames", frames]);
        let levels = ["300", "1000", "3000"].map(|photons| {
            let more = ["--background", photons, "--seed", photons, "--frames", frames];
            self.simulate(&format!("flat-{photons}"), flat, &more)
        });
        ["reflected", "transmitted"].map(|camera| {
            let out = self.path(&format!("{camera}.toml"));
            let mut arguments = vec!["calibrate", "camera", "--dark", text(&dark), "--camera", camera];
            levels.iter().for_each(|level| arguments.extend(["--flat", text(level)]));
            told(&[&arguments[..], &["--out", text(&out)]].concat());
            out
        })
    }

    /// Analyzes a simulated folder into another; gives what was said on stderr.
    pub(crate) fn analyze(&self, measured: &str, result: &str, more: &[&str]) -> String {
        let [r, t] = ["reflection", "transmission"].map(|c| self.path(measured).join(format!("{c}.ome.tif")));
        let out = self.path(result);
        let arguments = ["analyze", text(&r), text(&t), "--subsequence", "100", "--out", text(&out)];
        let [_, err] = said(&[&arguments[..], more].concat());
        err
    }

    /// The worst crosstalk unmixed and linearized, percent.
    pub(crate) fn worst(&self, result: &str, truth: &str) -> [f64; 2] {
        let [result, truth] = [result, truth].map(|name| self.path(name));
        let score = told(&["score", text(&result), "--truth", text(&truth)]);
        ["unmixed", "linearized"].map(|stage| score["worst_crosstalk_percent"][stage].as_f64().unwrap().abs())
    }
}

/// All pixels of all pages of a file.
pub(crate) fn pixels(path: &Path) -> Vec<f32> {
    let mut stack = ImageStack::open(path).unwrap();
    let info = stack.info().clone();
    let mut all = Vec::new();
    for channel in 0..info.channels {
        stack.select_channel(channel).unwrap();
        stack.seek(0).unwrap();
        let mut page = vec![0.0; info.height * info.width];
        stack.read_values(&mut page).unwrap();
        all.extend(page);
    }
    all
}

/// Whether two folders of results have the same bits, and how many values of them are missing.
pub(crate) fn assert_same_bits(a: &Path, b: &Path) -> usize {
    let mut missing = 0;
    for name in RESULTS {
        let [a, b] = [a, b].map(|folder| pixels(&folder.join(format!("{name}.ome.tif"))));
        assert_eq!(a.len(), b.len(), "{name}");
        let unequal = a.iter().zip(&b).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
        assert_eq!(unequal, 0, "{name}");
        missing += a.iter().filter(|value| value.is_nan()).count();
    }
    missing
}
