//! What can go wrong with a replay, said so that the reader of the message knows the next step.
//!
//! In: a cause and where it was met. Out: [`ReplayError`] with file, field and remedy.
//! Never: a panic, a bare operating-system message. Fails: not at all.

use crate::files::{ErrorKind, FileError};
use crate::recording::RecordingError;
use std::io;
use std::path::{Path, PathBuf};

/// Everything that opening and reading a replay can fail with.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReplayError {
    /// No file, an unreadable one, or a damaged stack.
    #[error(transparent)]
    File(#[from] FileError),
    /// A recording that cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A field contradicts the rest of the file, or the file ends too early.
    #[error("{}, {field}: {detail}. The file is damaged or cut short; copy or export it again.", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The field, page or line.
        field: String,
        /// What is wrong with it.
        detail: String,
    },
    /// The file is well formed but of a kind that is not read.
    #[error("{}, {field}: {detail}. {remedy}.", .path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The field.
        field: String,
        /// What was found.
        detail: String,
        /// What to do about it.
        remedy: &'static str,
    },
    /// A header with faults, all of them.
    #[error("{} has {} fault(s): {}.", .path.display(), .faults.len(), .faults.join("; "))]
    Header {
        /// The file.
        path: PathBuf,
        /// One text per fault, each naming its key.
        faults: Vec<String>,
    },
    /// The frames of one camera only.
    #[error(
        "{} has the frames of one camera, and a replay needs two. Name the file of the other camera as well, \
         or read this one with `sofiscope analyze`.",
        .path.display()
    )]
    OneCamera {
        /// The file.
        path: PathBuf,
    },
    /// The files do not belong together, or the wish cannot be met.
    #[error("This cannot be replayed: {reason}.")]
    Refused {
        /// Why, with the remedy.
        reason: String,
    },
}

impl ReplayError {
    /// Who has to act: decides the exit code.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::File(error) => error.kind(),
            Self::Recording(error) => error.kind(),
            Self::Damaged { .. } | Self::Unsupported { .. } | Self::Header { .. } => ErrorKind::Data,
            Self::OneCamera { .. } | Self::Refused { .. } => ErrorKind::Usage,
        }
    }

    pub(super) fn damaged(path: &Path, field: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_path_buf(), field: field.into(), detail: detail.into() }
    }

    pub(super) fn unsupported(
        path: &Path,
        field: impl Into<String>,
        detail: impl Into<String>,
        remedy: &'static str,
    ) -> Self {
        Self::Unsupported { path: path.to_path_buf(), field: field.into(), detail: detail.into(), remedy }
    }

    pub(super) fn io(path: &Path, action: &'static str, source: io::Error) -> Self {
        Self::File(FileError::from_io(path, action, source))
    }
}
