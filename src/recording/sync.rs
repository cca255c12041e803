//! Makes what is written durable, beside the recorder and never in its way.
//!
//! In: paths of files under way. Out: `fdatasync` on descriptors of its own, on a thread of its own.
//! Never: retries a sync that failed, since the system reports lost data only once. Fails: the first error stays.

use super::RecordingError;
use super::direct::{Gate, Operation};
use std::fs::File;
use std::path::PathBuf;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Data becomes durable at least this often while there is any.
const PERIOD: Duration = Duration::from_secs(1);
/// And when this much has been written.
const BYTES: u64 = 512 << 20;

/// A file with a descriptor of its own for syncing.
pub(super) type SyncFile = Arc<(PathBuf, File)>;

type Failure = Arc<Mutex<Option<RecordingError>>>;

/// The thread and what it is to do next.
#[derive(Debug)]
pub(super) struct Syncer {
    requests: Option<SyncSender<Vec<SyncFile>>>,
    thread: Option<JoinHandle<()>>,
    failure: Failure,
    last: Instant,
    bytes: u64,
}

impl Syncer {
    pub(super) fn start(gate: Gate) -> std::io::Result<Self> {
        let (requests, received) = sync_channel::<Vec<SyncFile>>(1);
        let failure: Failure = Arc::default();
        let failed = Arc::clone(&failure);
        let thread = std::thread::Builder::new().name("record-sync".to_owned()).spawn(move || {
            for files in received {
                for file in &files {
                    sync(file, &gate, &failed);
                }
            }
        })?;
        Ok(Self { requests: Some(requests), thread: Some(thread), failure, last: Instant::now(), bytes: 0 })
    }

    /// Notes `bytes` written; true when it is time to sync.
    pub(super) fn is_due(&mut self, bytes: u64) -> bool {
        self.bytes += bytes;
        self.bytes > 0 && (self.bytes >= BYTES || self.last.elapsed() >= PERIOD)
    }

    /// Hands over files to sync; while the thread is busy with others they wait for the next time.
    pub(super) fn request(&mut self, files: Vec<SyncFile>) -> bool {
        let taken = self.requests.as_ref().is_some_and(|requests| requests.try_send(files).is_ok());
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

    /// Syncs `files` as the last ones and waits for all.
    pub(super) fn finish(mut self, files: Vec<SyncFile>) -> Result<(), RecordingError> {
        if let Some(requests) = self.requests.take() {
            // A thread that is gone is found by joining it.
            let _ = requests.send(files);
        }
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            let source = std::io::Error::other("the syncing thread panicked");
            return Err(RecordingError::storage(std::path::Path::new(""), "sync", source));
        }
        self.failure().map_or(Ok(()), Err)
    }
}

fn sync(file: &SyncFile, gate: &Gate, failure: &Failure) {
    let (path, file) = &**file;
    if let Err(source) = gate.pass(Operation::Sync, path).and_then(|()| file.sync_data()) {
        let error = RecordingError::storage(path, "sync", source);
        failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }
}
