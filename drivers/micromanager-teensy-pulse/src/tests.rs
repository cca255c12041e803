//! The driver against a virtual generator, scripts, and lines that lose bytes.

use std::time::Duration;

use proptest::prelude::*;
use sofiscope_hal::{ErrorKind, TriggerSource, conformance};
use sofiscope_serial_line::{Line, ModelPort, Port, ScriptedPort, Wire};
use sofiscope_virtual::OpticalTable;
use sofiscope_virtual::table::Quantity;
use sofiscope_virtual::trigger::{Bench, VirtualTeensyPulse};

use crate::TeensyPulse;

const MILLISECOND: Duration = Duration::from_millis(1);
const VERSION: [u8; 5] = [0, 1, 0, 0, 0];

struct Rig {
    table: OpticalTable,
    port: ModelPort<Wire<VirtualTeensyPulse>>,
}

impl Rig {
    fn new() -> Self {
        let table = OpticalTable::private().unwrap();
        let model = VirtualTeensyPulse::new(Bench::quiet(table.clone(), Duration::from_secs(10)));
        Self { table, port: ModelPort::new(Wire::new(model, TeensyPulse::line_settings())) }
    }

    fn connect(&self) -> TeensyPulse {
        let line = Line::new(Box::new(self.port.again()), "teensy");
        TeensyPulse::connect(line, MILLISECOND).unwrap()
    }

    fn is_running(&self) -> bool {
        self.port.with(|wire, _| wire.model().is_running())
    }
}

#[test]
fn it_keeps_the_contract_of_trigger_sources() {
    conformance::trigger(&mut Rig::new().connect(), 10 * MILLISECOND);
}

#[test]
fn every_command_has_its_bytes() {
    let port = ScriptedPort::new()
        .expect([0xFF, 0], VERSION)
        .expect([0xFF, 0], VERSION)
        .expect([2, 0, 0, 0, 0], [2, 0, 0, 0, 0])
        .expect([0xFF, 1], [1, 0, 0, 0, 0])
        .expect([5, 0, 0, 0, 0], [5, 0, 0, 0, 0])
        .expect([4, 0xE8, 3, 0, 0], [4, 0xE8, 3, 0, 0])
        .expect([3, 0x10, 0x27, 0, 0], [3, 0x10, 0x27, 0, 0])
        .expect([6, 10, 0, 0, 0], [6, 10, 0, 0, 0])
        .expect([1, 0, 0, 0, 0], [1, 1, 0, 0, 0])
        .expect([0xFF, 1], [1, 1, 0, 0, 0])
        .expect([2, 0, 0, 0, 0], [2, 10, 0, 0, 0]);
    let line = Line::new(Box::new(port.clone()), "scripted");
    let mut generator = TeensyPulse::connect(line, MILLISECOND).unwrap();
    generator.start(10 * MILLISECOND, Some(10)).unwrap();
    assert!(generator.is_running().unwrap());
    assert_eq!(generator.stop_and_count().unwrap(), 10);
    port.assert_finished();
}

#[test]
fn a_finite_train_ends_without_a_word_and_is_counted() {
    let mut rig = Rig::new();
    let mut generator = rig.connect();
    generator.start(10 * MILLISECOND, Some(7)).unwrap();
    assert!(generator.is_running().unwrap());
    rig.port.pass(100 * MILLISECOND);
    assert!(!generator.is_running().unwrap());
    assert_eq!(rig.table.get(Quantity::Pulses), 7.0);
    let newest = rig.table.get(Quantity::LastPulse);
    let now = 10.0 + rig.port.with(|_, now| now.as_secs_f64());
    assert!(newest > 10.0 && newest < now, "{newest} before {now}");
    assert_eq!(generator.stop_and_count().unwrap(), 7);
    generator.start(10 * MILLISECOND, None).unwrap();
    rig.port.pass(Duration::from_secs(1));
    generator.stop().unwrap();
    assert!((100..=102).contains(&generator.pulses()), "{} in a second", generator.pulses());
}

#[test]
fn trains_that_cannot_be_made_are_refused_without_a_byte() {
    let rig = Rig::new();
    let mut generator = rig.connect();
    let sent = rig.port.with(|wire, _| wire.model().num_bytes());
    for (period, pulses) in [
        (Duration::ZERO, None),
        (Duration::from_micros(1), None),
        (Duration::from_secs(4295), None),
        (MILLISECOND, Some(0)),
        (MILLISECOND, Some(1 << 32)),
    ] {
        let error = generator.start(period, pulses).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::OutOfRange, "{period:?} {pulses:?}");
    }
    assert_eq!(rig.port.with(|wire, _| wire.model().num_bytes()), sent);
}

#[test]
fn a_pulse_is_never_longer_than_half_a_period() {
    let rig = Rig::new();
    let mut generator = rig.connect();
    generator.start(Duration::from_micros(500), None).unwrap();
    assert_eq!(rig.port.with(|wire, _| wire.model().settings()), (500, 250, 0));
}

#[test]
fn frames_cut_anywhere_are_found_again_and_leave_no_train() {
    for cut in 1..5 {
        for command in 0_u8..8 {
            let mut rig = Rig::new();
            rig.port.send(&[command, 0, 0, 0, 0][..cut]).unwrap();
            let mut generator = rig.connect();
            assert!(!rig.is_running(), "{cut} bytes of command {command}");
            generator.start(10 * MILLISECOND, Some(3)).unwrap();
            rig.port.pass(100 * MILLISECOND);
            assert_eq!(generator.stop_and_count().unwrap(), 3, "{cut} bytes of command {command}");
        }
    }
}

#[test]
fn lost_bytes_and_garbage_are_survived() {
    let rig = Rig::new();
    let mut generator = rig.connect();
    for swallowed in 1..12 {
        rig.port.with(|wire, _| wire.faults().swallow = swallowed);
        generator.stop().unwrap_or_else(|error| panic!("{swallowed}: {error}"));
        rig.port.with(|wire, _| wire.faults().garbage = vec![0xFF; swallowed]);
        generator.stop().unwrap_or_else(|error| panic!("{swallowed}: {error}"));
        assert!(!generator.is_running().unwrap());
    }
}

#[test]
fn a_train_that_may_have_started_is_stopped() {
    let stop = [2, 0, 0, 0, 0];
    let port = ScriptedPort::new()
        .expect([0xFF, 0], VERSION)
        .expect([0xFF, 0], VERSION)
        .expect(stop, stop)
        .expect([0xFF, 1], [1, 0, 0, 0, 0])
        .expect([5, 0, 0, 0, 0], [5, 0, 0, 0, 0])
        .expect([4, 0xE8, 3, 0, 0], [4, 0xE8, 3, 0, 0])
        .expect([3, 0x10, 0x27, 0, 0], [3, 0x10, 0x27, 0, 0])
        .expect([6, 0, 0, 0, 0], [6, 0, 0, 0, 0])
        .expect([1, 0, 0, 0, 0], [])
        .expect([0xFF, 0], VERSION)
        .expect([0xFF, 0], VERSION)
        .expect(stop, stop);
    let line = Line::new(Box::new(port.clone()), "scripted");
    let mut generator = TeensyPulse::connect(line, MILLISECOND).unwrap();
    assert_eq!(generator.start(10 * MILLISECOND, None).unwrap_err().kind(), ErrorKind::Timeout);
    port.assert_finished();
}

#[test]
fn an_unplugged_generator_is_lost() {
    let rig = Rig::new();
    let mut generator = rig.connect();
    rig.port.with(|wire, _| wire.faults().unplugged = true);
    assert_eq!(generator.stop().unwrap_err().kind(), ErrorKind::Lost);
}

#[test]
fn the_input_makes_one_stray_pulse_unless_it_was_stopped_once() {
    for connects in [false, true] {
        let mut rig = Rig::new();
        if connects {
            drop(rig.connect());
        }
        rig.port.send(&[5, 1, 0, 0, 0]).unwrap();
        for busy in [true, false] {
            rig.port.with(|wire, now| wire.model().set_busy(busy, now));
        }
        assert_eq!(rig.table.get(Quantity::Pulses), f64::from(u8::from(!connects)));
    }
}

#[test]
fn a_million_answers_that_are_none_are_not_taken_for_one() {
    let config = ProptestConfig { cases: 20_000, failure_persistence: None, ..ProptestConfig::default() };
    proptest!(config, |(answers in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..8), 50..51))| {
        for answer in answers {
            let port = ScriptedPort::new().expect([2, 0, 0, 0, 0], &answer);
            let line = Line::new(Box::new(port), "scripted");
            let mut generator = TeensyPulse { line, pulse_width_us: 1, pulses: 0 };
            let told = generator.ask(&[2, 0, 0, 0, 0], 2, MILLISECOND);
            prop_assert_eq!(told.is_ok(), answer.len() >= 5 && answer[0] == 2, "{:?}", answer);
        }
    });
}
