//! The driver against the stand-in library: the contract, and everything that goes wrong.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use sofiscope_hal::conformance::{self, FocusDriveRig};
use sofiscope_hal::{DeviceError, ErrorKind, FocusDrive, Nanometers, Properties, PropertyValue};
use sofiscope_madlib::{Madlib, NanoDrive, NanoDriveOptions};
use sofiscope_madlib_stand_in::{Remote, library};
use sofiscope_virtual::OpticalTable;
use sofiscope_virtual::table::Quantity;

static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// The stand-in with its time standing still, for one test at a time: a library is one for a process.
struct Bench {
    madlib: Madlib,
    remote: Remote,
    seconds: f64,
    _alone: MutexGuard<'static, ()>,
}

impl Bench {
    fn new() -> Self {
        let alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let path = library().expect("the stand-in is built as a library beside this test");
        let remote = Remote::open(&path).unwrap();
        remote.say("reset").unwrap();
        remote.say("time 0").unwrap();
        Self { madlib: Madlib::open(Some(&path)).unwrap(), remote, seconds: 0.0, _alone: alone }
    }

    fn say(&self, words: &str) -> String {
        self.remote.say(words).unwrap()
    }

    fn pass(&mut self, seconds: f64) {
        self.seconds += seconds;
        self.say(&format!("time {}", self.seconds));
    }

    fn open(&self) -> NanoDrive {
        NanoDrive::open(&self.madlib, options()).unwrap()
    }
}

fn nm(value: f64) -> Nanometers {
    Nanometers::new(value).unwrap()
}

fn options() -> NanoDriveOptions {
    NanoDriveOptions::within(nm(0.0)..=nm(300_000.0))
}

fn failed<T>(result: Result<T, DeviceError>, kind: ErrorKind) -> String {
    let error = result.map(|_| ()).unwrap_err();
    assert_eq!(error.kind(), kind, "{error}");
    error.to_string()
}

struct Rig {
    bench: Bench,
    drive: NanoDrive,
}

impl FocusDriveRig for Rig {
    fn drive(&mut self) -> &mut dyn FocusDrive {
        &mut self.drive
    }

    fn settle(&mut self) {
        self.bench.pass(0.2);
    }

    fn tolerance(&self) -> Nanometers {
        nm(8.0)
    }
}

#[test]
fn the_drive_keeps_its_contract_with_both_resolutions() {
    for bits in [16, 20] {
        let bench = Bench::new();
        bench.say(&format!("bits {bits}"));
        let travel = nm(10_000.0)..=nm(290_000.0);
        let drive = NanoDrive::open(&bench.madlib, NanoDriveOptions { travel, ..options() }).unwrap();
        conformance::focus_drive(&mut Rig { bench, drive });
    }
}

#[test]
fn it_says_who_it_is_and_that_it_is_simulated() {
    let bench = Bench::new();
    let mut drive = bench.open();
    let identity = drive.identity().clone();
    assert_eq!((identity.model.as_str(), identity.serial.as_str()), ("Nano-Drive 0x2201", "1234"));
    assert!(identity.simulated);
    assert_eq!(drive.travel(), nm(300_000.0));
    let properties = drive.properties().unwrap();
    let value = |name: &str| properties.iter().find(|found| found.name == name).unwrap().value.clone();
    assert_eq!(value("ADC_resolution"), PropertyValue::Whole(20));
    assert_eq!(value("FirmwareProfile"), PropertyValue::Whole(0x0108));
    assert_eq!(value("CommandedPosition"), PropertyValue::Number(0.0));
}

#[test]
fn a_little_below_zero_is_a_position_and_no_error() {
    let bench = Bench::new();
    bench.say("noise 0");
    bench.say("offset -0.0003");
    let mut drive = bench.open();
    let found = drive.position().unwrap();
    assert!((-0.4..0.0).contains(&found.value()), "{found}");
    drive.hold().unwrap();
    bench.say("offset -1.5");
    failed(drive.position(), ErrorKind::Fault);
}

#[test]
fn it_moves_as_a_damped_oscillation_and_returns_before_it_is_there() {
    let mut bench = Bench::new();
    let mut drive = bench.open();
    drive.move_to(nm(100_000.0)).unwrap();
    bench.pass(0.003);
    let early = drive.position().unwrap().value();
    assert!((1_000.0..50_000.0).contains(&early), "after 3 ms it is at {early}");
    bench.pass(0.1);
    assert!(drive.position().unwrap().distance(nm(100_000.0)) < nm(5.0));
}

#[test]
fn targets_outside_the_travel_are_refused_before_anything_is_sent() {
    let bench = Bench::new();
    let travel = nm(50_000.0)..=nm(200_000.0);
    let mut drive = NanoDrive::open(&bench.madlib, NanoDriveOptions { travel, ..options() }).unwrap();
    bench.say("fail -1 1");
    let text = failed(drive.move_to(nm(200_000.1)), ErrorKind::OutOfRange);
    assert!(text.contains("200000.1 nm is outside 50000 nm to 200000 nm"), "{text}");
    failed(drive.move_to(nm(100_000.0)), ErrorKind::Fault);
    drop(drive);
    for travel in [nm(-1.0)..=nm(10.0), nm(0.0)..=nm(300_001.0), nm(20.0)..=nm(10.0)] {
        let wrong = NanoDriveOptions { travel, ..options() };
        failed(NanoDrive::open(&bench.madlib, wrong), ErrorKind::OutOfRange);
    }
    let wrong = NanoDriveOptions { park: Some(nm(-5.0)), ..options() };
    failed(NanoDrive::open(&bench.madlib, wrong), ErrorKind::OutOfRange);
    assert_eq!(bench.say("open"), "0", "whoever was refused holds nothing");
}

#[test]
fn every_code_tells_the_caller_what_to_do() {
    let bench = Bench::new();
    let mut drive = bench.open();
    for (code, kind, says) in [
        (-1, ErrorKind::Fault, "general error"),
        (-2, ErrorKind::Lost, "off and on"),
        (-3, ErrorKind::Lost, "USB cable"),
        (-4, ErrorKind::OutOfRange, "does not support"),
        (-5, ErrorKind::Busy, "waveform"),
        (-6, ErrorKind::OutOfRange, "argument"),
        (-7, ErrorKind::OutOfRange, "axis"),
        (-8, ErrorKind::Lost, "handle"),
        (-9, ErrorKind::Fault, "USB driver"),
        (-10, ErrorKind::OutOfRange, "sequence"),
        (-11, ErrorKind::Busy, "TIRF-Lock"),
    ] {
        for _ in 0..2 {
            bench.say(&format!("fail {code} 1"));
            let text = failed(drive.move_to(nm(1_000.0)), kind);
            assert!(text.contains(says) && text.contains("S/N 1234"), "{code}: {text}");
            bench.say(&format!("fail {code} 1"));
            failed(drive.position(), kind);
            drive.position().unwrap();
        }
    }
}

#[test]
fn an_unplugged_drive_is_lost_and_comes_back() {
    let bench = Bench::new();
    let mut drive = bench.open();
    assert!(drive.is_attached());
    bench.say("unplug");
    failed(drive.position(), ErrorKind::Lost);
    assert_eq!(bench.say("open"), "0", "the handle was given back");
    assert!(!drive.is_attached());
    failed(drive.move_to(nm(5_000.0)), ErrorKind::Identity);
    bench.say("plug");
    drive.move_to(nm(5_000.0)).unwrap();
    assert!(drive.is_attached());
}

#[test]
fn drives_are_opened_by_serial_number() {
    let bench = Bench::new();
    let with =
        |serial| NanoDrive::open(&bench.madlib, NanoDriveOptions { serial: Some(serial), ..options() });
    let text = failed(with(77), ErrorKind::Identity);
    assert!(text.contains("S/N 77"), "{text}");
    assert_eq!(bench.say("open"), "0", "the other device is given back");
    drop(with(1234).unwrap());
    bench.say("owned");
    failed(NanoDrive::open(&bench.madlib, options()), ErrorKind::Lost);
}

#[test]
fn slow_calls_are_counted() {
    let bench = Bench::new();
    let slow_call = Duration::from_millis(20);
    let mut drive = NanoDrive::open(&bench.madlib, NanoDriveOptions { slow_call, ..options() }).unwrap();
    let before = drive.slow_calls().number;
    bench.say("slow 60");
    drive.position().unwrap();
    assert!(drive.slow_calls().number > before);
    assert!(drive.slow_calls().slowest >= Duration::from_millis(60));
}

#[test]
fn it_parks_only_where_it_was_told_to() {
    let mut bench = Bench::new();
    bench.say("noise 0");
    let mut drive = bench.open();
    drive.move_to(nm(100_000.0)).unwrap();
    bench.pass(0.5);
    drop(drive);
    bench.pass(0.5);
    let place = |bench: &Bench| bench.say("where").parse::<f64>().unwrap();
    assert!((place(&bench) - 100.0).abs() < 0.001, "it stays: {}", place(&bench));
    let park = Some(nm(20_000.0));
    drop(NanoDrive::open(&bench.madlib, NanoDriveOptions { park, ..options() }).unwrap());
    bench.pass(0.5);
    assert!((place(&bench) - 20.0).abs() < 0.001, "it is parked: {}", place(&bench));
    assert_eq!(bench.say("open"), "0");
}

#[test]
fn the_optical_table_sees_the_motion_while_nobody_asks() {
    let bench = Bench::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("table");
    let table = OpticalTable::set_up(&path).unwrap();
    bench.say("real-time");
    bench.say(&format!("table {}", path.display()));
    let mut drive = bench.open();
    drive.move_to(nm(40_000.0)).unwrap();
    let begun = Instant::now();
    while (table.get(Quantity::PiezoZ) - 40_000.0).abs() > 1.0 {
        assert!(begun.elapsed() < Duration::from_secs(10), "it is at {} nm", table.get(Quantity::PiezoZ));
        std::thread::yield_now();
    }
}

#[test]
fn opening_and_closing_ten_thousand_times_leaves_nothing_behind() {
    let bench = Bench::new();
    let resident = || {
        let statm = std::fs::read_to_string("/proc/self/statm").unwrap();
        statm.split_whitespace().nth(1).unwrap().parse::<i64>().unwrap() * 4
    };
    let cycle = || drop(bench.open());
    let cycles = if std::env::var_os("SOFISCOPE_FEW_CYCLES").is_some() { 100 } else { 10_000 };
    (0..cycles / 10).for_each(|_| cycle());
    let before = resident();
    (0..cycles).for_each(|_| cycle());
    let grown = resident() - before;
    assert!(grown < 1024, "grew by {grown} KiB in {cycles} cycles");
    assert_eq!(bench.say("open"), "0");
}
