//! The bytes of one file: length, byte order and reading at a position.
//!
//! In: a path. Out: bytes and numbers of the file's byte order, and section readers for the decompressors.
//! Never: reads past the end, allocates more than it was asked for. Fails: [`FileError`] naming file, page and field.

use std::fs::{self, File};
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use crate::files::{FileError, Place};

/// Order of the bytes within a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ByteOrder {
    Little,
    Big,
}

impl ByteOrder {
    pub(super) fn u16(self, bytes: [u8; 2]) -> u16 {
        match self {
            ByteOrder::Little => u16::from_le_bytes(bytes),
            ByteOrder::Big => u16::from_be_bytes(bytes),
        }
    }

    pub(super) fn u32(self, bytes: [u8; 4]) -> u32 {
        match self {
            ByteOrder::Little => u32::from_le_bytes(bytes),
            ByteOrder::Big => u32::from_be_bytes(bytes),
        }
    }

    pub(super) fn u64(self, bytes: [u8; 8]) -> u64 {
        match self {
            ByteOrder::Little => u64::from_le_bytes(bytes),
            ByteOrder::Big => u64::from_be_bytes(bytes),
        }
    }

    /// Whether numbers of this order are those of this computer.
    pub(super) fn is_native(self) -> bool {
        (self == ByteOrder::Little) == cfg!(target_endian = "little")
    }
}

/// An open file and what every part of the reader needs to know about it.
#[derive(Debug)]
pub(super) struct Source {
    file: File,
    pub(super) path: PathBuf,
    pub(super) length: u64,
    pub(super) order: ByteOrder,
}

impl Source {
    /// Opens a regular file; pipes and devices are refused without being opened.
    pub(super) fn open(path: &Path) -> Result<Source, FileError> {
        let metadata = fs::metadata(path).map_err(|source| FileError::from_io(path, "open", source))?;
        if !metadata.is_file() {
            return Err(FileError::NotAFile {
                path: path.to_path_buf(),
                found: if metadata.is_dir() { "a directory" } else { "a device or pipe" },
            });
        }
        let file = File::open(path).map_err(|source| FileError::from_io(path, "open", source))?;
        Ok(Source { file, path: path.to_path_buf(), length: metadata.len(), order: ByteOrder::Little })
    }

    /// Fills `bytes` from position `offset`.
    pub(super) fn read(
        &self,
        bytes: &mut [u8],
        offset: u64,
        place: Place,
        field: &'static str,
    ) -> Result<(), FileError> {
        self.ensure_inside(offset, bytes.len() as u64, place, field)?;
        self.file
            .read_exact_at(bytes, offset)
            .map_err(|source| FileError::from_io(&self.path, "read", source))
    }

    /// Refuses a section that reaches past the end of the file.
    pub(super) fn ensure_inside(
        &self,
        offset: u64,
        count: u64,
        place: Place,
        field: &'static str,
    ) -> Result<(), FileError> {
        match offset.checked_add(count) {
            Some(end) if end <= self.length => Ok(()),
            _ => Err(self.damaged(
                place,
                field,
                format!(
                    "{count} bytes at position {offset} reach past the end of the file ({} bytes)",
                    self.length
                ),
            )),
        }
    }

    /// A reader over `count` bytes from position `offset`; ends there, or with the file.
    pub(super) fn section(&self, offset: u64, count: u64) -> Section<'_> {
        Section { file: &self.file, offset, left: count }
    }

    pub(super) fn damaged(&self, place: Place, field: &'static str, detail: impl Into<String>) -> FileError {
        FileError::Damaged { path: self.path.clone(), place, field, detail: detail.into() }
    }

    pub(super) fn unsupported(
        &self,
        place: Place,
        field: &'static str,
        detail: impl Into<String>,
        remedy: &'static str,
    ) -> FileError {
        FileError::Unsupported { path: self.path.clone(), place, field, detail: detail.into(), remedy }
    }
}

/// Part of a file as a stream.
pub(super) struct Section<'file> {
    file: &'file File,
    offset: u64,
    left: u64,
}

impl Read for Section<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let wanted = usize::try_from(self.left).map_or(bytes.len(), |left| left.min(bytes.len()));
        let count = self.file.read_at(&mut bytes[..wanted], self.offset)?;
        self.offset += count as u64;
        self.left -= count as u64;
        Ok(count)
    }
}
