//! The lock on a simulated plant: a piezo of second order, a sensor with noise and a period of delay, a sample
//! that drifts.

use super::*;
use sofiscope_hal::{FocusReading, HostTime, Nanometers};

const PERIOD_NS: u64 = 10_000_000;
const SLOPE_PER_NM: f64 = 0.065;

fn nm(value: f64) -> Nanometers {
    Nanometers::new(value).unwrap()
}

/// Numbers with the statistics of a normal distribution, the same in every run.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        // Knuth's linear congruential generator (MMIX); good enough for noise.
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Piezo, sample and sensor.
struct Plant {
    z: f64,
    speed: f64,
    target: f64,
    sample: f64,
    drift_nm_per_s: f64,
    sign: f64,
    blocked: bool,
    noise: Noise,
    now: u64,
    number: u64,
    /// The sensor shows what was one period ago.
    seen_nm: f64,
}

impl Plant {
    fn new(z: f64) -> Self {
        Self {
            z,
            speed: 0.0,
            target: z,
            sample: z,
            drift_nm_per_s: 0.0,
            sign: 1.0,
            blocked: false,
            noise: Noise(7),
            now: 0,
            number: 0,
            seen_nm: 0.0,
        }
    }

    fn error(&self) -> f64 {
        self.z - self.sample
    }

    /// One period: damped oscillator of 30 Hz and damping 0.8, in steps of 0.1 ms.
    fn pass(&mut self) -> FocusReading {
        self.seen_nm = self.error();
        let omega = 2.0 * std::f64::consts::PI * 30.0;
        let dt = 1e-4;
        for _ in 0..100 {
            let force = omega * omega * (self.target - self.z) - 2.0 * 0.8 * omega * self.speed;
            self.speed += force * dt;
            self.z += self.speed * dt;
            self.sample += self.drift_nm_per_s * dt;
        }
        self.now += PERIOD_NS;
        self.number += 1;
        let measured = self.seen_nm + 1.0 * self.noise.normal();
        FocusReading {
            number: self.number,
            at: HostTime(self.now),
            signal: 100.0 + self.sign * SLOPE_PER_NM * measured.clamp(-2500.0, 2500.0),
            light: if self.blocked || self.seen_nm.abs() > 3000.0 { 10.0 } else { 1000.0 },
            saturated: 0.0,
            shape: 0.9,
        }
    }
}

fn settings() -> LockSettings {
    LockSettings {
        calibration: Calibration {
            zero: 100.0,
            slope_per_nm: SLOPE_PER_NM,
            capture: nm(2000.0),
            trust: Trust { least_light: 500.0, most_saturated: 0.05, least_shape: 0.5 },
        },
        servo: ServoSettings::default(),
        range: nm(0.0)..=nm(300_000.0),
    }
}

/// One period of lock and plant.
fn period(lock: FocusLock, plant: &mut Plant) -> FocusLock {
    let reading = plant.pass();
    let (lock, correction) = lock.step(Some(&reading), nm(plant.target), reading.at, &settings());
    if let Correction::MoveTo(z) = correction {
        plant.target = z.value();
    }
    lock
}

fn locked(plant: &mut Plant) -> FocusLock {
    let mut lock = FocusLock::begin(nm(plant.target), HostTime(plant.now));
    for _ in 0..1000 {
        lock = period(lock, plant);
        if matches!(lock, FocusLock::Locked(_)) {
            return lock;
        }
    }
    panic!("never locked: {lock:?}");
}

fn rms(errors: &[f64]) -> f64 {
    (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn it_holds_against_drift() {
    let mut plant = Plant::new(150_000.0);
    plant.drift_nm_per_s = 5.0;
    let mut lock = locked(&mut plant);
    for _ in 0..300 {
        lock = period(lock, &mut plant);
    }
    let errors: Vec<f64> = (0..6000)
        .map(|_| {
            lock = period(lock, &mut plant);
            plant.error()
        })
        .collect();
    println!("residual focus error against 5 nm/s: {:.2} nm rms", rms(&errors));
    assert!(matches!(lock, FocusLock::Locked(_)), "{lock:?}");
    assert!(rms(&errors) < 5.0, "{} nm", rms(&errors));
    let FocusLock::Locked(hold) = lock else { unreachable!() };
    assert!(hold.quality() > 0.9, "{}", hold.quality());
}

#[test]
fn a_step_is_answered_without_overshoot_beyond_a_fifth() {
    let mut plant = Plant::new(150_000.0);
    let mut lock = locked(&mut plant);
    for _ in 0..200 {
        lock = period(lock, &mut plant);
    }
    plant.sample += 300.0;
    let (mut settled_after, mut overshoot) = (0, 0.0_f64);
    for number in 1..=300 {
        lock = period(lock, &mut plant);
        overshoot = overshoot.max(plant.error());
        if plant.error().abs() > 15.0 {
            settled_after = number;
        }
    }
    println!("step of 300 nm: within 15 nm after {} ms, overshoot {overshoot:.0} nm", settled_after * 10);
    assert!(settled_after <= 60, "{settled_after} periods");
    assert!(overshoot < 60.0, "{overshoot} nm");
}

#[test]
fn a_lost_signal_freezes_the_drive_at_once_and_is_found_again() {
    let mut plant = Plant::new(150_000.0);
    let mut lock = locked(&mut plant);
    for _ in 0..100 {
        lock = period(lock, &mut plant);
    }
    plant.blocked = true;
    let frozen = plant.target;
    for _ in 0..200 {
        lock = period(lock, &mut plant);
        if !matches!(lock, FocusLock::Searching(_)) {
            assert!((plant.target - frozen).abs() < 1e-9, "moved without a signal: {lock:?}");
        }
    }
    assert!(!matches!(lock, FocusLock::Locked(_)), "two seconds without a signal");
    plant.blocked = false;
    let mut periods = 0;
    while !matches!(lock, FocusLock::Locked(_)) {
        lock = period(lock, &mut plant);
        periods += 1;
        assert!(periods < 3000, "never came back: {lock:?}");
    }
    println!("locked again {} ms after the signal came back", periods * 10);
}

#[test]
fn a_drive_that_goes_the_wrong_way_is_never_locked() {
    let mut plant = Plant::new(150_000.0);
    plant.sign = -1.0;
    plant.sample += 200.0;
    let mut lock = FocusLock::begin(nm(plant.target), HostTime(0));
    let begun = plant.target;
    for _ in 0..200 {
        lock = period(lock, &mut plant);
        assert!(!matches!(lock, FocusLock::Locked(_)));
        assert!((plant.target - begun).abs() <= 100.0, "no further than the probe");
    }
    assert_eq!(lock, FocusLock::Off(Some(LockEnd::WrongSign)));
}

#[test]
fn a_sign_that_flips_while_locked_is_found_within_five_periods_of_growth() {
    for seed in 1..50 {
        let mut plant = Plant::new(150_000.0);
        plant.noise = Noise(seed);
        let mut lock = locked(&mut plant);
        for _ in 0..200 {
            lock = period(lock, &mut plant);
        }
        plant.sign = -1.0;
        plant.sample += 100.0;
        let (frozen_at, mut periods, mut worst) = (plant.target, 0, 0.0_f64);
        while matches!(lock, FocusLock::Locked(_)) {
            lock = period(lock, &mut plant);
            periods += 1;
            worst = worst.max((plant.target - frozen_at).abs());
            assert!(periods < 100, "seed {seed}: never found");
        }
        assert!(worst <= 200.0, "seed {seed}: excursion of {worst} nm in {periods} periods");
        for _ in 0..100 {
            lock = period(lock, &mut plant);
        }
        assert_eq!(lock, FocusLock::Off(Some(LockEnd::WrongSign)), "seed {seed}");
    }
}

#[test]
fn readings_that_are_not_believed_move_nothing() {
    let mut plant = Plant::new(150_000.0);
    let mut lock = locked(&mut plant);
    for _ in 0..100 {
        lock = period(lock, &mut plant);
    }
    let good = plant.pass();
    let bad = [
        FocusReading { light: 0.0, ..good },
        FocusReading { saturated: 0.5, ..good },
        FocusReading { shape: 0.1, ..good },
        FocusReading { signal: f64::NAN, ..good },
        FocusReading { signal: good.signal + 100.0, ..good },
    ];
    for reading in bad {
        let (_, correction) = lock.step(Some(&reading), nm(plant.target), good.at, &settings());
        assert_eq!(correction, Correction::Stay, "{reading:?}");
    }
    let (after, first) = lock.step(Some(&good), nm(plant.target), good.at, &settings());
    let (_, again) = after.step(Some(&good), nm(plant.target), good.at, &settings());
    assert!(matches!(first, Correction::MoveTo(_)) && again == Correction::Stay, "the same reading twice");
    let (_, none) = lock.step(None, nm(plant.target), good.at, &settings());
    assert_eq!(none, Correction::Stay);
}

#[test]
fn the_end_of_the_range_ends_the_lock() {
    let mut plant = Plant::new(299_900.0);
    let mut lock = locked(&mut plant);
    plant.drift_nm_per_s = 2000.0;
    for _ in 0..400 {
        lock = period(lock, &mut plant);
        assert!(plant.target <= 300_000.0);
    }
    assert!(matches!(lock, FocusLock::Off(Some(_))), "{lock:?}");
}

#[test]
fn a_search_finds_the_signal_some_micrometers_away() {
    let mut plant = Plant::new(150_000.0);
    plant.sample += 6500.0;
    let lock = locked(&mut plant);
    assert!(matches!(lock, FocusLock::Locked(_)));
    let mut dark = Plant::new(150_000.0);
    dark.blocked = true;
    let mut lock = FocusLock::begin(nm(dark.target), HostTime(0));
    for _ in 0..2000 {
        lock = period(lock, &mut dark);
    }
    assert_eq!(lock, FocusLock::Off(Some(LockEnd::NotFound)));
    assert!((dark.target - 150_000.0).abs() < 1e-9, "back where it began");
}
