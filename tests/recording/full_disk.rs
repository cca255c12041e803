//! A disk that is really full: a small file system in memory, where this user may mount one.

use crate::common::{FORMATS, assert_true_to_exposures, exposure, plan, stop};
use sofiscope::acquisition::{Loss, RowState};
use sofiscope::recording::{Recording, RecordingError, StopStatus, open};
use std::path::Path;
use std::process::Command;

/// Unmounts when the test ends.
struct Mounted<'a>(&'a Path);

impl<'a> Mounted<'a> {
    fn new(path: &'a Path, size: &str) -> Option<Self> {
        let options = format!("size={size}");
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", &options, "tmpfs"]).arg(path).output();
        mount.is_ok_and(|output| output.status.success()).then_some(Self(path))
    }
}

impl Drop for Mounted<'_> {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0).output();
    }
}

#[test]
fn a_full_disk_ends_the_recording_with_all_that_fitted() {
    for format in FORMATS {
        let folder = tempfile::tempdir().unwrap();
        let Some(_mounted) = Mounted::new(folder.path(), "16m") else {
            println!("skipped: no tmpfs can be mounted here");
            return;
        };
        let directory = folder.path().join("run");
        let mut recording = Recording::create(&plan(&directory, format, 256, 256)).unwrap();
        let mut failures = Vec::new();
        for index in 0..200 {
            let pushed = recording
                .push(&exposure(index, 1 << 16))
                .and_then(|()| if index % 4 == 3 { recording.commit() } else { Ok(()) });
            failures.extend(pushed.err());
        }
        assert_eq!(failures.len(), 1, "{failures:?}");
        let said = failures[0].to_string();
        assert!(matches!(failures[0], RecordingError::Storage { .. }), "{said}");
        assert!(said.contains("bytes are free") && said.contains("per second"), "{said}");
        assert_eq!(failures[0].loss(), Loss::DiskFull);
        let summary = recording.finish(stop()).unwrap();
        assert_eq!((summary.stop.status, summary.exposures), (StopStatus::Fail, 200));
        assert!(summary.recorded[0] >= 40, "{summary:?}");
        let mut run = open(&directory).unwrap();
        assert_eq!(assert_true_to_exposures(&mut run, 256, 256), 200);
        assert_eq!(run.stop().unwrap().status, StopStatus::Fail);
        let lost = run
            .rows()
            .unwrap()
            .filter(|row| row.as_ref().unwrap().state == RowState::Lost(Loss::DiskFull))
            .count() as u64;
        let said: u64 = summary.lost.iter().map(|lost| lost[&Loss::DiskFull]).sum();
        assert_eq!(lost, said);
    }
}
