//! One writer at a time: a lock file that names its process.
//!
//! In: the directory of a recording. Out: a lock that the system takes back when the process ends, in whatever way.
//! Never: waits. Fails: [`RecordingError::InUse`] with the process that has it.

use super::RecordingError;
use rustix::fs::{FlockOperation, flock};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

const LOCK: &str = "recording.lock";

/// Held while a recording is written.
#[derive(Debug)]
pub(super) struct Lock {
    path: PathBuf,
    _file: File,
}

impl Lock {
    /// Takes the lock, also over the lock file that a killed process left behind.
    pub(super) fn take(directory: &Path) -> Result<Self, RecordingError> {
        let path = directory.join(LOCK);
        let mut file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(|source| RecordingError::storage(&path, "create", source))?;
        if flock(&file, FlockOperation::NonBlockingLockExclusive).is_err() {
            let pid = std::fs::read_to_string(&path).unwrap_or_default().trim().to_owned();
            return Err(RecordingError::InUse { path: directory.to_path_buf(), pid });
        }
        file.set_len(0)
            .and_then(|()| writeln!(file, "{}", std::process::id()))
            .map_err(|source| RecordingError::storage(&path, "write", source))?;
        Ok(Self { path, _file: file })
    }

    /// Lets go and removes the file.
    pub(super) fn release(self) {
        // A lock file that stays is taken over by whoever comes next.
        let _ = std::fs::remove_file(&self.path);
    }
}
