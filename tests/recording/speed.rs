//! How fast recording is, beside what the disk can do: run by hand with `-- --ignored --nocapture`.

use crate::common::{FORMATS, frame, plan, stop};
use sofiscope::acquisition::{Analysis, ExposureRecord, PairState, Side};
use sofiscope::recording::Recording;
use sofiscope_hal::{Channel, ExposureIndex};
use std::fs;
use std::io::{IoSlice, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::Instant;

const SIDE: u32 = 2048;
const LEN: usize = (SIDE * SIDE) as usize;
const EXPOSURES: u64 = 120;
const ROUNDS: usize = 3;
/// `O_DIRECT` on Linux for x86.
const DIRECT: i32 = 0o40000;

fn megabytes_per_second(begin: Instant) -> f64 {
    (EXPOSURES as usize * 2 * LEN * 2) as f64 / 1e6 / begin.elapsed().as_secs_f64()
}

/// The disk by itself: one file, 16 MiB of page-aligned memory at a time, past the page cache.
fn disk(path: &Path) -> f64 {
    let frames = [0, 1].map(|exposure| frame(Channel::Reflected, exposure, LEN));
    let mut file =
        fs::OpenOptions::new().write(true).create_new(true).custom_flags(DIRECT).open(path).unwrap();
    let begin = Instant::now();
    for _ in 0..EXPOSURES {
        let mut slices = frames.each_ref().map(|frame| IoSlice::new(frame.bytes()));
        let mut left = &mut slices[..];
        while !left.is_empty() {
            let written = file.write_vectored(left).unwrap();
            IoSlice::advance_slices(&mut left, written);
        }
    }
    let rate = megabytes_per_second(begin);
    fs::remove_file(path).unwrap();
    rate
}

fn recorder(directory: &Path, format: sofiscope::recording::Format) -> f64 {
    // A pool as in a run, so that every frame comes from other memory than the one before.
    let sides =
        [0, 1, 2, 3].map(|exposure| Channel::BOTH.map(|channel| Side::Frame(frame(channel, exposure, LEN))));
    let mut recording = Recording::create(&plan(directory, format, SIDE, SIDE)).unwrap();
    let begin = Instant::now();
    for index in 0..EXPOSURES {
        let record = ExposureRecord {
            exposure: ExposureIndex(index),
            sides: sides[index as usize % 4].clone(),
            pair: PairState::Paired,
            analysis: Analysis::None,
        };
        recording.push(&record).unwrap();
    }
    recording.commit().unwrap();
    let rate = megabytes_per_second(begin);
    recording.finish(stop()).unwrap();
    fs::remove_dir_all(directory).unwrap();
    rate
}

#[test]
#[ignore = "measures the disk"]
fn recording_beside_the_disk() {
    let folder =
        tempfile::tempdir_in(std::env::var("SOFISCOPE_TEST_DISK").unwrap_or(".".to_owned())).unwrap();
    for round in 0..ROUNDS {
        let before = disk(&folder.path().join("raw"));
        for format in FORMATS {
            let rate = recorder(&folder.path().join("run"), format);
            let after = disk(&folder.path().join("raw"));
            let share = 200.0 * rate / (before + after);
            println!(
                "round {round}, {format:?}: {rate:.0} MB/s, disk {before:.0} and {after:.0}, {share:.0} %"
            );
        }
    }
}
