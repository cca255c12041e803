//! The driver against the firmware itself on a virtual board, and against scripted and broken lines.

#[cfg(test)]
mod bytes;
#[cfg(test)]
mod faults;

use std::time::Duration;

use sofiscope_hal::{ErrorKind, GateController, GatePattern, GateTrip, TriggerSource, Volts, conformance};
use sofiscope_serial_line::{Line, ModelPort, Wire};
use sofiscope_virtual::OpticalTable;
use sofiscope_virtual::table::Quantity;
use sofiscope_virtual::trigger::{Bench, BoardSetup, VirtualGatekeeper};

use crate::{CLOSE_NOW, Gatekeeper, GatekeeperSettings, Step};

type Port = ModelPort<Wire<VirtualGatekeeper>>;

const MILLISECOND: Duration = Duration::from_millis(1);

fn settings() -> GatekeeperSettings {
    GatekeeperSettings {
        serial: Some(42),
        longest_on_time: vec![Duration::from_secs(20); 6],
        full_scale: Volts::new(5.0).unwrap(),
        pulse_width: MILLISECOND,
        step: Step::CameraExposure,
    }
}

struct Rig {
    table: OpticalTable,
    port: Port,
    gatekeeper: Gatekeeper,
}

impl Rig {
    fn new(setup: BoardSetup) -> Self {
        Self::with(setup, settings())
    }

    fn with(setup: BoardSetup, settings: GatekeeperSettings) -> Self {
        let table = OpticalTable::private().unwrap();
        let bench = Bench::quiet(table.clone(), Duration::from_secs(1000));
        let port =
            ModelPort::new(Wire::new(VirtualGatekeeper::new(setup, bench), Gatekeeper::line_settings()));
        port.with(|wire, now| wire.model().open_again(now));
        let gatekeeper = Gatekeeper::connect(line(&port), settings).unwrap();
        Self { table, port, gatekeeper }
    }

    fn armed() -> Self {
        let mut rig = Self::new(BoardSetup::teensy(42));
        rig.gatekeeper.arm().unwrap();
        rig
    }

    fn gates(&self) -> u8 {
        self.table.get(Quantity::Gates) as u8
    }

    fn model<T>(&self, change: impl FnOnce(&mut VirtualGatekeeper, Duration) -> T) -> T {
        self.port.with(|wire, now| change(wire.model(), now))
    }
}

fn line(port: &Port) -> Line {
    Line::new(Box::new(port.again()), "gatekeeper")
}

impl conformance::GateRig for Rig {
    fn gates(&mut self) -> &mut dyn GateController {
        &mut self.gatekeeper
    }

    fn pins(&mut self) -> GatePattern {
        GatePattern(Self::gates(self))
    }

    fn num_bytes(&mut self) -> u64 {
        self.model(|model, _| model.num_bytes())
    }

    fn pass(&mut self, time: Duration) {
        self.port.pass(time);
    }

    fn reset(&mut self) {
        self.model(VirtualGatekeeper::reset);
        self.port.pass(Duration::from_secs(2));
    }
}

#[test]
fn it_keeps_the_contract_of_trigger_controllers() {
    conformance::gates(&mut Rig::new(BoardSetup::uno(42)));
    conformance::gates(&mut Rig::new(BoardSetup::teensy(42)));
}

#[test]
fn it_keeps_the_contract_of_trigger_sources() {
    conformance::trigger(&mut Rig::new(BoardSetup::uno(42)).gatekeeper, 10 * MILLISECOND);
}

#[test]
fn it_tells_what_the_board_is() {
    let rig = Rig::new(BoardSetup::uno(42));
    let identity = rig.gatekeeper.identity();
    assert_eq!((identity.serial.as_str(), identity.simulated), ("42", true));
    let able = rig.gatekeeper.capabilities();
    assert_eq!((able.gates, able.levels, able.sequence), (6, 2, 256));
    assert_eq!(able.watchdog, Some(250 * MILLISECOND));
}

#[test]
fn another_board_and_impossible_settings_are_refused() {
    let connect = |settings| {
        let bench = Bench::quiet(OpticalTable::private().unwrap(), Duration::ZERO);
        let model = VirtualGatekeeper::new(BoardSetup::uno(42), bench);
        let port = ModelPort::new(Wire::new(model, Gatekeeper::line_settings()));
        Gatekeeper::connect(line(&port), settings).err().unwrap().kind()
    };
    assert_eq!(connect(GatekeeperSettings { serial: Some(7), ..settings() }), ErrorKind::Identity);
    for longest_on_time in [vec![Duration::ZERO], vec![Duration::from_secs(1801)], vec![MILLISECOND; 7]] {
        assert_eq!(connect(GatekeeperSettings { longest_on_time, ..settings() }), ErrorKind::OutOfRange);
    }
    assert_eq!(connect(GatekeeperSettings { full_scale: Volts::ZERO, ..settings() }), ErrorKind::OutOfRange);
    assert_eq!(
        connect(GatekeeperSettings { pulse_width: Duration::ZERO, ..settings() }),
        ErrorKind::OutOfRange
    );
}

#[test]
fn levels_come_out_and_return_after_a_reset() {
    let mut rig = Rig::armed();
    rig.gatekeeper.set_level(1, Volts::new(2.5).unwrap()).unwrap();
    let volts = |rig: &Rig| (rig.table.get(Quantity::Level(1)) * 100.0).round() / 100.0;
    assert_eq!(volts(&rig), 2.5);
    rig.model(VirtualGatekeeper::reset);
    assert_eq!(volts(&rig), 0.0);
    rig.gatekeeper.arm().unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(volts(&rig), 2.5);
}

#[test]
fn a_train_is_counted_and_ends_by_itself() {
    let mut rig = Rig::armed();
    rig.gatekeeper.start(10 * MILLISECOND, Some(5)).unwrap();
    assert_eq!(rig.gatekeeper.start(10 * MILLISECOND, None).unwrap_err().kind(), ErrorKind::Busy);
    rig.port.pass(100 * MILLISECOND);
    assert_eq!(rig.gatekeeper.pulses().unwrap(), 5);
    assert_eq!(rig.table.get(Quantity::Pulses), 5.0);
    rig.gatekeeper.start(10 * MILLISECOND, None).unwrap();
    for period in [MILLISECOND / 20, Duration::from_secs(61)] {
        let error = rig.gatekeeper.start(period, None).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::OutOfRange, "{period:?}");
    }
    for pulses in [0, 1 << 32] {
        let error = rig.gatekeeper.start(10 * MILLISECOND, Some(pulses)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::OutOfRange, "{pulses}");
    }
}

#[test]
fn sequences_step_with_the_camera() {
    let mut rig = Rig::armed();
    rig.model(|model, _| model.exposure.length = 4 * MILLISECOND);
    let patterns: Vec<GatePattern> = (0..40).map(|step| GatePattern(1 << (step % 3))).collect();
    rig.gatekeeper.begin_sequence(&patterns).unwrap();
    rig.gatekeeper.start(10 * MILLISECOND, Some(7)).unwrap();
    let mut seen = Vec::new();
    for _ in 0..700 {
        rig.port.pass(MILLISECOND / 10);
        if seen.last() != Some(&rig.gates()) {
            seen.push(rig.gates());
        }
    }
    // The first exposure is under way when the answer has come over the line.
    assert_eq!(seen.iter().filter(|gates| **gates != 0).copied().collect::<Vec<_>>(), [1, 2, 4, 1, 2, 4, 1]);
    assert_eq!(rig.gatekeeper.exposures().unwrap(), 7);
}

#[test]
fn sequences_step_with_the_own_clock_and_open_only_in_the_window() {
    let step = Step::OwnClock { delay: 2 * MILLISECOND, open: 5 * MILLISECOND };
    let mut rig = Rig::with(BoardSetup::teensy(42), GatekeeperSettings { step, ..settings() });
    rig.gatekeeper.arm().unwrap();
    assert_eq!(rig.gatekeeper.start(6 * MILLISECOND, None).unwrap_err().kind(), ErrorKind::OutOfRange);
    rig.gatekeeper.begin_sequence(&[GatePattern(1), GatePattern(2)]).unwrap();
    rig.gatekeeper.start(20 * MILLISECOND, None).unwrap();
    for _ in 0..100 {
        rig.port.pass(MILLISECOND);
        let since = rig.port.with(|_, now| now.as_secs_f64()) + 1000.0 - rig.table.get(Quantity::LastPulse);
        let inside = (0.002..0.007).contains(&since);
        assert_eq!(rig.gates() != 0, inside, "{since} s after the pulse");
    }
    rig.gatekeeper.stop().unwrap();
    assert_eq!(rig.gates(), 0);
}

#[test]
fn one_byte_over_a_second_handle_closes_at_once() {
    let mut rig = Rig::armed();
    rig.gatekeeper.set_gates(GatePattern(3)).unwrap();
    let mut sender = rig.gatekeeper.sender().unwrap();
    sender.write_all(CLOSE_NOW).unwrap();
    assert_eq!(rig.gates(), 0);
    let state = rig.gatekeeper.state().unwrap();
    assert_eq!((state.armed, state.trip), (false, Some(GateTrip::Commanded)));
}
