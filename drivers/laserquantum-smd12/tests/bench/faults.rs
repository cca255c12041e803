//! Its contract, and the faults of lasers and lines.

use std::time::Duration;

use sofiscope_hal::{Emission, ErrorKind, Laser, Properties, PropertyValue};
use sofiscope_laserquantum_smd12::{DARK, Ramp};

use crate::bench::{Bench, CAP_MW, Rig, VERSION, mw};

#[test]
fn the_laser_keeps_its_contract() {
    let bench = Bench::new();
    let laser = bench.open().unwrap();
    sofiscope_hal::conformance::laser(&mut Rig { bench, laser });
}

#[test]
fn it_says_that_it_is_virtual_and_never_emits_by_itself_at_power_up() {
    let bench = Bench::new();
    assert!(bench.model(|model, _| model.enabled_at_start()));
    let laser = bench.open().unwrap();
    assert!(laser.identity().simulated);
    assert!(!bench.model(|model, _| model.enabled_at_start()));
}

#[test]
fn another_identity_is_refused_and_left_alone() {
    let bench = Bench::new();
    bench.model(|model, now| model.left_on(5.0, now));
    let error = bench.open_as("SMD12 2.0").err().unwrap();
    assert_eq!(error.kind(), ErrorKind::Identity);
    assert!(error.to_string().contains(VERSION), "{error}");
    assert_eq!(bench.table.get(sofiscope_virtual::table::Quantity::Power(1)), 5.0);
}

#[test]
fn a_laser_that_was_left_on_is_dark_after_opening_and_after_dropping() {
    let mut bench = Bench::new();
    bench.model(|model, now| model.left_on(50.0, now));
    assert!(bench.light() > 49.0);
    let laser = bench.open().unwrap();
    assert_eq!(bench.light(), 0.0);
    drop(laser);
    drop(bench.bright());
    assert_eq!(bench.light(), 0.0);
}

#[test]
fn switching_on_does_not_wait_for_the_ramp() {
    let bench = Bench::new();
    let mut laser = bench.open().unwrap();
    laser.set_power(mw(100.0)).unwrap();
    let begun = bench.now();
    laser.switch_on().unwrap();
    assert!(bench.now() - begun < Duration::from_secs(2), "{:?}", bench.now() - begun);
    let mut port = bench.port.again();
    let mut seen = Vec::new();
    for _ in 0..40 {
        seen.push(laser.state().unwrap().power_measured.unwrap().value());
        if laser.ramp() == Ramp::Steady {
            break;
        }
        port.pass(Duration::from_millis(500));
    }
    assert_eq!(laser.ramp(), Ramp::Steady);
    assert!(seen.len() > 5 && seen[0] < 50.0 && seen.is_sorted_by(|a, b| *a <= b + 2.0), "{seen:?}");
}

#[test]
fn less_power_is_a_ramp_and_no_fault() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    laser.set_power(mw(20.0)).unwrap();
    assert!(matches!(laser.ramp(), Ramp::Rising { .. }));
    for _ in 0..20 {
        assert_eq!(laser.state().unwrap().fault, None);
        bench.port.pass(Duration::from_secs(1));
    }
    assert_eq!(laser.ramp(), Ramp::Steady);
}

#[test]
fn enabled_and_dark_is_a_fault_after_a_minute() {
    let bench = Bench::new();
    let mut laser = bench.open().unwrap();
    laser.set_power(mw(100.0)).unwrap();
    bench.model(|model, _| model.faults.dead_diode = true);
    laser.switch_on().unwrap();
    let mut port = bench.port.again();
    port.pass(Duration::from_secs(58));
    assert_eq!(laser.state().unwrap().emission, Emission::On);
    port.pass(Duration::from_secs(3));
    let error = laser.state().unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Fault);
    assert!(error.to_string().contains("interlock"), "{error}");
    assert_eq!(laser.state().unwrap().emission, Emission::Off, "it was told to be dark");
}

#[test]
fn a_key_that_is_off_is_a_fault_at_once() {
    let bench = Bench::new();
    let mut laser = bench.open().unwrap();
    bench.model(|model, _| model.faults.key_off = true);
    let error = laser.switch_on().unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Fault);
    assert!(error.to_string().contains("DISABLED"), "{error}");
}

#[test]
fn off_that_is_acknowledged_and_not_done_is_a_fault_within_two_seconds() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    bench.model(|model, _| model.faults.stuck_on = true);
    let begun = bench.now();
    let error = laser.switch_off().unwrap_err();
    assert!(bench.now() - begun < Duration::from_secs(2), "{:?}", bench.now() - begun);
    assert_eq!(error.kind(), ErrorKind::Fault);
    assert!(error.to_string().contains("still ENABLED"), "{error}");
    assert!(laser.state().is_err(), "it emits, and nobody has switched it on");
}

#[test]
fn off_is_confirmed_within_half_a_second() {
    for _ in 0..20 {
        let mut bench = Bench::new();
        let mut laser = bench.bright();
        let begun = bench.now();
        laser.switch_off().unwrap();
        assert!(bench.now() - begun <= Duration::from_millis(500), "{:?}", bench.now() - begun);
    }
}

#[test]
fn a_power_that_is_off_by_more_than_a_tenth_is_a_fault_and_dark() {
    for (set_mw, power_error) in [(100.0, 0.15), (100.0, -0.15), (CAP_MW, 0.06)] {
        let mut bench = Bench::new();
        let mut laser = bench.bright();
        laser.set_power(mw(set_mw)).unwrap();
        bench.port.pass(Duration::from_secs(30));
        assert_eq!(laser.state().unwrap().fault, None);
        bench.model(|model, _| model.faults.power_error = power_error);
        bench.port.pass(Duration::from_secs(30));
        assert_eq!(laser.state().unwrap_err().kind(), ErrorKind::Fault, "{set_mw} {power_error}");
        assert_eq!(bench.light(), 0.0, "{set_mw} {power_error}");
    }
}

#[test]
fn error_numbers_are_told() {
    let bench = Bench::new();
    let mut laser = bench.open().unwrap();
    bench.model(|model, _| model.faults.refuses_with = Some(67));
    let error = laser.set_power(mw(10.0)).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Fault);
    assert!(error.to_string().contains("error 67"), "{error}");
}

#[test]
fn the_hour_meters_do_not_shift_the_next_answer() {
    for missing in [false, true] {
        let bench = Bench::new();
        let mut laser = bench.open().unwrap();
        bench.model(|model, _| model.faults.timers_without_end = missing);
        let properties = laser.properties().unwrap();
        let hours = properties.iter().find(|property| property.name == "Laser Operation Time").unwrap();
        assert_eq!(hours.value, PropertyValue::Text("340 Hours".into()));
        assert_eq!(laser.state().unwrap().emission, Emission::Off);
    }
}

#[test]
fn a_late_answer_is_not_taken_for_the_next() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    bench.model(|model, _| model.faults.delay = Duration::from_millis(1200));
    assert!(laser.state().is_err());
    bench.model(|model, _| model.faults.delay = Duration::ZERO);
    assert_eq!(laser.state().unwrap().emission, Emission::Off, "three times late: it was told to be dark");
    assert_eq!(bench.light(), 0.0);
}

#[test]
fn etx_blanks_garbage_and_lost_bytes_are_overcome_without_losing_the_light() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    for fault in 0..5 {
        bench.port.with(|wire, _| match fault {
            0 => wire.model().faults.etx = true,
            1 => wire.model().faults.blank = true,
            2 => wire.faults().garbage = vec![0xFF, 0x00, b'E', b'N', b'\r', b'\n'],
            3 => wire.faults().swallow = 4,
            _ => wire.faults().pause = Duration::from_millis(4),
        });
        assert_eq!(laser.state().unwrap().emission, Emission::On, "fault {fault}");
        assert!((bench.light() - 100.0).abs() < 0.1, "fault {fault}");
    }
}

#[test]
fn a_dead_line_is_told_and_told_to_be_dark() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    bench.model(|model, _| model.faults.silent = true);
    let begun = bench.now();
    assert_eq!(laser.switch_off().unwrap_err().kind(), ErrorKind::Timeout);
    assert!(bench.now() - begun < Duration::from_secs(2), "{:?}", bench.now() - begun);
    assert_eq!(bench.light(), 0.0, "it does not answer, but it hears");
}

#[test]
fn an_unplugged_line_is_lost_and_nothing_comes_on_again() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    bench.port.with(|wire, _| wire.faults().unplugged = true);
    for error in [laser.state().err(), laser.switch_off().err(), laser.make_dark().err()] {
        assert_eq!(error.map(|error| error.kind()), Some(ErrorKind::Lost));
    }
    bench.port.with(|wire, _| wire.faults().unplugged = false);
    assert!(laser.state().is_err(), "it still emits, and nobody has switched it on");
    assert_eq!(bench.light(), 0.0);
}

#[test]
fn the_bytes_of_darkness_need_no_driver() {
    let mut bench = Bench::new();
    let laser = bench.bright();
    sofiscope_serial_line::Port::send(&mut bench.port.again(), b"POW").unwrap();
    sofiscope_serial_line::Port::send(&mut bench.port.again(), DARK).unwrap();
    assert_eq!(bench.light(), 0.0, "even in the midst of another command");
    drop(laser);
}
