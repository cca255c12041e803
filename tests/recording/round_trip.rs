//! What goes in comes out, in both formats.

use crate::common::{FORMATS, assert_true_to_exposures, contents, exposure, plan, stop};
use sofiscope::acquisition::{RowState, Side};
use sofiscope::files::ImageStack;
use sofiscope::recording::{Format, Outcome, Recording, RecordingError, StopStatus, export, open, recover};
use sofiscope_hal::Channel;
use std::path::Path;

const SIZES: [(u32, u32); 3] = [(40, 57), (64, 64), (1, 3)];

fn record(directory: &Path, format: Format, (height, width): (u32, u32), exposures: u64) {
    let mut recording = Recording::create(&plan(directory, format, height, width)).unwrap();
    for index in 0..exposures {
        recording.push(&exposure(index, (height * width) as usize)).unwrap();
        if index % 37 == 36 {
            recording.commit().unwrap();
        }
    }
    let summary = recording.finish(stop()).unwrap();
    assert_eq!((summary.exposures, summary.stop), (exposures, stop()));
}

#[test]
fn frames_and_rows_come_back() {
    let folder = tempfile::tempdir().unwrap();
    for format in FORMATS {
        for (height, width) in SIZES {
            let directory = folder.path().join(format!("{format:?}-{height}-{width}"));
            record(&directory, format, (height, width), 300);
            let mut run = open(&directory).unwrap();
            assert_eq!(run.stop(), Some(stop()));
            assert_eq!(assert_true_to_exposures(&mut run, height, width), 300);
            let text = std::fs::read_to_string(directory.join("plan.yaml")).unwrap();
            assert_eq!(text, "# as used\n");
            assert!(!directory.join("recording.lock").exists());
        }
    }
}

#[test]
fn a_finished_recording_needs_no_recovery() {
    let folder = tempfile::tempdir().unwrap();
    for format in FORMATS {
        let directory = folder.path().join(format!("{format:?}"));
        record(&directory, format, (40, 57), 100);
        let before = contents(&directory);
        let report = recover(&directory).unwrap();
        assert_eq!((report.outcome, report.exit_status()), (Outcome::Sound, 0), "{report:?}");
        assert!(before == contents(&directory));
    }
}

#[test]
fn our_own_stack_reader_sees_the_same_frames() {
    let folder = tempfile::tempdir().unwrap();
    let directory = folder.path().join("run");
    record(&directory, Format::OmeTiff, (40, 57), 130);
    let mut stack = ImageStack::open(&directory.join("transmission.ome.tif")).unwrap();
    let mut run = open(&directory).unwrap();
    assert_eq!(stack.info().frames as u64, run.frames(Channel::Transmitted));
    let (mut ours, mut theirs) = (vec![0; 40 * 57], vec![0; 40 * 57]);
    for page in 0..run.frames(Channel::Transmitted) {
        run.read(Channel::Transmitted, page, &mut ours).unwrap();
        assert!(stack.read_counts(&mut theirs).unwrap());
        assert!(ours == theirs, "page {page}");
    }
}

#[test]
fn export_keeps_pixels_and_ledger() {
    let folder = tempfile::tempdir().unwrap();
    for (from, to) in [(Format::OmeTiff, Format::OmeZarr), (Format::OmeZarr, Format::OmeTiff)] {
        let (directory, exported) =
            (folder.path().join(format!("{from:?}")), folder.path().join(format!("{from:?}-{to:?}")));
        record(&directory, from, (40, 57), 200);
        let summary = export(&directory, to, &exported).unwrap();
        assert_eq!((summary.exposures, summary.stop.status), (200, StopStatus::Success));
        let ledger = |directory: &Path| std::fs::read_to_string(directory.join("ledger.csv")).unwrap();
        assert_eq!(ledger(&directory), ledger(&exported));
        let mut run = open(&exported).unwrap();
        assert_eq!(run.metadata().format, to);
        assert_eq!(run.metadata().created, open(&directory).unwrap().metadata().created);
        assert_eq!(assert_true_to_exposures(&mut run, 40, 57), 200);
        let lines =
            ledger(&exported).lines().filter(|line| line.ends_with(",1250.5,-3,488=10;561=2.5")).count();
        let received = run.rows().unwrap().filter(|row| row.as_ref().unwrap().id.is_some()).count();
        assert_eq!(lines, received);
        assert!(exported.join("plan.yaml").exists());
    }
}

#[test]
fn frames_of_another_size_are_lost_and_said() {
    let folder = tempfile::tempdir().unwrap();
    let directory = folder.path().join("run");
    let mut recording = Recording::create(&plan(&directory, Format::OmeTiff, 16, 16)).unwrap();
    let mut record = exposure(0, 256);
    record.sides[0] = Side::Frame(crate::common::frame(Channel::Reflected, 0, 255));
    recording.push(&record).unwrap();
    recording.finish(stop()).unwrap();
    let states: Vec<String> =
        open(&directory).unwrap().rows().unwrap().map(|row| format!("{:?}", row.unwrap().state)).collect();
    assert_eq!(states[0], "Lost(SizeMismatch)");
    assert!(states[1].starts_with("Recorded"));
}

#[test]
fn nothing_is_overwritten_and_plans_that_do_not_fit_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let taken = Recording::create(&plan(folder.path(), Format::OmeTiff, 16, 16)).unwrap_err();
    assert!(matches!(taken, RecordingError::Exists { .. }), "{taken}");
    let mut large = plan(&folder.path().join("large"), Format::OmeTiff, 2048, 2048);
    large.planned_exposures = Some(1 << 40);
    let refused = Recording::create(&large).unwrap_err();
    assert!(matches!(refused, RecordingError::Space { .. }), "{refused}");
    assert!(!large.directory.exists());
    let mut odd = plan(&folder.path().join("odd"), Format::OmeTiff, 16, 16);
    for name in ["../plan.yaml", "ledger.csv", "", "a/b", ".hidden"] {
        odd.provenance = vec![(name.to_owned(), String::new())];
        assert!(Recording::create(&odd).is_err(), "{name}");
    }
}

#[test]
fn what_is_committed_is_there_before_the_end() {
    let folder = tempfile::tempdir().unwrap();
    for format in FORMATS {
        let directory = folder.path().join(format!("{format:?}"));
        let mut recording = Recording::create(&plan(&directory, format, 40, 57)).unwrap();
        assert_eq!(open(&directory).unwrap().frames(Channel::Reflected), 0);
        for index in 0..150 {
            recording.push(&exposure(index, 40 * 57)).unwrap();
            if index % 50 == 49 {
                recording.commit().unwrap();
                let mut run = open(&directory).unwrap();
                assert_eq!(assert_true_to_exposures(&mut run, 40, 57), index + 1);
                assert_eq!(run.stop(), None);
            }
        }
        assert!(recover(&directory).is_err(), "a recording under way is not repaired");
        assert!(recording.space_left().unwrap().bytes > 0);
        drop(recording);
        let report = recover(&directory).unwrap();
        assert_eq!(report.exit_status(), 3, "{report:?}");
        let mut run = open(&directory).unwrap();
        assert_eq!(assert_true_to_exposures(&mut run, 40, 57), 150);
        assert_eq!(run.stop().unwrap().status, StopStatus::CrashRecovered);
        let before = contents(&directory);
        assert_eq!(recover(&directory).unwrap().exit_status(), 0);
        assert!(before == contents(&directory));
        let recorded = run.rows().unwrap().filter(|row| {
            let row = row.as_ref().unwrap();
            row.channel == Channel::Reflected && matches!(row.state, RowState::Recorded { .. })
        });
        assert_eq!(recorded.count() as u64, run.frames(Channel::Reflected));
    }
}
