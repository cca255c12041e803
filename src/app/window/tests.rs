//! The bench behind the window, driven as a window drives it, with the simulated microscope.

use super::bench::LocalBench;
use crate::reconstruction::SofiStage;
use crate::viewer::bench::{Activity, Bench, BenchCommand, BenchStatus, Gravity, LiveSettings};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Far longer than anything here takes.
const PATIENCE: Duration = Duration::from_secs(60);

/// Looks until something is so; the pause between two looks is a wait for a message that nobody sends.
fn until<T>(bench: &LocalBench, what: &str, mut look: impl FnMut(&BenchStatus) -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        let status = bench.status();
        if let Some(found) = look(&status) {
            return found;
        }
        assert!(begun.elapsed() < PATIENCE, "{what} has not come; {:#?}", status.events);
        let _ = crossbeam_channel::after(Duration::from_millis(5)).recv();
    }
}

fn is(activity: &'static Activity) -> impl FnMut(&BenchStatus) -> Option<()> {
    move |status| (status.activity == *activity).then_some(())
}

fn text_of(status: &BenchStatus, gravity: Gravity) -> Vec<String> {
    status.events.iter().filter(|event| event.gravity == gravity).map(|event| event.text.clone()).collect()
}

fn simulated() -> LocalBench {
    let bench = LocalBench::start().unwrap();
    bench.ask(BenchCommand::OpenSimulated).unwrap();
    until(&bench, "an open instrument", is(&Activity::Idle));
    bench
}

/// 200 exposures in half a second.
const QUICK: LiveSettings = LiveSettings {
    exposure: Duration::from_millis(2),
    region: None,
    order: 2,
    subsequence: 50,
    species: Vec::new(),
    laser_power_mw: BTreeMap::new(),
    hold_focus: false,
};

#[test]
fn the_live_view_shows_cameras_and_every_step_until_it_is_finished() {
    let bench = simulated();
    let card = bench.status().instrument.clone().unwrap();
    assert_eq!(card.label, Some("SIMULATED"));
    assert!(card.devices.iter().all(|device| device.is_simulated), "{:?}", card.devices);
    assert_eq!(card.species.len(), 3);
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    until(&bench, "quality", |status| (!status.quality.is_empty()).then_some(()));
    let pictures = until(&bench, "both pictures", |_| {
        let pictures = bench.pictures();
        (pictures.cameras.is_some() && pictures.sofi.is_some()).then_some(pictures)
    });
    let (cameras, sofi) = (pictures.cameras.unwrap(), pictures.sofi.unwrap());
    assert_eq!((cameras.width, cameras.height), (card.sensor.0 as usize, card.sensor.1 as usize));
    assert_eq!(cameras.cameras[0].histogram.iter().sum::<u32>() as usize, cameras.width * cameras.height);
    for (stage, images) in SofiStage::ALL.into_iter().zip([2, 3, 3, 3, 3]) {
        assert_eq!(sofi.stage(stage).count(), images, "{stage:?}: {:?}", sofi.trouble);
    }
    assert_eq!(bench.status().activity, Activity::Live);
    bench.ask(BenchCommand::Finish).unwrap();
    until(&bench, "the end", is(&Activity::Idle));
    let run = &bench.status().run;
    assert!(run.exposures > 0 && run.lost.is_empty() && !run.ended.is_empty(), "{run:?}");
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("kept");
    bench.ask(BenchCommand::SaveResults(target.clone())).unwrap();
    until(&bench, "saved results", |status| status.last_saved.clone());
    for file in ["linearized.ome.tif", "composite.png", "report.html"] {
        assert!(target.join(file).exists(), "{file}");
    }
}

#[test]
fn other_settings_begin_another_live_view() {
    let bench = simulated();
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    until(&bench, "frames", |_| bench.pictures().cameras);
    let region = Some([8, 8, 32, 24]);
    bench.ask(BenchCommand::Live(LiveSettings { region, ..QUICK })).unwrap();
    let smaller = until(&bench, "the region", |_| {
        bench.pictures().cameras.filter(|cameras| (cameras.width, cameras.height) == (32, 24))
    });
    assert_eq!(smaller.cameras[0].counts.len(), 32 * 24);
    bench.ask(BenchCommand::Live(LiveSettings { region: Some([0, 0, 5000, 10]), ..QUICK })).unwrap();
    until(&bench, "a refusal", |status| {
        let errors = text_of(status, Gravity::Error);
        (status.activity == Activity::Idle).then_some(()).and(errors.first().cloned())
    });
}

#[test]
fn stop_ends_what_runs_and_what_waits() {
    let bench = simulated();
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    until(&bench, "frames", |_| bench.pictures().cameras);
    let begun = Instant::now();
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    bench.stop();
    until(&bench, "standstill", is(&Activity::Idle));
    assert!(begun.elapsed() < Duration::from_secs(2), "STOP took {:?}", begun.elapsed());
    until(&bench, "what became of the rest", |status| {
        text_of(status, Gravity::Warning).iter().any(|text| text.contains("not begun")).then_some(())
    });
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    until(&bench, "another live view after STOP", is(&Activity::Live));
}

#[test]
fn the_stage_moves_the_sample_and_refuses_what_is_outside() {
    let bench = simulated();
    let here = until(&bench, "a place", |status| status.stage);
    assert_eq!((here.x_um, here.y_um), (500.0, 500.0));
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    let mean = |bench: &LocalBench, after: u64| {
        until(bench, "a mean", |_| {
            bench.pictures().sofi.filter(|sofi| sofi.samples > after).map(|sofi| {
                let mean = sofi.stage(SofiStage::Mean).next().unwrap();
                Arc::clone(&mean.image)
            })
        })
    };
    let before = mean(&bench, 200);
    // 10 pixels of 108 nm.
    bench.ask(BenchCommand::MoveStage { x_um: 501.08, y_um: 500.0 }).unwrap();
    until(&bench, "the place", |status| {
        status.stage.filter(|stage| !stage.is_moving && (stage.x_um - 501.08).abs() < 1e-9)
    });
    // A new live view, so that the mean is of the new place alone.
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    until(&bench, "a new beginning", |_| bench.pictures().sofi.filter(|sofi| sofi.samples < 200));
    let after = mean(&bench, 200);
    let likeness = |shift: usize| -> f32 {
        let (height, width) = before.dim();
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (y, x)));
        pixels.map(|(y, x)| (after[[y, x]] - before[[y, (x + shift) % width]]).powi(2)).sum()
    };
    assert!(10.0 * likeness(10) < likeness(0), "{} {}", likeness(10), likeness(0));
    bench.ask(BenchCommand::MoveStage { x_um: 2000.0, y_um: 0.0 }).unwrap();
    until(&bench, "a refusal", |status| {
        text_of(status, Gravity::Error).iter().any(|text| text.contains("outside")).then_some(())
    });
    assert!((bench.status().stage.unwrap().x_um - 501.08).abs() < 1e-9, "nothing has moved");
}

#[test]
fn a_plan_is_judged_recorded_and_replayed() {
    let bench = simulated();
    let plan = "time_plan: {interval: 0, loops: 200}
keep_shutter_open_across: [t]
metadata:
  sofiscope:
    version: 1
    cameras: {exposure_ms: 2.0, period_ms: 2.0}
    analysis: {order: 2, subsequence_exposures: 50}
";
    let estimate = bench.judge_plan(plan).unwrap();
    assert!(estimate.may_begin, "{:?}", estimate.checks);
    assert_eq!((estimate.series, estimate.exposures), (1, Some(200)));
    let faults = bench.judge_plan(&plan.replace("order: 2", "order: 9")).unwrap_err();
    assert!(faults.contains("order"), "{faults}");
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    bench.ask(BenchCommand::Run { plan: plan.to_owned(), out: out.clone() }).unwrap();
    until(&bench, "a run", |status| status.last_saved.clone().filter(|_| status.activity == Activity::Idle));
    assert!(out.join("results/linearized.ome.tif").exists() && out.join("ledger.csv").exists());
    assert!(crate::app::replay::compare(&out, &out.join("results")).unwrap().is_empty());
    let speed = f64::INFINITY;
    bench.ask(BenchCommand::Replay { recording: out, speed, from: 0 }).unwrap();
    until(&bench, "a replay", |status| {
        let notes = text_of(status, Gravity::Note);
        notes.iter().any(|text| text.starts_with("replay (SIMULATED data): 400 frames")).then_some(())
    });
}

#[test]
fn what_cannot_be_done_is_an_event() {
    let bench = LocalBench::start().unwrap();
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    until(&bench, "an error", |status| text_of(status, Gravity::Error).first().cloned());
    bench.ask(BenchCommand::OpenInstrument("/nowhere/at/all.toml".into())).unwrap();
    let error = until(&bench, "another error", |status| text_of(status, Gravity::Error).get(1).cloned());
    assert!(error.contains("/nowhere/at/all.toml"), "{error}");
    assert!(bench.judge_plan("").unwrap_err().contains("no instrument is open"));
}
