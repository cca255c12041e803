//! A computer that loses power while it records: a log of every change, cut anywhere, with any of the writes that were
//! not made durable missing, whole or by sectors. What `recover` makes of it must be true.

use super::fault_tests::{EAGER, assert_readable, exposure, folder, plan};
use super::gate::{Change, Gate, Operation, Watch};
use super::{Format, Outcome, Recording, StopRecord, StopStatus, open, recover};
use crate::acquisition::RowState;
use sofiscope_hal::Channel;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// How many cuts per format; the goal is 1000.
const CUTS: &str = "SOFISCOPE_TEST_POWER_CUTS";
const EXPOSURES: u64 = 90;
const PAGE: usize = 4096;
const SECTOR: usize = 512;

#[derive(Debug)]
enum Entry {
    Created,
    Directory,
    Bytes(u64, Vec<u8>),
    Length(u64),
    Removed,
    SyncBegun,
    Synced,
}

#[derive(Default)]
struct Log(Mutex<Vec<(PathBuf, Entry)>>);

impl Log {
    fn add(&self, path: &Path, entry: Entry) {
        self.0.lock().unwrap().push((path.to_path_buf(), entry));
    }
}

impl Watch for Log {
    fn before(&self, operation: Operation, path: &Path) -> io::Result<()> {
        if operation == Operation::Sync {
            self.add(path, Entry::SyncBegun);
        }
        Ok(())
    }

    fn after(&self, change: Change<'_>, path: &Path) {
        let entry = match change {
            Change::Created => Entry::Created,
            Change::Directory => Entry::Directory,
            Change::Bytes(offset, bytes) => Entry::Bytes(offset, bytes.to_vec()),
            Change::Length(len) => Entry::Length(len),
            Change::Removed => Entry::Removed,
            Change::Synced => Entry::Synced,
        };
        self.add(path, entry);
    }
}

/// Chances out of 8.
struct Dice {
    state: u64,
    kept_in_8: u64,
    piece: usize,
}

impl Dice {
    fn new(seed: u64) -> Self {
        let mut dice =
            Self { state: seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1, kept_in_8: 0, piece: PAGE };
        dice.roll(8);
        dice.kept_in_8 = [0, 1, 4, 7, 8][dice.roll(5) as usize];
        dice.piece = [PAGE, SECTOR][dice.roll(2) as usize];
        dice
    }

    fn roll(&mut self, sides: u64) -> u64 {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        (self.state.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32) % sides
    }

    fn keeps(&mut self) -> bool {
        self.roll(8) < self.kept_in_8
    }
}

/// Up to which entry the changes of each path are durable.
fn durable(log: &[(PathBuf, Entry)]) -> BTreeMap<&Path, usize> {
    let mut begun: BTreeMap<&Path, Vec<usize>> = BTreeMap::new();
    let mut until = BTreeMap::new();
    for (at, (path, entry)) in log.iter().enumerate() {
        match entry {
            Entry::SyncBegun => begun.entry(path).or_default().push(at),
            Entry::Synced => {
                // Two threads may sync one file; the one that began first is taken to end first.
                let waiting = begun.entry(path).or_default();
                let first = if waiting.is_empty() { at } else { waiting.remove(0) };
                let until = until.entry(path.as_path()).or_insert(first);
                *until = first.max(*until);
            }
            _ => {}
        }
    }
    until
}

/// Bytes of the files, `None` for directories, as the disk may have them after a cut behind `log`.
fn image<'a>(log: &'a [(PathBuf, Entry)], dice: &mut Dice) -> BTreeMap<&'a Path, Option<Vec<u8>>> {
    let durable = durable(log);
    let is_durable = |path: &Path, at: usize| durable.get(path).is_some_and(|until| at < *until);
    let mut image: BTreeMap<&Path, Option<Vec<u8>>> = BTreeMap::new();
    for (at, (path, entry)) in log.iter().enumerate() {
        let is_safe = match entry {
            Entry::Created | Entry::Directory | Entry::Removed => is_durable(path.parent().unwrap(), at),
            _ => is_durable(path, at),
        };
        match entry {
            Entry::Directory if is_safe || dice.keeps() => drop(image.insert(path, None)),
            Entry::Created if is_safe || dice.keeps() => drop(image.insert(path, Some(Vec::new()))),
            Entry::Removed if is_safe || dice.keeps() => drop(image.remove(path.as_path())),
            Entry::Length(len) if is_safe || dice.keeps() => {
                if let Some(Some(bytes)) = image.get_mut(path.as_path()) {
                    bytes.resize(*len as usize, 0);
                }
            }
            Entry::Bytes(offset, written) => {
                let Some(Some(bytes)) = image.get_mut(path.as_path()) else { continue };
                write(bytes, *offset as usize, written, |dice| is_safe || dice.keeps(), dice);
            }
            _ => {}
        }
    }
    image
}

/// Those pieces of a write that `keeps` lets through.
fn write(
    bytes: &mut Vec<u8>,
    offset: usize,
    written: &[u8],
    mut keeps: impl FnMut(&mut Dice) -> bool,
    dice: &mut Dice,
) {
    let mut done = 0;
    while done < written.len() {
        let at = offset + done;
        let end = (at / dice.piece + 1) * dice.piece;
        let piece = &written[done..written.len().min(done + end - at)];
        if keeps(dice) {
            bytes.resize(bytes.len().max(at + piece.len()), 0);
            bytes[at..at + piece.len()].copy_from_slice(piece);
        }
        done += piece.len();
    }
}

/// Frames of R and T that the recorder has declared durable.
fn declared(log: &[(PathBuf, Entry)]) -> [u64; 2] {
    let mut lines = log.iter().filter_map(|(path, entry)| match entry {
        Entry::Bytes(_, bytes) if path.ends_with("recording.lock") => std::str::from_utf8(bytes).ok(),
        _ => None,
    });
    let numbers = lines.next_back().map(|line| {
        let mut words = line.split_whitespace().skip(1).map(|word| word.parse().unwrap());
        [words.next().unwrap(), words.next().unwrap()]
    });
    numbers.unwrap_or_default()
}

/// Records everything; the log, and how long it was before the first frame.
fn recorded(directory: &Path, format: Format) -> (Vec<(PathBuf, Entry)>, usize) {
    let log = Arc::new(Log::default());
    let gate = Gate::shared(log.clone());
    let mut recording =
        Recording::create_through(&plan(directory, format), jiff::Timestamp::UNIX_EPOCH, gate, EAGER)
            .unwrap();
    let created = log.0.lock().unwrap().len();
    for index in 0..EXPOSURES {
        recording.push(&exposure(index)).unwrap();
        // As they come at first, and then in groups.
        if index < 40 || index % 7 == 6 {
            recording.settle(0).unwrap();
        }
    }
    let stop = StopRecord { status: StopStatus::Success, reason: "planned".to_owned() };
    recording.finish(stop).unwrap();
    (std::mem::take(&mut *log.0.lock().unwrap()), created)
}

fn write_image(image: BTreeMap<&Path, Option<Vec<u8>>>, from: &Path, to: &Path) {
    // Directories come before what is in them.
    for (path, bytes) in image {
        let path = to.join(path.strip_prefix(from).unwrap());
        let made = match bytes {
            None => fs::create_dir(&path),
            Some(bytes) => fs::write(&path, bytes),
        };
        // What is in a directory that is lost is lost.
        if let Err(error) = made {
            assert_eq!(error.kind(), io::ErrorKind::NotFound, "{}", path.display());
        }
    }
}

fn assert_survives(log: &[(PathBuf, Entry)], from: &Path, seed: u64, case: &str) {
    let folder = folder();
    let mut dice = Dice::new(seed);
    let parent = from.parent().unwrap();
    write_image(image(log, &mut dice), parent, folder.path());
    let directory = folder.path().join(from.strip_prefix(parent).unwrap());
    let report = recover(&directory).unwrap_or_else(|error| panic!("{case}: {error}"));
    assert!(report.damaged.is_empty(), "{case}: {report}");
    let rows = assert_readable(&directory);
    let run = open(&directory).unwrap();
    for channel in Channel::BOTH {
        let is_frame = |row: &&crate::acquisition::LedgerRow| {
            row.channel == channel && matches!(row.state, RowState::Recorded { .. })
        };
        let frames = run.frames(channel);
        assert_eq!(rows.iter().filter(is_frame).count() as u64, frames, "{case}");
        assert!(frames >= declared(log)[channel.index()], "{case}: {frames} of {:?}", declared(log));
    }
    assert!(run.stop().is_some(), "{case}");
    assert_eq!(recover(&directory).unwrap().outcome, Outcome::Sound, "{case}");
}

#[test]
fn what_was_durable_survives_a_loss_of_power() {
    let cuts: u64 = std::env::var(CUTS).ok().and_then(|cuts| cuts.parse().ok()).unwrap_or(150);
    for format in [Format::OmeTiff, Format::OmeZarr] {
        let folder = folder();
        let directory = folder.path().join("run");
        let (log, created) = recorded(&directory, format);
        assert!(declared(&log) == [EXPOSURES; 2], "{:?}", declared(&log));
        for seed in 0..cuts {
            let cut = created + Dice::new(seed ^ 0x5eed).roll((log.len() - created + 1) as u64) as usize;
            let case = format!("{format:?}, seed {seed}, {cut} of {} changes", log.len());
            assert_survives(&log[..cut], &directory, seed, &case);
        }
        println!("{format:?}: {cuts} cuts in {} changes, all frames declared durable are there", log.len());
    }
}
