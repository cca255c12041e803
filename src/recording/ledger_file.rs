//! `ledger.csv` under way: a header and one line per exposure of each camera.
//!
//! In: rows. Out: whole lines, in the file when [`LedgerFile::write`] returns.
//! Never: leaves room ahead unreserved, so that the end can be written to a full disk.
//! Fails: [`RecordingError`]; what was not written is kept and tried again with the next rows, up to a bound.

use super::RecordingError;
use super::appended::Appended;
use super::gate::Gate;
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
        self.file.sync_file()
    }

    /// Gives back what was reserved and makes the ledger durable.
    pub(super) fn close(self) -> Result<(), RecordingError> {
        self.file.close()
    }
}
