//! What the controller can do wrong on a line, and what the driver then does.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::time::Duration;

use sofiscope_hal::{ErrorKind, Motion, Properties, PropertyValue, Stage};
use sofiscope_virtual::stage::Jam;

use crate::bench::{Bench, place};

const ABORT: &str = "\\x03";

/// Begins a long move.
fn moving() -> Bench {
    let mut bench = Bench::homed();
    bench.stage.move_to(place(10_000.0, 10_000.0)).unwrap();
    bench.port.pass(Duration::from_secs(1));
    assert_eq!(bench.stage.motion().unwrap(), Motion::Moving);
    bench.received();
    bench
}

/// Asserts that STOP was sent, the place is unknown, moves are refused, and homing makes all well.
fn assert_given_up(bench: &mut Bench, what: &str) {
    assert!(bench.received().iter().any(|command| command == ABORT), "{what}: STOP was sent");
    assert_eq!(bench.ended().unwrap(), Motion::Unknown, "{what}");
    bench.received();
    assert_eq!(bench.stage.move_to(place(50_000.0, 10_000.0)).unwrap_err().kind(), ErrorKind::Busy, "{what}");
    assert_eq!(bench.received(), [""; 0], "{what}: a refused move costs no byte");
    bench.stage.begin_homing().unwrap();
    assert_eq!(bench.ended().unwrap(), Motion::Still, "{what}: homed again");
    bench.stage.move_to(place(50_000.0, 10_000.0)).unwrap();
    assert_eq!(bench.ended().unwrap(), Motion::Still, "{what}: moved again");
}

#[test]
fn stuck_timed_out_and_switched_axes_are_faults() {
    let jams = [
        (Jam::Moving, "the motion goes on after"),
        (Jam::Timeout, "needed too long"),
        (Jam::Switch, "stands in an end switch (error 12: limit switch actuated)"),
        (Jam::Short, "the move to (10.0000 10.0000) mm ended at (65000 µm, 45000 µm)"),
    ];
    for (jam, expected) in jams {
        let mut bench = Bench::homed();
        bench.with(|model| model.faults().jam = Some(jam));
        let begun = bench.now();
        bench.stage.move_to(place(10_000.0, 10_000.0)).unwrap();
        let error = bench.ended().unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Fault, "{error}");
        assert!(error.to_string().contains(expected), "{error}");
        let taken = bench.now() - begun;
        assert!(taken < Duration::from_secs(25), "{jam:?} was seen after {taken:?} of a move of 11 s");
        assert_given_up(&mut bench, expected);
    }
}

#[test]
fn an_abort_that_was_not_ours_is_a_fault() {
    let mut bench = moving();
    // The button at the controller: as STOP, but not by this driver.
    bench.port.with(|wire, now| sofiscope_serial_line::LineModel::receive(wire.model(), &[3], now));
    let error = bench.ended().unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Fault, "{error}");
    assert_given_up(&mut bench, "aborted");
}

#[test]
fn refused_commands_are_typed_and_change_nothing() {
    let kinds = [
        (5, ErrorKind::OutOfRange),
        (11, ErrorKind::Busy),
        (12, ErrorKind::Fault),
        (27, ErrorKind::Fault),
        (29, ErrorKind::Fault),
        (32, ErrorKind::OutOfRange),
    ];
    for (code, kind) in kinds {
        let mut bench = Bench::homed();
        let here = bench.stage.position().unwrap();
        let before = bench.stage.properties().unwrap();
        for is_move in [true, false] {
            bench.with(|model| model.faults().refuse = Some(code));
            let refused = if is_move {
                bench.stage.move_to(place(10_000.0, 10_000.0))
            } else {
                bench.stage.set_property("vel x", &PropertyValue::Number(1.0))
            };
            let error = refused.unwrap_err();
            assert_eq!(error.kind(), kind, "{error}");
            assert!(error.to_string().contains(&format!("error {code}")), "{error}");
            assert_eq!(bench.stage.motion().unwrap(), Motion::Still);
        }
        bench.port.pass(Duration::from_secs(5));
        assert_eq!(bench.stage.position().unwrap(), here);
        assert_eq!(bench.stage.properties().unwrap(), before);
        bench.stage.move_to(place(10_000.0, 10_000.0)).unwrap();
        assert_eq!(bench.ended().unwrap(), Motion::Still, "the error is cleared");
    }
}

#[test]
fn lasting_conditions_refuse_until_they_are_over() {
    for code in [27, 29] {
        let mut bench = Bench::homed();
        bench.with(|model| model.faults().condition = Some(code));
        bench.received();
        for _ in 0..2 {
            let error = bench.stage.move_to(place(10_000.0, 10_000.0)).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Fault, "{error}");
        }
        assert!(
            !bench.received().iter().any(|command| command.contains("moa")),
            "{code} is seen before the move"
        );
        bench.with(|model| model.faults().condition = None);
        bench.stage.move_to(place(10_000.0, 10_000.0)).unwrap();
        assert_eq!(bench.ended().unwrap(), Motion::Still);
    }
}

#[test]
fn lines_of_autostatus_between_answers_are_skipped() {
    let mut bench = Bench::new();
    bench.with(|model| model.faults().talks_between = true);
    bench.stage.begin_homing().unwrap();
    assert_eq!(bench.ended().unwrap(), Motion::Still);
    for x in [10_000.0, 90_000.0] {
        bench.stage.move_to(place(x, 10_000.0)).unwrap();
        assert_eq!(bench.ended().unwrap(), Motion::Still);
        assert!((bench.stage.position().unwrap().x.value() - x).abs() < 0.1);
    }
}

#[test]
fn a_person_at_the_joystick_is_seen() {
    let mut bench = Bench::homed();
    bench.stage.set_property("joy", &PropertyValue::Flag(true)).unwrap();
    assert_eq!(bench.stage.motion().unwrap(), Motion::ByHand);
    bench.with(|model| model.push([-1000.0, 0.0]));
    assert!((bench.stage.position().unwrap().x.value() - 119_000.0).abs() < 0.1);
    let error = bench.stage.move_to(place(50_000.0, 10_000.0)).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Busy, "{error}");
    assert!(error.to_string().contains("joy"), "{error}");
    bench.stage.set_property("joy", &PropertyValue::Flag(false)).unwrap();
    bench.stage.move_to(place(50_000.0, 10_000.0)).unwrap();
    assert_eq!(bench.ended().unwrap(), Motion::Still);
}

#[test]
fn motion_that_nobody_here_began_is_by_hand() {
    let mut bench = Bench::homed();
    bench
        .port
        .with(|wire, now| sofiscope_serial_line::LineModel::receive(wire.model(), b"!moa 10 10\r", now));
    assert_eq!(bench.stage.motion().unwrap(), Motion::ByHand);
}

#[test]
fn units_that_somebody_changed_are_set_again() {
    for dims in [[2, 2], [1, 1], [0, 9], [6, 7]] {
        let mut bench = Bench::homed();
        bench.with(|model| model.set_dims(dims));
        let there = bench.stage.position().unwrap();
        assert!((there.x.value() - 120_000.0).abs() < 0.1, "{dims:?}: {there:?}");
        bench.with(|model| model.set_dims(dims));
        bench.stage.move_to(place(20_000.0, 30_000.0)).unwrap();
        assert_eq!(bench.ended().unwrap(), Motion::Still);
        let really = bench.port.with(|wire, now| wire.model().place_um(now));
        assert!((really[0] - 20_000.0).abs() < 0.1 && (really[1] - 30_000.0).abs() < 0.1, "{really:?}");
    }
}

#[test]
fn settings_do_not_change_during_a_motion() {
    let mut bench = moving();
    let error = bench.stage.set_property("vel x", &PropertyValue::Number(1.0)).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Busy, "{error}");
    assert_eq!(bench.received(), [""; 0]);
}

#[test]
fn an_envelope_beside_the_travel_is_a_fault() {
    let mut bench = Bench::new();
    let port = bench.port.again();
    bench.stage.begin_homing().unwrap();
    bench.ended().unwrap();
    let mut settings = crate::bench::settings();
    settings.envelope.x = crate::bench::length(130_000.0)..=crate::bench::length(150_000.0);
    let error = crate::bench::opened(&port, settings).err().unwrap();
    assert_eq!(error.kind(), ErrorKind::Fault);
    assert!(error.to_string().contains("correct the configuration"), "{error}");
}
