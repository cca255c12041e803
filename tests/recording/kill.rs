//! A program that is killed while it records loses the last moments and nothing else.

use crate::common::{FORMATS, assert_true_to_exposures, contents, exposure, plan};
use crate::stock_readers;
use sofiscope::acquisition::ExposureRecord;
use sofiscope::pipeline::{Bell, Received, Receiver, WhenFull, bounded};
use sofiscope::recording::{Format, Recording, open, recover};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

const DIRECTORY: &str = "SOFISCOPE_TEST_KILL_DIRECTORY";
const FORMAT: &str = "SOFISCOPE_TEST_KILL_FORMAT";
/// How often each format is killed; 50 for a thorough run.
const COUNT: &str = "SOFISCOPE_TEST_KILLS";
const SIDE: u32 = 64;
const PERIOD: Duration = Duration::from_millis(5);
/// From this many kills on, the goal for the median is checked.
const ENOUGH: usize = 50;

/// Waits without sleeping: nothing is ever sent.
fn wait(time: Duration) {
    let (_sender, receiver) = sync_channel::<()>(0);
    let _ = receiver.recv_timeout(time);
}

/// The program that is killed; it says on stdout which exposure it has pushed and when.
#[test]
#[ignore = "run by the test below"]
fn child() {
    let (Ok(directory), Ok(format)) = (std::env::var(DIRECTORY), std::env::var(FORMAT)) else { return };
    let format = if format == "zarr" { Format::OmeZarr } else { Format::OmeTiff };
    let recording = Recording::create(&plan(Path::new(&directory), format, SIDE, SIDE)).unwrap();
    let (mut sender, receiver) = bounded("pair→record", 64, WhenFull::Wait, &Bell::default());
    std::thread::spawn(move || record(recording, receiver));
    let begin = Instant::now();
    let mut out = std::io::stdout();
    for index in 0..10_000 {
        sender.send(exposure(index, (SIDE * SIDE) as usize)).unwrap();
        writeln!(out, "pushed {index} {}", begin.elapsed().as_micros()).unwrap();
        wait((PERIOD * (index as u32 + 1)).saturating_sub(begin.elapsed()));
    }
}

/// As the recording thread of the program does.
fn record(mut recording: Recording, mut records: Receiver<ExposureRecord>) {
    loop {
        match records.receive(Duration::from_millis(10)) {
            Received::Value(record) => recording.push(&record).unwrap(),
            Received::Empty => {}
            Received::Closed => return,
        }
        recording.settle(records.len()).unwrap();
    }
}

/// Exposures pushed and when, as the killed program said.
fn kill_after(directory: &Path, format: Format, time: Duration) -> Vec<(u64, u64)> {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "kill::child", "--ignored", "--nocapture", "--test-threads", "1"])
        .env(DIRECTORY, directory)
        .env(FORMAT, if format == Format::OmeZarr { "zarr" } else { "tiff" })
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut pushed = Vec::new();
    let mut note = |line: String| {
        let Some((_, said)) = line.split_once("pushed ") else { return false };
        let Some((index, micros)) = said.split_once(' ') else { return false };
        let (Ok(index), Ok(micros)) = (index.parse(), micros.parse()) else { return false };
        pushed.push((index, micros));
        true
    };
    while !note(lines.next().unwrap().unwrap()) {}
    wait(time);
    child.kill().unwrap();
    child.wait().unwrap();
    for line in lines.map_while(Result::ok) {
        note(line);
    }
    pushed
}

#[test]
fn a_kill_costs_the_last_moments_and_nothing_else() {
    let kills: u64 = std::env::var(COUNT).ok().and_then(|count| count.parse().ok()).unwrap_or(5);
    let folder = tempfile::tempdir().unwrap();
    let mut directories = Vec::new();
    for format in FORMATS {
        let mut lost = Vec::new();
        for kill in 0..kills {
            let directory = folder.path().join(format!("{format:?}-{kill}"));
            // Spread over the phases of groups, syncs and shards.
            let time = Duration::from_micros((kill * 377_717 + 13_331) % 1_500_000);
            let pushed = kill_after(&directory, format, time);
            let (last, at) = *pushed.last().unwrap();
            let mut run = open(&directory).unwrap();
            let recorded = assert_true_to_exposures(&mut run, SIDE, SIDE);
            // The line of the last exposure may not have come through.
            assert!(recorded <= last + 2, "{recorded} rows, {last} pushed");
            let early = pushed.iter().filter(|(_, micros)| micros + 100_000 <= at).count() as u64;
            assert!(recorded >= early, "{recorded} rows, {early} of {last} pushed 100 ms before the kill");
            lost.push((last + 1).saturating_sub(recorded));
            directories.push(directory);
        }
        lost.sort_unstable();
        let (median, most) = (lost[lost.len() / 2], lost[lost.len() - 1]);
        println!("{format:?}: {kills} kills, exposures lost: median {median}, most {most}");
        assert!(lost.len() < ENOUGH || median <= 2, "{lost:?}");
    }
    stock_readers::assert_open(&directories, SIDE, SIDE);
    for directory in &directories {
        let before = open(directory).unwrap().rows().unwrap().count();
        assert_eq!(recover(directory).unwrap().exit_status(), 3);
        let recovered = contents(directory);
        assert_eq!(recover(directory).unwrap().exit_status(), 0);
        assert!(recovered == contents(directory), "{}", directory.display());
        let mut run = open(directory).unwrap();
        let recovered = assert_true_to_exposures(&mut run, SIDE, SIDE);
        assert!(recovered * 2 >= before as u64);
        assert!(run.stop().is_some());
    }
    stock_readers::assert_open(&directories, SIDE, SIDE);
}
