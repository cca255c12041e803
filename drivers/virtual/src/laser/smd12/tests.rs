//! The laser by its bytes.

use super::*;
use crate::log::EmissionLog;
use crate::table::{OpticalTable, Quantity};

struct Bench {
    table: OpticalTable,
    laser: Smd12,
    now: Duration,
}

impl Bench {
    fn new(current_control: CurrentControl) -> Self {
        let table = OpticalTable::private().unwrap();
        let (log, began) = (EmissionLog::none(), Duration::ZERO);
        let place = Place { table: table.clone(), line: 1, wavelength_nm: 561, log, began };
        Self { table, laser: Smd12::new(place, 500.0, current_control), now: Duration::ZERO }
    }

    fn say(&mut self, command: &str) -> String {
        let mut bytes = Vec::new();
        self.laser.receive(format!("{command}\r").as_bytes(), self.now);
        self.now += Duration::from_millis(59);
        self.laser.advance(self.now, &mut bytes);
        assert!(bytes.is_empty(), "no answer before 60 ms");
        self.now += Duration::from_millis(61);
        self.laser.advance(self.now, &mut bytes);
        String::from_utf8(bytes).unwrap()
    }

    fn light_after(&mut self, time: Duration) -> f64 {
        self.now += time;
        self.laser.advance(self.now, &mut Vec::new());
        self.table.get(Quantity::Power(1))
    }
}

#[test]
fn worked_exchanges_are_those_of_the_adapters() {
    let mut bench = Bench::new(CurrentControl::Missing);
    assert_eq!(bench.say("VERSION?"), "SMD12 virtual 1.0\r\n");
    assert_eq!(bench.say("STATUS?"), "DISABLED\r\n");
    assert_eq!(bench.say("POWER=80"), "\r\n");
    assert_eq!(bench.say("ON"), "\r\n");
    assert_eq!(bench.say("STATUS?"), "ENABLED\r\n");
    assert_eq!(bench.say("CURRENT=30"), "Error 67\r\n");
    assert_eq!(bench.say("LASTEMP?"), "25.0C\r\n");
    assert_eq!(bench.say("STEN=NO"), "\r\n");
    assert!(!bench.laser.enabled_at_start());
    let timers = bench.say("TIMERS?");
    assert_eq!(timers.matches("\r\n").count(), 4);
    assert!(timers.ends_with("Laser Operation Time = 340 Hours\r\n\r\n"), "{timers:?}");
}

#[test]
fn power_rises_with_its_time_constant() {
    let mut bench = Bench::new(CurrentControl::Fitted);
    bench.say("POWER=100");
    bench.say("ON");
    let light = bench.light_after(Duration::from_millis(2880));
    assert!((light - 100.0 * (1.0 - (-1.0_f64).exp())).abs() < 0.1, "{light}");
    assert!(bench.light_after(Duration::from_secs(30)) > 99.9);
    bench.say("OFF");
    assert_eq!(bench.light_after(Duration::ZERO), 0.0);
}

#[test]
fn an_open_interlock_disables_it_for_good() {
    let mut bench = Bench::new(CurrentControl::Fitted);
    bench.say("POWER=100");
    bench.say("ON");
    assert!(bench.light_after(Duration::from_secs(1)) > 0.0);
    bench.table.set(Quantity::InterlockOpen, 1.0);
    assert_eq!(bench.light_after(LOOKS_EVERY), 0.0);
    assert_eq!(bench.say("ON"), "\r\n", "taken, and dark nevertheless");
    assert_eq!(bench.say("STATUS?"), "DISABLED\r\n");
    bench.table.set(Quantity::InterlockOpen, 0.0);
    assert_eq!(bench.light_after(Duration::from_secs(9)), 0.0);
}

#[test]
fn faults_show_on_the_line() {
    let mut bench = Bench::new(CurrentControl::Fitted);
    bench.laser.faults = Faults { etx: true, blank: true, timers_without_end: true, ..Faults::default() };
    assert_eq!(bench.say("STATUS?"), "\u{3} DISABLED\r\n");
    assert_eq!(bench.say("TIMERS?").matches("\r\n").count(), 3);
    bench.laser.faults = Faults { refuses_with: Some(12), ..Faults::default() };
    assert_eq!(bench.say("ON"), "Error 12\r\n");
    assert_eq!(bench.say("POWER=9"), "Error 12\r\n");
    bench.laser.faults = Faults { stuck_on: true, ..Faults::default() };
    bench.say("POWER=50");
    bench.say("ON");
    assert_eq!(bench.say("OFF"), "\r\n");
    assert!(bench.light_after(Duration::from_secs(10)) > 40.0, "acknowledged, and on nevertheless");
}
