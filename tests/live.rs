//! Runs of the simulated microscope, their recordings, and the same bits again by replay and by analysis.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

const EXPOSURES: u64 = 1030;
const RESULTS: [&str; 6] = ["mean", "variance", "cumulants", "unmixed", "flattened", "linearized"];

/// The simulated microscope with cameras that lose, delay, double and damage frames, as fast as frames are taken.
fn instrument(folder: &Path, faults: &str) -> PathBuf {
    let text = fs::read_to_string("config/simulated.toml").unwrap().replace("speed = 1.0", "speed = 0.0");
    let path = folder.join("instrument.toml");
    fs::write(&path, format!("{text}\n{faults}")).unwrap();
    path
}

const FAULTS: &str = "
[faults]
drop_one_in = 61
reorder_within = 8
duplicate_one_in = 100
incomplete_one_in = 200
[faults.transmitted]
missed_trigger_at = [500]
";

fn plan(folder: &Path, recording: &str, more: &str) -> PathBuf {
    let path = folder.join("plan.yaml");
    let text = format!(
        "time_plan: {{interval: 0, loops: {EXPOSURES}}}
metadata:
  sofiscope:
    version: 1
    cameras: {{exposure_ms: 20.0, period_ms: 20.0}}
    analysis: {{order: 2, subsequence_exposures: 200}}
    recording: {recording}
{more}"
    );
    fs::write(&path, text).unwrap();
    path
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn sofiscope(arguments: &[&str], threads: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sofiscope"));
    command.args(arguments).env("RAYON_NUM_THREADS", threads).stdin(Stdio::null()).output().unwrap()
}

/// The object that a command ends with.
fn ended(output: &Output) -> Value {
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {said}"))
}

/// A faulty run recorded in a format.
fn recorded(folder: &TempDir, format: &str) -> (PathBuf, Value) {
    let out = folder.path().join("run");
    let (plan, instrument) = (plan(folder.path(), format, ""), instrument(folder.path(), FAULTS));
    let arguments = ["run", text(&plan), "--instrument", text(&instrument), "--out", text(&out), "--json"];
    let ended = ended(&sofiscope(&arguments, "2"));
    (out, ended)
}

fn assert_same_results(one: &Path, other: &Path) {
    for name in RESULTS {
        let file = format!("{name}.ome.tif");
        assert!(fs::read(one.join(&file)).unwrap() == fs::read(other.join(&file)).unwrap(), "{file} differs");
    }
}

#[test]
fn live_replayed_and_offline_results_are_the_same_bits() {
    for format in ["ome-tiff", "ome-zarr"] {
        let folder = tempfile::tempdir().unwrap();
        let (run, ended_live) = recorded(&folder, format);
        let lost: u64 =
            ended_live["frames_lost"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum();
        assert!(lost > 20, "{format}: the cameras are unkind, and {lost} frames were lost");
        assert_eq!(ended_live["frames_received"].as_u64().unwrap() + lost, 2 * EXPOSURES);
        assert_eq!(ended_live["frames_recorded"], ended_live["frames_received"]);
        for threads in ["1", "2", "3"] {
            let out = folder.path().join(format!("replay-{threads}"));
            let arguments = ["replay", text(&run), "--verify", "--json", "--out", text(&out)];
            let replayed = ended(&sofiscope(&arguments, threads));
            assert_eq!(replayed["verified"], true, "{format}, {threads} threads");
            assert_eq!(replayed["pairs_analyzed"], ended_live["pairs_analyzed"]);
            assert_same_results(&run.join("results"), &out);
        }
        let out = folder.path().join("analyzed");
        let output = sofiscope(&["analyze", text(&run), "--json", "--out", text(&out)], "2");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_same_results(&run.join("results"), &out);
    }
}

#[test]
fn a_changed_frame_is_found_by_verify() {
    let folder = tempfile::tempdir().unwrap();
    let (run, _) = recorded(&folder, "ome-tiff");
    let path = run.join("reflection.ome.tif");
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 512].iter_mut().for_each(|byte| *byte ^= 1);
    fs::write(&path, bytes).unwrap();
    let out = folder.path().join("replay");
    let output = sofiscope(&["replay", text(&run), "--verify", "--out", text(&out)], "2");
    assert_eq!(output.status.code(), Some(4), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn an_export_replays_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let (run, _) = recorded(&folder, "ome-tiff");
    let zarr = folder.path().join("zarr");
    let arguments = ["export", text(&run), "--format", "ome-zarr", "--out", text(&zarr)];
    assert!(sofiscope(&arguments, "2").status.success());
    let out = folder.path().join("replay");
    let output = sofiscope(&["replay", text(&zarr), "--speed", "max", "--out", text(&out), "--json"], "2");
    assert_eq!(ended(&output)["simulated"], true);
    assert_same_results(&run.join("results"), &out);
}

#[test]
fn a_dry_run_checks_and_touches_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let (plan, instrument) = (plan(folder.path(), "ome-tiff", ""), instrument(folder.path(), ""));
    let arguments =
        ["run", text(&plan), "--instrument", text(&instrument), "--out", text(&out), "--dry-run", "--json"];
    let told = ended(&sofiscope(&arguments, "2"));
    assert_eq!(
        (told["may_begin"].as_bool(), told["exposures_per_series"].as_u64()),
        (Some(true), Some(EXPOSURES))
    );
    assert!(!out.exists());
}

#[test]
fn a_stop_rule_ends_a_run_early_and_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let plan = plan(folder.path(), "none", "    stop: {snr: 4.0}\n");
    // So many that the cameras, which wait for nobody here, cannot have made all before the rule is looked at.
    let many = fs::read_to_string(&plan).unwrap().replace(&format!("loops: {EXPOSURES}"), "loops: 40000");
    fs::write(&plan, many).unwrap();
    let instrument = instrument(folder.path(), "");
    let arguments = ["run", text(&plan), "--instrument", text(&instrument), "--out", text(&out), "--json"];
    let ended = ended(&sofiscope(&arguments, "2"));
    assert!(ended["ended"].as_str().unwrap().contains("signal-to-noise"), "{ended}");
    assert!(ended["pairs"].as_u64().unwrap() < 40_000, "{ended}");
    assert!(ended["recording"].is_null());
}

#[test]
fn a_camera_that_dies_fails_the_run_and_keeps_what_came_before() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let plan = plan(folder.path(), "ome-tiff", "");
    let instrument = instrument(folder.path(), "[faults.transmitted]\ndie_at = 700\n");
    let arguments = ["run", text(&plan), "--instrument", text(&instrument), "--out", text(&out), "--json"];
    let output = sofiscope(&arguments, "2");
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let ended: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(ended["frames_recorded"].as_u64().unwrap() >= 1400, "{ended}");
    let events = fs::read_to_string(out.join("events.jsonl")).unwrap();
    assert_eq!(events.lines().filter(|line| line.contains("\"stop\"")).count(), 1, "{events}");
    assert!(events.contains("\"fail\""), "{events}");
}

#[test]
fn foreign_stacks_replay_like_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let frames = folder.path().join("frames");
    let arguments = ["simulate", "figure-s4", "--frames", "400", "--out", text(&frames)];
    assert!(sofiscope(&arguments, "2").status.success());
    let (r, t) = (frames.join("reflection.ome.tif"), frames.join("transmission.ome.tif"));
    let dyes = ["--species", "Alexa Fluor 488,Atto 565,Alexa Fluor 647", "--dichroic", "zt 594 RDC"];
    let (replayed, analyzed) = (folder.path().join("replayed"), folder.path().join("analyzed"));
    let mut arguments = vec!["replay", text(&r), text(&t), "--speed", "max", "--out", text(&replayed)];
    arguments.extend(dyes);
    let output = sofiscope(&arguments, "2");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut arguments = vec!["analyze", text(&r), text(&t), "--out", text(&analyzed)];
    arguments.extend(dyes);
    assert!(sofiscope(&arguments, "2").status.success());
    assert_same_results(&replayed, &analyzed);
}
