//! One writer at a time: a lock file that names its process, and how many frames are known to be durable.
//!
//! In: the directory of a recording. Out: a lock that the system takes back when the process ends, in whatever way.
//! Never: waits. Fails: [`RecordingError::InUse`] with the process that has it.
//!
//! ```text
//! 0..11    process, and the end of its line
//! 11..     `durable R T`, frames of both cameras; behind a crash, damage before them is no part of the crash
//! ```

use super::RecordingError;
use super::gate::{Change, Gate, Operation};
use super::sync::SyncFile;
use rustix::fs::{FlockOperation, flock};
use std::fs::{File, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const LOCK: &str = "recording.lock";
/// Where the number of durable frames stands.
const DURABLE_AT: u64 = 11;
/// A longer file is none of ours.
const MAX_BYTES: usize = 64;

/// Held while a recording is written.
#[derive(Debug)]
pub(super) struct Lock {
    file: (PathBuf, File),
}

impl Lock {
    /// Takes the lock, also over the lock file that a killed process left behind, which keeps what it says of frames.
    pub(super) fn take(directory: &Path) -> Result<Self, RecordingError> {
        let path = directory.join(LOCK);
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(|source| RecordingError::storage(&path, "create", source))?;
        if flock(&file, FlockOperation::NonBlockingLockExclusive).is_err() {
            let text = std::fs::read_to_string(&path).unwrap_or_default();
            let pid = text.lines().next().unwrap_or_default().trim().to_owned();
            return Err(RecordingError::InUse { path: directory.to_path_buf(), pid });
        }
        file.write_all_at(format!("{:>10}\n", std::process::id()).as_bytes(), 0)
            .map_err(|source| RecordingError::storage(&path, "write", source))?;
        Ok(Self { file: (path, file) })
    }

    /// The file for the thread that syncs, without the lock, which ends with the recording.
    pub(super) fn file(&self) -> Result<SyncFile, RecordingError> {
        let path = &self.file.0;
        let file = OpenOptions::new().write(true).open(path);
        file.map(|file| Arc::new((path.clone(), file)))
            .map_err(|source| RecordingError::storage(path, "open", source))
    }

    /// Frames of R and T that were durable when the program that held the lock last said so.
    pub(super) fn durable(&self) -> Option<[u64; 2]> {
        let mut bytes = [0; MAX_BYTES];
        let len = self.file.1.read_at(&mut bytes, DURABLE_AT).ok()?;
        let line = std::str::from_utf8(&bytes[..len]).ok()?.strip_suffix('\n')?;
        let (r, t) = line.strip_prefix("durable ")?.trim_start().split_once(' ')?;
        Some([r.parse().ok()?, t.trim_start().parse().ok()?])
    }

    /// Lets go and removes the file.
    pub(super) fn release(self) {
        // A lock file that stays is taken over by whoever comes next.
        let _ = std::fs::remove_file(&self.file.0);
    }
}

/// Says that this many frames of R and T are durable.
pub(super) fn note_durable(file: &(PathBuf, File), frames: [u64; 2], gate: &Gate) -> std::io::Result<()> {
    let (path, file) = file;
    let line = format!("durable {:>10} {:>10}\n", frames[0], frames[1]);
    gate.pass(Operation::Write, path)?;
    file.write_all_at(line.as_bytes(), DURABLE_AT)?;
    gate.note(Change::Bytes(DURABLE_AT, line.as_bytes()), path);
    Ok(())
}
