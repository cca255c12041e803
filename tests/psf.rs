//! The width of the point-spread function: from the optics, the data or beads, and what each of them is worth.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

const DYES: &str = "Alexa Fluor 488,Atto 565,Alexa Fluor 647";
const EMISSIONS_NM: [f64; 3] = [520.0, 592.0, 668.0];
const PITCH_NM: f64 = 108.0;

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

/// What the lens of the scenes makes of an emission, camera pixels.
fn optics_px(emission_nm: f64) -> f64 {
    0.21 * emission_nm / 1.27 / PITCH_NM
}

/// The same once pixels have integrated it.
fn seen_px(emission_nm: f64) -> f64 {
    (optics_px(emission_nm).powi(2) + 1.0 / 12.0).sqrt()
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

    /// Simulates a scene into `name`.
    fn simulate(&self, name: &str, scene: &str, frames: &str) -> [PathBuf; 2] {
        let out = self.path(name);
        said(&["simulate", scene, "--seed", "2", "--frames", frames, "--out", text(&out)]);
        ["reflection", "transmission"].map(|camera| out.join(format!("{camera}.ome.tif")))
    }

    /// Simulates the three dyes of Figure S4 with one line of the scene changed.
    fn simulate_changed(&self, name: &str, key: &str, line: &str, frames: &str) -> [PathBuf; 2] {
        let scene = fs::read_to_string(in_repository("config/scenes/figure-s4.toml")).unwrap();
        let changed = |old: &str| if old.starts_with(key) { line.to_owned() } else { old.to_owned() };
        let scene: Vec<String> = scene.lines().map(changed).collect();
        let file = self.path(&format!("{name}.toml"));
        fs::write(&file, scene.join("\n")).unwrap();
        self.simulate(name, text(&file), frames)
    }

    /// Analyzes into `name`.
    fn analyze(&self, name: &str, [r, t]: &[PathBuf; 2], more: &[&str]) -> PathBuf {
        let result = self.path(name);
        let analyze = ["analyze", text(r), text(t), "--species", DYES, "--dichroic", "zt 594 RDC"];
        said(&[&analyze[..], more, &["--out", text(&result)]].concat());
        result
    }

    /// Largest crosstalk of the linearized images, percent.
    fn crosstalk(&self, result: &Path, truth: &str) -> f64 {
        let score = said(&["score", text(result), "--truth", text(&self.path(truth)), "--json"]);
        let score: Value = serde_json::from_str(&score).unwrap();
        score["worst_crosstalk_percent"]["linearized"].as_f64().unwrap().abs()
    }
}

fn in_repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn report(result: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(result.join("report.json")).unwrap()).unwrap()
}

fn warnings(result: &Path) -> Vec<String> {
    serde_json::from_value(report(result)["warnings"].clone()).unwrap()
}

fn entries(result: &Path, begin: &str) -> Vec<(String, String)> {
    let report = report(result);
    let all = report["settings"]["other"].as_array().unwrap().iter();
    let words = all.map(|entry| [0, 1].map(|place| entry[place].as_str().unwrap().to_owned()));
    words.filter(|[name, _]| name.starts_with(begin)).map(|[name, value]| (name, value)).collect()
}

/// The entries "PSF sigma of ...", each "0.859 px (source)".
fn widths(result: &Path) -> Vec<(f64, String)> {
    let width = |(_, value): (String, String)| {
        let (sigma, source) = value.split_once(" px (").unwrap();
        (sigma.parse().unwrap(), source.strip_suffix(')').unwrap().to_owned())
    };
    let widths: Vec<(f64, String)> = entries(result, "PSF sigma of ").into_iter().map(width).collect();
    let first = &report(result)["settings"]["psf"];
    assert!((first["sigma_px"].as_f64().unwrap() - widths[0].0).abs() < 1e-3);
    assert_eq!(first["source"], widths[0].1);
    widths
}

/// The entries "measured PSF sigma of ...", each "0.859 px, standard error 0.004 px (...)".
fn measured(result: &Path) -> Vec<(f64, f64)> {
    let number = |text: &str| text.split_once(" px").unwrap().0.parse::<f64>().unwrap();
    let entries = entries(result, "measured PSF sigma of ");
    let width = |(_, value): &(String, String)| {
        (number(value), number(value.split_once("standard error ").unwrap().1))
    };
    entries.iter().map(width).collect()
}

/// Factors that the sub-grids of each species were multiplied by, row by row.
fn sub_grid_factors(result: &Path) -> Vec<Vec<f64>> {
    let report = report(result);
    let species = report["species"].as_array().unwrap().iter();
    species
        .map(|one| serde_json::from_value(one["flattening"]["sub_grid_factors"].clone()).unwrap())
        .collect()
}

#[test]
fn the_sub_grids_of_the_data_show_the_widths_of_the_lens() {
    let bench = Bench::new();
    let stacks = bench.simulate("s4", "figure-s4", "2000");
    let by_default = bench.analyze("default", &stacks, &[]);
    for ((sigma_px, error_px), emission_nm) in measured(&by_default).into_iter().zip(EMISSIONS_NM) {
        let off = sigma_px / optics_px(emission_nm) - 1.0;
        println!("{emission_nm} nm: {sigma_px} px, {:+.2} %, standard error {error_px} px", 100.0 * off);
        assert!(off.abs() < 0.015, "{sigma_px} px for {emission_nm} nm, {:+.1} %", 100.0 * off);
        // The pixels' deviation from a Gaussian comes on top of the noise.
        let allowed = 4.0 * error_px + 0.005 * sigma_px;
        assert!((sigma_px - optics_px(emission_nm)).abs() < allowed, "{sigma_px} +- {error_px} px");
        assert!(error_px < 0.02 * sigma_px, "{error_px} px");
    }
    assert!(!warnings(&by_default).iter().any(|warning| warning.contains("point-spread")));
    // The optics are the default, the data where they are asked for.
    for ((sigma_px, source), emission_nm) in widths(&by_default).into_iter().zip(EMISSIONS_NM) {
        assert_eq!(source, format!("NA 1.27, {emission_nm} nm emission"));
        assert!((sigma_px - optics_px(emission_nm)).abs() < 1e-3);
    }
    let chosen = bench.analyze("measured", &stacks, &["--psf", "measured"]);
    for ((sigma_px, source), (expected, _)) in widths(&chosen).into_iter().zip(measured(&by_default)) {
        assert!(source.starts_with("measured from sub-grid ratios, ") && source.contains("standard error"));
        assert!((sigma_px - expected).abs() < 2e-3, "{sigma_px} {expected}");
    }
    // Where the optics are known, nothing is gained or lost.
    let [optics, data] = [&by_default, &chosen].map(|result| bench.crosstalk(result, "s4"));
    println!("crosstalk {optics:.3} % with the optics, {data:.3} % measured");
    assert!((data - optics).abs() < 0.05, "{data} % for {optics} %");
    let given = bench.analyze("given", &stacks, &["--psf-sigma", "1.1", "--psf", "measured"]);
    assert!(widths(&given).iter().all(|width| *width == (1.1, "given".to_owned())));
    let [r, t] = &stacks;
    let output =
        sofiscope(&["analyze", text(r), text(t), "--psf", "guess", "--out", text(&bench.path("no"))]);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(error.contains("psf = \"guess\"") && error.contains("optics, measured"), "{error}");
}

#[test]
fn optics_that_are_not_those_of_the_data_are_told_and_the_true_width_can_be_had() {
    let bench = Bench::new();
    // The analysis believes in an aperture of 1.27.
    let stacks = bench.simulate_changed("wide", "numerical_aperture", "numerical_aperture = 1.0", "2000");
    let by_default = bench.analyze("default", &stacks, &[]);
    let told = warnings(&by_default).iter().filter(|warning| warning.contains("--psf measured")).count();
    assert_eq!(told, 3, "{:?}", warnings(&by_default));
    let chosen = bench.analyze("measured", &stacks, &["--psf", "measured"]);
    assert!(!warnings(&chosen).iter().any(|warning| warning.contains("--psf measured")));
    for ((sigma_px, _), emission_nm) in widths(&chosen).into_iter().zip(EMISSIONS_NM) {
        let truth = 0.21 * emission_nm / PITCH_NM;
        assert!((sigma_px / truth - 1.0).abs() < 0.02, "{sigma_px} px for {truth} px");
    }
}

#[test]
fn distance_factors_are_those_of_what_the_pixels_see() {
    let bench = Bench::new();
    let stacks = bench.simulate("s4", "figure-s4", "2000");
    let settings = bench.path("settings.toml");
    fs::write(&settings, "flattening = \"distance-factor\"\n").unwrap();
    let result = bench.analyze("factors", &stacks, &["--settings", text(&settings)]);
    for (factors, emission_nm) in sub_grid_factors(&result).into_iter().zip(EMISSIONS_NM) {
        for (factor, distance) in factors.into_iter().zip([4.0, 1.0, 1.0, 2.0]) {
            let expected = (distance / (4.0 * seen_px(emission_nm).powi(2))).exp();
            assert!((factor / expected - 1.0).abs() < 1e-6, "{factor} for {expected}");
        }
    }
    // Equal means find nearly the same in the data; the lens alone would be 5 to 15 % further off.
    let means = bench.analyze("means", &stacks, &[]);
    for (by_distance, by_mean) in sub_grid_factors(&result).into_iter().zip(sub_grid_factors(&means)) {
        let off = by_distance[1] / by_distance[0] / (by_mean[1] / by_mean[0]) - 1.0;
        println!("{:+.2} %", 100.0 * off);
        assert!(off.abs() < 0.06, "{off}");
    }
}

#[test]
fn beads_give_the_widths_of_both_cameras_with_their_registration() {
    let bench = Bench::new();
    let [r, t] = bench.simulate("beads", "beads", "100");
    let calibrated = |out: &str, more: &[&str]| -> Value {
        let out = bench.path(out);
        let calibrate = ["calibrate", "registration", text(&r), text(&t), "--json", "--out", text(&out)];
        serde_json::from_str(&said(&[&calibrate[..], more].concat())).unwrap()
    };
    let told = calibrated("registration.toml", &[]);
    let widths: Vec<f64> = serde_json::from_value(told["psf_sigma_px"].clone()).unwrap();
    println!("{widths:?} for {:.4} px", seen_px(580.0));
    for width in &widths {
        // T is seen through an optics that magnifies by 1.004 less.
        assert!((width / seen_px(580.0) - 1.0).abs() < 0.02, "{widths:?}");
    }
    assert!(fs::read_to_string(bench.path("registration.toml")).unwrap().contains("psf_sigma_px = ["));
    let points = calibrated("points.toml", &["--bead-nm", "0"])["psf_sigma_px"].clone();
    let points: Vec<f64> = serde_json::from_value(points).unwrap();
    let size = points[0] * points[0] - widths[0] * widths[0];
    assert!((size - (200.0 / PITCH_NM).powi(2) / 20.0).abs() < 1e-9, "{size}");
    let output = sofiscope(&["calibrate", "registration", text(&r), text(&t), "--bead-nm", "-1"]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn frames_too_few_to_tell_take_the_width_from_beads_and_without_them_from_the_optics() {
    let bench = Bench::new();
    let stacks = bench.simulate_changed("dim", "i_on_photons", "i_on_photons = 5.0", "20");
    let result = bench.analyze("optics", &stacks, &["--psf", "measured"]);
    for (_, source) in widths(&result) {
        assert!(source.starts_with("NA 1.27, "), "{source}");
    }
    assert!(
        entries(&result, "measured PSF sigma of ").iter().all(|(_, value)| value.starts_with("not clear"))
    );
    let registration = bench.path("registration.toml");
    let identity = "registration_version = 1\nmethod = \"beads\"\ndate = \"2026-01-02\"\nheight_px = 72\nwidth_px = 72\n\
                    pixel_pitch_nm = 108.0\nmirror = \"none\"\nmatrix_y = [1.0, 0.0]\nmatrix_x = [0.0, 1.0]\n\
                    shift_px = [0.0, 0.0]\nresidual_px = 0.01\npoints_left_out = 0\npsf_sigma_px = [0.9, 1.05]\n\
                    [transmitted_noise]\nslope_counts = 2.174\nat_zero_counts2 = -208.0\n";
    fs::write(&registration, identity).unwrap();
    let result =
        bench.analyze("beads", &stacks, &["--psf", "measured", "--registration", text(&registration)]);
    for ((sigma_px, source), transmission) in widths(&result).iter().zip([0.02, 0.35, 0.98]) {
        assert!(source.starts_with("measured from beads of the registration, "), "{source}");
        let seen = (1.0 - transmission) * 0.81 + transmission * 1.05 * 1.05_f64;
        let expected = (seen - 1.0 / 12.0).sqrt();
        assert!((sigma_px - expected).abs() < 1e-3, "{sigma_px} for {expected}");
    }
}

#[test]
fn a_run_and_its_replay_measure_the_same_width_and_make_the_same_images() {
    let bench = Bench::new();
    let (plan, instrument) = (bench.path("plan.yaml"), bench.path("instrument.toml"));
    let simulated = fs::read_to_string(in_repository("config/simulated.toml")).unwrap();
    fs::write(&instrument, simulated.replace("speed = 1.0", "speed = 0.0")).unwrap();
    fs::write(
        &plan,
        "time_plan: {interval: 0, loops: 600}\nmetadata:\n  sofiscope:\n    version: 1\n    cameras: {exposure_ms: 20.0, \
         period_ms: 20.0}\n    analysis: {order: 2, subsequence_exposures: 200, psf: measured}\n    recording: ome-tiff\n",
    )
    .unwrap();
    let out = bench.path("run");
    said(&["run", text(&plan), "--instrument", text(&instrument), "--out", text(&out), "--json"]);
    let live = out.join("results");
    println!("{:?}", widths(&live));
    assert!(widths(&live).iter().any(|(_, source)| source.starts_with("measured from ")));
    let replayed = bench.path("replayed");
    said(&["replay", text(&out), "--speed", "max", "--out", text(&replayed), "--json"]);
    assert_eq!(widths(&replayed), widths(&live));
    assert_eq!(measured(&replayed), measured(&live));
    let image = |result: &Path| fs::read(result.join("linearized.ome.tif")).unwrap();
    assert!(image(&replayed) == image(&live), "linearized images differ");
}
