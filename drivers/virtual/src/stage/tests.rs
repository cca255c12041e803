//! The model talks as the manual says.

use super::*;
use sofiscope_serial_line::ModelPort;
use sofiscope_serial_line::Port;

struct Bench(ModelPort<TangoModel>);

impl Bench {
    fn new() -> Self {
        Self(ModelPort::new(TangoModel::new("20260001", OpticalTable::private().unwrap())))
    }

    /// Sends a line and gives everything that comes back within 50 ms.
    fn ask(&mut self, line: &str) -> String {
        self.0.send(format!("{line}\r").as_bytes()).unwrap();
        self.0.pass(Duration::from_millis(50));
        self.heard()
    }

    fn heard(&mut self) -> String {
        let mut bytes = [0; 256];
        let num_bytes = self.0.receive(&mut bytes, Duration::ZERO).unwrap();
        String::from_utf8(bytes[..num_bytes].to_vec()).unwrap()
    }

    fn table(&self, quantity: Quantity) -> f64 {
        self.0.with(|model, _| model.table.get(quantity))
    }
}

fn homed() -> Bench {
    let mut bench = Bench::new();
    for command in ["!autostatus 0", "!cal", "!rm"] {
        assert_eq!(bench.ask(command), "");
        bench.0.pass(Duration::from_secs(20));
    }
    assert_eq!(bench.ask("!dim 1 1"), "");
    bench
}

#[test]
fn questions_are_answered_as_in_the_manual() {
    let mut bench = Bench::new();
    assert_eq!(bench.ask(""), "");
    assert!(bench.ask("?version").starts_with("TANGO-DT2-SIMULATED, Version"));
    for (question, answer) in [
        ("?readsn", "20260001\r"),
        ("?det", "32\r"),
        ("?dim", "2 2\r"),
        ("?pos", "0.0000 0.0000\r"),
        ("?POS x", "0.0000\r"),
        ("?statusaxis", "@@--.\r"),
        ("?sa y", "@\r"),
        ("?vel x", "5.0000\r"),
        ("?lim x", "-1000.0000 1000.0000\r"),
        ("?calst", "0 0\r"),
        ("?autostatus", "1\r"),
        ("?err", "0\r"),
    ] {
        assert_eq!(bench.ask(question), answer, "{question}");
    }
}

#[test]
fn wrong_commands_have_their_codes_and_do_nothing() {
    let mut bench = homed();
    let place = bench.ask("?pos");
    for (command, code) in [
        ("!nonsense 1", "4\r"),
        ("?nonsense", "4\r"),
        ("moa 1 2", "7\r"),
        ("!moa 1", "6\r"),
        ("!moa 1 2 3", "6\r"),
        ("!moa 1  2", "5\r"),
        ("!moa 1 NaN", "5\r"),
        ("!moa 1 1e3", "5\r"),
        ("!moa x inf", "5\r"),
        ("!moa z 1", "1\r"),
        ("!moa 999999 0", "32\r"),
        ("!moa 0 -0.1", "32\r"),
        ("!accel x 11", "5\r"),
        ("!dim 11 1", "5\r"),
    ] {
        assert_eq!(bench.ask(command), "", "{command}");
        assert_eq!(bench.ask("?err"), code, "{command}");
        assert_eq!(bench.ask("?err"), code, "reading does not clear");
        assert_eq!(bench.ask("!err"), "");
        assert_eq!(bench.ask("?err"), "0\r");
        assert_eq!(bench.ask("?statusaxis"), "DD--.\r", "{command}");
    }
    assert_eq!(bench.ask("?pos"), place);
}

#[test]
fn homing_finds_the_switches_and_the_limits() {
    let mut bench = homed();
    assert_eq!(bench.ask("?statusaxis"), "DD--.\r");
    assert_eq!(bench.ask("?calst"), "3 3\r");
    assert_eq!(bench.ask("?lim x"), "0.0 120000.0\r");
    assert_eq!(bench.ask("?pos"), "120000.0 80000.0\r");
}

#[test]
fn a_move_takes_its_time_and_shows_on_the_table() {
    let mut bench = homed();
    assert_eq!(bench.ask("!moa 100000 80000"), "");
    assert_eq!(bench.ask("?statusaxis"), "M@--.\r");
    assert_eq!(bench.table(Quantity::StageMoving), 1.0);
    bench.0.pass(Duration::from_millis(1850));
    assert_eq!(bench.ask("?statusaxis"), "M@--.\r");
    bench.0.pass(Duration::from_millis(100));
    assert_eq!(bench.ask("?statusaxis"), "@@--.\r");
    assert_eq!(bench.ask("?pos"), "100000.0 80000.0\r");
    assert_eq!((bench.table(Quantity::StageX), bench.table(Quantity::StageMoving)), (100_000.0, 0.0));
}

#[test]
fn the_abort_works_anywhere_in_the_stream() {
    let command = b"!moa 20000 20000\r?pos\r";
    for place in 0..=command.len() {
        let mut bench = homed();
        bench.ask("!moa 60000 40000");
        bench.0.send(&command[..place]).unwrap();
        bench.0.send(&[ABORT]).unwrap();
        bench.0.pass(Duration::from_millis(60));
        if place <= 16 {
            assert!(!bench.0.with(|model, _| model.was_moving), "stopped before the end of the command");
            bench.0.send(&[ABORT]).unwrap();
        }
        bench.0.send(&command[place..]).unwrap();
        bench.0.send(&[ABORT]).unwrap();
        bench.0.pass(Duration::from_millis(60));
        assert!(!bench.0.with(|model, _| model.was_moving), "{place}");
        bench.heard();
        assert_eq!(bench.ask("?statusaxis"), "EE--.\r");
    }
}

#[test]
fn autostatus_speaks_unasked() {
    let mut bench = Bench::new();
    assert_eq!(bench.ask("!mor 10 0"), "");
    bench.0.pass(Duration::from_secs(2));
    assert_eq!(bench.heard(), "@@--.\r");
}

#[test]
fn hands_move_it_only_with_the_joystick_on() {
    let mut bench = homed();
    bench.0.with(|model, _| model.push([-10.0, 0.0]));
    assert_eq!(bench.ask("?pos"), "120000.0 80000.0\r");
    bench.ask("!joy 2");
    assert_eq!(bench.ask("?statusaxis"), "JJ--.\r");
    bench.0.with(|model, _| model.push([-10.0, 0.0]));
    assert_eq!(bench.ask("?pos"), "119990.0 80000.0\r");
    bench.ask("!moa 0 0");
    assert_eq!(bench.ask("?err"), "11\r");
}

#[test]
fn a_move_into_a_switch_says_so() {
    let mut bench = Bench::new();
    bench.ask("!autostatus 0");
    bench.ask("!mor -100 0");
    bench.0.pass(Duration::from_secs(10));
    assert_eq!(bench.ask("?statusaxis"), "S@--.\r");
    assert_eq!(bench.ask("?err"), "12\r");
}

#[test]
fn jams_end_as_they_are_called() {
    for (jam, letters) in [(Jam::Moving, "M"), (Jam::Timeout, "T"), (Jam::Switch, "S"), (Jam::Short, "@")] {
        let mut bench = homed();
        bench.0.with(|model, _| model.faults().jam = Some(jam));
        bench.ask("!moa 0 0");
        bench.0.pass(Duration::from_secs(20));
        assert_eq!(bench.ask("?statusaxis x"), format!("{letters}\r"));
        assert_eq!(bench.ask("?pos x"), "60000.0\r");
    }
}

#[test]
fn late_and_missing_answers_are_late_and_missing() {
    let mut bench = homed();
    bench.0.with(|model, _| model.faults().late = Some(Duration::from_secs(2)));
    assert_eq!(bench.ask("?dim"), "");
    bench.0.pass(Duration::from_secs(2));
    assert_eq!(bench.heard(), "1 1\r");
    bench.0.with(|model, _| model.faults().silent = 1);
    assert_eq!((bench.ask("?dim"), bench.ask("?dim")), (String::new(), "1 1\r".to_owned()));
}
