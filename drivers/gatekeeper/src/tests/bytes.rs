//! Every command byte by byte; and a million lines of garbage. Check sums were computed elsewhere (`binascii.crc_hqx`
//! of Python) where they stand here as numbers.

use std::time::Duration;

use proptest::prelude::*;
use sofiscope_hal::{ErrorKind, GateController, GatePattern, TriggerSource, Volts};
use sofiscope_serial_line::{Line, ScriptedPort};

use crate::frame::{self, crc};
use crate::{Gatekeeper, GatekeeperSettings, Step};

/// A line with its check sum.
fn framed(digits: &str) -> String {
    let digits = digits.replace(' ', "");
    let bytes: Vec<u8> =
        (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap()).collect();
    format!(":{digits}{:04X}\n", crc(&bytes))
}

struct Script(ScriptedPort);

impl Script {
    fn then(self, sent: &str, answer: &str) -> Self {
        Self(self.0.expect(framed(sent), if answer.is_empty() { String::new() } else { framed(answer) }))
    }
}

/// Up to the end of connecting, for a board with one gate and one level in epoch 0x0102.
fn connected() -> Script {
    Script(ScriptedPort::new())
        .then("0001 01 0000", "0001 81 0102 00 474B 01 01 0000002A 01 01 0100 00FA 00 A24C")
        .then("0002 03 0102", "0002 83 0102 00 00 00 05 A24C 00000000 0000 0000")
        .then("0003 07 0102 00 0000C350", "0003 87 0102 00 00 00 05 1234 00000000 0000 0000")
}

fn settings() -> GatekeeperSettings {
    GatekeeperSettings {
        serial: Some(42),
        longest_on_time: vec![Duration::from_millis(50)],
        full_scale: Volts::new(5.0).unwrap(),
        pulse_width: Duration::from_millis(1),
        step: Step::OwnClock { delay: Duration::from_micros(16), open: Duration::from_micros(32) },
    }
}

fn connect(script: &Script) -> Gatekeeper {
    Gatekeeper::connect(Line::new(Box::new(script.0.clone()), "scripted"), settings()).unwrap()
}

#[test]
fn check_sums_are_those_of_the_tables() {
    assert_eq!(crc(b"123456789"), 0x29B1);
    assert_eq!(framed("0001 01 0000"), ":00010100005088\n");
}

#[test]
fn every_command_has_its_bytes() {
    // The config CRC for one gate of 50 ms and seven that are not there.
    let config = format!("{:04X}", settings().config_crc(1));
    let state = |flags: &str, open: &str| format!("00 {open} {flags} 00 {config} 00000000 0000 0000");
    let (off, on) = (state("00", "00"), state("01", "00"));
    let script = connected()
        .then("0004 06 0102 00 0800", &format!("0004 86 0102 {off}"))
        .then("0005 03 0102", &format!("0005 83 0102 {off}"))
        .then(&format!("0006 02 0102 {config}"), &format!("0006 82 0102 {on}"))
        .then("0007 05 0102 01", &format!("0007 85 0102 {}", state("01", "01")))
        .then("0008 04 0102", &format!("0008 84 0102 {}", state("01", "01")))
        .then("0009 0A 0102", &format!("0009 8A 0102 {on}"))
        .then("000A 08 0102 0000 010001", &format!("000A 88 0102 {on}"))
        .then("000B 09 0102 0003 EB8D 01", &format!("000B 89 0102 {on}"))
        .then("000C 0B 0102 00002710 00000003 000003E8 00000010 00000020", &format!("000C 8B 0102 {on}"))
        .then("000D 0C 0102", &format!("000D 8C 0102 {on}"))
        .then("000E 0A 0102", &format!("000E 8A 0102 {on}"))
        .then("000F 0D 0102", &format!("000F 8D 0102 {on}"))
        .then("0010 03 0102", &format!("0010 83 0102 {off}"));
    let mut gatekeeper = connect(&script);
    gatekeeper.set_level(0, Volts::new(2.501).unwrap()).unwrap();
    gatekeeper.arm().unwrap();
    gatekeeper.set_gates(GatePattern(1)).unwrap();
    gatekeeper.heartbeat().unwrap();
    gatekeeper.begin_sequence(&[GatePattern(1), GatePattern(0), GatePattern(1)]).unwrap();
    gatekeeper.start(Duration::from_millis(10), Some(3)).unwrap();
    gatekeeper.stop().unwrap();
    gatekeeper.end_sequence().unwrap();
    let state = gatekeeper.state().unwrap();
    assert_eq!((state.epoch, state.armed, state.trip), (0x0102, true, None));
    gatekeeper.disarm().unwrap();
    script.0.assert_finished();
}

#[test]
fn a_lost_answer_is_asked_for_with_the_same_number() {
    let state = "00 00 00 05 1234 00000000 0000 0000";
    let script = connected()
        .then("0004 0D 0102", "")
        .then("0004 0D 0102", "")
        .then("0004 0D 0102", &format!("0004 8D 0102 {state}"));
    let mut gatekeeper = connect(&script);
    gatekeeper.state().unwrap();
    script.0.assert_finished();
}

#[test]
fn three_strikes_are_an_error_and_the_next_command_begins_with_hello() {
    let mut script = connected();
    for _ in 0..3 {
        script = script.then("0004 0D 0102", "");
    }
    let script = script
        .then("0005 01 0000", "0005 81 0102 00 474B 01 01 0000002A 01 01 0100 00FA 00 A24C")
        .then("0006 0D 0102", "0006 8D 0102 00 00 00 05 1234 00000000 0000 0000");
    let mut gatekeeper = connect(&script);
    assert_eq!(gatekeeper.state().unwrap_err().kind(), ErrorKind::Timeout);
    gatekeeper.state().unwrap();
    script.0.assert_finished();
}

#[test]
fn answers_to_others_are_read_past() {
    let state = "00 00 00 05 1234 00000000 0000 0000";
    let ours = framed(&format!("0004 8D 0102 {state}"));
    let others = [
        framed(&format!("0003 8D 0102 {state}")),
        framed(&format!("0004 84 0102 {state}")),
        ours.replace('5', "6"),
        ours.to_lowercase(),
        "\n\u{0}:::\n".to_owned(),
        format!("{}{}", &ours[..12], &ours),
    ];
    for other in others {
        // Joined to the front of the answer, whole or torn.
        let mut port = connected();
        port.0 = port.0.expect(framed("0004 0D 0102"), format!("{other}{ours}"));
        let mut gatekeeper = connect(&port);
        assert!(!gatekeeper.state().unwrap().armed, "{other:?}");
    }
}

#[test]
fn a_million_lines_of_garbage_are_no_answer() {
    let config = ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() };
    let answer = framed("0004 8D 0102 00 FF 01 00 1234 00000000 0000 0000").into_bytes();
    let answer = &answer[..answer.len() - 1];
    proptest!(config, |(seed in 1_u64.., kind in 0_u8..3)| {
        let mut dice = seed;
        let mut throw = |below: u64| {
            dice ^= dice << 13;
            dice ^= dice >> 7;
            dice ^= dice << 17;
            dice % below
        };
        for _ in 0..1000 {
            let mut line = answer.to_vec();
            match kind {
                0 => line = (0..throw(60)).map(|_| throw(256) as u8).collect(),
                1 => {
                    let at = throw(line.len() as u64) as usize;
                    line[at] ^= 1 << throw(8);
                }
                _ => {
                    let [from, to] = [throw(line.len() as u64), throw(line.len() as u64)].map(|at| at as usize);
                    line.drain(from.min(to)..=from.max(to));
                }
            }
            prop_assert_eq!(frame::read(&line), None, "{}", line.escape_ascii());
        }
    });
    assert!(frame::read(answer).is_some());
}
