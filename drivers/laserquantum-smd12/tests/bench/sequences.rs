//! Random commands and faults: light only when it was switched on, behind a closed interlock, under its cap.

use std::time::Duration;

use crate::bench::{Bench, CAP_MW, mw};
use sofiscope_hal::{Emission, ErrorKind, Laser};
use sofiscope_virtual::laser::head::EMISSION;
use sofiscope_virtual::laser::noise::Noise;
use sofiscope_virtual::log;
use sofiscope_virtual::table::Quantity;

/// One random thing; returns whether the last command that was accepted is "on".
fn step(noise: &mut Noise, bench: &mut Bench, laser: &mut dyn Laser, on: bool) -> bool {
    match noise.below(20) {
        0..=3 => match laser.switch_on() {
            Ok(()) => true,
            // Nothing reaches a laser whose line is gone; in any other case it was told to be dark.
            Err(error) => on && error.kind() == ErrorKind::Lost,
        },
        4 | 5 if laser.switch_off().is_ok() => false,
        6 if laser.make_dark().is_ok() => false,
        7..=9 => {
            let power = mw((noise.unit() * 1.5 - 0.2) * CAP_MW);
            let accepted = laser.set_power(power).is_ok();
            assert!(!accepted || (0.0..=CAP_MW).contains(&power.value()), "{power}");
            on
        }
        10..=13 => {
            if let Ok(told) = laser.state() {
                let light = bench.light();
                assert!(told.emission != Emission::Off || light == 0.0, "says Off and emits {light} mW");
            }
            on
        }
        14 => {
            let open = bench.table.get(Quantity::InterlockOpen);
            bench.table.set(Quantity::InterlockOpen, 1.0 - open);
            on
        }
        _ => {
            fault(noise, bench);
            on
        }
    }
}

fn fault(noise: &mut Noise, bench: &mut Bench) {
    let (which, number) = (noise.below(14), noise.below(40));
    bench.port.with(|wire, _| match which {
        0 => wire.model().faults.silent ^= true,
        1 => wire.model().faults.refuses_with = (number < 10).then_some(number as u32),
        2 => wire.model().faults.timers_without_end ^= true,
        3 => wire.model().faults.key_off ^= true,
        4 => wire.model().faults.dead_diode ^= true,
        5 => wire.model().faults.etx ^= true,
        6 => wire.model().faults.blank ^= true,
        7 => wire.faults().garbage = (0..number as u8).collect(),
        8 => wire.faults().swallow = number,
        9 => wire.faults().pause = Duration::from_millis(number as u64 % 4),
        10 => wire.model().faults.delay = Duration::from_millis(40 * number as u64),
        11 => wire.faults().unplugged ^= true,
        _ => {
            *wire.faults() = Default::default();
            wire.model().faults = Default::default();
        }
    });
}

fn sequences(seed: u64, num_steps: u32) {
    let mut noise = Noise::new(seed);
    let (mut num_bright, mut done) = (0, 0);
    while done < num_steps {
        let mut bench = Bench::new();
        let Ok(mut laser) = bench.open() else { panic!("a laser without faults opens") };
        let mut on = false;
        for _ in 0..100 {
            on = step(&mut noise, &mut bench, &mut laser, on);
            done += 1;
            let light = bench.light();
            num_bright += u32::from(light > 0.0);
            let closed = bench.table.get(Quantity::InterlockOpen) == 0.0;
            assert!(light == 0.0 || (on && closed), "seed {seed}, step {done}: {light} mW, on {on}");
            assert!(light <= CAP_MW + 1e-9, "seed {seed}, step {done}: {light} mW");
        }
        bench.port.with(|wire, _| wire.faults().unplugged = false);
        drop(laser);
        assert_eq!(bench.light(), 0.0, "seed {seed}, step {done}: dropped");
    }
    assert!(num_bright > num_steps / 50, "light was seen in {num_bright} of {num_steps} steps");
}

#[test]
fn there_is_no_light_that_nobody_has_switched_on_in_a_hundred_thousand_steps() {
    sequences(2, 100_000);
}

#[test]
fn five_hundred_connections_make_no_light() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log");
    let bench = Bench::logged(&path);
    for _ in 0..500 {
        drop(bench.open().unwrap());
    }
    let emitted = |path| log::read(path).unwrap().iter().filter(|note| note.value > 0.0).count();
    assert_eq!(emitted(&path), 0);
    // The judge sees light when there is some.
    let mut laser = bench.open().unwrap();
    laser.set_power(mw(1.0)).unwrap();
    laser.switch_on().unwrap();
    bench.port.again().pass(Duration::from_secs(1));
    assert!(emitted(&path) > 0);
    drop(laser);
    let last = log::read(&path).unwrap().pop().unwrap();
    assert_eq!((last.quantity.as_str(), last.value), (EMISSION, 0.0));
}
