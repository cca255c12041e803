//! The driver against the virtual laser: its contract, and the faults of lasers and lines.

use std::time::Duration;

use crate::bench::{Bench, CAP_MW, Rig, SERIAL, mw};
use sofiscope_hal::{Emission, ErrorKind, Laser, Properties};
use sofiscope_serial_line::Line;
use sofiscope_toptica_ibeam_smart::{DARK, IbeamSettings, IbeamSmart, Modulation};
use sofiscope_virtual::table::Quantity;

#[test]
fn the_laser_keeps_its_contract() {
    for modulation in [Modulation::External, Modulation::None] {
        let bench = Bench::new();
        let laser = bench.open(modulation).unwrap();
        let mut rig = Rig { bench, laser };
        if modulation == Modulation::External {
            rig.bench.table.set(Quantity::Gates, 1.0);
        }
        sofiscope_hal::conformance::laser(&mut rig);
    }
}

#[test]
fn it_says_what_it_is_and_that_it_is_virtual() {
    let mut laser = Bench::new().open(Modulation::None).unwrap();
    let identity = laser.identity().clone();
    assert_eq!((identity.serial.as_str(), identity.model.as_str()), (SERIAL, "iBEAM-SMART-488-S-HP"));
    assert!(identity.simulated);
    let properties = laser.properties().unwrap();
    assert!(properties.iter().any(|property| property.name == "clip status"), "{properties:?}");
}

#[test]
fn another_serial_number_is_refused_and_left_alone() {
    let bench = Bench::new();
    bench.model(|model, now| model.left_on(5.0, now));
    let error = bench.open_as("iBEAM-SMART-OTHER", Modulation::None).err().unwrap();
    assert_eq!(error.kind(), ErrorKind::Identity);
    assert!(error.to_string().contains(SERIAL), "{error}");
    assert_eq!(bench.table.get(Quantity::Power(0)), 5.0, "somebody else's laser is not switched");
}

#[test]
fn a_cap_that_is_no_power_is_refused() {
    let line = Line::new(Box::new(Bench::new().port.again()), "laser 488");
    let settings = IbeamSettings {
        wavelength_nm: 488,
        serial: SERIAL.into(),
        cap: mw(0.0),
        modulation: Modulation::None,
    };
    assert_eq!(IbeamSmart::open(line, settings).err().unwrap().kind(), ErrorKind::OutOfRange);
}

#[test]
fn a_laser_that_was_left_on_is_dark_after_opening() {
    let mut bench = Bench::new();
    bench.model(|model, now| model.left_on(50.0, now));
    assert_eq!(bench.light(), 50.0);
    let laser = bench.open(Modulation::None).unwrap();
    assert_eq!(bench.light(), 0.0);
    drop(laser);
}

#[test]
fn dropped_it_is_dark_and_prompts_again() {
    let mut bench = Bench::new();
    drop(bench.bright());
    assert_eq!(bench.light(), 0.0);
    let mut port = bench.port.again();
    port.pass(Duration::from_millis(100));
    sofiscope_serial_line::Port::forget_received(&mut port).unwrap();
    sofiscope_serial_line::Port::send(&mut port, b"sta la\r\n").unwrap();
    let mut line = Line::new(Box::new(port), "test");
    let heard = line.drain(Duration::from_millis(50), Duration::from_secs(1)).unwrap();
    assert!(heard.ends_with(b"OFF\r\nCMD> "), "{}", heard.escape_ascii());
}

#[test]
fn under_modulation_the_gate_decides_what_is_measured() {
    let bench = Bench::new();
    let mut laser = bench.open(Modulation::External).unwrap();
    laser.set_power(mw(40.0)).unwrap();
    laser.switch_on().unwrap();
    assert_eq!(laser.state().unwrap().power_measured, Some(mw(0.0)), "a closed gate is no fault");
    bench.table.set(Quantity::Gates, 1.0);
    let measured = laser.state().unwrap().power_measured.unwrap().value();
    assert!((measured - 40.0).abs() < 0.5, "{measured}");
}

#[test]
fn a_channel_that_stays_disabled_is_found_before_it_is_trusted() {
    let bench = Bench::new();
    let mut laser = bench.open(Modulation::None).unwrap();
    laser.set_power(mw(10.0)).unwrap();
    bench.model(|model, _| model.faults.channels_dead = true);
    let error = laser.switch_on().unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Fault);
    assert!(error.to_string().contains("channel 2"), "{error}");
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
    assert!(error.to_string().contains("still says ON"), "{error}");
    assert!(laser.state().is_err(), "it emits, and nobody has switched it on");
}

#[test]
fn off_is_confirmed_within_half_a_second() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    let begun = bench.now();
    laser.switch_off().unwrap();
    assert!(bench.now() - begun <= Duration::from_millis(500), "{:?}", bench.now() - begun);
}

#[test]
fn a_power_that_is_off_by_more_than_a_tenth_is_a_fault_and_dark() {
    for power_error in [0.12, -0.12, 0.5] {
        let mut bench = Bench::new();
        let mut laser = bench.bright();
        assert!(laser.state().unwrap().fault.is_none());
        bench.model(|model, _| model.faults.power_error = power_error);
        assert_eq!(laser.state().unwrap_err().kind(), ErrorKind::Fault, "{power_error}");
        assert_eq!(bench.light(), 0.0, "{power_error}");
    }
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    laser.set_power(mw(CAP_MW)).unwrap();
    bench.model(|model, _| model.faults.power_error = 0.05);
    assert_eq!(laser.state().unwrap_err().kind(), ErrorKind::Fault, "above the cap");
    assert_eq!(bench.light(), 0.0);
}

#[test]
fn another_level_than_was_set_is_a_fault_and_dark() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    bench.model(|model, _| model.faults.level_error = 0.02);
    assert_eq!(laser.set_power(mw(30.0)).unwrap_err().kind(), ErrorKind::Fault);
    assert_eq!(bench.light(), 0.0);
}

#[test]
fn a_refusal_is_told_in_its_own_words() {
    let bench = Bench::new();
    let mut laser = bench.open(Modulation::None).unwrap();
    bench.model(|model, _| model.faults.refuses_with = Some("%SYS-E-00025, parameter error".into()));
    let error = laser.set_power(mw(10.0)).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Fault);
    assert!(error.to_string().contains("%SYS-E-00025, parameter error"), "{error}");
}

#[test]
fn information_in_between_is_no_error() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    bench.model(|model, _| model.faults.chatter = Some("%SYS-I-077, something is fine".into()));
    assert_eq!(laser.state().unwrap().emission, Emission::On);
    assert_eq!(bench.light(), 40.0);
}

#[test]
fn answers_that_lag_are_never_believed() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    bench.model(|model, _| model.faults.lags = true);
    let error = laser.state().unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Protocol, "{error}");
    assert_eq!(bench.light(), 0.0, "three answers that were none make it dark");
    assert!(laser.switch_off().is_err(), "nobody knows");
    // Only a person who wants light has the time for a reboot.
    laser.set_power(mw(20.0)).unwrap();
    laser.switch_on().unwrap();
    assert_eq!(bench.light(), 20.0);
}

#[test]
fn a_line_that_lags_at_start_is_cured_by_a_reboot() {
    let bench = Bench::new();
    bench.model(|model, _| model.faults.lags = true);
    let mut laser = bench.open(Modulation::None).unwrap();
    assert_eq!(laser.state().unwrap().emission, Emission::Off);
}

#[test]
fn lost_ends_banners_and_garbage_are_overcome_without_losing_the_light() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    for fault in 0..5 {
        bench.port.with(|wire, now| match fault {
            0 => wire.model().faults.lose_ok = 1,
            1 => wire.model().announce(now),
            2 => wire.faults().garbage = vec![0xFF, 0x00, b'O', b'N', b'\r', b'\n'],
            3 => wire.faults().swallow = 5,
            _ => wire.faults().pause = Duration::from_millis(3),
        });
        assert_eq!(laser.state().unwrap().emission, Emission::On, "fault {fault}");
        assert_eq!(bench.light(), 40.0, "fault {fault}");
    }
}

#[test]
fn a_reboot_by_itself_is_dark_and_told() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    bench.model(sofiscope_virtual::laser::IbeamSmart::restart);
    bench.port.pass(Duration::from_secs(7));
    let told = laser.state();
    assert!(
        told.is_err() || told.is_ok_and(|state| state.emission == Emission::Off && state.fault.is_some())
    );
    assert_eq!(bench.light(), 0.0);
}

#[test]
fn a_dead_line_is_told_and_told_to_be_dark() {
    let mut bench = Bench::new();
    let mut laser = bench.bright();
    bench.port.with(|wire, _| wire.faults().swallow = usize::MAX);
    let begun = bench.now();
    assert_eq!(laser.switch_off().unwrap_err().kind(), ErrorKind::Timeout);
    assert!(bench.now() - begun < Duration::from_millis(1500), "{:?}", bench.now() - begun);
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
    sofiscope_serial_line::Port::send(&mut bench.port.again(), DARK).unwrap();
    assert_eq!(bench.light(), 0.0);
    drop(laser);
}
