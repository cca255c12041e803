//! What can go wrong with a file, said so that the reader of the message knows the next step.
//!
//! In: a cause and where it was met. Out: [`FileError`], one or two sentences with file, page, field and remedy.
//! Never: a panic, a bare operating-system message. Fails: not at all.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Who has to act on a [`FileError`]; decides the exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorKind {
    /// The request cannot be met as given: a wrong path, an output that exists already.
    Usage,
    /// The contents of a file are damaged or of a kind that is not read.
    Data,
    /// The disk is full, read-only or failing.
    Storage,
}

impl ErrorKind {
    /// Exit code of a command that ends with an error of this kind: 2 for usage, else 4.
    pub fn exit_code(self) -> u8 {
        match self {
            ErrorKind::Usage => 2,
            ErrorKind::Data | ErrorKind::Storage => 4,
        }
    }
}

/// Everything that opening, reading or writing a file can fail with.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FileError {
    /// Nothing has this path.
    #[error("{} does not exist. Check the spelling of the path.", .path.display())]
    Missing {
        /// The path as given.
        path: PathBuf,
    },
    /// The path leads to a directory, a pipe or a device.
    #[error("{} is {found}, not a file. Name one image file.", .path.display())]
    NotAFile {
        /// The path as given.
        path: PathBuf,
        /// What is there instead, with its article.
        found: &'static str,
    },
    /// The operating system refuses access.
    #[error("No permission to {action} {}. Change its permissions or choose another path.", .path.display())]
    Denied {
        /// The path as given.
        path: PathBuf,
        /// What was tried, as a verb.
        action: &'static str,
    },
    /// The file is no TIFF at all.
    #[error("{} is not a TIFF file: {found}. Save it as TIFF, OME-TIFF or BigTIFF.", .path.display())]
    NotTiff {
        /// The file.
        path: PathBuf,
        /// What its first bytes are.
        found: String,
    },
    /// A field contradicts the rest of the file, or the file ends too early.
    #[error("{}, {place}, {field}: {detail}. The file is damaged or cut short; copy or export it again.", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The page or part of the file.
        place: Place,
        /// The TIFF field or section concerned.
        field: &'static str,
        /// What is wrong with it.
        detail: String,
    },
    /// The file is well formed but of a kind that is not read.
    #[error("{}, {place}, {field}: {detail}. {remedy}.", .path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The page or part of the file.
        place: Place,
        /// The TIFF field or section concerned.
        field: &'static str,
        /// What was found.
        detail: String,
        /// What to do about it.
        remedy: &'static str,
    },
    /// A pixel is NaN or infinite.
    #[error(
        "{}, page {page}: pixel (y, x) = ({y}, {x}) is {value}, and one such pixel spoils every cumulant. Replace it or leave that frame out.",
        .path.display()
    )]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Page in the file, from 1.
        page: usize,
        /// Row, from 0.
        y: usize,
        /// Column, from 0.
        x: usize,
        /// The value found.
        value: f32,
    },
    /// A frame or channel that the stack does not have was asked for.
    #[error("{} has {count} {noun}s; {noun} {index} (from 0) was asked for. Ask for less.", .path.display())]
    OutOfRange {
        /// The file.
        path: PathBuf,
        /// `frame` or `channel`.
        noun: &'static str,
        /// What was asked for.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// The memory given does not fit the frame or the sample type.
    #[error("{}: a frame has {expected} of type {sample}, the memory given is for {given}. Size it from the stack's info.", .path.display())]
    WrongBuffer {
        /// The file.
        path: PathBuf,
        /// Samples per frame.
        expected: usize,
        /// Sample type of the file.
        sample: &'static str,
        /// What was given.
        given: String,
    },
    /// The output path is taken.
    #[error("{} exists already. Choose another --out or remove it.", .path.display())]
    OutputExists {
        /// The output path.
        path: PathBuf,
    },
    /// The output path cannot be used.
    #[error("{} cannot be the output: {reason}. Choose another --out.", .path.display())]
    OutputRefused {
        /// The output path.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// What was asked to be written cannot be stored.
    #[error("{} cannot be written: {reason}.", .path.display())]
    NotWritable {
        /// The file.
        path: PathBuf,
        /// Why not, with the remedy.
        reason: String,
    },
    /// The disk is full or would become so.
    #[error("{}: not enough space on this disk ({space}). Free some space or choose another --out.", .path.display())]
    DiskFull {
        /// Where was written.
        path: PathBuf,
        /// Bytes needed and left, as far as known.
        space: Space,
    },
    /// Any other failure of the operating system.
    #[error("Could not {action} {}: {source}. Check the disk, then try again.", .path.display())]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// What was tried, as a verb.
        action: &'static str,
        /// What the system said.
        source: io::Error,
    },
}

impl FileError {
    /// Who has to act: decides the exit code.
    pub fn kind(&self) -> ErrorKind {
        match self {
            FileError::NotTiff { .. }
            | FileError::Damaged { .. }
            | FileError::Unsupported { .. }
            | FileError::NotFinite { .. } => ErrorKind::Data,
            FileError::DiskFull { .. } | FileError::Io { .. } => ErrorKind::Storage,
            _ => ErrorKind::Usage,
        }
    }

    /// The error for an operating-system failure while doing `action` (a verb) at `path`.
    pub(crate) fn from_io(path: &Path, action: &'static str, source: io::Error) -> FileError {
        let path = path.to_path_buf();
        match source.kind() {
            io::ErrorKind::NotFound => FileError::Missing { path },
            io::ErrorKind::PermissionDenied => FileError::Denied { path, action },
            io::ErrorKind::ReadOnlyFilesystem => {
                FileError::OutputRefused { path, reason: "the disk is read-only".to_owned() }
            }
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
                FileError::DiskFull {
                    space: Space { needed_bytes: None, free_bytes: super::space::free_bytes(&path).ok() },
                    path,
                }
            }
            _ => FileError::Io { path, action, source },
        }
    }
}

/// Where in a file: a page counted from 1, or the file as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The header before all pages.
    Header,
    /// A page of the file, counted from 1 over all directories.
    Page(usize),
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Place::Header => f.write_str("file header"),
            Place::Page(page) => write!(f, "page {page}"),
        }
    }
}

/// Space on a disk, as far as known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Space {
    /// Bytes that the output needs.
    pub needed_bytes: Option<u64>,
    /// Bytes left for this user.
    pub free_bytes: Option<u64>,
}

impl std::fmt::Display for Space {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let megabytes = |bytes: u64| format!("{:.1} MB", bytes as f64 / 1e6);
        match (self.needed_bytes, self.free_bytes) {
            (Some(needed), Some(free)) => {
                write!(f, "{} needed, {} free", megabytes(needed), megabytes(free))
            }
            (Some(needed), None) => write!(f, "{} needed", megabytes(needed)),
            (None, Some(free)) => write!(f, "{} free", megabytes(free)),
            (None, None) => f.write_str("the disk reports that it is full"),
        }
    }
}
