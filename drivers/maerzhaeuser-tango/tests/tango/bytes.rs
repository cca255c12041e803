//! The bytes on the wire, one by one, as the instruction set of the TANGO has them.

use crate::bench::{SERIAL, length, place, settings};
use sofiscope_hal::{DeviceError, ErrorKind, Motion, Properties, PropertyValue, Stage};
use sofiscope_maerzhaeuser_tango::Tango;
use sofiscope_serial_line::{Line, ScriptedPort};

/// A script that goes on where another ends.
struct Script(ScriptedPort);

impl Script {
    fn new() -> Self {
        Self(ScriptedPort::new())
    }

    fn asks(self, question: &str, answer: &str) -> Self {
        Self(self.0.expect(format!("{question}\r"), format!("{answer}\r")))
    }

    fn sends(self, command: &str) -> Self {
        Self(self.0.expect(format!("{command}\r"), ""))
    }

    /// A command that sets, between two questions for errors.
    fn tells(self, command: &str) -> Self {
        self.asks("?err", "0").sends(command).asks("?err", "0")
    }

    /// Start-up with a controller whose `?calst` is `calibration`.
    fn starts(self, calibration: &str) -> Self {
        let script = self
            .sends("")
            .asks("?version", "TANGO-DT2, Version 1.73")
            .asks("?readsn", SERIAL)
            .sends("!autostatus 0")
            .asks("?err", "0")
            .asks("?det", "32")
            .tells("!dim 9 9")
            .asks("?vel x", "10.0000")
            .tells("!vel x 8.0000")
            .asks("?vel x", "8.0000")
            .asks("?accel x", "0.2000")
            .asks("?backlash x", "0.0")
            .asks("?vel y", "7.5000")
            .asks("?accel y", "0.2000")
            .asks("?backlash y", "0.0")
            .asks("?calst", calibration);
        if calibration == "3 3" { script.limits() } else { script }
    }

    fn limits(self) -> Self {
        self.asks("?dim", "9 9").asks("?lim x", "0.0000 120.0000").asks("?lim y", "0.0000 80.0000")
    }

    fn open(&self) -> Result<Tango, DeviceError> {
        Tango::open(Line::new(Box::new(self.0.clone()), "stage"), settings())
    }

    fn finished(&self) {
        self.0.assert_finished();
    }
}

#[test]
fn start_up_of_a_controller_that_knows_where_it_is() {
    let script = Script::new().starts("3 3").asks("?statusaxis x", "@").asks("?statusaxis y", "D");
    let mut stage = script.open().unwrap();
    assert_eq!(stage.motion().unwrap(), Motion::Still);
    assert_eq!(*stage.envelope().x.start(), length(5000.0), "the configuration is narrower");
    assert_eq!(*stage.envelope().y.start(), length(0.0), "the travel is narrower");
    assert!(!stage.identity().simulated);
    assert_eq!(stage.identity().to_string(), "Märzhäuser TANGO, S/N 20260001");
    script.finished();
}

#[test]
fn a_position_is_read_with_the_units_in_mind() {
    let script = Script::new()
        .starts("3 3")
        .asks("?dim", "9 9")
        .asks("?pos", "12.5000 3.4050")
        .asks("?dim", "1 1")
        .tells("!dim 9 9")
        .asks("?pos", "12.5000 3.4050");
    let mut stage = script.open().unwrap();
    for _ in 0..2 {
        let there = stage.position().unwrap();
        assert!((there.x.value() - 12_500.0).abs() < 1e-6 && (there.y.value() - 3405.0).abs() < 1e-6);
    }
    script.finished();
}

#[test]
fn a_move_and_one_that_replaces_it() {
    let script = Script::new()
        .starts("3 3")
        .asks("?dim", "9 9")
        .asks("?pos", "50.0000 40.0000")
        .tells("!moa 13.0000 0.3001")
        .asks("?statusaxis x", "M")
        .asks("?dim", "9 9")
        .asks("?pos", "49.0000 39.0000")
        .tells("go 100.0000 60.0000")
        .asks("?statusaxis x", "@")
        .asks("?statusaxis y", "@")
        .asks("?dim", "9 9")
        .asks("?pos", "100.0000 60.0000");
    let mut stage = script.open().unwrap();
    stage.move_to(place(13_000.0, 300.123)).unwrap();
    assert_eq!(stage.motion().unwrap(), Motion::Moving);
    stage.move_to(place(100_000.0, 60_000.0)).unwrap();
    assert_eq!(stage.motion().unwrap(), Motion::Still);
    script.finished();
}

#[test]
fn refused_places_and_unhomed_stages_cost_no_byte() {
    let script = Script::new().starts("3 3");
    let mut stage = script.open().unwrap();
    for (x, y) in [(4999.9, 10.0), (100_000.1, 10.0), (6000.0, -0.1), (6000.0, 1e300), (-1e300, 0.0)] {
        assert_eq!(stage.move_to(place(x, y)).unwrap_err().kind(), ErrorKind::OutOfRange);
    }
    script.finished();
    let script = Script::new().starts("1 3");
    let mut stage = script.open().unwrap();
    let error = stage.move_to(place(50_000.0, 40_000.0)).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Busy);
    assert_eq!(error.to_string(), "stage: the place of the stage is not known; home it first");
    script.finished();
}

#[test]
fn stop_is_one_byte() {
    let script = Script::new().starts("3 3");
    let script = Script(script.0.expect(b"\x03", "").expect(b"\x03", ""));
    let stopper = script.open().unwrap().stopper();
    stopper.stop_motion().unwrap();
    stopper.stop_motion().unwrap();
    script.finished();
}

#[test]
fn homing_goes_to_both_ends() {
    let script = Script::new()
        .starts("0 0")
        .tells("!cal x")
        .tells("!cal y")
        .asks("?statusaxis x", "M")
        .asks("?statusaxis x", "A")
        .asks("?statusaxis y", "A");
    let mut stage = script.open().unwrap();
    stage.begin_homing().unwrap();
    assert_eq!(stage.motion().unwrap(), Motion::Moving);
    assert_eq!(stage.motion().unwrap(), Motion::Moving, "an end so soon is not believed");
    script.finished();
}

#[test]
fn properties_are_set_and_read_back() {
    let script = Script::new()
        .starts("3 3")
        .asks("?joy", "0")
        .asks("?dim", "9 9")
        .tells("!vel x 2.5000")
        .asks("?vel x", "2.5000")
        .tells("!accel y 0.1000")
        .asks("?accel y", "0.1000")
        .tells("!backlash x 5.0000")
        .asks("?backlash x", "5.0")
        .tells("!joy 2")
        .tells("!accel x 0.3000")
        .asks("?accel x", "0.2000");
    let mut stage = script.open().unwrap();
    let names: Vec<String> = stage.properties().unwrap().into_iter().map(|property| property.name).collect();
    assert_eq!(names, ["vel x", "accel x", "backlash x", "vel y", "accel y", "backlash y", "joy"]);
    stage.set_property("vel x", &PropertyValue::Number(2.5)).unwrap();
    stage.set_property("accel y", &PropertyValue::Number(0.1)).unwrap();
    stage.set_property("backlash x", &PropertyValue::Whole(5)).unwrap();
    stage.set_property("joy", &PropertyValue::Flag(true)).unwrap();
    for (name, value) in [("accel y", f64::NAN), ("accel y", 3.0), ("accel z", 0.1)] {
        let refused = stage.set_property(name, &PropertyValue::Number(value)).unwrap_err();
        assert_eq!(refused.kind(), ErrorKind::OutOfRange, "{name} {value}");
    }
    let not_taken = stage.set_property("accel x", &PropertyValue::Number(0.3)).unwrap_err();
    assert_eq!(not_taken.kind(), ErrorKind::Fault, "{not_taken}");
    script.finished();
}

#[test]
fn other_devices_are_asked_and_left_alone() {
    let foreign = Script::new().sends("").asks("?version", "TANGO-DT2, Version 1.73").asks("?readsn", "17");
    let error = foreign.open().err().unwrap();
    assert_eq!(error.kind(), ErrorKind::Identity);
    assert!(error.to_string().contains("expected serial number 20260001, found 17"), "{error}");
    foreign.finished();
    let laser = Script::new().sends("").asks("?version", "%SYS-E-035, command error");
    assert_eq!(laser.open().err().unwrap().kind(), ErrorKind::Identity);
    laser.finished();
}
