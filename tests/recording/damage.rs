//! Recordings damaged by a crash, by the disk or by somebody: an error that names the place, or a repair.

use crate::common::{FORMATS, assert_true_to_exposures, exposure, plan, stop};
use sofiscope::recording::{Format, Outcome, Recording, RecordingError, open, recover};
use sofiscope_hal::Channel;
use std::fs;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

const SIDE: u32 = 16;
const LEN: usize = (SIDE * SIDE) as usize;

/// A recording of 90 exposures, finished or as after a crash.
fn recorded(folder: &Path, format: Format, is_finished: bool) -> PathBuf {
    let directory = folder.join(format!("{format:?}-{is_finished}"));
    let mut recording = Recording::create(&plan(&directory, format, SIDE, SIDE)).unwrap();
    for index in 0..90 {
        recording.push(&exposure(index, LEN)).unwrap();
        if index % 20 == 19 {
            recording.commit().unwrap();
        }
    }
    recording.commit().unwrap();
    if is_finished {
        recording.finish(stop()).unwrap();
    }
    directory
}

#[test]
fn rows_that_a_crash_took_come_back_from_the_frames() {
    let folder = tempfile::tempdir().unwrap();
    for format in FORMATS {
        let directory = recorded(folder.path(), format, false);
        let path = directory.join("ledger.csv");
        let whole = fs::read_to_string(&path).unwrap();
        for cut in [0, 40, whole.len() / 3, whole.len() - 200, whole.len() - 7, whole.len() - 1] {
            fs::write(&path, &whole[..cut]).unwrap();
            let report = recover(&directory).unwrap();
            assert_eq!(report.outcome, Outcome::Repaired, "{cut}");
            let mut run = open(&directory).unwrap();
            assert_true_to_exposures(&mut run, SIDE, SIDE);
            let recorded = |text: &str| {
                let rows = text.lines().filter(|line| line.contains("recorded"));
                rows.map(str::to_owned).collect::<Vec<_>>()
            };
            assert_eq!(recorded(&fs::read_to_string(&path).unwrap()), recorded(&whole), "{cut}");
            assert_eq!(recover(&directory).unwrap().outcome, Outcome::Sound, "{cut}");
        }
    }
}

#[test]
fn rows_without_frames_are_marked_and_torn_files_are_cut() {
    let folder = tempfile::tempdir().unwrap();
    let directory = recorded(folder.path(), Format::OmeTiff, false);
    let path = directory.join("reflection.ome.tif");
    let file = fs::OpenOptions::new().write(true).open(&path).unwrap();
    for len in [file.metadata().unwrap().len() - 4096, 80_000, 20_000, 4096] {
        file.set_len(len).unwrap();
        assert!(matches!(open(&directory), Err(RecordingError::Damaged { .. })) || len == 4096);
        let report = recover(&directory).unwrap();
        assert_eq!(report.outcome, Outcome::Repaired);
        let text = fs::read_to_string(directory.join("ledger.csv")).unwrap();
        assert!(text.contains("CRASH_TAIL"));
        let mut run = open(&directory).unwrap();
        assert_eq!(assert_true_to_exposures(&mut run, SIDE, SIDE), 90);
        assert_eq!(recover(&directory).unwrap().outcome, Outcome::Sound);
    }
}

#[test]
fn a_flipped_bit_is_found() {
    let folder = tempfile::tempdir().unwrap();
    for (format, image, offset) in [
        (Format::OmeTiff, "transmission.ome.tif", 4096 + 2 * 4096 + 5),
        (Format::OmeZarr, "transmission.ome.zarr/0/c/0/0/0", 4096 + 5),
    ] {
        let directory = recorded(folder.path(), format, true);
        let file = fs::OpenOptions::new().read(true).write(true).open(directory.join(image)).unwrap();
        let mut byte = [0];
        file.read_exact_at(&mut byte, offset).unwrap();
        file.write_all_at(&[byte[0] ^ 4], offset).unwrap();
        let mut run = open(&directory).unwrap();
        let mut counts = vec![0; LEN];
        let found = run.read_checked(Channel::Transmitted, 0, &mut counts).unwrap_err();
        assert!(matches!(found, RecordingError::BadCrc { page: 0, .. }), "{found}");
        run.read(Channel::Transmitted, 0, &mut counts).unwrap();
        run.read_checked(Channel::Transmitted, 1, &mut counts).unwrap();
        let report = recover(&directory).unwrap();
        assert_eq!((report.exit_status(), report.damaged), (1, vec![(Channel::Transmitted, 0)]));
    }
}

#[test]
fn hostile_files_are_refused_with_file_and_field() {
    let folder = tempfile::tempdir().unwrap();
    for format in FORMATS {
        let directory = recorded(folder.path(), format, true);
        let refuse = |name: &str, change: &dyn Fn(&str) -> String, expected: &str| {
            let path = directory.join(name);
            let text = fs::read_to_string(&path).unwrap();
            fs::write(&path, change(&text)).unwrap();
            let said = open(&directory).map(|_| ()).unwrap_err().to_string();
            fs::write(&path, text).unwrap();
            assert!(said.contains(name) && said.contains(expected), "{said}");
        };
        refuse("recording.json", &|text| text[..text.len() / 2].to_owned(), "JSON");
        refuse("recording.json", &|text| text.replace("\"format_version\": 1", "\"format_version\": 9"), "9");
        refuse("recording.json", &|text| text.replace("\"width\": 16", "\"width\": 4000000000"), "region");
        refuse("recording.json", &|text| " ".repeat(2 << 20) + text, "length");
        refuse("ledger.csv", &|text| text.replace("exposure,camera", "a,b"), "line 1");
        refuse("ledger.csv", &|text| text.replace("\n3,T,", "\n3,Q,"), "camera");
        refuse("ledger.csv", &|text| text.replace(",,3,", ",,7,"), "page");
        refuse(
            "ledger.csv",
            &|text| text.replace("\n4,R", &("\n".to_owned() + &"4".repeat(5000))),
            "too long",
        );
        refuse("events.jsonl", &|text| text.replace("\"event\"", "\"even"), "line 1");
        if format == Format::OmeZarr {
            let name = "reflection.ome.zarr/0/zarr.json";
            refuse(name, &|text| text.replace("\"uint16\"", "\"float64\""), "data_type");
            refuse(name, &|text| text.replace("\"start\"", "\"end\""), "codecs");
            refuse(name, &|_| "{\"shape\":[18446744073709551615,16,16]}".to_owned(), "shape");
        }
    }
}

#[test]
fn directories_that_lead_in_a_circle_or_nowhere_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let directory = recorded(folder.path(), Format::OmeTiff, true);
    let path = directory.join("reflection.ome.tif");
    let file = fs::OpenOptions::new().read(true).write(true).open(&path).unwrap();
    let mut whole = Vec::new();
    let mut state = 1_u64;
    std::io::Read::read_to_end(&mut &file, &mut whole).unwrap();
    let mut refused = 0;
    // Every byte of the header and of the first directories takes a few other values.
    for at in (0..16).chain(4096..4096 + 1200) {
        for _ in 0..3 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            file.write_all_at(&[(state >> 56) as u8], at).unwrap();
            if let Ok(mut run) = open(&directory) {
                let mut counts = vec![0; LEN];
                for page in 0..run.frames(Channel::Reflected) {
                    let _ = run.read_checked(Channel::Reflected, page, &mut counts);
                }
            } else {
                refused += 1;
            }
        }
        file.write_all_at(&[whole[at as usize]], at).unwrap();
    }
    assert!(refused > 500, "{refused}");
    open(&directory).unwrap();
}
