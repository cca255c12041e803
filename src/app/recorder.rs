//! The recording thread: exposures to disk, in groups, off the path of the cameras.

use crate::acquisition::ExposureRecord;
use crate::pipeline::Receiver;

/// What the recording thread works with.
#[derive(Debug)]
pub(super) struct Recorder;

/// What it leaves.
#[derive(Debug)]
pub(super) struct RecorderReport;

impl Recorder {
    pub(super) fn run(self, _records: Receiver<ExposureRecord>) -> RecorderReport {
        RecorderReport
    }
}
