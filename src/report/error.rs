//! What can go wrong when a report is written or read.

use std::path::PathBuf;

use crate::display::DisplayError;

/// A report could not be made, written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// A picture could not be made.
    #[error("the picture \"{title}\" could not be made")]
    Picture {
        /// Title of the picture.
        title: String,
        /// What was wrong with it.
        source: DisplayError,
    },
    /// The report could not be turned into JSON.
    #[error("the report could not be written as JSON")]
    Encode(#[source] serde_json::Error),
    /// The file is not a report.
    #[error("{} is not a report of this program", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// The field and line at fault.
        source: serde_json::Error,
    },
    /// The file could not be read or written.
    #[error("{} could not be read or written", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}
