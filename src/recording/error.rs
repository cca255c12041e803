//! What can go wrong with a recording, with the next step.

use crate::acquisition::Loss;
use crate::files::{ErrorKind, FileError, free_bytes};
use std::io;
use std::path::{Path, PathBuf};

/// Everything that recording, reading and repairing a recording can fail with.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The directory is taken.
    #[error("{} exists already, and a recording never overwrites. Choose another directory.", .path.display())]
    Exists {
        /// The directory.
        path: PathBuf,
    },
    /// What was asked for cannot be recorded or exported.
    #[error("{} cannot be recorded: {reason}.", .path.display())]
    Refused {
        /// The directory.
        path: PathBuf,
        /// Why, with the remedy.
        reason: String,
    },
    /// Too little room for what was planned, or for going on.
    #[error(
        "{}: {} MB free, {} MB needed. Free some space or record to another disk.",
        .path.display(), .free_bytes / 1_000_000, .needed_bytes / 1_000_000
    )]
    Space {
        /// The directory.
        path: PathBuf,
        /// Bytes needed.
        needed_bytes: u64,
        /// Bytes left for this user.
        free_bytes: u64,
    },
    /// The disk or the file system refuses.
    #[error(
        "Could not {action} {}: {source}; {}. What was committed before is readable.",
        .path.display(), Room { free: *.free_bytes, rate: *.needed_bytes_per_second }
    )]
    Storage {
        /// The file.
        path: PathBuf,
        /// What was tried, as a verb.
        action: &'static str,
        /// What the system said.
        source: io::Error,
        /// Bytes left for this user, if the disk answers.
        free_bytes: Option<u64>,
        /// Bytes per second that the cameras deliver; 0 when nothing is being recorded.
        needed_bytes_per_second: u64,
    },
    /// Directory or files are no longer where they were created.
    #[error(
        "{} is gone: it was deleted, renamed or unmounted during the recording. \
         Frames go nowhere from then on; what was recorded is where the directory is now, if anywhere.",
        .path.display()
    )]
    Gone {
        /// The directory or file.
        path: PathBuf,
    },
    /// The disk does not answer any more.
    #[error(
        "{} could not be closed within {seconds} s: the disk does not answer. \
         What was committed is readable; run recover when the disk is back.",
        .path.display()
    )]
    Hangs {
        /// The directory.
        path: PathBuf,
        /// How long it was waited for.
        seconds: f64,
    },
    /// Another process has the recording open.
    #[error("{} is in use by process {pid}. Wait until it ends.", .path.display())]
    InUse {
        /// The directory.
        path: PathBuf,
        /// What the lock file says.
        pid: String,
    },
    /// A file contradicts itself or its neighbors.
    #[error("{}, {field}: {detail}. The recording is damaged there.", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The field, page or line.
        field: String,
        /// What is wrong.
        detail: String,
    },
    /// A page that was never recorded, or memory that does not fit.
    #[error("{}: page {page} of {pages} with memory for {given} of {expected} pixels was asked for.", .path.display())]
    OutOfRange {
        /// The file.
        path: PathBuf,
        /// The page asked for, from 0.
        page: u64,
        /// Pages there.
        pages: u64,
        /// Pixels given.
        given: usize,
        /// Pixels of a frame.
        expected: usize,
    },
    /// A frame is not what was recorded.
    #[error("{}, page {page}: the pixels have the checksum {found:08x}, the ledger says {expected:08x}. Do not analyze this frame.", .path.display())]
    BadCrc {
        /// The file.
        path: PathBuf,
        /// The page, from 0.
        page: u64,
        /// CRC-32C of the ledger.
        expected: u32,
        /// CRC-32C of the pixels.
        found: u32,
    },
}

impl RecordingError {
    /// Who has to act: decides the exit code.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Damaged { .. } | Self::BadCrc { .. } => ErrorKind::Data,
            Self::Space { .. } | Self::Storage { .. } | Self::Gone { .. } | Self::Hangs { .. } => {
                ErrorKind::Storage
            }
            _ => ErrorKind::Usage,
        }
    }

    /// What the ledger says of frames lost to this error.
    #[must_use]
    pub fn loss(&self) -> Loss {
        match self {
            Self::Space { .. } => Loss::DiskFull,
            Self::Storage { source, .. } if is_full(source) => Loss::DiskFull,
            _ => Loss::IoError,
        }
    }

    pub(super) fn storage(path: &Path, action: &'static str, source: io::Error) -> Self {
        let free_bytes = free_bytes(path).ok();
        Self::Storage { path: path.to_path_buf(), action, source, free_bytes, needed_bytes_per_second: 0 }
    }

    pub(super) fn damaged(path: &Path, field: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_path_buf(), field: field.into(), detail: detail.into() }
    }

    pub(super) fn at_rate(mut self, rate: u64) -> Self {
        if let Self::Storage { needed_bytes_per_second, .. } = &mut self {
            *needed_bytes_per_second = rate;
        }
        self
    }
}

impl From<FileError> for RecordingError {
    fn from(error: FileError) -> Self {
        match error {
            FileError::Io { path, action, source } => Self::storage(&path, action, source),
            other => Self::Refused { path: PathBuf::new(), reason: other.to_string() },
        }
    }
}

fn is_full(source: &io::Error) -> bool {
    use io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    matches!(source.kind(), StorageFull | QuotaExceeded | FileTooLarge)
}

/// Free bytes and rate as a clause.
struct Room {
    free: Option<u64>,
    rate: u64,
}

impl std::fmt::Display for Room {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.free {
            Some(free) => write!(formatter, "{free} bytes are free")?,
            None => formatter.write_str("the free space is unknown")?,
        }
        if self.rate > 0 { write!(formatter, ", {} per second are needed", self.rate) } else { Ok(()) }
    }
}
