//! Every command by its bytes.

use std::time::Duration;

use sofiscope_hal::{ErrorKind, Laser, Milliwatts, Properties};
use sofiscope_laserquantum_smd12::{DARK, Smd12, Smd12Settings};
use sofiscope_serial_line::{Line, ScriptedPort};

const OK: &str = "\r\n";
const WHO: [&str; 2] = ["VERSION?\r", "SMD12 1.0\r\n"];

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
        ["\r", ""],
        WHO,
        WHO,
        ["OFF\r", OK],
        ["STATUS?\r", "DISABLED\r\n"],
        ["STEN=NO\r", OK],
        WHO,
        ["CONTROL=POWER\r", OK],
        WHO,
        ["CONTROL?\r", "POWER\r\n"],
        WHO,
        ["POWER=0\r", OK],
    ])
}

fn open(port: &ScriptedPort) -> Smd12 {
    let line = Line::new(Box::new(port.clone()), "laser 561");
    let cap = Milliwatts::new(200.0).expect("it is finite");
    let settings = Smd12Settings { wavelength_nm: 561, version: "SMD12 1.0".into(), cap };
    Smd12::open(line, settings, Box::new(|| Duration::ZERO)).expect("the script answers as the laser does")
}

fn leaving(port: ScriptedPort) -> ScriptedPort {
    port.expect("\rOFF\r", "")
}

#[test]
fn opening_and_leaving() {
    let port = leaving(opening());
    let laser = open(&port);
    assert!(!laser.identity().simulated);
    drop(laser);
    port.assert_finished();
}

#[test]
fn power_is_set_in_tenths_of_a_milliwatt() {
    let port = leaving(opening().then(&[WHO, ["POWER=80.5\r", OK]]));
    let mut laser = open(&port);
    let refused = laser.set_power(Milliwatts::new(200.01).unwrap()).unwrap_err();
    assert_eq!(refused.kind(), ErrorKind::OutOfRange);
    laser.set_power(Milliwatts::new(80.57).unwrap()).unwrap();
    drop(laser);
    port.assert_finished();
}

#[test]
fn on_state_and_off() {
    let port = leaving(opening().then(&[
        WHO,
        ["POWER=0\r", OK],
        WHO,
        ["ON\r", OK],
        ["STATUS?\r", "ENABLED\r\n"],
        WHO,
        ["STATUS?\r", "ENABLED\r\n"],
        ["POWER?\r", "0mW\r\n"],
        ["OFF\r", OK],
        ["STATUS?\r", "DISABLED\r\n"],
    ]));
    let mut laser = open(&port);
    laser.switch_on().unwrap();
    laser.state().unwrap();
    laser.switch_off().unwrap();
    drop(laser);
    port.assert_finished();
}

#[test]
fn properties_are_read_and_nothing_is_written() {
    let timers =
        "PSU Time = 3 Hours\r\nLaser Enabled Time = 2 Hours\r\nLaser Operation Time = 1 Hours\r\n\r\n";
    let port = leaving(opening().then(&[
        WHO,
        ["CONTROL?\r", "POWER\r\n"],
        WHO,
        ["CURRENT?\r", "45%\r\n"],
        WHO,
        ["LASTEMP?\r", "25.3C\r\n"],
        WHO,
        ["PSUTEMP?\r", "30.0C\r\n"],
        WHO,
        ["TIMERS?\r", timers],
        WHO,
    ]));
    let mut laser = open(&port);
    let names: Vec<_> = laser.properties().unwrap().into_iter().map(|property| property.name).collect();
    assert_eq!(names[6..], ["PSU Time", "Laser Enabled Time", "Laser Operation Time"]);
    drop(laser);
    port.assert_finished();
}

#[test]
fn the_short_way_reads_nothing() {
    let port = leaving(opening().expect(DARK, ""));
    let mut laser = open(&port);
    laser.make_dark().unwrap();
    drop(laser);
    port.assert_finished();
    assert_eq!(DARK, b"\rOFF\r");
}
