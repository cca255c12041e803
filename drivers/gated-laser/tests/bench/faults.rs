//! Its contract, and the faults of its controller.

use sofiscope_gated_laser::{GatedLaser, Permitting, Polarity, Wiring};
use sofiscope_hal::{
    Emission, ErrorKind, GateController, GatePattern, GateTrip, Interlock, Laser, Properties,
};
use sofiscope_virtual::EmissionLog;
use sofiscope_virtual::table::{OpticalTable, Quantity};

use crate::bench::{Bench, CAP_MW, LINE, OUTPUT, Rig, Wired, mw, settings, volts};
use crate::controller::Controller;

const GATE: GatePattern = GatePattern(1 << LINE);

fn bench(wired: Wired) -> Bench {
    Bench::new(wired, EmissionLog::none())
}

fn kind<T>(result: Result<T, sofiscope_hal::DeviceError>) -> Option<ErrorKind> {
    result.err().map(|error| error.kind())
}

#[test]
fn the_laser_keeps_its_contract() {
    for wired in [Wired::Analog, Wired::Both] {
        let bench = bench(wired);
        let laser = bench.laser();
        sofiscope_hal::conformance::laser(&mut Rig { bench, laser });
    }
}

#[test]
fn an_inverted_input_is_refused_with_its_reason() {
    for wired in [Wired::Ttl, Wired::Both] {
        let shared = bench(wired).shared;
        let error = GatedLaser::new(shared, settings(wired, Polarity::LowIsLight, CAP_MW)).err().unwrap();
        assert_eq!(error.kind(), ErrorKind::OutOfRange);
        assert!(error.to_string().contains("pulled cable"), "{error}");
    }
}

#[test]
fn a_fixed_power_above_the_cap_is_refused() {
    let shared = bench(Wired::Ttl).shared;
    let error = GatedLaser::new(shared, settings(Wired::Ttl, Polarity::HighIsLight, 99.0)).err().unwrap();
    assert_eq!(error.kind(), ErrorKind::OutOfRange);
}

#[test]
fn a_laser_with_a_gate_alone_has_one_power_and_is_gated() {
    let mut bench = bench(Wired::Ttl);
    let mut laser = bench.laser();
    assert_eq!(
        (laser.power_cap(), kind(laser.set_power(mw(50.0)))),
        (mw(100.0), Some(ErrorKind::OutOfRange))
    );
    laser.set_power(mw(100.0)).unwrap();
    assert_eq!(kind(bench.shared.lock().set_gates(GATE)), Some(ErrorKind::Fault), "it is off");
    laser.switch_on().unwrap();
    assert_eq!(bench.light(), 0.0, "its gate is closed");
    bench.shared.lock().set_gates(GATE).unwrap();
    assert_eq!((bench.light(), laser.state().unwrap().emission), (100.0, Emission::On));
    laser.switch_off().unwrap();
    assert_eq!((bench.light(), laser.state().unwrap().emission), (0.0, Emission::Off));
}

#[test]
fn switching_off_closes_its_gate_and_leaves_the_others_open() {
    let bench = bench(Wired::Both);
    let mut laser = bench.laser();
    laser.set_power(mw(50.0)).unwrap();
    laser.switch_on().unwrap();
    bench.shared.lock().set_gates(GATE.with(0)).unwrap();
    laser.make_dark().unwrap();
    assert_eq!(bench.shared.lock().state().unwrap().open, GatePattern(1));
    let patterns = [GatePattern(1), GATE];
    assert_eq!(kind(bench.shared.lock().begin_sequence(&patterns)), Some(ErrorKind::Fault));
    laser.switch_on().unwrap();
    bench.shared.lock().begin_sequence(&patterns).unwrap();
    laser.switch_off().unwrap();
    assert!(bench.shared.lock().state().unwrap().open.is_closed(), "a sequence with its gate is ended");
}

#[test]
fn switching_on_needs_an_armed_controller_and_arming_begins_dark() {
    let mut bench = bench(Wired::Both);
    let mut laser = bench.laser();
    laser.set_power(mw(50.0)).unwrap();
    laser.switch_on().unwrap();
    bench.shared.lock().disarm().unwrap();
    assert_eq!(bench.light(), 0.0);
    assert_eq!(kind(laser.switch_on()), Some(ErrorKind::Fault));
    bench.shared.lock().arm().unwrap();
    assert_eq!(bench.light(), 0.0);
    laser.switch_on().unwrap();
    bench.shared.lock().arm().unwrap();
    assert_eq!(bench.light(), 0.0, "armed again, every laser must be switched on again");
    let told = laser.state().unwrap();
    assert!(told.emission == Emission::Off && told.fault.is_some(), "{told:?}");
}

#[test]
fn a_new_power_is_applied_to_light_and_brings_none_back() {
    let mut bench = bench(Wired::Both);
    let mut laser = bench.laser();
    laser.set_power(mw(50.0)).unwrap();
    laser.switch_on().unwrap();
    laser.set_power(mw(20.0)).unwrap();
    assert!((bench.light() - 20.0).abs() < 1e-9);
    bench.shared.lock().arm().unwrap();
    laser.set_power(mw(30.0)).unwrap();
    assert_eq!(bench.light(), 0.0, "armed again, every laser must be switched on again");
}

#[test]
fn a_trip_and_a_reset_are_dark_and_told() {
    for trip in [Some(GateTrip::Watchdog), Some(GateTrip::Interlock), None] {
        let mut bench = bench(Wired::Both);
        let mut laser = bench.laser();
        laser.set_power(mw(50.0)).unwrap();
        laser.switch_on().unwrap();
        match trip {
            Some(trip) => bench.shared.lock().controller().trip(trip),
            None => bench.shared.lock().controller().reset(),
        }
        assert_eq!(bench.light(), 0.0, "{trip:?}");
        let told = laser.state().unwrap();
        assert!(told.emission == Emission::Off && told.fault.is_some(), "{trip:?}: {told:?}");
        assert_eq!(told.interlock == Interlock::Open, trip == Some(GateTrip::Interlock));
        assert_eq!(kind(laser.switch_on()), Some(ErrorKind::Fault), "{trip:?}: arm it first");
    }
}

#[test]
fn a_controller_that_is_gone_is_lost_and_nothing_comes_on_again() {
    let mut bench = bench(Wired::Both);
    let mut laser = bench.laser();
    laser.set_power(mw(50.0)).unwrap();
    laser.switch_on().unwrap();
    bench.shared.lock().controller().lost = true;
    for kind in [kind(laser.state()), kind(laser.switch_off()), kind(laser.make_dark())] {
        assert_eq!(kind, Some(ErrorKind::Lost));
    }
    bench.shared.lock().controller().lost = false;
    assert_eq!(
        kind(laser.state()),
        Some(ErrorKind::Fault),
        "its level is held, and nobody has switched it on"
    );
    assert_eq!(bench.light(), 0.0);
}

#[test]
fn dropped_it_is_dark() {
    let mut bench = bench(Wired::Analog);
    let mut laser = bench.laser();
    laser.set_power(mw(50.0)).unwrap();
    laser.switch_on().unwrap();
    assert!((bench.light() - 50.0).abs() < 1e-9);
    drop(laser);
    assert_eq!(bench.light(), 0.0);
}

#[test]
fn outputs_belong_to_one_laser_alone() {
    let mut controller = Permitting::new(Controller::new(OpticalTable::private().unwrap()));
    let wiring = |line, output| Wiring { line, output };
    controller.claim(wiring(Some(0), Some(0))).unwrap();
    controller.claim(wiring(Some(1), None)).unwrap();
    for taken in [(Some(0), None), (Some(2), Some(0)), (None, None), (Some(8), None), (None, Some(4))] {
        assert_eq!(
            kind(controller.claim(wiring(taken.0, taken.1))),
            Some(ErrorKind::OutOfRange),
            "{taken:?}"
        );
    }
    controller.arm().unwrap();
    assert_eq!(kind(controller.set_level(0, volts(1.0))), Some(ErrorKind::OutOfRange));
    controller.set_level(3, volts(1.0)).unwrap();
    controller.set_gates(GatePattern(1 << 5)).unwrap();
    assert_eq!(kind(controller.grant(wiring(Some(5), None), volts(0.0))), Some(ErrorKind::OutOfRange));
}

#[test]
fn its_properties_are_those_of_its_output() {
    let bench = bench(Wired::Both);
    let properties = bench.laser().properties().unwrap();
    assert!(properties.iter().any(|property| property.name == "threshold"), "{properties:?}");
    assert_eq!(bench.table.get(Quantity::Level(usize::from(OUTPUT))), 0.0);
}
