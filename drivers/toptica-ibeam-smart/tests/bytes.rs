//! Every command by its bytes.

use sofiscope_hal::{ErrorKind, Laser, Milliwatts};
use sofiscope_serial_line::{Line, ScriptedPort};
use sofiscope_toptica_ibeam_smart::{DARK, IbeamSettings, IbeamSmart, Modulation};

const OK: &str = "\r\n[OK]\r\n";
const WHO: [&str; 2] = ["serial\r\n", "\r\nSN: S-1\r\n[OK]\r\n"];
const LEAVE: [&str; 3] = ["di 0\r\n", "la off\r\n", "prompt on\r\n"];

trait Script {
    fn then(self, exchanges: &[[&str; 2]]) -> Self;
}

impl Script for ScriptedPort {
    fn then(self, exchanges: &[[&str; 2]]) -> Self {
        exchanges.iter().fold(self, |port, [command, answer]| port.expect(command, answer))
    }
}

fn opening() -> ScriptedPort {
    ScriptedPort::new().then(&[
        ["echo off\r\n", "echo off\r\nCMD> "],
        ["prom off\r\n", OK],
        ["talk usual\r\n", OK],
        WHO,
        ["la off\r\n", OK],
        WHO,
        ["di 0\r\n", OK],
        ["sta la\r\n", "\r\nOFF\r\n[OK]\r\n"],
        WHO,
        ["id\r\n", "\r\niBEAM-SMART-488-S-HP\r\n[OK]\r\n"],
        WHO,
        ["version\r\n", "\r\niBPs-001A01-05\r\n[OK]\r\n"],
        WHO,
        ["sh sat\r\n", "\r\nPmax: 50 mW\r\nCH2 setp: 10.0 mW\r\n[OK]\r\n"],
        ["fine off\r\n", OK],
        WHO,
        ["ch 1 pow 0\r\n", OK],
        WHO,
        ["ch 2 pow 0\r\n", OK],
        WHO,
        ["en ext\r\n", OK],
        ["sta ext\r\n", "\r\nON\r\n[OK]\r\n"],
        ["sh level pow\r\n", "\r\nCH1, PWR: 0.000 mW\r\nCH2, PWR: 0.000 mW\r\n[OK]\r\n"],
    ])
}

fn open(port: &ScriptedPort) -> IbeamSmart {
    let line = Line::new(Box::new(port.clone()), "laser 488");
    let cap = Milliwatts::new(60.0).expect("it is finite");
    let settings =
        IbeamSettings { wavelength_nm: 488, serial: "S-1".into(), cap, modulation: Modulation::External };
    IbeamSmart::open(line, settings).expect("the script answers as the laser does")
}

fn leaving(port: ScriptedPort) -> ScriptedPort {
    LEAVE.iter().fold(port, |port, command| port.expect(command, OK))
}

#[test]
fn opening_and_leaving() {
    let port = leaving(opening());
    let laser = open(&port);
    assert_eq!(
        laser.power_cap(),
        Milliwatts::new(50.0).unwrap(),
        "its own limit is below that of the configuration"
    );
    assert!(!laser.identity().simulated);
    drop(laser);
    port.assert_finished();
}

#[test]
fn power_is_set_in_whole_microwatts_and_read_back() {
    let level = "\r\nCH1, PWR: 0.000 mW\r\nCH2, PWR: 5.000 mW\r\n[OK]\r\n";
    let port = leaving(opening().then(&[["ch 2 pow 5000 mic\r\n", OK], ["sh level pow\r\n", level]]));
    let mut laser = open(&port);
    let refused = laser.set_power(Milliwatts::new(50.001).unwrap()).unwrap_err();
    assert_eq!(refused.kind(), ErrorKind::OutOfRange);
    laser.set_power(Milliwatts::new(5.000_3).unwrap()).unwrap();
    drop(laser);
    port.assert_finished();
}

#[test]
fn on_state_and_off() {
    let levels = "\r\nCH1, PWR: 0.000 mW\r\nCH2, PWR: 0.000 mW\r\n[OK]\r\n";
    let on = "\r\nON\r\n[OK]\r\n";
    let port = leaving(opening().then(&[
        WHO,
        ["sh level pow\r\n", levels],
        ["en 1\r\n", OK],
        WHO,
        ["en 2\r\n", OK],
        ["sta ch 2\r\n", on],
        ["la on\r\n", OK],
        ["sta la\r\n", on],
        WHO,
        ["sta la\r\n", on],
        ["sh pow\r\n", "\r\nPIC  = 000000 uW  \r\n[OK]\r\n"],
        ["sh level pow\r\n", levels],
        ["la off\r\n", OK],
        WHO,
        ["di 0\r\n", OK],
        ["sta la\r\n", "\r\nOFF\r\n[OK]\r\n"],
    ]));
    let mut laser = open(&port);
    laser.switch_on().unwrap();
    laser.state().unwrap();
    laser.switch_off().unwrap();
    drop(laser);
    port.assert_finished();
}

#[test]
fn the_short_way_reads_nothing() {
    let port = opening().expect("di 0\r\n", "").expect("la off\r\n", "");
    let port = leaving(port);
    let mut laser = open(&port);
    laser.make_dark().unwrap();
    drop(laser);
    port.assert_finished();
    assert_eq!(DARK, b"di 0\r\nla off\r\n");
}
