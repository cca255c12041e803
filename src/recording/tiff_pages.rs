//! The pages of a recorded BigTIFF: their pixels and facts, found by one walk over the directories.
//!
//! In: a file of ours, whole, cut short or under way. Out: where each frame is.
//! Never: follows a chain backwards, so that no file keeps it busy for long. Fails: [`RecordingError`] with page and field.

use super::RecordingError;
use super::facts::{FACTS_BYTES, FIRST_FACTS_BYTES, FactsBytes};
use super::tiff::FACTS_TAG;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// More pages than this are not kept in memory; 11 hours at 100 per second.
pub(super) const MAX_PAGES: u64 = 1 << 22;
/// Directories are read in pieces of this size.
const WINDOW: usize = 64 << 10;
const MAX_FIELDS: u64 = 32;
const MAX_IFD: usize = 8 + MAX_FIELDS as usize * 20 + 8;

/// An open file and the places of its frames.
#[derive(Debug)]
pub(super) struct TiffPages {
    path: PathBuf,
    file: File,
    /// Offset of the pixels of each page.
    pixels: Vec<u64>,
    /// Offset of the facts of each page.
    facts: Vec<u64>,
    /// Their bytes; recordings of before have fewer.
    facts_bytes: usize,
    /// Where the last page ends.
    end: u64,
    /// Offset of the description of the first page.
    description: Option<u64>,
    /// Where the offset of the directory behind the last page stands.
    chain_end: u64,
}

/// The size that every page must have.
#[derive(Debug, Clone, Copy)]
pub(super) struct FrameSize {
    pub(super) height: u64,
    pub(super) width: u64,
}

impl FrameSize {
    pub(super) fn bytes(self) -> u64 {
        self.height * self.width * 2
    }
}

impl TiffPages {
    /// Walks over all directories.
    pub(super) fn open(path: &Path, size: FrameSize) -> Result<Self, RecordingError> {
        let (pages, fault) = Self::open_readable(path, size)?;
        fault.map_or(Ok(pages), Err)
    }

    /// Walks over the directories up to the first that cannot be read, which is said.
    pub(super) fn open_readable(
        path: &Path,
        size: FrameSize,
    ) -> Result<(Self, Option<RecordingError>), RecordingError> {
        let file = File::open(path).map_err(|source| RecordingError::storage(path, "open", source))?;
        let mut window = Window::over(path, &file)?;
        let mut header = [0; 16];
        header.copy_from_slice(window.at(0, 16, "header")?);
        if header[..8] != [b'I', b'I', 43, 0, 8, 0, 0, 0] {
            return Err(RecordingError::damaged(path, "header", "no little-endian BigTIFF"));
        }
        let mut next = word(&header[8..]);
        let mut pages = Self {
            path: path.to_path_buf(),
            file: file.try_clone().map_err(|source| RecordingError::storage(path, "open", source))?,
            pixels: Vec::new(),
            facts: Vec::new(),
            facts_bytes: FACTS_BYTES,
            end: 4096,
            description: None,
            chain_end: 8,
        };
        let mut last = 0;
        while next != 0 {
            let page = pages.len();
            if next <= last || page >= MAX_PAGES {
                let detail = if next <= last { "points backwards" } else { "more pages than are read" };
                let field = format!("page {page}, next directory");
                return Ok((pages, Some(RecordingError::damaged(path, field, detail))));
            }
            last = next;
            match directory(&mut window, next, page, size) {
                Err(fault) => return Ok((pages, Some(fault))),
                Ok(found) => next = pages.add(&found, size),
            }
        }
        Ok((pages, None))
    }

    /// Takes in the next page; returns where the directory behind it is.
    fn add(&mut self, found: &Found, size: FrameSize) -> u64 {
        if self.pixels.is_empty() {
            self.description = found.description;
        }
        self.pixels.push(found.pixels);
        self.facts.push(found.facts);
        self.facts_bytes = found.facts_bytes;
        self.end = self.end.max((found.pixels + size.bytes()).next_multiple_of(4096));
        self.chain_end = found.next_at;
        found.next
    }

    /// Ends the chain behind the last page that was read.
    pub(super) fn end_chain(&self) -> Result<(), RecordingError> {
        std::fs::OpenOptions::new()
            .write(true)
            .open(&self.path)
            .and_then(|file| file.write_all_at(&[0; 8], self.chain_end))
            .map_err(|source| RecordingError::storage(&self.path, "write", source))
    }

    /// Leaves the pages from `pages` on out of the chain, in memory and in the file.
    pub(super) fn keep(&mut self, pages: u64, size: FrameSize) -> Result<(), RecordingError> {
        let mut window = Window::over(&self.path, &self.file)?;
        let mut next = word(window.at(8, 8, "header")?);
        let (mut end, mut chain_end) = (4096, 8);
        for page in 0..pages {
            let found = directory(&mut window, next, page, size)?;
            end = end.max((found.pixels + size.bytes()).next_multiple_of(4096));
            (next, chain_end) = (found.next, found.next_at);
        }
        drop(window);
        (self.end, self.chain_end) = (end, chain_end);
        self.pixels.truncate(pages as usize);
        self.facts.truncate(pages as usize);
        self.end_chain()
    }

    pub(super) fn len(&self) -> u64 {
        self.pixels.len() as u64
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Where the last page ends, a whole 4 KiB page.
    pub(super) fn end(&self) -> u64 {
        self.end
    }

    /// True when the first page names OME-XML behind the last page.
    pub(super) fn is_described(&self) -> bool {
        self.description.is_none_or(|offset| offset >= self.end)
    }

    /// Reads the pixels of a page that exists, as bytes.
    pub(super) fn read(&self, page: u64, bytes: &mut [u8]) -> Result<(), RecordingError> {
        self.file
            .read_exact_at(bytes, self.pixels[page as usize])
            .map_err(|source| RecordingError::storage(&self.path, "read", source))
    }

    /// The facts of a page that exists.
    pub(super) fn facts(&self, page: u64) -> Result<FactsBytes, RecordingError> {
        let mut facts = [0; FACTS_BYTES];
        self.file
            .read_exact_at(&mut facts[..self.facts_bytes], self.facts[page as usize])
            .map_err(|source| RecordingError::storage(&self.path, "read", source))?;
        Ok(facts)
    }
}

/// What one directory says.
struct Found {
    pixels: u64,
    facts: u64,
    facts_bytes: usize,
    next: u64,
    next_at: u64,
    description: Option<u64>,
}

fn directory(window: &mut Window<'_>, at: u64, page: u64, size: FrameSize) -> Result<Found, RecordingError> {
    let num_fields = word(window.at(at, 8, "directory")?);
    let path = window.path;
    let bad = |field: &str, detail: String| {
        Err(RecordingError::damaged(path, format!("page {page}, {field}"), detail))
    };
    if num_fields == 0 || num_fields > MAX_FIELDS {
        return bad("number of fields", num_fields.to_string());
    }
    let bytes = window.at(at, 16 + num_fields as usize * 20, "directory")?;
    let field = |tag: u16| {
        let mut fields = bytes[8..].chunks_exact(20).take(num_fields as usize);
        fields.find(|field| field[..2] == tag.to_le_bytes())
    };
    let value = |tag: u16| field(tag).map(|field| word(&field[12..]));
    let expected = [
        (256, "ImageWidth", size.width),
        (257, "ImageLength", size.height),
        (258, "BitsPerSample", 16),
        (259, "Compression", 1),
        (277, "SamplesPerPixel", 1),
        (279, "StripByteCounts", size.bytes()),
    ];
    for (tag, name, expected) in expected {
        match value(tag) {
            Some(found) if found == expected => {}
            found => return bad(name, format!("{found:?} where {expected} was recorded")),
        }
    }
    let (Some(pixels), Some(facts)) = (value(273), value(FACTS_TAG)) else {
        return bad("StripOffsets", "no frame of a recording".to_owned());
    };
    let facts_bytes = match field(FACTS_TAG).map(|field| word(&field[4..])) {
        Some(count) if count == FIRST_FACTS_BYTES as u64 => FIRST_FACTS_BYTES,
        Some(count) if count == FACTS_BYTES as u64 => FACTS_BYTES,
        count => return bad("facts", format!("{count:?} bytes")),
    };
    let next = word(&bytes[8 + num_fields as usize * 20..]);
    let description = value(270);
    let fits = |offset: u64, len: u64| offset.checked_add(len).is_some_and(|end| end <= window.len);
    if !fits(pixels, size.bytes()) || !fits(facts, facts_bytes as u64) {
        return bad("StripOffsets", format!("{pixels} is beyond the end of the file, {} bytes", window.len));
    }
    let next_at = at + 8 + num_fields * 20;
    Ok(Found { pixels, facts, facts_bytes, next, next_at, description })
}

/// A piece of the file that holds several directories.
struct Window<'a> {
    path: &'a Path,
    file: &'a File,
    len: u64,
    start: u64,
    bytes: Vec<u8>,
}

impl<'a> Window<'a> {
    fn over(path: &'a Path, file: &'a File) -> Result<Self, RecordingError> {
        let len = file.metadata().map_err(|source| RecordingError::storage(path, "read", source))?.len();
        Ok(Self { path, file, len, start: 0, bytes: Vec::new() })
    }

    /// `len` bytes at `offset`; `field` names them in errors.
    fn at(&mut self, offset: u64, len: usize, field: &str) -> Result<&[u8], RecordingError> {
        debug_assert!(len <= MAX_IFD);
        let end = self.start + self.bytes.len() as u64;
        if offset < self.start || offset + len as u64 > end {
            let available = self.len.saturating_sub(offset).min(WINDOW as u64) as usize;
            if available < len {
                let detail = format!("{offset} is beyond the end of the file, {} bytes", self.len);
                return Err(RecordingError::damaged(self.path, field, detail));
            }
            // Groups of few frames have small directories.
            self.bytes.resize(available.min(if offset == 0 { 4096 } else { WINDOW }), 0);
            self.start = offset;
            self.file
                .read_exact_at(&mut self.bytes, offset)
                .map_err(|source| RecordingError::storage(self.path, "read", source))?;
        }
        let first = (offset - self.start) as usize;
        Ok(&self.bytes[first..first + len])
    }
}

fn word(bytes: &[u8]) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|byte| bytes[byte]))
}
