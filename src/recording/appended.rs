//! A file of a recording that only grows at its end.
//!
//! In: whole lines. Out: their bytes in the file when [`Appended::append`] returns.
//! Never: moves its end for what was not written whole. Fails: [`RecordingError`].

use super::RecordingError;
use super::gate::{Change, Gate, Operation};
use super::sync::SyncFile;
use rustix::fs::{FallocateFlags, fallocate};
use std::fs::{File, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::PathBuf;

/// The open file.
#[derive(Debug)]
pub(super) struct Appended {
    file: File,
    path: PathBuf,
    gate: Gate,
    end: u64,
}

impl Appended {
    /// A new file.
    pub(super) fn create(path: PathBuf, gate: Gate) -> Result<Self, RecordingError> {
        let file = gate
            .pass(Operation::Write, &path)
            .and_then(|()| OpenOptions::new().write(true).create_new(true).open(&path))
            .map_err(|source| RecordingError::storage(&path, "create", source))?;
        gate.note(Change::Created, &path);
        Ok(Self { file, path, gate, end: 0 })
    }

    /// An old file, cut at `end`; where there is none, a new one.
    pub(super) fn reopen(path: PathBuf, end: u64) -> Result<Self, RecordingError> {
        let file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .and_then(|file| file.set_len(end).map(|()| file))
            .map_err(|source| RecordingError::storage(&path, "open", source))?;
        Ok(Self { file, path, gate: Gate::default(), end })
    }

    /// Bytes written.
    pub(super) fn end(&self) -> u64 {
        self.end
    }

    /// Keeps room on the disk for so many bytes behind the end; a disk that cannot still writes.
    pub(super) fn reserve(&self, bytes: u64) -> bool {
        fallocate(&self.file, FallocateFlags::KEEP_SIZE, self.end, bytes).is_ok()
    }

    /// Appends bytes.
    pub(super) fn append(&mut self, bytes: &[u8]) -> Result<(), RecordingError> {
        self.gate
            .pass(Operation::Write, &self.path)
            .and_then(|()| self.file.write_all_at(bytes, self.end))
            .map_err(|source| {
            // No half line stays; if not even that works, readers leave a torn line out.
            let _ = self.file.set_len(self.end);
            RecordingError::storage(&self.path, "write", source)
        })?;
        self.gate.note(Change::Bytes(self.end, bytes), &self.path);
        self.end += bytes.len() as u64;
        Ok(())
    }

    /// For syncing while lines are appended.
    pub(super) fn sync_file(&self) -> Result<SyncFile, RecordingError> {
        super::writer::sync_file(&self.path)
    }

    /// Gives back what was reserved and makes the file durable.
    pub(super) fn close(self) -> Result<(), RecordingError> {
        self.file
            .set_len(self.end)
            .and_then(|()| self.gate.pass(Operation::Sync, &self.path))
            .and_then(|()| self.file.sync_all())
            .map_err(|source| RecordingError::storage(&self.path, "sync", source))?;
        self.gate.note(Change::Length(self.end), &self.path);
        self.gate.note(Change::Synced, &self.path);
        Ok(())
    }
}
