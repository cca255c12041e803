//! Every command byte by byte, as in the table of the protocol; and a million answers that are none.

use proptest::prelude::*;
use sofiscope_hal::{ErrorKind, GateController, GatePattern, Volts};
use sofiscope_serial_line::{Line, ScriptedPort};

use crate::{ExposureLevel, MicroManagerArduino};

fn closing(port: ScriptedPort, triggers: u8) -> ScriptedPort {
    port.expect([1, 0], [1])
        .expect([9], [9, triggers])
        .expect([21], [21])
        .expect([1, 0], [1])
        .expect([22, 1], [22])
        .expect([2], [2, 0])
}

fn connecting() -> ScriptedPort {
    let port = ScriptedPort::new()
        .expect([30], "MM-Ard\r\n")
        .expect([31], "5\r\n")
        .expect([35], [35, 6])
        .expect([34], [34, 2])
        .expect([32], [32, 1, 0]);
    closing(port, 0)
}

fn connect(port: &ScriptedPort) -> Result<MicroManagerArduino, sofiscope_hal::DeviceError> {
    MicroManagerArduino::connect(Line::new(Box::new(port.clone()), "scripted"), ExposureLevel::High)
}

#[test]
fn every_command_has_its_bytes() {
    let port =
        closing(connecting(), 0).expect([1, 5], [1]).expect([2], [2, 5]).expect([3, 1, 8, 0], [3, 1, 8, 0]);
    let port = closing(port, 0).expect([33, 0, 3, 1, 0, 2], [33, 0, 3]).expect([8], [8]);
    let port = closing(port, 77).expect([2], [2, 0]);
    let port = closing(port, 0);
    let mut arduino = connect(&port).unwrap();
    arduino.arm().unwrap();
    arduino.set_gates(GatePattern(5)).unwrap();
    arduino.set_level(1, Volts::new(2.501).unwrap()).unwrap();
    arduino.begin_sequence(&[1, 0, 2].map(GatePattern)).unwrap();
    arduino.end_sequence().unwrap();
    assert_eq!(arduino.triggers_modulo_256(), 77);
    assert!(arduino.state().unwrap().open.is_closed());
    arduino.heartbeat().unwrap();
    arduino.disarm().unwrap();
    port.assert_finished();
}

#[test]
fn other_devices_are_not_taken_for_one() {
    let refused = |port: ScriptedPort| connect(&port).err().unwrap().kind();
    assert_eq!(refused(ScriptedPort::new().expect([30], "pgFocus\r\n")), ErrorKind::Identity);
    assert_eq!(
        refused(ScriptedPort::new().expect([30], "MM-Ard\r\n").expect([31], "2\r\n")),
        ErrorKind::Identity
    );
    assert_eq!(refused(ScriptedPort::new().expect([30], "").expect([30], "")), ErrorKind::Timeout);
}

#[test]
fn gates_that_stay_open_are_told() {
    let port = connecting().expect([1, 0], [1]).expect([9], [9, 0]).expect([21], [21]).expect([1, 0], [1]);
    let port = port.expect([22, 1], [22]).expect([2], [2, 4]);
    let port = port.expect([1, 0], [1]).expect([9], [9, 0]).expect([21], [21]).expect([1, 0], [1]);
    let port = port.expect([22, 1], [22]).expect([2], [2, 4]);
    let mut arduino = connect(&port).unwrap();
    assert_eq!(arduino.disarm().unwrap_err().kind(), ErrorKind::Fault);
    port.assert_finished();
}

#[test]
fn a_million_answers_that_are_none_are_not_taken_for_one() {
    let config = ProptestConfig { cases: 20_000, failure_persistence: None, ..ProptestConfig::default() };
    proptest!(config, |(answers in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..6), 50..51))| {
        for answer in answers {
            let port = ScriptedPort::new().expect([1, 1], [1]).expect([2], &answer);
            let mut board = crate::board::Board::open(Line::new(Box::new(port), "scripted")).unwrap();
            let [] = board.ask_echoed([1, 1], &[1], "setting gates").unwrap();
            let read: Result<[u8; 1], _> = board.ask([2], "reading");
            prop_assert_eq!(read.is_ok(), answer.len() >= 2 && answer[0] == 2, "{:?}", answer);
        }
    });
}
