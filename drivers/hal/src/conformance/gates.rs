//! Checks of trigger controllers: what is closed, what opens, and what happens when nobody holds it.

use std::time::Duration;

use super::{must, refused};
use crate::{ErrorKind, GateController, GatePattern, GateState, GateTrip, Volts};

/// A trigger controller on the bench, with a probe at its outputs.
pub trait GateRig {
    /// The controller; connected and never armed before the suite begins, and always the same one.
    fn gates(&mut self) -> &mut dyn GateController;

    /// Outputs as an oscilloscope sees them.
    fn pins(&mut self) -> GatePattern;

    /// Bytes that have reached the device so far.
    fn num_bytes(&mut self) -> u64;

    /// Lets time pass on the rig's clock while nobody speaks.
    fn pass(&mut self, time: Duration);

    /// Interrupts the power of the device, and waits until it would answer again.
    fn reset(&mut self);
}

/// Everything that a trigger controller promises; leaves it disarmed.
///
/// # Panics
/// With the first promise that is broken.
pub fn gates(rig: &mut impl GateRig) {
    is_closed_at_the_start(rig);
    opens_nothing_unless_armed(rig);
    opens_exactly_what_is_asked(rig);
    refuses_what_is_not_there(rig);
    disarming_closes(rig);
    sequences_begin_and_end_closed(rig);
    heartbeats_hold_and_silence_closes(rig);
    a_reset_is_seen(rig);
    disarming_closes(rig);
}

fn one() -> GatePattern {
    GatePattern::CLOSED.with(0)
}

fn state(rig: &mut impl GateRig) -> GateState {
    must(rig.gates().state(), "asking for the state")
}

fn arm(rig: &mut impl GateRig) {
    must(rig.gates().arm(), "arming");
    let state = state(rig);
    assert!(state.armed && state.trip.is_none(), "armed controllers are armed without a trip: {state:?}");
    assert!(rig.pins().is_closed(), "arming opens no gate: {:?}", rig.pins());
}

/// Asserts that outputs and what is told about them are this.
fn assert_open(rig: &mut impl GateRig, open: GatePattern, when: &str) {
    assert_eq!(rig.pins(), open, "{when}: the outputs");
    assert_eq!(state(rig).open, open, "{when}: what is told of the outputs");
}

fn is_closed_at_the_start(rig: &mut impl GateRig) {
    let identity = rig.gates().identity().clone();
    assert!(!identity.model.trim().is_empty(), "the identity has a model: {identity:?}");
    let able = rig.gates().capabilities().clone();
    assert!((1..=8).contains(&able.gates), "there are 1 to 8 gates: {able:?}");
    assert_open(rig, GatePattern::CLOSED, "at the start");
    assert!(!state(rig).armed, "nothing is armed at the start");
}

fn opens_nothing_unless_armed(rig: &mut impl GateRig) {
    refused(rig.gates().set_gates(one()), ErrorKind::Fault, "opening a gate of a disarmed controller");
    assert_open(rig, GatePattern::CLOSED, "disarmed");
    if rig.gates().capabilities().sequence > 0 {
        let begun = rig.gates().begin_sequence(&[one()]);
        refused(begun, ErrorKind::Fault, "beginning a sequence on a disarmed controller");
    }
    assert_open(rig, GatePattern::CLOSED, "disarmed, after a sequence was refused");
}

fn opens_exactly_what_is_asked(rig: &mut impl GateRig) {
    arm(rig);
    let gates = rig.gates().capabilities().gates;
    let all = (0..gates).fold(GatePattern::CLOSED, GatePattern::with);
    let each = (0..gates).map(|line| GatePattern::CLOSED.with(line));
    for pattern in each.chain([all, GatePattern::CLOSED]) {
        must(rig.gates().heartbeat(), "a heartbeat");
        must(rig.gates().set_gates(pattern), "opening gates");
        assert_open(rig, pattern, "after opening exactly these");
    }
}

fn refuses_what_is_not_there(rig: &mut impl GateRig) {
    arm(rig);
    must(rig.gates().set_gates(one()), "opening a gate");
    let able = rig.gates().capabilities().clone();
    let before = rig.num_bytes();
    let volts = |volts| Volts::new(volts).unwrap_or(Volts::ZERO);
    if able.gates < 8 {
        let beyond = GatePattern::CLOSED.with(able.gates);
        refused(rig.gates().set_gates(beyond), ErrorKind::OutOfRange, "opening a gate that is not there");
        let begun = rig.gates().begin_sequence(&[beyond]);
        refused(begun, ErrorKind::OutOfRange, "a sequence of gates that are not there");
    }
    let beyond = rig.gates().set_level(able.levels, Volts::ZERO);
    refused(beyond, ErrorKind::OutOfRange, "setting an analog output that is not there");
    if able.levels > 0 {
        for level in [-1.0, 1e6] {
            let set = rig.gates().set_level(0, volts(level));
            refused(set, ErrorKind::OutOfRange, "setting a level that is not there");
        }
    }
    refused(rig.gates().begin_sequence(&[]), ErrorKind::OutOfRange, "a sequence of nothing");
    let long = vec![GatePattern::CLOSED; able.sequence as usize + 1];
    refused(rig.gates().begin_sequence(&long), ErrorKind::OutOfRange, "a sequence that is too long");
    assert_eq!(rig.num_bytes(), before, "what is refused as out of range sends no byte");
    assert_open(rig, one(), "after refusals");
}

fn disarming_closes(rig: &mut impl GateRig) {
    arm(rig);
    must(rig.gates().set_gates(one()), "opening a gate");
    for when in ["disarmed", "disarmed twice"] {
        must(rig.gates().disarm(), "disarming");
        assert_open(rig, GatePattern::CLOSED, when);
        assert!(!state(rig).armed, "{when}: nothing is armed");
    }
    refused(rig.gates().set_gates(one()), ErrorKind::Fault, "opening a gate after disarming");
    assert_open(rig, GatePattern::CLOSED, "after disarming");
}

fn sequences_begin_and_end_closed(rig: &mut impl GateRig) {
    let longest = rig.gates().capabilities().sequence as usize;
    if longest == 0 {
        return;
    }
    for num_patterns in [1, 2.min(longest), longest] {
        arm(rig);
        must(rig.gates().set_gates(one()), "opening a gate");
        let patterns = vec![one(); num_patterns];
        must(rig.gates().begin_sequence(&patterns), "beginning a sequence");
        assert!(rig.pins().is_closed(), "a sequence without an exposure opens nothing");
        must(rig.gates().heartbeat(), "a heartbeat");
        must(rig.gates().end_sequence(), "ending a sequence");
        must(rig.gates().end_sequence(), "ending a sequence twice");
        assert_open(rig, GatePattern::CLOSED, "after a sequence");
        must(rig.gates().set_gates(one()), "opening a gate after a sequence");
        assert_open(rig, one(), "opened after a sequence");
    }
    must(rig.gates().disarm(), "disarming");
}

fn heartbeats_hold_and_silence_closes(rig: &mut impl GateRig) {
    let Some(within) = rig.gates().capabilities().watchdog else {
        let before = rig.num_bytes();
        must(rig.gates().heartbeat(), "a heartbeat of a controller without a watchdog");
        assert_eq!(rig.num_bytes(), before, "heartbeats without a watchdog do nothing");
        return;
    };
    arm(rig);
    must(rig.gates().set_gates(one()), "opening a gate");
    for _ in 0..3 {
        rig.pass(within / 2);
        must(rig.gates().heartbeat(), "a heartbeat");
        assert_eq!(rig.pins(), one(), "heartbeats hold the gates");
    }
    rig.pass(within);
    assert!(rig.pins().is_closed(), "gates close within {within:?} after the last heartbeat");
    let told = state(rig);
    let expected =
        GateState { open: GatePattern::CLOSED, armed: false, trip: Some(GateTrip::Watchdog), ..told };
    assert_eq!(told, expected, "the watchdog is told");
    refused(rig.gates().set_gates(one()), ErrorKind::Fault, "opening a gate after the watchdog closed it");
    assert_open(rig, GatePattern::CLOSED, "latched");
    arm(rig);
}

fn a_reset_is_seen(rig: &mut impl GateRig) {
    arm(rig);
    must(rig.gates().set_gates(one()), "opening a gate");
    let before = state(rig);
    rig.reset();
    assert!(rig.pins().is_closed(), "outputs are low after a reset");
    let told = state(rig);
    assert_eq!((told.armed, told.trip), (false, Some(GateTrip::Reset)), "a reset is told");
    assert_ne!(told.epoch, before.epoch, "a reset changes the epoch");
    refused(rig.gates().set_gates(one()), ErrorKind::Fault, "opening a gate after a reset");
    assert_eq!(state(rig).trip, Some(GateTrip::Reset), "a reset is latched");
    arm(rig);
    must(rig.gates().set_gates(one()), "opening a gate when armed again after a reset");
    assert_open(rig, one(), "armed again after a reset");
}
