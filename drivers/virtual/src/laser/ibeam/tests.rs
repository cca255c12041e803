//! The laser by its bytes.

use super::*;
use crate::log::EmissionLog;
use crate::table::{OpticalTable, Quantity};

struct Bench {
    table: OpticalTable,
    laser: IbeamSmart,
    now: Duration,
}

impl Bench {
    fn at_power_up() -> Self {
        let table = OpticalTable::private().unwrap();
        let (log, began) = (EmissionLog::none(), Duration::ZERO);
        let place = Place { table: table.clone(), line: 0, wavelength_nm: 488, log, began };
        Self { table, laser: IbeamSmart::new(place, "iBEAM-SMART-TEST", 200.0), now: Duration::ZERO }
    }

    fn clean() -> Self {
        let mut bench = Self::at_power_up();
        bench.say("echo off");
        bench.say("prom off");
        bench
    }

    fn say(&mut self, command: &str) -> String {
        self.say_after(command, Duration::from_millis(100))
    }

    fn say_after(&mut self, command: &str, pause: Duration) -> String {
        self.now += pause;
        let mut bytes = Vec::new();
        self.laser.advance(self.now, &mut bytes);
        bytes.clear();
        self.laser.receive(format!("{command}\r\n").as_bytes(), self.now);
        self.now += ANSWERS_AFTER;
        self.laser.advance(self.now, &mut bytes);
        String::from_utf8(bytes).unwrap()
    }

    fn light(&mut self) -> f64 {
        self.now += LOOKS_EVERY;
        self.laser.advance(self.now, &mut Vec::new());
        self.table.get(Quantity::Power(0))
    }
}

#[test]
fn at_power_up_it_announces_itself_echoes_and_prompts() {
    let mut bench = Bench::at_power_up();
    let mut banner = Vec::new();
    bench.laser.advance(ANSWERS_AFTER, &mut banner);
    assert!(String::from_utf8(banner).unwrap().ends_with("CMD> "));
    assert_eq!(bench.say("sta la"), "status laser\r\nOFF\r\nCMD> ");
    assert_eq!(bench.say("echo off"), "echo off\r\nCMD> ");
    assert_eq!(bench.say("prom off"), "\r\n[OK]\r\n");
    assert_eq!(bench.say("talk usual"), "\r\n[OK]\r\n");
}

#[test]
fn worked_exchanges_are_those_of_the_manual() {
    let mut bench = Bench::clean();
    assert_eq!(bench.say("sta la"), "\r\nOFF\r\n[OK]\r\n");
    assert_eq!(bench.say("ch 2 pow 5000 mic"), "\r\n[OK]\r\n");
    assert_eq!(bench.say("en 2"), "\r\n[OK]\r\n");
    assert_eq!(bench.say("la on"), "\r\n[OK]\r\n");
    let power = bench.say("sh pow");
    assert!(power.starts_with("\r\nPIC  = 0049") && power.ends_with(" uW  \r\n[OK]\r\n"), "{power:?}");
    assert_eq!(bench.say("ch 9 pow 1"), "\r\n%SYS-E-00025, parameter error\r\n[OK]\r\n");
    assert_eq!(bench.say("serial"), "\r\nSN: iBEAM-SMART-TEST\r\n[OK]\r\n");
    assert!(bench.say("show level power").contains("CH2, PWR: 5.000 mW\r\n"));
}

#[test]
fn light_needs_master_switch_channel_and_interlock() {
    let mut bench = Bench::clean();
    bench.say("ch 2 pow 5");
    bench.say("la on");
    assert_eq!(bench.light(), 0.0, "a power for a disabled channel is taken and gives no light");
    bench.say("en 2");
    assert_eq!(bench.light(), 5.0);
    bench.table.set(Quantity::InterlockOpen, 1.0);
    assert_eq!(bench.light(), 0.0);
    bench.table.set(Quantity::InterlockOpen, 0.0);
    assert_eq!(bench.light(), 0.0, "closing the interlock does not switch on again");
    assert_eq!(bench.say("sta la"), "\r\nOFF\r\n[OK]\r\n");
    bench.say("la on");
    assert_eq!(bench.light(), 5.0);
    bench.say("di 0");
    assert_eq!(bench.light(), 0.0);
}

#[test]
fn under_external_modulation_it_measures_what_the_gate_lets_through() {
    let mut bench = Bench::clean();
    for command in ["ch 1 pow 0", "en 1", "ch 2 pow 5", "en 2", "en ext", "la on"] {
        assert_eq!(bench.say(command), "\r\n[OK]\r\n", "{command}");
    }
    assert_eq!(bench.light(), 5.0, "what leaves the head through an open gate");
    assert_eq!(bench.say("sh pow"), "\r\nPIC  = 000000 uW  \r\n[OK]\r\n");
    bench.table.set(Quantity::Gates, 1.0);
    assert!(bench.say("sh pow").starts_with("\r\nPIC  = 0049"));
}

#[test]
fn commands_in_haste_let_the_answers_lag_until_it_is_reset() {
    let mut bench = Bench::clean();
    bench.say("sta la");
    assert_eq!(bench.say_after("serial", Duration::from_millis(5)), "\r\nOFF\r\n[OK]\r\n");
    assert_eq!(bench.say("sta clip"), "\r\nSN: iBEAM-SMART-TEST\r\n[OK]\r\n");
    assert_eq!(bench.say("reset system"), "");
    bench.now += Duration::from_secs(7);
    assert_eq!(bench.say("sta clip"), "status clip\r\nGOOD\r\nCMD> ");
}
