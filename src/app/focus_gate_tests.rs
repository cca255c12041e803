//! A run of simulated cameras with a scripted focus error: what the gate keeps from the live analysis is recorded,
//! and stays out when the recording is replayed, analyzed, recovered and exported.

use super::analysis::{self, Prepared};
use super::analysis_note::AnalysisNote;
use super::instrument::species_of;
use super::live_path::PathOptions;
use super::replay::{ReplayRequest, compare, play};
use super::session::{acquire, analysis_of, write};
use super::simulated::series;
use crate::acquisition::{Analysis, FocusGauge, LeaveOut, LedgerRow, Light, Loss, PairState, Patience};
use crate::config::{AnalysisSettings, RawAnalysis};
use crate::control::contracts::{FocusHold, Illumination, StageDrive};
use crate::control::plan::{FocusWish, RecordingFormat, StagePosition};
use crate::control::sequencer::{CameraStation, Devices};
use crate::recording::{self, Format, Outcome};
use crate::replay::{ReplayOptions, ReplaySpeed};
use sofiscope_hal::{Camera, Channel, DeviceError, Nanometers, Region};
use sofiscope_sim::instrument::Pace;
use sofiscope_sim::{InstrumentSettings, Scenario, Scene, SimulatedInstrument, Source, World};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

const EXPOSURES: u64 = 600;
const GATE_NM: f64 = 50.0;

/// Lasers, stage and focus lock that do as they are asked, of which this test wants nothing else.
struct Obedient;

impl Illumination for Obedient {
    fn on(&mut self, _power_mw: &BTreeMap<u32, f64>) -> Result<(), DeviceError> {
        Ok(())
    }

    fn off(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

impl StageDrive for Obedient {
    fn move_to(&mut self, _position: &StagePosition) -> Result<(), DeviceError> {
        Ok(())
    }
}

impl FocusHold for Obedient {
    fn lock(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn look(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// Frames find the focus at the gate, within it, beyond it, and lost.
fn script() -> FocusGauge {
    let asked = AtomicU64::new(0);
    FocusGauge::new(move || match asked.fetch_add(1, Ordering::Relaxed) % 200 {
        at @ 0..90 => Some(at as f64 / 3.0),
        at @ 90..180 => Some(-GATE_NM + (at - 90) as f64 / 3.0),
        180..190 => Some(-GATE_NM - 0.01),
        _ => None,
    })
}

/// Records a run in `out` and writes its results; gives pairs analyzed and left out for want of focus.
fn record(out: &Path) -> (u64, u64) {
    let scene = Scene::from_toml(Scene::built_in("figure-s4").unwrap()).unwrap();
    let world = Arc::new(World::new(&scene.with_frames(EXPOSURES).unwrap(), 3));
    let faults = Scenario::from_toml("[faults]\ndrop_one_in = 61\n").unwrap().into_settings();
    let settings = InstrumentSettings { pace: Pace::Unpaced, ..faults };
    let instrument = SimulatedInstrument::new(Source::World(Arc::clone(&world)), settings);
    let cameras = instrument.cameras();
    let identities = cameras.each_ref().map(|camera| camera.identity().clone());
    let (height, width) = (world.scene().height_px(), world.scene().width_px());
    let region = Region { left: 0, top: 0, width: width as u32, height: height as u32 };
    let stations = Channel::BOTH.into_iter().zip(cameras).map(|(channel, camera)| CameraStation {
        channel,
        camera: Box::new(camera),
        region,
    });
    let devices = Devices::new(
        stations.collect(),
        Some(Box::new(instrument.trigger())),
        Box::new(Obedient),
        Some(Box::new(Obedient)),
    );
    let input = |role: &str| (role.to_owned(), "simulated".to_owned(), "uint16".to_owned());
    let raw = RawAnalysis { subsequence_exposures: Some(100), ..RawAnalysis::default() };
    let source = analysis::Source {
        inputs: vec![input("camera R"), input("camera T")],
        height,
        width,
        frames: EXPOSURES,
        pixel_pitch_nm: Some(world.scene().optics().pixel_pitch_nm),
        exposure_ms: Some(world.scene().exposure_ms()),
        simulated: true,
        species: Some(species_of(&world).unwrap()),
        serials: [None, None],
        registration: None,
        calibrations: analysis::Calibrations::default(),
    };
    let prepared = Prepared::new(AnalysisSettings::try_from(raw.clone()).unwrap(), source).unwrap();
    let options = PathOptions {
        analysis: Some(prepared.clone()),
        preview_every: None,
        patience: Patience::Patient,
        leave_out: LeaveOut::default(),
        focus: script(),
        recording: Some(out.to_path_buf()),
        identities,
        pixel_pitch_nm: Some(prepared.pixel_pitch_nm),
        provenance: vec![AnalysisNote::of(&raw, &prepared).file().unwrap()],
        pool_frames: None,
        onlooker: None,
    };
    let period = Duration::from_secs_f64(world.scene().exposure_ms() / 1e3);
    let mut event = series(period, EXPOSURES, RecordingFormat::OmeTiff);
    event.position = Some(StagePosition { x_um: Some(1250.5), y_um: Some(-3.0), ..StagePosition::default() });
    event.laser_power_mw = [(405, 0.0), (488, 10.0), (561, 2.5)].into();
    event.duties.focus = FocusWish::Hold;
    event.duties.focus_gate = Some(Nanometers::new(GATE_NM).unwrap());
    let mut acquired = acquire(devices.with_focus(Some(Box::new(Obedient))), options, vec![event]).unwrap();
    assert!(acquired.failure().is_none(), "{:?}", acquired.records);
    let accounts = acquired.results[0].report.dispatch.accounts.clone();
    accounts.balance().unwrap();
    assert_eq!(accounts.analysis_left_out.keys().collect::<Vec<_>>(), [&Loss::OutOfFocus]);
    let found = analysis_of(&mut acquired.results[0], prepared).unwrap();
    write(&found, &out.join("results"), None).unwrap();
    (accounts.pairs_analyzed, accounts.analysis_left_out[&Loss::OutOfFocus])
}

/// What differs in the images of a recording when it is played again.
fn differences(original: &Path, played: &Path, as_live: bool, out: &Path) -> Vec<String> {
    let request = ReplayRequest {
        paths: &[played.to_path_buf()],
        options: ReplayOptions { speed: ReplaySpeed::Max, ..ReplayOptions::default() },
        settings: RawAnalysis::default(),
        as_live,
    };
    let (_, results, _) = play(request, out).unwrap();
    compare(original, &results).unwrap()
}

fn ledger(directory: &Path) -> String {
    fs::read_to_string(directory.join("ledger.csv")).unwrap()
}

/// Every pair is analyzed if both its frames were in focus, and left out if not; counts both.
fn assert_gated(directory: &Path) -> (u64, u64) {
    let run = recording::open(directory).unwrap();
    let rows: Vec<LedgerRow> = run.rows().unwrap().map(Result::unwrap).collect();
    let light = Light::of([(488, 10.0), (561, 2.5)]).unwrap();
    let mut counts = (0, 0);
    for pair in rows.chunks_exact(2).filter(|rows| rows[0].pair == PairState::Paired) {
        let is_sharp = pair.iter().all(|row| row.conditions.focus_nm.is_some_and(|e| e.abs() <= GATE_NM));
        let expected = if is_sharp { Analysis::Analyzed } else { Analysis::LeftOut(Loss::OutOfFocus) };
        for row in pair {
            assert_eq!(row.analysis, expected, "{row:?}");
            let told = row.conditions;
            assert_eq!((told.x_um, told.y_um, told.light), (Some(1250.5), Some(-3.0), light), "{row:?}");
        }
        if is_sharp { counts.0 += 1 } else { counts.1 += 1 }
    }
    counts
}

#[test]
fn pairs_out_of_focus_are_recorded_and_stay_out_of_every_analysis() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| -> PathBuf { folder.path().join(name) };
    let run = place("run");
    let (analyzed, left_out) = record(&run);
    assert!(analyzed > 400 && left_out > 30, "{analyzed} analyzed, {left_out} left out");
    assert_eq!(assert_gated(&run), (analyzed, left_out));
    let kept = ledger(&run);
    let edge = |focus: &str| kept.contains(&format!(",{focus},1250.5,-3,488=10;561=2.5\n"));
    assert!(edge("-50") && edge("-50.01") && edge(""), "the script was played");

    assert_eq!(differences(&run, &run, true, &place("replayed")), Vec::<String>::new());
    assert_eq!(differences(&run, &run, false, &place("analyzed")), Vec::<String>::new());

    let zarr = place("zarr");
    recording::export(&run, Format::OmeZarr, &zarr).unwrap();
    for (number, directory) in [&run, &zarr].into_iter().enumerate() {
        assert_eq!(ledger(directory), kept, "exported");
        fs::write(directory.join("ledger.csv"), &kept[..kept.len() / 3]).unwrap();
        assert_eq!(recording::recover(directory).unwrap().outcome, Outcome::Repaired);
        let is_recorded = |line: &&str| line.contains("recorded");
        assert!(
            ledger(directory).lines().filter(is_recorded).eq(kept.lines().filter(is_recorded)),
            "recovered"
        );
        let out = place(&format!("recovered-{number}"));
        assert_eq!(differences(&run, directory, true, &out), Vec::<String>::new());
    }

    // Without the gate the images are others: the comparison sees what was left out.
    fs::write(run.join("ledger.csv"), kept.replace("OUT_OF_FOCUS", "analyzed")).unwrap();
    assert!(!differences(&run, &run, true, &place("everything")).is_empty());
}
