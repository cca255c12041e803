//! Silence, late answers and a line that is gone.

use std::time::Duration;

use sofiscope_hal::{ErrorKind, Motion, Stage};

use crate::bench::{Bench, line, opened, place, powered_up, settings};

#[test]
fn answers_in_single_bytes_are_put_together() {
    let mut bench = Bench::homed();
    bench.port.with(|wire, _| wire.faults().pause = Duration::from_millis(20));
    bench.stage.move_to(place(10_000.0, 10_000.0)).unwrap();
    assert_eq!(bench.ended().unwrap(), Motion::Still);
    assert!((bench.stage.position().unwrap().x.value() - 10_000.0).abs() < 0.1);
}

#[test]
fn one_missing_answer_is_asked_for_again() {
    for missing in [1, 2] {
        let mut bench = Bench::homed();
        bench.with(|model| model.faults().silent = missing);
        let there = bench.stage.position();
        // The second missing answer is that of the question that finds the step again.
        assert_eq!(there.is_ok(), missing == 1, "{there:?}");
        assert!((bench.stage.position().unwrap().x.value() - 120_000.0).abs() < 0.1);
    }
}

#[test]
fn moves_are_never_repeated() {
    let mut num_moves = [0; 2];
    // Whichever answers around the move are missing.
    for spared in 0..8 {
        for silent in [1, 2, 3, usize::MAX] {
            let mut bench = Bench::homed();
            bench.received();
            bench.with(|model| (model.faults().spared, model.faults().silent) = (spared, silent));
            let taken = bench.stage.move_to(place(10_000.0, 10_000.0));
            bench.with(|model| model.faults().silent = 0);
            let received = bench.received();
            let moves = received.iter().filter(|command| command.starts_with("!moa")).count();
            num_moves[moves] += 1;
            if taken.is_err() && moves == 1 {
                // Nobody knows whether it was taken.
                assert!(received.iter().any(|command| command == "\\x03"), "{received:?}");
                assert_eq!(bench.ended().unwrap(), Motion::Unknown);
            } else if moves == 1 {
                assert_eq!(bench.ended().unwrap(), Motion::Still);
            }
        }
    }
    assert!(num_moves.iter().all(|cases| *cases > 4), "{num_moves:?} cases without and with a move");
}

#[test]
fn a_late_answer_is_never_the_next_one() {
    for late_ms in (0..6000).step_by(97) {
        let mut bench = Bench::homed();
        let late = Duration::from_millis(late_ms);
        bench.with(|model| model.faults().late = Some(late));
        let asked = bench.stage.position();
        assert!(asked.is_ok() || late > Duration::from_millis(1400), "{late:?}: {asked:?}");
        // The stage is elsewhere now; an old answer would still say 120 mm.
        bench.with(|model| {
            model.faults().late = None;
        });
        bench
            .stage
            .move_to(place(10_000.0, 10_000.0))
            .or_else(|_| {
                bench.port.pass(Duration::from_secs(10));
                bench.stage.move_to(place(10_000.0, 10_000.0))
            })
            .unwrap();
        assert_eq!(bench.ended().unwrap(), Motion::Still, "{late:?}");
        let there = bench.stage.position().unwrap();
        assert!((there.x.value() - 10_000.0).abs() < 0.1, "{late:?}: {there:?}");
    }
}

#[test]
fn silence_during_a_move_ends_it() {
    let mut bench = Bench::homed();
    bench.stage.move_to(place(10_000.0, 10_000.0)).unwrap();
    bench.received();
    bench.with(|model| model.faults().silent = usize::MAX);
    let begun = bench.now();
    let error = bench.stage.motion().unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Timeout, "{error}");
    let waited = bench.now() - begun;
    assert!(waited < Duration::from_secs(4), "a silent controller costs {waited:?}");
    assert!(bench.received().iter().any(|command| command == "\\x03"), "STOP was sent");
    bench.with(|model| model.faults().silent = 0);
    assert_eq!(bench.ended().unwrap(), Motion::Unknown);
    assert_eq!(bench.stage.move_to(place(10_000.0, 10_000.0)).unwrap_err().kind(), ErrorKind::Busy);
}

#[test]
fn a_line_lost_during_a_move_needs_homing() {
    let mut bench = Bench::homed();
    let stopper = bench.stage.stopper();
    bench.stage.move_to(place(10_000.0, 10_000.0)).unwrap();
    bench.port.with(|wire, _| wire.faults().unplugged = true);
    assert_eq!(bench.stage.motion().unwrap_err().kind(), ErrorKind::Lost);
    assert_eq!(
        stopper.stop_motion().unwrap_err().kind(),
        ErrorKind::Lost,
        "STOP says that it did not go out"
    );
    assert_eq!(bench.stage.reconnect(line(&bench.port)).unwrap_err().kind(), ErrorKind::Lost);
    bench.port.with(|wire, _| wire.faults().unplugged = false);
    bench.received();
    bench.stage.reconnect(line(&bench.port)).unwrap();
    assert!(bench.received().iter().any(|command| command == "\\x03"), "STOP was sent");
    assert_eq!(bench.ended().unwrap(), Motion::Unknown);
    assert_eq!(bench.stage.move_to(place(20_000.0, 10_000.0)).unwrap_err().kind(), ErrorKind::Busy);
    bench.stage.begin_homing().unwrap();
    assert_eq!(bench.ended().unwrap(), Motion::Still);
    bench.stage.move_to(place(20_000.0, 10_000.0)).unwrap();
    stopper.stop_motion().unwrap();
    assert_eq!(bench.ended().unwrap(), Motion::Still, "the old stopper works on the new line");
    assert!(bench.stage.position().unwrap().x.value() > 21_000.0);
}

#[test]
fn a_line_lost_while_standing_needs_no_homing_unless_the_power_was_off() {
    for power_was_off in [false, true] {
        let mut bench = Bench::homed();
        bench.port.with(|wire, _| wire.faults().unplugged = true);
        assert_eq!(bench.stage.position().unwrap_err().kind(), ErrorKind::Lost);
        for _ in 0..2 {
            assert_eq!(bench.stage.reconnect(line(&bench.port)).unwrap_err().kind(), ErrorKind::Lost);
            assert_eq!(bench.stage.move_to(place(20_000.0, 10_000.0)).unwrap_err().kind(), ErrorKind::Busy);
        }
        bench.port.with(|wire, now| {
            wire.faults().unplugged = false;
            if power_was_off {
                wire.model().switch_off_and_on(now);
            }
        });
        bench.stage.reconnect(line(&bench.port)).unwrap();
        let expected = if power_was_off { Motion::Unknown } else { Motion::Still };
        assert_eq!(bench.stage.motion().unwrap(), expected);
    }
}

#[test]
fn exchanged_ports_are_refused() {
    let other = powered_up();
    let mut wanted = settings();
    wanted.serial = "20260002".to_owned();
    let error = opened(&other, wanted).err().unwrap();
    assert_eq!(error.kind(), ErrorKind::Identity, "{error}");
    let received = other.with(|wire, _| wire.model().take_received());
    assert!(received.iter().all(|(_, command)| !command.starts_with(b"!")), "nothing was set: {received:?}");
}
