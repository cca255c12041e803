//! The recording thread: exposures to disk, in groups, off the path of the cameras.
//!
//! In: every exposure once, in order. Out: the recording, still open for its stop record.
//! Never: stops reading its queue before the cameras are done, also when the disk has failed.
//! Fails: the failure is shown to whoever watches, once, and stays.

use crate::acquisition::ExposureRecord;
use crate::pipeline::{Received, Receiver};
use crate::recording::Recording;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Oldest exposure that is not yet on its way to the disk; a kill costs no more.
const GROUP_AGE: Duration = Duration::from_millis(50);

/// Longest sleep without a look at the age of the group.
const TURN: Duration = Duration::from_millis(10);

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
        loop {
            let received = records.receive(TURN);
            let outcome = match &received {
                Received::Value(record) => self.recording.push(record),
                Received::Empty | Received::Closed => Ok(()),
            };
            self.note(outcome);
            let is_closed = matches!(received, Received::Closed);
            drop(received);
            let is_old = self.recording.pending_since().is_some_and(|since| since.elapsed() >= GROUP_AGE);
            if is_old || is_closed {
                let outcome = self.recording.commit();
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
