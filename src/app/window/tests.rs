//! The bench behind the window, driven as a window drives it, with the simulated microscope.

mod colors;
mod registration;
mod served;

use super::bench::LocalBench;
use crate::reconstruction::SofiStage;
use crate::viewer::bench::{Activity, Bench, BenchCommand, BenchStatus, Gravity, LiveSettings};
use ndarray::{Array2, s};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Far longer than anything here takes.
const PATIENCE: Duration = Duration::from_secs(300);

/// Looks until something is so; the pause between two looks is a wait for a message that nobody sends.
fn until<T>(bench: &impl Bench, what: &str, mut look: impl FnMut(&BenchStatus) -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        let status = bench.status();
        if let Some(found) = look(&status) {
            return found;
        }
        assert!(
            begun.elapsed() < PATIENCE,
            "{what} has not come while {:?}, {:?}, {:?}; {:#?}",
            status.activity,
            status.registration.step,
            status.colors.step,
            status.events
        );
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
    assert_eq!(card.label.as_deref(), Some("SIMULATED"));
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
    // 16 pixels of 108 nm.
    bench.ask(BenchCommand::MoveStage { x_um: 501.728, y_um: 500.0 }).unwrap();
    until(&bench, "the place", |status| {
        status.stage.filter(|stage| !stage.is_moving && (stage.x_um - 501.728).abs() < 1e-9)
    });
    // A new live view, so that the mean is of the new place alone.
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    until(&bench, "a new beginning", |_| bench.pictures().sofi.filter(|sofi| sofi.samples < 200));
    let after = mean(&bench, 200);
    // A slow computer averages pixels of the picture; both are compared with 4 x 4 pixels averaged.
    let [before, after] = [before, after].map(|image| {
        let [height, width] = [image.nrows() / 18, image.ncols() / 18];
        assert_eq!(
            [18 * height, 18 * width],
            [image.nrows(), image.ncols()],
            "72 pixels divide into pictures"
        );
        Array2::from_shape_fn((18, 18), |(y, x)| {
            let [y, x] = [y * height, x * width];
            f64::from(image.slice(s![y..y + height, x..x + width]).mean().unwrap())
        })
    });
    // The correlation, as the means are of different numbers of exposures, and the sample bleaches.
    let likeness = |shift: usize| -> f64 {
        let means = [&before, &after].map(|image| image.mean().unwrap());
        let products = after.indexed_iter().map(|((y, x), new)| {
            let [old, new] = [before[[y, (x + shift) % 18]] - means[0], new - means[1]];
            [old * new, old * old, new * new]
        });
        let sums = products.fold([0.0; 3], |sums, parts| std::array::from_fn(|k| sums[k] + parts[k]));
        sums[0] / (sums[1] * sums[2]).sqrt()
    };
    let (moved, still) = (likeness(4), likeness(0));
    assert!(4.0 * (1.0 - moved) < 1.0 - still, "{moved} at the new place, {still} at the old one");
    bench.ask(BenchCommand::MoveStage { x_um: 2000.0, y_um: 0.0 }).unwrap();
    until(&bench, "a refusal", |status| {
        text_of(status, Gravity::Error).iter().any(|text| text.contains("outside")).then_some(())
    });
    assert!((bench.status().stage.unwrap().x_um - 501.728).abs() < 1e-9, "nothing has moved");
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

const SHORT_RUN: &str = "time_plan: {interval: 0, loops: 600}
metadata:
  sofiscope:
    version: 1
    cameras: {exposure_ms: 2.0, period_ms: 2.0}
    analysis: {order: 2, subsequence_exposures: 50}
";

/// A recording of 600 exposures, 2 ms apart, and the bench that made it.
fn recorded(folder: &std::path::Path) -> (LocalBench, std::path::PathBuf) {
    let (bench, out) = (simulated(), folder.join("run"));
    bench.ask(BenchCommand::Run { plan: SHORT_RUN.to_owned(), out: out.clone() }).unwrap();
    until(&bench, "a run", |status| status.last_saved.clone().filter(|_| status.activity == Activity::Idle));
    (bench, out)
}

#[test]
fn a_replay_is_held_goes_elsewhere_and_on_at_another_speed() {
    let folder = tempfile::tempdir().unwrap();
    let (bench, recording) = recorded(folder.path());
    assert_eq!(bench.status().replay, None);
    bench.ask(BenchCommand::Replay { recording: recording.clone(), speed: 0.1, from: 0 }).unwrap();
    until(&bench, "frames of the replay", |status| {
        status.replay.as_ref().filter(|replay| replay.position > 5).map(|_| ())
    });
    bench.ask(BenchCommand::Pause).unwrap();
    let held = until(&bench, "a pause", |status| {
        let replay = status.replay.clone().filter(|replay| replay.is_paused);
        replay.filter(|_| status.run.phase == "paused")
    });
    assert_eq!((held.exposures, held.speed, &held.recording), (600, 0.1, &recording));
    assert_eq!(bench.status().activity, Activity::Replay);
    // Held, it goes to another place, and from there on.
    bench.ask(BenchCommand::Seek(400)).unwrap();
    until(&bench, "another place", |status| {
        let there = status.replay.as_ref().is_some_and(|replay| replay.position > 400 && !replay.is_paused);
        there.then_some(())
    });
    assert_eq!(bench.status().run.planned, Some(200));
    bench.ask(BenchCommand::Pause).unwrap();
    until(&bench, "a second pause", |status| {
        status.replay.as_ref().filter(|replay| replay.is_paused).map(|_| ())
    });
    bench.ask(BenchCommand::Resume).unwrap();
    bench.ask(BenchCommand::ReplaySpeed(f64::INFINITY)).unwrap();
    until(&bench, "the end", is(&Activity::Idle));
    let notes = text_of(&bench.status(), Gravity::Note);
    let books = notes.iter().rfind(|text| text.starts_with("replay (SIMULATED data)")).unwrap();
    assert!(books.contains(": 400 frames received") && books.contains(" 0 lost"), "{books}");
    assert!(text_of(&bench.status(), Gravity::Error).is_empty(), "{:?}", bench.status().events);
    assert_eq!(bench.status().replay, None);
}

#[test]
fn a_replay_by_hand_ends_with_the_bits_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let (bench, recording) = recorded(folder.path());
    bench.ask(BenchCommand::Replay { recording: recording.clone(), speed: 2.0, from: 0 }).unwrap();
    until(&bench, "frames of the replay", |status| {
        status.replay.as_ref().filter(|replay| replay.position > 50).map(|_| ())
    });
    bench.ask(BenchCommand::Pause).unwrap();
    until(&bench, "a pause", |status| (status.run.phase == "paused").then_some(()));
    bench.ask(BenchCommand::Resume).unwrap();
    bench.ask(BenchCommand::ReplaySpeed(f64::INFINITY)).unwrap();
    until(&bench, "the end", is(&Activity::Idle));
    let kept = folder.path().join("kept");
    bench.ask(BenchCommand::SaveResults(kept.clone())).unwrap();
    until(&bench, "saved results", |status| {
        status.last_saved.clone().filter(|saved| saved.ends_with("kept"))
    });
    let differences = crate::app::replay::compare(&recording, &kept).unwrap();
    assert!(differences.is_empty(), "{differences:?}");
}

#[test]
fn a_run_that_was_held_goes_on_without_a_loss() {
    let folder = tempfile::tempdir().unwrap();
    let (bench, out) = (simulated(), folder.path().join("run"));
    // So slow that no computer loses frames by itself.
    let plan = SHORT_RUN.replace("loops: 600", "loops: 800").replace("2.0", "10.0");
    bench.ask(BenchCommand::Run { plan, out }).unwrap();
    for _ in 0..3 {
        let before = bench.status().run.exposures;
        until(&bench, "exposures", |status| {
            (status.activity == Activity::Run && status.run.exposures > before + 20).then_some(())
        });
        bench.ask(BenchCommand::Pause).unwrap();
        until(&bench, "a pause", is(&Activity::Paused));
        bench.ask(BenchCommand::Resume).unwrap();
        until(&bench, "the run again", is(&Activity::Run));
    }
    until(&bench, "the end", is(&Activity::Idle));
    assert!(text_of(&bench.status(), Gravity::Error).is_empty(), "{:?}", bench.status().events);
    let run = bench.status().run.clone();
    assert!(run.lost.is_empty() && (run.exposures, run.pairs) == (800, 800), "{run:?}");
}

fn property(bench: &LocalBench, name: &str) -> String {
    let card = bench.status().instrument.clone().unwrap();
    let camera = card.devices.iter().find(|device| device.role == "camera R").unwrap();
    camera.properties.iter().find(|row| row.name == name).unwrap().value.clone()
}

#[test]
fn properties_of_cameras_are_changed_while_they_rest_and_read_back() {
    let bench = simulated();
    let set = |property: &str, value: &str| {
        let (device, property, value) = ("camera R".to_owned(), property.to_owned(), value.to_owned());
        bench.ask(BenchCommand::SetProperty { device, property, value }).unwrap();
    };
    assert_eq!(property(&bench, "sensor temperature"), "-10");
    set("target temperature", "-25");
    until(&bench, "a colder sensor", |_| (property(&bench, "sensor temperature") == "-25").then_some(()));
    set("cooler", "off");
    until(&bench, "a warm sensor", |_| (property(&bench, "sensor temperature") == "20").then_some(()));
    let columns = bench.status().instrument.clone().unwrap().sensor.0;
    assert_eq!(property(&bench, "sensor width"), columns.to_string(), "what was known stays");
    for (name, value, says) in [
        ("target temperature", "-31", "takes -30 to 20 °C"),
        ("target temperature", "cold", "takes a number"),
        ("sensor temperature", "0", "can only be looked at"),
        ("sensor width", "10", "has no property"),
    ] {
        set(name, value);
        until(&bench, says, |status| {
            text_of(status, Gravity::Error).iter().any(|text| text.contains(says)).then_some(())
        });
    }
    bench.ask(BenchCommand::Live(QUICK)).unwrap();
    until(&bench, "frames", |_| bench.pictures().cameras);
    set("cooler", "on");
    until(&bench, "a refusal", |status| {
        let warnings = text_of(status, Gravity::Warning);
        warnings.iter().any(|text| text.contains("only while the cameras rest; finish")).then_some(())
    });
    assert_eq!(bench.status().activity, Activity::Live, "nothing was stopped for it");
    bench.ask(BenchCommand::Finish).unwrap();
    until(&bench, "the end", is(&Activity::Idle));
    assert_eq!(property(&bench, "sensor temperature"), "20", "and it was not done later");
}

#[test]
fn a_focus_lock_that_is_not_there_is_said() {
    let bench = simulated();
    bench.ask(BenchCommand::Focus(crate::viewer::bench::FocusAsk::Lock)).unwrap();
    until(&bench, "a sentence", |status| {
        let warnings = text_of(status, Gravity::Warning);
        warnings.iter().any(|text| text == "this instrument has no focus lock").then_some(())
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
