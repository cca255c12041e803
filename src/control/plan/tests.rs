//! Plans are read, refused and written back.

use super::*;
use proptest::prelude::*;

const PAPER: &str = include_str!("../../../config/plans/paper-three-color.yaml");
const QUICK: &str = include_str!("../../../config/plans/quick-look.yaml");

fn faults(text: &str) -> Vec<String> {
    let error = Plan::from_text(text).unwrap_err();
    error.faults.iter().map(ToString::to_string).collect()
}

fn expect(text: &str, parts: &[&str]) {
    let found = faults(text);
    for part in parts {
        assert!(found.iter().any(|fault| fault.contains(part)), "{part}: {found:#?}");
    }
    assert_eq!(found.len(), parts.len(), "{found:#?}");
}

#[test]
fn the_shipped_plans_are_without_faults() {
    let paper = Plan::from_text(PAPER).unwrap();
    assert_eq!(paper.loops(), Some(4000));
    assert_eq!(paper.duration(), Some(Duration::from_secs(80)));
    assert_eq!(paper.analysis().subsequence_exposures, Some(200));
    assert_eq!(paper.recording(), RecordingFormat::OmeTiff);
    let quick = Plan::from_text(QUICK).unwrap();
    assert_eq!((quick.loops(), quick.exposures_per_series()), (None, Some(1000)));
    assert_eq!(quick.events().count(), 1);
}

#[test]
fn written_plans_read_as_the_same_plan() {
    let rich = PAPER.replace("axis_order: ptc", "uid: abc\naxis_order: [p, t, c]\nstage_positions: [[1, 2, 3], {name: cell, x: 4, y: 5.5}]\nchannels: [Cy5]")
        .replace("recording: ome-tiff", "recording: ome-zarr\n    laser_power_mw: {488: 5.0, 638: 12}\n    dose_limit_mj: 5000\n    stop: {frames: 3000, seconds: 70, snr: 4, resolution_nm: 110}")
        .replace("exposure_ms: 20.0", "exposure_ms: 19.5\n      trigger: external\n      accept_readback: true\n      region: {left: 8, top: 16, width: 64, height: 32}\n      transmitted: {region: {width: 64, height: 32}}")
        .replace("metadata:\n", "metadata:\n  lab: {mood: good}\n");
    for text in [PAPER, QUICK, &rich] {
        let plan = Plan::from_text(text).unwrap();
        assert_eq!(Plan::from_text(&plan.to_yaml()).unwrap(), plan, "{}", plan.to_yaml());
        assert_eq!(Plan::from_text(&plan.to_json().to_string()).unwrap(), plan);
    }
    let plan = Plan::from_text(&rich).unwrap();
    assert_eq!(plan.metadata()["lab"]["mood"], "good");
    assert_eq!(plan.events().count(), 2);
    assert_eq!(plan.events().nth(1).unwrap().position.unwrap().name.as_deref(), Some("cell"));
    assert_eq!(plan.region(Channel::Transmitted).unwrap().left, 0);
    assert_eq!(plan.dose_per_series_mj().unwrap(), 17.0 * 60.0);
    assert_eq!(plan.duration(), Some(Duration::from_secs(120)));
}

#[test]
fn fields_that_are_not_supported_are_refused_by_name_all_at_once() {
    let text = format!(
        "{PAPER}z_plan: {{range: 4, step: 1}}\nautofocus_plan: {{axes: [t]}}\ngrid_plan: {{rows: 2}}\nchannels: [A, B]\nstage_positions: [{{x: 1, y: 2, sequence: {{}}}}, {{x: 1, y: 2, sequence: {{z_plan: 1}}}}]\nsetup: {{properties: [[a, b, c]]}}\n"
    );
    expect(
        &text,
        &[
            "`z_plan` is not supported yet: the focus",
            "`autofocus_plan` is not supported yet: write `focus_lock: hold`",
            "`grid_plan` is not supported yet",
            "`channels[1]` is not supported yet: all dyes",
            "`stage_positions[1].sequence` is not supported yet",
            "`setup.properties` is not supported yet",
        ],
    );
    assert!(faults(&text).iter().all(|fault| fault.starts_with("line 2")), "{:#?}", faults(&text));
}

#[test]
fn fields_without_content_are_no_wish() {
    let text = format!("{PAPER}z_plan: null\nautofocus_plan:\ngrid_plan: {{}}\nchannels: []\n");
    assert!(Plan::from_text(&text).is_ok());
}

#[test]
fn unknown_keys_are_refused_with_the_nearest_known_one_and_their_line() {
    let text =
        PAPER.replace("loops", "loop").replace("period_ms: ", "period: ").replace("order: 2", "ordr: 2");
    expect(
        &text,
        &[
            "`loop` is not a known key",
            "`time_plan.loops` is missing",
            "`metadata.sofiscope.cameras.period` is not",
            "period_ms` is missing",
            "write `order`",
        ]
        .map(|part| {
            if part.starts_with("`loop`") {
                "`time_plan.loop` is not a known key; remove it, or write `loops`"
            } else {
                part
            }
        }),
    );
}

#[test]
fn values_of_a_wrong_kind_are_not_missing_as_well() {
    let text = PAPER.replace("loops: 4000", "loops: many").replace("period_ms: 20.0", "period_ms: [20]");
    expect(&text, &["`time_plan.loops` cannot be read", "period_ms` cannot be read"]);
}

#[test]
fn times_must_agree() {
    let with = |interval: &str, period: &str| {
        PAPER.replace("interval: 0 ", &format!("interval: {interval} ")).replace("period_ms: 20.0", period)
    };
    let period = |text: &str| Plan::from_text(text).unwrap().cameras().period;
    assert_eq!(period(&with("0.025", "")), Duration::from_millis(25));
    assert_eq!(period(&with("{milliseconds: 25}", "period_ms: 25")), Duration::from_millis(25));
    expect(&with("0.03", "period_ms: 25"), &["`time_plan.interval` is 30ms"]);
    expect(&with("0", "period_ms: 10"), &["is 10ms, shorter than the exposure of 20ms"]);
    expect(&with("0", ""), &["period_ms` is missing"]);
    expect(&with("soon", ""), &["expected seconds as a number", "period_ms` is missing"]);
}

#[test]
fn a_plan_has_an_end() {
    let endless = PAPER.replace(
        "time_plan:\n  interval: 0   # seconds; 0 leaves the pace to period_ms\n  loops: 4000\n",
        "",
    );
    expect(&endless, &["the plan has no end"]);
    let hoped = endless.replace("recording:", "stop: {snr: 3}\n    recording:");
    assert_eq!(Plan::from_text(&hoped).unwrap().duration(), None);
}

#[test]
fn axes_keep_a_series_together() {
    let two = format!("{PAPER}stage_positions: [[1, 2], [3, 4]]\n");
    assert!(Plan::from_text(&two).is_ok());
    expect(&two.replace("axis_order: ptc", "axis_order: tpc"), &["time outside of positions"]);
    expect(&PAPER.replace("axis_order: ptc", "axis_order: ptq"), &["has an axis q"]);
    expect(&PAPER.replace("axis_order: ptc", "axis_order: ptt"), &["an axis twice"]);
    assert!(Plan::from_text(&PAPER.replace("axis_order: ptc", "axis_order: tpgcz")).is_ok());
    expect(&PAPER.replace("[t]", "[t, p]"), &["the sample would be lit"]);
    expect(&PAPER.replace("[t]", "[p]"), &["without t"]);
}

#[test]
fn settings_that_cannot_work_are_refused() {
    let change = |from: &str, to: &str| PAPER.replace(from, to);
    expect(&change("order: 2", "order: 9"), &["order 9 is not available"]);
    expect(&change("Atto 565", "Ato 565"), &["no fluorophore is called"]);
    expect(&change("zt 594 RDC", "zt 1"), &["no dichroic is called"]);
    expect(&change("Alexa Fluor 647]", "Alexa Fluor 647, Alexa Fluor 568]"), &["order 2 tells 3 apart"]);
    expect(&change("loops: 4000", "loops: 100"), &["more than the 100 exposures"]);
    expect(&change("recording: ome-tiff", "recording: ome-tif"), &["write `ome-tiff`"]);
    expect(&change("version: 1", "version: 7"), &["this program reads version 1"]);
    let lasers = |power: &str| change("recording:", &format!("laser_power_mw: {power}\n    recording:"));
    expect(&lasers("{blue: 3}"), &["is no laser line"]);
    expect(&lasers("{488: -3}"), &["give a number from 0"]);
    expect(&lasers("{488: lots}"), &["cannot be read"]);
    let regions = "region: {width: 8, height: 8}\n      transmitted: {region: {width: 8, height: 9}}\n      exposure_ms";
    expect(&change("exposure_ms", regions), &["regions of equal size"]);
}

#[test]
fn a_focus_gate_needs_a_lock_that_holds() {
    let with = |text: &str| PAPER.replace("recording:", &format!("{text}\n    recording:"));
    let gated = Plan::from_text(&with("focus_lock: hold\n    focus_gate_nm: 50")).unwrap();
    assert_eq!(gated.focus_gate().map(Nanometers::value), Some(50.0));
    assert!(gated.events().all(|event| event.duties.focus_gate == gated.focus_gate()));
    assert_eq!(Plan::from_text(&gated.to_yaml()).unwrap(), gated);
    assert_eq!(Plan::from_text(PAPER).unwrap().focus_gate(), None);
    for lock in ["", "focus_lock: none\n    "] {
        expect(&with(&format!("{lock}focus_gate_nm: 50")), &["needs the focus lock"]);
    }
    for gate in ["0", "-50", "20000"] {
        let plan = with(&format!("focus_lock: hold\n    focus_gate_nm: {gate}"));
        let faults = Plan::from_text(&plan).unwrap_err();
        assert!(faults.to_string().contains("metadata.sofiscope.focus_gate_nm"), "{gate}: {faults}");
    }
}

#[test]
fn positions_are_whole() {
    let with = |positions: &str| format!("{PAPER}stage_positions: {positions}\n");
    expect(&with("[{x: 1}]"), &["only one of x and y"]);
    expect(&with("[{name: here}]"), &["names no place"]);
    expect(&with("[[a, 2]]"), &["only one of x and y"]);
    expect(&with("5"), &["is a number; give a list"]);
    expect(&with("[[1, 2e9]]"), &["is 2000000000"]);
}

proptest! {
    #[test]
    fn no_text_panics(text in "[ -~\n]{0,200}") {
        drop(Plan::from_text(&text));
    }

    #[test]
    fn no_damage_panics(at in 0..PAPER.len(), with in "[\\[\\]{}:,\"a0.\n -]{0,3}") {
        if let (Some(before), Some(after)) = (PAPER.get(..at), PAPER.get(at + 1..)) {
            drop(Plan::from_text(&format!("{before}{with}{after}")));
        }
    }
}
