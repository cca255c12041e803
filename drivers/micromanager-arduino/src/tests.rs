//! The driver against a virtual board with all its defects, and against scripts.

#[cfg(test)]
mod bytes;

use std::time::Duration;

use sofiscope_hal::{ErrorKind, GateController, GatePattern, GateTrip, Volts, conformance};
use sofiscope_serial_line::{Line, ModelPort, Wire};
use sofiscope_virtual::table::Quantity;
use sofiscope_virtual::trigger::{ArduinoDefects, ArduinoKind, Bench, VirtualArduino};
use sofiscope_virtual::{EmissionLog, OpticalTable, log};

use crate::{ExposureLevel, MicroManagerArduino};

const MILLISECOND: Duration = Duration::from_millis(1);
const OPEN: GatePattern = GatePattern(1);

struct Rig {
    table: OpticalTable,
    port: ModelPort<Wire<VirtualArduino>>,
    arduino: MicroManagerArduino,
}

impl Rig {
    fn new(kind: ArduinoKind) -> Self {
        let table = OpticalTable::private().unwrap();
        let bench = Bench::quiet(table.clone(), Duration::from_secs(1000));
        let model = VirtualArduino::new(kind, ArduinoDefects::default(), bench);
        let port = ModelPort::new(Wire::new(model, MicroManagerArduino::line_settings()));
        port.with(|wire, now| wire.model().open_again(now));
        let line = Line::new(Box::new(port.again()), "arduino");
        let arduino = MicroManagerArduino::connect(line, ExposureLevel::High).unwrap().simulated();
        Self { table, port, arduino }
    }

    fn open() -> Self {
        let mut rig = Self::new(ArduinoKind::Uno);
        rig.arduino.arm().unwrap();
        rig.arduino.set_gates(OPEN).unwrap();
        assert_eq!(rig.gates(), 1);
        rig
    }

    fn gates(&self) -> u8 {
        self.table.get(Quantity::Gates) as u8
    }

    /// A camera that exposes, as the table tells the virtual board.
    fn expose(&mut self, exposures: u32) -> Vec<u8> {
        let mut seen = Vec::new();
        for _ in 0..exposures {
            let now = self.port.with(|wire, now| {
                wire.model().exposure.length = 4 * MILLISECOND;
                now
            });
            self.table.set(Quantity::LastPulse, (Duration::from_secs(1000) + now).as_secs_f64());
            self.port.pass(2 * MILLISECOND);
            seen.push(self.gates());
            self.port.pass(4 * MILLISECOND);
            assert_eq!(self.gates(), 0, "closed between exposures");
        }
        seen
    }
}

impl conformance::GateRig for Rig {
    fn gates(&mut self) -> &mut dyn GateController {
        &mut self.arduino
    }

    fn pins(&mut self) -> GatePattern {
        GatePattern(Self::gates(self))
    }

    fn num_bytes(&mut self) -> u64 {
        self.port.with(|wire, _| wire.model().num_bytes())
    }

    fn pass(&mut self, time: Duration) {
        self.port.pass(time);
    }

    fn reset(&mut self) {
        self.port.with(|wire, now| wire.model().reset(now));
        self.port.pass(Duration::from_secs(2));
    }
}

#[test]
fn it_keeps_the_contract_of_trigger_controllers() {
    conformance::gates(&mut Rig::new(ArduinoKind::Uno));
}

#[test]
fn a_teensy_has_more_of_everything() {
    let rig = Rig::new(ArduinoKind::Teensy4);
    let able = rig.arduino.capabilities();
    assert_eq!((able.gates, able.levels, able.sequence), (8, 8, 39_999));
    assert_eq!((able.watchdog, able.limits_on_time, able.makes_triggers), (None, false, false));
    assert_eq!(rig.arduino.identity().model, "MM-Ard-1");
}

#[test]
fn sequences_step_with_the_camera() {
    let mut rig = Rig::new(ArduinoKind::Uno);
    rig.arduino.arm().unwrap();
    rig.arduino.begin_sequence(&[1, 2, 4].map(GatePattern)).unwrap();
    assert_eq!(rig.expose(5), [1, 2, 4, 1, 2]);
    assert_eq!(rig.arduino.set_gates(OPEN).unwrap_err().kind(), ErrorKind::Busy);
    rig.arduino.end_sequence().unwrap();
    assert_eq!(rig.arduino.triggers_modulo_256(), 5);
    assert!(rig.arduino.state().unwrap().armed, "a sequence that ended leaves it armed");
    assert_eq!(rig.expose(2), [0, 0]);
}

#[test]
fn the_count_of_triggers_wraps() {
    let mut rig = Rig::new(ArduinoKind::Uno);
    rig.arduino.arm().unwrap();
    rig.arduino.begin_sequence(&[OPEN]).unwrap();
    rig.expose(260);
    rig.arduino.end_sequence().unwrap();
    assert_eq!(rig.arduino.triggers_modulo_256(), 4);
}

#[test]
fn a_sequence_as_long_as_the_memory_would_be_executed_and_is_never_sent() {
    let mut rig = Rig::open();
    let sent = rig.port.with(|wire, _| wire.model().num_bytes());
    let patterns = vec![OPEN; 256];
    assert_eq!(rig.arduino.begin_sequence(&patterns).unwrap_err().kind(), ErrorKind::OutOfRange);
    assert_eq!(rig.port.with(|wire, _| wire.model().num_bytes()), sent);
    rig.arduino.begin_sequence(&patterns[..255]).unwrap();
    // What the guard is for: the bytes after a refused upload open a gate.
    let mut bare = Rig::new(ArduinoKind::Uno);
    let mut line = Line::new(Box::new(bare.port.again()), "arduino");
    line.send(&[&[33, 1, 0], [1, 63].repeat(128).as_slice()].concat()).unwrap();
    bare.port.pass(MILLISECOND);
    assert_eq!(bare.gates(), 63);
}

#[test]
fn a_reset_while_nobody_asks_is_seen_by_the_next_question() {
    let mut rig = Rig::open();
    rig.port.with(|wire, now| wire.model().reset(now));
    // It is silent for two seconds; the driver finds it again and closes it.
    let state = rig.arduino.state();
    assert!(matches!(&state, Ok(state) if state.trip == Some(GateTrip::Reset)), "{state:?}");
    assert_eq!(rig.arduino.set_gates(OPEN).unwrap_err().kind(), ErrorKind::Fault);
    rig.arduino.arm().unwrap();
    rig.arduino.set_gates(OPEN).unwrap();
}

#[test]
fn a_silent_board_is_closed_and_counts_as_reset() {
    let mut rig = Rig::open();
    rig.port.with(|wire, _| wire.faults().swallow = 1);
    assert_eq!(rig.arduino.set_gates(GatePattern(2)).unwrap_err().kind(), ErrorKind::Timeout);
    assert_eq!(rig.gates(), 0);
    let state = rig.arduino.state().unwrap();
    assert_eq!((state.armed, state.trip), (false, Some(GateTrip::Reset)));
}

#[test]
fn garbage_is_no_echo() {
    let mut rig = Rig::open();
    rig.port.with(|wire, _| wire.faults().garbage = vec![7]);
    assert_eq!(rig.arduino.set_gates(GatePattern(2)).unwrap_err().kind(), ErrorKind::Protocol);
    assert_eq!(rig.gates(), 0);
    rig.port.with(|wire, _| wire.faults().garbage = vec![1, 2, 3, 4]);
    rig.arduino.disarm().unwrap();
}

#[test]
fn single_bytes_with_pauses_are_put_together() {
    let mut rig = Rig::open();
    rig.port.with(|wire, _| wire.faults().pause = 20 * MILLISECOND);
    rig.arduino.set_gates(GatePattern(3)).unwrap();
    rig.arduino.set_level(1, Volts::new(5.0).unwrap()).unwrap();
    assert_eq!(rig.table.get(Quantity::Level(1)), 5.0);
}

#[test]
fn an_unplugged_board_is_lost_and_keeps_its_gates() {
    let mut rig = Rig::open();
    rig.port.with(|wire, _| wire.faults().unplugged = true);
    assert_eq!(rig.arduino.disarm().unwrap_err().kind(), ErrorKind::Lost);
    rig.port.pass(Duration::from_secs(10));
    assert_eq!(rig.gates(), 1, "no watchdog: this is why a guard and an interlock are needed");
}

#[test]
fn five_hundred_connects_never_open_a_gate() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gates.log");
    let log = EmissionLog::append(&path, "arduino").unwrap();
    let bench = Bench { table: OpticalTable::private().unwrap(), log, base: Duration::ZERO };
    let mut model = VirtualArduino::new(ArduinoKind::Uno, ArduinoDefects::default(), bench);
    model.boot_noise = vec![0, 0xF0, 1];
    let port = ModelPort::new(Wire::new(model, MicroManagerArduino::line_settings()));
    for connect in 0..500 {
        port.with(|wire, now| wire.model().open_again(now));
        let line = Line::new(Box::new(port.again()), "arduino");
        let arduino = MicroManagerArduino::connect(line, ExposureLevel::High);
        assert!(arduino.is_ok(), "{connect}: {:?}", arduino.err());
    }
    assert_eq!(log::read(&path).unwrap(), [], "a change of a gate is a gate that opened");
}
