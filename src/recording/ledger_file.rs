//! `ledger.csv` under way: a header and one line per exposure of each camera.
//!
//! In: rows. Out: whole lines, in the file when [`LedgerFile::write`] returns.
//! Never: leaves room ahead unreserved, so that the end can be written to a full disk.
//! Fails: [`RecordingError`]; what was not written is kept and tried again with the next rows, up to a bound.

use super::RecordingError;
use super::appended::Appended;
use super::direct::Gate;
use super::gate::{Change, Gate, Operation};
use super::sync::SyncFile;
use crate::acquisition::LedgerRow;
use std::path::Path;

/// Name of the file.
pub(super) const LEDGER: &str = "ledger.csv";
/// Room kept ahead of the last line: minutes of rows.
const RESERVE: u64 = 1 << 20;
/// Lines kept in memory while the disk refuses them.
const MAX_WAITING_BYTES: usize = 8 << 20;

/// The open file.
#[derive(Debug)]
pub(super) struct LedgerFile {
    file: Appended,
    reserved: u64,
    waiting: String,
}

impl LedgerFile {
    pub(super) fn create(directory: &Path, gate: Gate) -> Result<Self, RecordingError> {
        let file = Appended::create(directory.join(LEDGER), gate)?;
        let path = directory.join(LEDGER);
        let file = gate
            .pass(Operation::Write, &path)
            .and_then(|()| OpenOptions::new().write(true).create_new(true).open(&path))
            .map_err(|source| RecordingError::storage(&path, "create", source))?;
        gate.note(Change::Created, &path);
        let waiting = LedgerRow::header() + "\n";
        let mut ledger = Self { file, reserved: 0, waiting };
        ledger.write(&[])?;
        Ok(ledger)
    }

    /// Appends rows.
    pub(super) fn write(&mut self, rows: &[LedgerRow]) -> Result<(), RecordingError> {
        for row in rows {
            if self.waiting.len() < MAX_WAITING_BYTES {
                row.write_to(&mut self.waiting);
            }
        }
        if self.waiting.is_empty() {
            return Ok(());
        }
        self.reserve();
        if let Err(error) = self.file.append(self.waiting.as_bytes()) {
            self.reserved = self.file.end();
            return Err(error);
        }
        self.gate
            .pass(Operation::Write, &self.path)
            .and_then(|()| self.file.write_all_at(self.waiting.as_bytes(), self.end))
            .map_err(|source| {
                // No half line stays; if not even that works, readers leave a torn line out.
                let _ = self.file.set_len(self.end);
                self.reserved = self.end;
                RecordingError::storage(&self.path, "write", source)
            })?;
        self.gate.note(Change::Bytes(self.end, self.waiting.as_bytes()), &self.path);
        self.end += self.waiting.len() as u64;
        self.waiting.clear();
        Ok(())
    }

    /// Keeps room for what waits and [`RESERVE`] behind it.
    fn reserve(&mut self) {
        let end = self.file.end() + self.waiting.len() as u64 + RESERVE / 2;
        if end > self.reserved && self.file.reserve(end + RESERVE - self.file.end()) {
            self.reserved = end + RESERVE;
        }
    }

    /// For syncing while the ledger is written.
    pub(super) fn sync_file(&self) -> Result<SyncFile, RecordingError> {
        super::writer::sync_file(&self.path)
    }

    /// Gives back what was reserved and makes the ledger durable.
    pub(super) fn close(self) -> Result<(), RecordingError> {
        self.file.close()
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
