//! What goes wrong: resets, silence, garbage, interlock, a dead host.

use std::time::Duration;

use sofiscope_hal::{ErrorKind, GateController, GatePattern, GateTrip};
use sofiscope_serial_line::{ModelPort, Wire};
use sofiscope_virtual::table::Quantity;
use sofiscope_virtual::trigger::{Bench, BoardSetup, VirtualGatekeeper};
use sofiscope_virtual::{EmissionLog, OpticalTable, log};

use super::{MILLISECOND, Rig, line, settings};
use crate::Gatekeeper;

#[test]
fn a_dead_host_leaves_the_gates_open_for_a_quarter_second() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gates.log");
    let log = EmissionLog::append(&path, "gatekeeper").unwrap();
    let base = Duration::from_secs(500);
    let bench = Bench { table: OpticalTable::private().unwrap(), log, base };
    let model = VirtualGatekeeper::new(BoardSetup::teensy(42), bench);
    let mut port = ModelPort::new(Wire::new(model, Gatekeeper::line_settings()));
    let mut gatekeeper = Gatekeeper::connect(line(&port), settings()).unwrap();
    gatekeeper.arm().unwrap();
    gatekeeper.set_gates(GatePattern(1)).unwrap();
    for _ in 0..20 {
        port.pass(50 * MILLISECOND);
        gatekeeper.heartbeat().unwrap();
    }
    let dead = base + port.with(|_, now| now);
    drop(gatekeeper);
    port.pass(Duration::from_secs(5));
    let notes = log::read(&path).unwrap();
    assert_eq!(notes.iter().map(|note| note.value).collect::<Vec<_>>(), [1.0, 0.0]);
    let closed = notes[1].at.checked_sub(dead).unwrap();
    assert!(closed <= 250 * MILLISECOND, "closed {closed:?} after the last answer");
    assert!(closed >= 240 * MILLISECOND, "closed {closed:?} after the last answer");
}

#[test]
fn the_interlock_closes_and_latches() {
    let mut rig = Rig::armed();
    rig.gatekeeper.set_gates(GatePattern(1)).unwrap();
    rig.table.set(Quantity::InterlockOpen, 1.0);
    rig.port.pass(2 * MILLISECOND);
    assert_eq!(rig.gates(), 0);
    assert_eq!(rig.gatekeeper.arm().unwrap_err().kind(), ErrorKind::Fault, "while it is open");
    rig.table.set(Quantity::InterlockOpen, 0.0);
    rig.port.pass(MILLISECOND);
    let state = rig.gatekeeper.state().unwrap();
    assert_eq!((state.armed, state.trip), (false, Some(GateTrip::Interlock)), "closing it enables nothing");
    assert_eq!(rig.gatekeeper.heartbeat(), Ok(()), "heartbeats of a disarmed board are no error");
    rig.gatekeeper.arm().unwrap();
}

#[test]
fn a_camera_stuck_in_an_exposure_is_cut() {
    let mut rig = Rig::armed();
    rig.gatekeeper.begin_sequence(&[GatePattern(1)]).unwrap();
    rig.model(|model, _| model.exposure.stuck = Some(true));
    rig.port.pass(25 * MILLISECOND);
    assert_eq!(rig.gates(), 1);
    let mut open = Duration::ZERO;
    while rig.gates() == 1 && open < Duration::from_secs(30) {
        rig.port.pass(100 * MILLISECOND);
        open += 100 * MILLISECOND;
        let _tripped_at_the_end = rig.gatekeeper.heartbeat();
    }
    assert!(open <= Duration::from_secs(20), "cut after {open:?}");
    assert_eq!(rig.gatekeeper.state().unwrap().trip, Some(GateTrip::OnTime));
}

#[test]
fn five_hundred_connects_with_boot_noise_never_open_a_gate() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gates.log");
    let log = EmissionLog::append(&path, "gatekeeper").unwrap();
    let bench = Bench { table: OpticalTable::private().unwrap(), log, base: Duration::ZERO };
    let mut model = VirtualGatekeeper::new(BoardSetup::uno(42), bench);
    model.boot_noise = b"\x00\xff:0001\xf0\n".to_vec();
    let port = ModelPort::new(Wire::new(model, Gatekeeper::line_settings()));
    for connect in 0..500 {
        port.with(|wire, now| wire.model().open_again(now));
        let mut gatekeeper =
            Gatekeeper::connect(line(&port), settings()).unwrap_or_else(|error| panic!("{connect}: {error}"));
        assert!(!gatekeeper.state().unwrap().armed);
    }
    assert_eq!(log::read(&path).unwrap(), [], "a change of a gate is a gate that opened");
}

#[test]
fn a_reset_board_is_not_commanded_before_it_is_armed_again() {
    let mut rig = Rig::new(BoardSetup::uno(42));
    rig.gatekeeper.arm().unwrap();
    rig.gatekeeper.set_gates(GatePattern(1)).unwrap();
    rig.model(VirtualGatekeeper::reset);
    assert_eq!(rig.gates(), 0);
    // Its boot loader runs: nothing is known.
    assert_eq!(rig.gatekeeper.heartbeat().unwrap_err().kind(), ErrorKind::Timeout);
    rig.port.pass(Duration::from_secs(2));
    assert_eq!(rig.gatekeeper.heartbeat().unwrap_err().kind(), ErrorKind::Fault);
    assert_eq!(rig.gatekeeper.set_gates(GatePattern(1)).unwrap_err().kind(), ErrorKind::Fault);
    assert_eq!(rig.gatekeeper.state().unwrap().trip, Some(GateTrip::Reset));
    assert_eq!(rig.gates(), 0);
    rig.gatekeeper.arm().unwrap();
    rig.gatekeeper.set_gates(GatePattern(1)).unwrap();
}

#[test]
fn broken_and_lost_answers_are_asked_for_again() {
    let mut rig = Rig::armed();
    for swallowed in 1..50 {
        rig.port.with(|wire, _| wire.faults().swallow = swallowed);
        rig.gatekeeper.heartbeat().unwrap_or_else(|error| panic!("{swallowed}: {error}"));
        rig.port.with(|wire, _| wire.faults().garbage = vec![b':', 0xFF, b'0', swallowed as u8]);
        rig.gatekeeper.heartbeat().unwrap_or_else(|error| panic!("{swallowed}: {error}"));
    }
    rig.port.with(|wire, _| wire.faults().pause = MILLISECOND / 2);
    rig.gatekeeper.set_gates(GatePattern(5)).unwrap();
    assert_eq!(rig.gates(), 5);
}

#[test]
fn late_answers_are_never_those_to_another_command() {
    let mut rig = Rig::armed();
    rig.port.with(|wire, _| wire.faults().delay = 300 * MILLISECOND);
    assert_eq!(rig.gatekeeper.set_gates(GatePattern(1)).unwrap_err().kind(), ErrorKind::Timeout);
    rig.port.with(|wire, _| wire.faults().delay = Duration::ZERO);
    let state = rig.gatekeeper.state();
    // Either nothing is known, or it is the state as it is: by now the watchdog has closed the gates.
    if let Ok(state) = state {
        assert_eq!(state.open, GatePattern(rig.gates()));
    }
    rig.port.pass(Duration::from_secs(1));
    assert_eq!(rig.gates(), 0);
    assert_eq!(rig.gatekeeper.state().unwrap().trip, Some(GateTrip::Watchdog));
}

#[test]
fn an_unplugged_board_is_lost_and_closes_by_itself() {
    let mut rig = Rig::armed();
    rig.gatekeeper.set_gates(GatePattern(1)).unwrap();
    rig.port.with(|wire, _| wire.faults().unplugged = true);
    assert_eq!(rig.gatekeeper.heartbeat().unwrap_err().kind(), ErrorKind::Lost);
    rig.port.pass(250 * MILLISECOND);
    assert_eq!(rig.gates(), 0);
}
