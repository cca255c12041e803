//! A recording read back: by replay and analysis, finished or not.
//!
//! In: a directory. Out: what was planned, the rows of the ledger, and any frame of either camera.
//! Never: changes a file, holds more than the places of the frames. Fails: [`RecordingError`] naming file and field.

use super::RecordingError;
use super::events::{self, Event, StopRecord};
use super::facts::{self, FactsBytes};
use super::ledger_file::LEDGER;
use super::metadata::{Format, Metadata};
use super::tiff_pages::{FrameSize, TiffPages};
use super::zarr_pages::ZarrPages;
use crate::acquisition::{LedgerColumns, LedgerRow, RowState};
use sofiscope_hal::Channel;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// A longer line is no row.
const MAX_LINE_BYTES: u64 = 1024;

/// An open recording.
#[derive(Debug)]
pub struct RecordedRun {
    directory: PathBuf,
    metadata: Metadata,
    events: Vec<Event>,
    images: [ImagePages; 2],
    checksums: [Vec<u32>; 2],
}

/// The frames of one camera, whatever their format.
#[derive(Debug)]
pub(super) enum ImagePages {
    Tiff(TiffPages),
    Zarr(ZarrPages),
}

/// Opens a recording; also one that was never finished, as far as it was committed.
///
/// # Errors
/// [`RecordingError::Storage`] for files that cannot be read, [`RecordingError::Damaged`] with file and field.
pub fn open(directory: &Path) -> Result<RecordedRun, RecordingError> {
    let metadata = Metadata::read(directory)?;
    let (events, _) = events::read(directory)?;
    // The ledger first: while a recording goes on, frames come before their rows.
    let checksums = checksums(directory)?;
    let image = |channel| ImagePages::open(directory, &metadata, channel);
    let images = [image(Channel::Reflected)?, image(Channel::Transmitted)?];
    Ok(RecordedRun { directory: directory.to_path_buf(), images, metadata, events, checksums })
}

impl RecordedRun {
    /// Where it is.
    #[must_use]
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// What was planned.
    #[must_use]
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// What happened.
    #[must_use]
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// How it ended; `None` while it goes on and after a crash.
    #[must_use]
    pub fn stop(&self) -> Option<StopRecord> {
        self.events.last().and_then(Event::as_stop)
    }

    /// The rows of the ledger from its begin, R and T of each exposure.
    ///
    /// # Errors
    /// [`RecordingError::Storage`] when the ledger cannot be opened; each row can be damaged.
    pub fn rows(&self) -> Result<LedgerRows, RecordingError> {
        LedgerRows::open(&self.directory)
    }

    /// Frames of one camera.
    #[must_use]
    pub fn frames(&self, channel: Channel) -> u64 {
        self.images[channel.index()].len()
    }

    /// Reads a frame, row by row, unchecked.
    ///
    /// # Errors
    /// [`RecordingError::OutOfRange`] for a page or memory that does not fit, [`RecordingError::Storage`],
    /// [`RecordingError::Damaged`].
    pub fn read(&mut self, channel: Channel, page: u64, counts: &mut [u16]) -> Result<(), RecordingError> {
        let expected = self.metadata.cameras[channel.index()].pixels();
        let image = &mut self.images[channel.index()];
        if page >= image.len() || counts.len() != expected {
            let path = image.path().to_path_buf();
            let (pages, given) = (image.len(), counts.len());
            return Err(RecordingError::OutOfRange { path, page, pages, given, expected });
        }
        image.read(page, counts)
    }

    /// Reads a frame and proves that it is what was recorded.
    ///
    /// # Errors
    /// As [`read`](RecordedRun::read), and [`RecordingError::BadCrc`].
    pub fn read_checked(
        &mut self,
        channel: Channel,
        page: u64,
        counts: &mut [u16],
    ) -> Result<(), RecordingError> {
        self.read(channel, page, counts)?;
        let image = &mut self.images[channel.index()];
        let expected = match self.checksums[channel.index()].get(page as usize) {
            Some(checksum) => *checksum,
            None => image.row(channel, page)?.and_then(|row| checksum(&row)).unwrap_or(0),
        };
        let found = crc32c::crc32c(bytemuck::cast_slice(counts));
        if found == expected {
            return Ok(());
        }
        Err(RecordingError::BadCrc { path: image.path().to_path_buf(), page, expected, found })
    }
}

impl ImagePages {
    pub(super) fn open(
        directory: &Path,
        metadata: &Metadata,
        channel: Channel,
    ) -> Result<Self, RecordingError> {
        let path = directory.join(metadata.image_name(channel));
        let camera = &metadata.cameras[channel.index()];
        match metadata.format {
            Format::OmeTiff => {
                let size = FrameSize { height: camera.height() as u64, width: camera.width() as u64 };
                TiffPages::open(&path, size).map(Self::Tiff)
            }
            Format::OmeZarr => ZarrPages::open(&path, camera).map(Self::Zarr),
        }
    }

    pub(super) fn len(&self) -> u64 {
        match self {
            Self::Tiff(pages) => pages.len(),
            Self::Zarr(pages) => pages.len(),
        }
    }

    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Tiff(pages) => pages.path(),
            Self::Zarr(pages) => pages.path(),
        }
    }

    pub(super) fn read(&mut self, page: u64, counts: &mut [u16]) -> Result<(), RecordingError> {
        let bytes = bytemuck::cast_slice_mut(counts);
        match self {
            Self::Tiff(pages) => pages.read(page, bytes),
            Self::Zarr(pages) => pages.read(page, bytes),
        }
    }

    fn facts(&mut self, page: u64) -> Result<FactsBytes, RecordingError> {
        match self {
            Self::Tiff(pages) => pages.facts(page),
            Self::Zarr(pages) => pages.facts(page),
        }
    }

    /// The row that a frame carries with it; `None` beyond the end and for facts that no row gives.
    pub(super) fn row(&mut self, channel: Channel, page: u64) -> Result<Option<LedgerRow>, RecordingError> {
        if page >= self.len() {
            return Ok(None);
        }
        Ok(facts::decode(&self.facts(page)?, channel, page))
    }
}

pub(super) fn checksum(row: &LedgerRow) -> Option<u32> {
    match row.state {
        RowState::Recorded { crc32c, .. } => Some(crc32c),
        _ => None,
    }
}

/// Checksums of the frames of both cameras in order of their pages.
fn checksums(directory: &Path) -> Result<[Vec<u32>; 2], RecordingError> {
    let mut checksums = [Vec::new(), Vec::new()];
    let mut rows = LedgerRows::open(directory)?;
    while let Some(row) = rows.next() {
        let row = row?;
        let of_camera = &mut checksums[row.channel.index()];
        if let RowState::Recorded { page, crc32c } = row.state {
            if page != of_camera.len() as u64 || page >= super::tiff_pages::MAX_PAGES {
                let field = format!("line {}, page", rows.line);
                let detail = format!("{page} where {} follows", of_camera.len());
                return Err(RecordingError::damaged(&rows.path, field, detail));
            }
            of_camera.push(crc32c);
        }
    }
    Ok(checksums)
}

/// The rows of a ledger, one after another; a torn last line is left out.
#[derive(Debug)]
pub struct LedgerRows {
    path: PathBuf,
    lines: BufReader<File>,
    columns: LedgerColumns,
    line: u64,
    /// Bytes of the whole lines so far.
    bytes: u64,
}

impl LedgerRows {
    pub(super) fn open(directory: &Path) -> Result<Self, RecordingError> {
        let path = directory.join(LEDGER);
        let file = File::open(&path).map_err(|source| RecordingError::storage(&path, "open", source))?;
        let (lines, columns) = (BufReader::with_capacity(1 << 16, file), LedgerColumns::default());
        let mut rows = Self { lines, columns, path, line: 0, bytes: 0 };
        match rows.next_line()?.as_deref().and_then(LedgerColumns::of_header) {
            Some(columns) => Ok(Self { columns, ..rows }),
            None => Err(RecordingError::damaged(&rows.path, "line 1", "not the header of a ledger")),
        }
    }

    /// Bytes of the whole lines so far.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The next whole line.
    fn next_line(&mut self) -> Result<Option<String>, RecordingError> {
        let mut bytes = Vec::new();
        (&mut self.lines)
            .take(MAX_LINE_BYTES)
            .read_until(b'\n', &mut bytes)
            .map_err(|source| RecordingError::storage(&self.path, "read", source))?;
        self.line += 1;
        let len = bytes.len() as u64;
        if bytes.pop() != Some(b'\n') {
            if bytes.len() as u64 + 1 >= MAX_LINE_BYTES {
                let field = format!("line {}", self.line);
                return Err(RecordingError::damaged(&self.path, field, "too long for a row"));
            }
            return Ok(None);
        }
        self.bytes += len;
        Ok(Some(String::from_utf8_lossy(&bytes).into_owned()))
    }
}

impl Iterator for LedgerRows {
    type Item = Result<LedgerRow, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        let line = match self.next_line() {
            Ok(line) => line?,
            Err(error) => return Some(Err(error)),
        };
        Some(self.columns.parse(&line).map_err(|error| {
            RecordingError::damaged(&self.path, format!("line {}", self.line), error.to_string())
        }))
    }
}
