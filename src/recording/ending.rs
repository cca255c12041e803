//! The end of a recording: everything closed, the stop record last, in bounded time.
//!
//! In: what was open, and why it ends. Out: the summary.
//! Never: keeps its caller longer than it said, whatever the disk does; a disk that hangs keeps one thread.
//! Fails: [`RecordingError`]; the frames that were committed are readable.

use super::RecordingError;
use super::direct::sync_directory;
use super::events::{Event, EventLog, StopRecord, StopStatus};
use super::finish::finish_image;
use super::gate::Gate;
use super::ledger_file::LedgerFile;
use super::lock::Lock;
use super::metadata::Metadata;
use super::summary::RecordingSummary;
use super::sync::{SyncRequest, Syncer};
use super::writer::ImageWriter;
use sofiscope_hal::Channel;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

/// What is to be closed.
pub(super) struct Ending {
    pub(super) directory: PathBuf,
    pub(super) metadata: Metadata,
    pub(super) gate: Gate,
    pub(super) images: [ImageWriter; 2],
    pub(super) ledger: LedgerFile,
    pub(super) events: EventLog,
    pub(super) syncer: Syncer,
    pub(super) lock: Lock,
    pub(super) tally: RecordingSummary,
    pub(super) times: [Vec<u64>; 2],
    /// What has failed before.
    pub(super) fault: Option<String>,
}

impl Ending {
    pub(super) fn run(mut self, stop: StopRecord) -> Result<RecordingSummary, RecordingError> {
        let mut fault = self.fault;
        for channel in Channel::BOTH {
            let image = &mut self.images[channel.index()];
            let times = &self.times[channel.index()];
            if let Err(error) = finish_image(image, &self.metadata, channel, times, &self.gate) {
                fault.get_or_insert(error.to_string());
            }
        }
        let files = self.images.iter().flat_map(ImageWriter::sync_files).collect();
        let frames = self.images.each_ref().map(ImageWriter::pages);
        if let Err(error) = self.syncer.finish(SyncRequest { files, frames }) {
            fault.get_or_insert(error.to_string());
        }
        self.tally.stop = match fault {
            None => stop,
            Some(fault) => {
                StopRecord { status: StopStatus::Fail, reason: format!("{}: {fault}", stop.reason) }
            }
        };
        let ledger = self.ledger.write(&[]).and_then(|()| self.ledger.close());
        self.events.append(&Event::stop(&self.tally.stop))?;
        self.events.close()?;
        ledger?;
        self.lock.release();
        sync_directory(&self.directory, &self.gate)?;
        Ok(self.tally)
    }
}

/// Runs `end` on a thread of its own and waits for it, but no longer than `time`.
pub(super) fn within<T: Send + 'static>(
    time: Duration,
    directory: &Path,
    end: impl FnOnce() -> Result<T, RecordingError> + Send + 'static,
) -> Result<T, RecordingError> {
    let (sender, receiver) = sync_channel(1);
    std::thread::Builder::new()
        .name("record-end".to_owned())
        .spawn(move || {
            // Nobody waits any more when this fails.
            let _ = sender.send(end());
        })
        .map_err(|source| RecordingError::storage(directory, "close", source))?;
    match receiver.recv_timeout(time) {
        Ok(outcome) => outcome,
        Err(RecvTimeoutError::Timeout) => {
            Err(RecordingError::Hangs { path: directory.to_path_buf(), seconds: time.as_secs_f64() })
        }
        Err(RecvTimeoutError::Disconnected) => {
            let source = std::io::Error::other("the closing thread panicked");
            Err(RecordingError::storage(directory, "close", source))
        }
    }
}
