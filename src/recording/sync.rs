//! Makes what is written durable, beside the recorder and never in its way.
//!
//! In: files under way and the frames in them. Out: `fdatasync` on descriptors of its own, on a thread of its own,
//! and then the number of durable frames in the lock file.
//! Never: retries a sync that failed, since the system reports lost data only once. Fails: the first error stays.

use super::RecordingError;
use super::gate::{Change, Gate, Operation};
use super::lock::note_durable;
use std::fs::File;
use std::path::PathBuf;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// When data is to become durable.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pace {
    /// At least this often while there is any.
    pub(super) period: Duration,
    /// And when this much has been written.
    pub(super) bytes: u64,
}

impl Default for Pace {
    fn default() -> Self {
        Self { period: Duration::from_secs(1), bytes: 512 << 20 }
    }
}

/// A file or directory with a descriptor of its own for syncing.
pub(super) type SyncFile = Arc<(PathBuf, File)>;

type Failure = Arc<Mutex<Option<RecordingError>>>;

/// What is to become durable.
#[derive(Debug)]
pub(super) struct SyncRequest {
    pub(super) files: Vec<SyncFile>,
    /// Frames of R and T that the files hold.
    pub(super) frames: [u64; 2],
}

/// The thread and what it is to do next.
#[derive(Debug)]
pub(super) struct Syncer {
    requests: Option<SyncSender<SyncRequest>>,
    thread: Option<JoinHandle<()>>,
    failure: Failure,
    pace: Pace,
    last: Instant,
    bytes: u64,
}

impl Syncer {
    /// Starts the thread; `lock` is the file that tells how many frames are durable.
    pub(super) fn start(lock: SyncFile, gate: Gate, pace: Pace) -> std::io::Result<Self> {
        let (requests, received) = sync_channel::<SyncRequest>(1);
        let failure: Failure = Arc::default();
        let failed = Arc::clone(&failure);
        let thread = std::thread::Builder::new().name("record-sync".to_owned()).spawn(move || {
            for request in received {
                if let Err(error) = carry_out(&request, &lock, &gate) {
                    failed.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                    return;
                }
            }
        })?;
        let thread = Some(thread);
        Ok(Self { requests: Some(requests), thread, failure, pace, last: Instant::now(), bytes: 0 })
    }

    /// Notes `bytes` written; true when it is time to sync.
    pub(super) fn is_due(&mut self, bytes: u64) -> bool {
        self.bytes += bytes;
        self.bytes > 0 && (self.bytes >= self.pace.bytes || self.last.elapsed() >= self.pace.period)
    }

    /// Hands over files to sync; while the thread is busy with others they wait for the next time.
    pub(super) fn request(&mut self, request: SyncRequest) -> bool {
        let taken = self.requests.as_ref().is_some_and(|requests| requests.try_send(request).is_ok());
        if taken {
            self.last = Instant::now();
            self.bytes = 0;
        }
        taken
    }

    /// The first failure, once.
    pub(super) fn failure(&self) -> Option<RecordingError> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Syncs what is left and waits for all.
    pub(super) fn finish(mut self, request: SyncRequest) -> Result<(), RecordingError> {
        if let Some(requests) = self.requests.take() {
            // A thread that is gone is found by joining it.
            let _ = requests.send(request);
        }
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            let source = std::io::Error::other("the syncing thread panicked");
            return Err(RecordingError::storage(std::path::Path::new(""), "sync", source));
        }
        self.failure().map_or(Ok(()), Err)
    }
}

fn carry_out(request: &SyncRequest, lock: &SyncFile, gate: &Gate) -> Result<(), RecordingError> {
    request.files.iter().chain([lock]).try_for_each(|file| sync(file, gate))?;
    note_durable(lock, request.frames, gate)
        .map_err(|source| RecordingError::storage(&lock.0, "write", source))
}

/// Makes one file or directory durable.
pub(super) fn sync(file: &SyncFile, gate: &Gate) -> Result<(), RecordingError> {
    let (path, file) = &**file;
    gate.pass(Operation::Sync, path)
        .and_then(|()| file.sync_data())
        .map_err(|source| RecordingError::storage(path, "sync", source))?;
    gate.note(Change::Synced, path);
    Ok(())
}
