//! The recording thread: exposures to disk as they come, off the path of the cameras.
//!
//! In: every exposure once, in order. Out: the recording, still open for its stop record.
//! Never: stops reading its queue before the cameras are done, also when the disk has failed.
//! Fails: the failure is shown to whoever watches, once, and stays.

use crate::acquisition::ExposureRecord;
use crate::pipeline::{Received, Receiver};
use crate::recording::Recording;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Longest sleep without a look at the age of the group.
const TURN: Duration = Duration::from_millis(10);

/// How often it is asked whether the directory is still there.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// How often the disk is asked for its space.
const ASK_SPACE_EVERY: Duration = Duration::from_secs(1);

/// What the recording says while it goes on.
#[derive(Debug, Clone, Default)]
pub(super) struct RecorderStatus(Arc<OnceLock<String>>);

impl RecorderStatus {
    /// Why nothing more is recorded, if so.
    pub(super) fn failure(&self) -> Option<&str> {
        self.0.get().map(String::as_str)
    }
}

/// The work of the recording thread.
#[derive(Debug)]
pub(super) struct Recorder {
    pub(super) recording: Recording,
    pub(super) status: RecorderStatus,
}

impl Recorder {
    /// Records until the dispatch is gone; gives the recording back for its stop record.
    pub(super) fn run(mut self, mut records: Receiver<ExposureRecord>) -> Recording {
        let mut asked = Instant::now();
        let mut looked = asked;
        loop {
            let received = records.receive(TURN);
            let outcome = match &received {
                Received::Value(record) => self.recording.push(record),
                Received::Empty | Received::Closed => Ok(()),
            };
            self.note(outcome);
            let is_closed = matches!(received, Received::Closed);
            drop(received);
            let outcome = self.recording.settle(records.len());
            self.note(outcome);
            if looked.elapsed() >= LOOK_EVERY {
                looked = Instant::now();
                let outcome = self.recording.ensure_present();
                self.note(outcome);
            }
            if asked.elapsed() >= ASK_SPACE_EVERY {
                asked = Instant::now();
                let outcome = self.recording.ensure_space().map(|_| ());
                self.note(outcome);
            }
            if is_closed {
                return self.recording;
            }
        }
    }

    fn note<E: std::fmt::Display>(&self, outcome: Result<(), E>) {
        if let Err(error) = outcome {
            tracing::error!(%error, "recording");
            // The first failure is the one that explains the others.
            let _ = self.status.0.set(error.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::Conditions;
    use crate::pipeline::{Bell, WhenFull, bounded};
    use crate::recording::{CameraDescription, Format, RecordingPlan};
    use sofiscope_hal::{CameraIdentity, CameraSettings, Region, TriggerMode};

    fn plan(directory: std::path::PathBuf) -> RecordingPlan {
        let identity = CameraIdentity {
            vendor: String::new(),
            model: String::new(),
            serial: String::new(),
            firmware: String::new(),
            simulated: true,
        };
        let settings = CameraSettings {
            region: Region { left: 0, top: 0, width: 8, height: 8 },
            exposure: Duration::from_millis(1),
            period: Duration::from_millis(1),
            trigger: TriggerMode::External,
        };
        let camera = CameraDescription { identity, settings, pixel_size_nm: None };
        RecordingPlan {
            directory,
            format: Format::OmeTiff,
            cameras: [camera.clone(), camera],
            planned_exposures: None,
            simulated: true,
            conditions: Conditions::default(),
            provenance: Vec::new(),
        }
    }

    #[test]
    fn a_directory_that_is_deleted_is_missed_within_a_second() {
        let folder = tempfile::tempdir().unwrap();
        let directory = folder.path().join("run");
        let recording = Recording::create(&plan(directory.clone())).unwrap();
        let status = RecorderStatus::default();
        let recorder = Recorder { recording, status: status.clone() };
        let (sender, receiver) =
            bounded::<ExposureRecord>("pair→record", 4, WhenFull::Wait, &Bell::default());
        let thread = std::thread::spawn(move || recorder.run(receiver));
        std::fs::remove_dir_all(&directory).unwrap();
        let deleted = Instant::now();
        while status.failure().is_none() {
            assert!(deleted.elapsed() < Duration::from_secs(1));
            std::thread::yield_now();
        }
        assert!(status.failure().unwrap().contains("is gone"), "{:?}", status.failure());
        drop(sender);
        thread.join().unwrap();
    }
}
