//! Random commands and faults: light only when it was switched on, behind a closed interlock, under its cap.

use sofiscope_hal::{Emission, ErrorKind, GateController, GatePattern, GateTrip, Laser};
use sofiscope_virtual::EmissionLog;
use sofiscope_virtual::laser::noise::Noise;
use sofiscope_virtual::log;
use sofiscope_virtual::table::Quantity;

use crate::bench::{Bench, CAP_MW, LINE, Wired, mw};

/// One random thing; returns whether the last command that was accepted is "on".
fn step(noise: &mut Noise, bench: &mut Bench, laser: &mut dyn Laser, on: bool) -> bool {
    let kept = match noise.below(20) {
        0..=4 => match laser.switch_on() {
            Ok(()) => true,
            // Nothing reaches a laser whose controller is gone; in any other case it is dark.
            Err(error) => on && error.kind() == ErrorKind::Lost,
        },
        5 => on && laser.switch_off().is_err(),
        6 => on && laser.make_dark().is_err(),
        7..=9 => {
            let power = mw((noise.unit() * 1.5 - 0.2) * CAP_MW);
            let accepted = laser.set_power(power).is_ok();
            assert!(!accepted || (0.0..=CAP_MW).contains(&power.value()), "{power}");
            on
        }
        10..=12 => {
            if let Ok(told) = laser.state() {
                let light = bench.light();
                assert!(told.emission != Emission::Off || light == 0.0, "says Off and emits {light} mW");
            }
            on
        }
        _ => on,
    };
    let pattern = GatePattern(noise.bits() as u8);
    let mut controller = bench.shared.lock();
    match noise.below(12) {
        0..=2 => drop(controller.set_gates(pattern)),
        3 => drop(controller.begin_sequence(&[pattern, GatePattern(noise.bits() as u8)])),
        4 => drop(controller.end_sequence()),
        // Arming and disarming take "on" back.
        5 => return kept & controller.arm().is_err_and(|error| error.kind() == ErrorKind::Lost),
        6 if noise.below(4) == 0 => {
            return kept & controller.disarm().is_err_and(|error| error.kind() == ErrorKind::Lost);
        }
        7 if noise.below(4) == 0 => controller.controller().trip(GateTrip::Watchdog),
        8 if noise.below(4) == 0 => controller.controller().reset(),
        9 => {
            let lost = noise.below(3) == 0;
            controller.controller().lost = lost;
        }
        10 if noise.below(2) == 0 => {
            drop(controller);
            let open = bench.table.get(Quantity::InterlockOpen);
            bench.table.set(Quantity::InterlockOpen, 1.0 - open);
        }
        _ => {}
    }
    kept
}

fn sequences(wired: Wired, seed: u64, num_steps: u32) {
    let mut noise = Noise::new(seed);
    let (mut num_bright, mut done) = (0, 0);
    while done < num_steps {
        let mut bench = Bench::new(wired, EmissionLog::none());
        let mut laser = bench.laser();
        let mut on = false;
        for _ in 0..100 {
            on = step(&mut noise, &mut bench, &mut laser, on);
            done += 1;
            let light = bench.light();
            num_bright += u32::from(light > 0.0);
            let closed = bench.table.get(Quantity::InterlockOpen) == 0.0;
            assert!(light == 0.0 || (on && closed), "seed {seed}, step {done}: {light} mW, on {on}");
            assert!(light <= CAP_MW + 1e-9, "seed {seed}, step {done}: {light} mW");
            let gates = bench.table.get(Quantity::Gates) as u64;
            let gated = wired != Wired::Analog;
            assert!(
                !gated || on || gates >> LINE & 1 == 0,
                "seed {seed}, step {done}: gate of a laser that is off"
            );
        }
        bench.shared.lock().controller().lost = false;
        drop(laser);
        assert_eq!(bench.light(), 0.0, "seed {seed}, step {done}: dropped");
    }
    assert!(num_bright > num_steps / 50, "light was seen in {num_bright} of {num_steps} steps");
}

#[test]
fn there_is_no_light_that_nobody_has_switched_on_in_a_hundred_thousand_steps() {
    sequences(Wired::Both, 1, 40_000);
    sequences(Wired::Analog, 2, 30_000);
    sequences(Wired::Ttl, 3, 30_000);
}

#[test]
fn five_hundred_connections_make_no_light() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log");
    let mut bench = Bench::new(Wired::Both, EmissionLog::append(&path, "laser-405").unwrap());
    for _ in 0..500 {
        let laser = bench.laser();
        bench.light();
        drop(laser);
        bench.light();
    }
    let emitted = || log::read(&path).unwrap().iter().filter(|note| note.value > 0.0).count();
    assert_eq!(emitted(), 0);
    // The judge sees light when there is some.
    let mut laser = bench.laser();
    laser.set_power(mw(10.0)).unwrap();
    laser.switch_on().unwrap();
    bench.light();
    assert_eq!(emitted(), 1);
}
