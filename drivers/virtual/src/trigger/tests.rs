//! The defects of the Arduino firmware, each with its flag and without.

use std::time::Duration;

use sofiscope_serial_line::{ModelPort, Port};

use super::{ArduinoDefects, ArduinoKind, Bench, VirtualArduino};
use crate::OpticalTable;

const MILLISECOND: Duration = Duration::from_millis(1);

fn board(defects: ArduinoDefects) -> ModelPort<VirtualArduino> {
    let bench = Bench::quiet(OpticalTable::private().unwrap(), Duration::ZERO);
    ModelPort::new(VirtualArduino::new(ArduinoKind::Teensy4, defects, bench))
}

fn answer(port: &mut ModelPort<VirtualArduino>, sent: &[u8]) -> Vec<u8> {
    port.send(sent).unwrap();
    let mut bytes = [0; 16];
    let num_bytes = port.receive(&mut bytes, MILLISECOND).unwrap();
    bytes[..num_bytes].to_vec()
}

/// Gates during and after an edge of the trigger input.
fn trigger(port: &mut ModelPort<VirtualArduino>) -> u8 {
    let mut seen = 0;
    for level in [true, false] {
        port.with(|model, _| model.exposure.stuck = Some(level));
        port.pass(2 * MILLISECOND);
        seen |= port.with(|model, _| model.gates());
    }
    seen
}

#[test]
fn skipped_triggers_show_patterns_only_with_the_defect() {
    for (defect, seen, count) in [(true, [1, 2, 1], 1), (false, [0, 0, 1], 1)] {
        let mut port = board(ArduinoDefects { counts_skipped: defect, ..ArduinoDefects::default() });
        assert_eq!(answer(&mut port, &[33, 0, 2, 1, 2]), [33, 0, 2]);
        assert_eq!(answer(&mut port, &[7, 2]), [7, 2]);
        assert_eq!(answer(&mut port, &[8]), [8]);
        assert_eq!([(); 3].map(|()| trigger(&mut port)), seen, "defect: {defect}");
        assert_eq!(answer(&mut port, &[9]), [9, count]);
    }
}

#[test]
fn half_a_command_makes_it_deaf_only_with_the_defect() {
    for (defect, seen) in [(true, 0), (false, 1)] {
        let mut port = board(ArduinoDefects { deaf_while_waiting: defect, ..ArduinoDefects::default() });
        answer(&mut port, &[33, 0, 1, 1]);
        answer(&mut port, &[8]);
        assert_eq!(answer(&mut port, &[3, 0]), [0; 0]);
        assert_eq!(trigger(&mut port), seen, "defect: {defect}");
        port.pass(Duration::from_secs(1));
        assert_eq!(trigger(&mut port), 1, "after a second it listens again");
    }
}

#[test]
fn a_refused_upload_is_executed_only_with_the_defect() {
    for (defect, open) in [(true, 1), (false, 0)] {
        let mut port =
            board(ArduinoDefects { executes_refused_uploads: defect, ..ArduinoDefects::default() });
        let upload = [[33, 0x9C, 0x40].as_slice(), &[1; 40_000]].concat();
        assert_eq!(answer(&mut port, &upload)[..3], [33, 0, 0]);
        assert_eq!(port.with(|model, _| model.gates()), open, "defect: {defect}");
    }
}
