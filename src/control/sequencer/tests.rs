//! The sequencer with fake devices that write down what is done to them, and a clock that only the tests turn.

mod fakes;

use super::*;
use crate::control::contracts::{Illumination, NoLasers};
use crate::control::stop_rule::StopReason;
use fakes::{Bench, PLAN};
use proptest::prelude::*;
use std::collections::BTreeMap;

#[test]
fn a_series_goes_from_setting_up_to_its_record() {
    let bench = Bench::default();
    let record = bench.run().remove(0);
    assert_eq!((record.reason, record.exposures), (FinishReason::Completed, 100));
    assert!((record.acquired_s - 2.0).abs() < 1e-9 && (record.dose_mj - 10.0).abs() < 1e-9);
    let expected = [
        "configure R",
        "configure T",
        "arm R",
        "arm T",
        "open",
        "light",
        "trigger",
        "pulses Some(100) every 20 ms",
        "hold",
        "dark",
        "stop R",
        "stop T",
        "close",
        "record",
    ];
    assert_eq!(bench.log()[..expected.len()], expected);
}

#[test]
fn when_one_camera_does_not_arm_the_other_is_stopped_and_the_next_start_works() {
    for call in ["arm R", "arm T"] {
        let bench = Bench::failing(call);
        let reason = bench.reason();
        assert!(matches!(&reason, FinishReason::Failed(message) if message.contains(call)), "{reason:?}");
        assert!(!bench.log().iter().any(|call| call == "trigger" || call == "light" || call == "open"));
        bench.world.lock().unwrap().failing.clear();
        assert_eq!(bench.reason(), FinishReason::Completed);
    }
}

#[test]
fn whatever_fails_ends_dark_with_a_record() {
    for call in [
        "configure R",
        "configure T",
        "open",
        "light",
        "trigger",
        "hold",
        "dark",
        "stop R",
        "stop T",
        "close",
        "record",
    ] {
        let bench = Bench::failing(call);
        let records = bench.run();
        let FinishReason::Failed(message) = &records[0].reason else {
            // What fails after the reason was settled stands in the failures.
            assert!(call == "close" || call == "record", "{call}: {:?}", records[0]);
            assert!(!records[0].failures.is_empty() || call == "close", "{call}: {:?}", records[0]);
            continue;
        };
        assert!(message.contains("does not work today"), "{call}: {message}");
    }
}

#[test]
fn a_camera_that_clamps_is_refused_with_both_numbers_unless_the_plan_accepts() {
    let mut bench = Bench::default();
    bench.world.lock().unwrap().clamp = Some(Duration::from_millis(10));
    let reason = bench.reason().to_string();
    assert!(reason.contains("exposure 19 ms was asked, the camera does 10 ms"), "{reason}");
    assert!(reason.contains("camera R") && reason.contains("camera T"), "{reason}");
    assert!(!bench.log().iter().any(|call| call.starts_with("arm")));
    bench.plan = PLAN.replace("period_ms: 20", "period_ms: 20, accept_readback: true");
    assert_eq!(bench.reason(), FinishReason::Completed);
}

#[test]
fn rounding_to_the_cameras_step_is_no_clamp() {
    let bench = Bench::default();
    bench.world.lock().unwrap().clamp = Some(Duration::from_micros(19_006));
    assert_eq!(bench.reason(), FinishReason::Completed);
}

#[test]
fn a_stop_while_preparing_starts_nothing() {
    for command in [Command::Stop, Command::Interrupt, Command::Abort] {
        let bench = Bench { before: vec![command], ..Bench::default() };
        let reason = bench.reason();
        assert!(matches!(reason, FinishReason::Stopped | FinishReason::Aborted), "{reason:?}");
        assert!(
            !bench.log().iter().any(|call| call == "trigger" || call.starts_with("arm")),
            "{:?}",
            bench.log()
        );
    }
}

#[test]
fn a_device_that_dies_ends_the_series() {
    let failure = Some((4, DataPathError::Device("camera T is gone".to_owned())));
    let bench = Bench { failure, ..Bench::default() };
    assert_eq!(bench.reason(), FinishReason::Failed("camera T is gone".to_owned()));
}

#[test]
fn stop_and_abort_end_in_their_own_way() {
    let stopped = Bench { drains_needed: 3, ..Bench::scripted(&[(3, Command::Stop), (4, Command::Stop)]) };
    assert_eq!(stopped.reason(), FinishReason::Stopped);
    assert!(!stopped.log().contains(&"abandon".to_owned()));
    let aborted = Bench::scripted(&[(3, Command::Abort)]);
    assert_eq!(aborted.reason(), FinishReason::Aborted);
    let log = aborted.log();
    let at = |name: &str| log.iter().position(|call| call == name).unwrap();
    assert!(at("dark") < at("hold") && at("stop T") < at("abandon") && at("abandon") < at("close"));
}

#[test]
fn the_second_interrupt_aborts_a_slow_stop() {
    let script = [(3, Command::Interrupt), (5, Command::Interrupt), (5, Command::Interrupt)];
    let bench = Bench { drains_needed: 50, ..Bench::scripted(&script) };
    assert_eq!(bench.reason(), FinishReason::Aborted);
    assert!(bench.log().contains(&"abandon".to_owned()));
}

#[test]
fn draining_is_given_up_after_its_time() {
    let bench = Bench { drains_needed: u64::MAX, ..Bench::default() };
    let reason = bench.reason().to_string();
    assert!(reason.contains("still on their way 10.0 s after the end"), "{reason}");
    assert!(bench.log().contains(&"abandon".to_owned()));
}

#[test]
fn a_pause_is_dark_and_its_time_does_not_count() {
    let bench = Bench::scripted(&[(3, Command::Pause), (9, Command::Resume)]);
    let record = bench.run().remove(0);
    assert_eq!((record.reason, record.exposures), (FinishReason::Completed, 100));
    assert!(record.acquired_s < 2.5, "{}", record.acquired_s);
    let log = bench.log();
    assert_eq!(log.iter().filter(|call| *call == "light").count(), 2);
    assert!(log.iter().any(|call| call.starts_with("pulses Some(") && !call.contains("100")), "{log:?}");
}

#[test]
fn exposures_on_their_way_at_a_pause_are_not_made_again() {
    // 30 are counted when it is held, 7 more come after the wish to go on.
    let script = [(3, Command::Pause), (4, Command::Resume)];
    let bench = Bench { on_their_way: (5, 7), ..Bench::scripted(&script) };
    let record = bench.run().remove(0);
    assert_eq!((record.reason, record.exposures), (FinishReason::Completed, 107));
    let log = bench.log();
    assert!(log.contains(&"pulses Some(63) every 20 ms".to_owned()), "{log:?}");
}

#[test]
fn cameras_without_any_exposure_have_stalled() {
    let bench = Bench { per_look: 0, ..Bench::default() };
    let reason = bench.reason().to_string();
    assert!(reason.contains("no exposure came for"), "{reason}");
}

#[test]
fn exposures_lost_at_the_end_do_not_hold_the_series() {
    // The trigger gives 100 pulses, and nothing is heard of the last ten.
    let bench = Bench { last: 90, ..Bench::default() };
    let record = bench.run().remove(0);
    assert_eq!((record.reason, record.exposures), (FinishReason::Completed, 90));
}

#[test]
fn a_recording_that_loses_frames_ends_the_series_unless_the_plan_goes_on() {
    let mut bench = Bench { drops_from: 50, ..Bench::default() };
    let reason = bench.reason().to_string();
    assert!(reason.contains("the recording lost 1 frames"), "{reason}");
    bench.plan = format!("{PLAN}    on_record_drop: continue\n");
    assert_eq!(bench.reason(), FinishReason::Completed);
}

#[test]
fn the_stop_rule_ends_a_series() {
    let plan = format!("{PLAN}    dose_limit_mj: 4\n");
    let bench = Bench { plan, ..Bench::default() };
    assert!(matches!(bench.reason(), FinishReason::StopRule(StopReason::Dose { .. })));
}

#[test]
fn every_position_has_a_series_of_its_own() {
    let plan = format!("{PLAN}stage_positions: [[1, 0], [2, 0]]\n");
    let bench = Bench { plan: plan.clone(), ..Bench::default() };
    let records = bench.run();
    assert_eq!(records.iter().map(|record| record.series).collect::<Vec<_>>(), [0, 1]);
    assert!(bench.log().contains(&"move 2.0".to_owned()));
    let stopped = Bench { plan, ..Bench::scripted(&[(3, Command::Stop)]) };
    assert_eq!(stopped.run().len(), 1, "after a stop no other series begins");
}

#[test]
fn a_series_waits_for_its_command_where_asked() {
    let bench = Bench { begin: Begin::OnCommand, ..Bench::scripted(&[(5, Command::Start)]) };
    assert_eq!(bench.reason(), FinishReason::Completed);
    let bench = Bench { begin: Begin::OnCommand, ..Bench::scripted(&[(5, Command::Stop)]) };
    assert_eq!(bench.reason(), FinishReason::Stopped);
}

#[test]
fn light_that_is_not_there_is_refused() {
    let mut lasers = NoLasers;
    assert!(lasers.on(&BTreeMap::new()).is_ok());
    let error = lasers.on(&[(488, 5.0)].into_iter().collect()).unwrap_err();
    assert!(error.to_string().contains("488 nm"));
}

fn any_command() -> impl Strategy<Value = Command> {
    prop::sample::select(vec![
        Command::Start,
        Command::Pause,
        Command::Resume,
        Command::Stop,
        Command::Abort,
        Command::Interrupt,
    ])
}

proptest! {
    #[test]
    fn no_course_of_commands_and_failures_leaves_anything_on(
        script in prop::collection::vec((1..30_u64, any_command()), 0..12),
        failing in prop::option::of(prop::sample::select(vec![
            "configure T", "arm R", "arm T", "open", "light", "trigger", "hold", "stop R", "stop T", "close",
        ])),
        drains_needed in 1..5_u64,
        failure in prop::option::of(1..20_u64),
    ) {
        let mut bench = Bench { drains_needed, ..Bench::scripted(&script) };
        // A pause without an end would be one.
        bench.script.push((31, Command::Stop));
        bench.failure = failure.map(|look| (look, DataPathError::Recording("disk full".to_owned())));
        bench.world.lock().unwrap().failing.extend(failing);
        prop_assert_eq!(bench.run().len(), 1);
    }
}
