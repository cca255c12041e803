//! TIFF and BigTIFF files written front to back, one page after another.
//!
//! In: pages of known size. Out: a file in this computer's byte order, directory before pixels, never rewound.
//! Never: keeps a page, seeks. Fails: [`FileError`] when the disk does.

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use super::FileError;

/// Files that would grow larger are written as BigTIFF; some readers take offsets as signed or need room to append.
const MAX_CLASSIC_BYTES: u64 = 3_900_000_000;
/// Generous bound of what a page takes beside its pixels, without its texts.
const PAGE_OVERHEAD_BYTES: u64 = 512;
/// Small pages are gathered up to this size.
const BUFFER_BYTES: usize = 1 << 20;
/// Numerator of the resolution; with it pixel sizes are exact to 1/400 nm.
const RESOLUTION_PIXELS: u32 = 4_000_000_000;

/// What all pages have in common.
#[derive(Clone, Copy, Debug)]
pub(super) struct PageFormat {
    pub(super) height: u32,
    pub(super) width: u32,
    pub(super) bits: u16,
    /// 1 unsigned integer, 3 floating point.
    pub(super) sample_format: u16,
    /// 1 uncompressed, 8 Deflate.
    pub(super) compression: u16,
    pub(super) pixel_size_nm: Option<f64>,
}

/// A TIFF file under way.
#[derive(Debug)]
pub(super) struct TiffWriter {
    out: BufWriter<File>,
    path: PathBuf,
    format: PageFormat,
    is_big: bool,
    position: u64,
    num_pages: u64,
    pages_written: u64,
    description: String,
}

impl TiffWriter {
    /// Creates the file, which must not exist, for exactly `num_pages` pages; `description` is that of the first.
    pub(super) fn create(
        path: &Path,
        format: PageFormat,
        num_pages: u64,
        description: String,
    ) -> Result<TiffWriter, FileError> {
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        let file = options.open(path).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => FileError::OutputExists { path: path.to_path_buf() },
            io::ErrorKind::NotFound => FileError::OutputRefused {
                path: path.to_path_buf(),
                reason: "its directory does not exist".to_owned(),
            },
            _ => FileError::from_io(path, "create", source),
        })?;
        TiffWriter::over(file, path, format, num_pages, description)
    }

    /// As [`create`](TiffWriter::create), into a file that is open already.
    pub(super) fn over(
        file: File,
        path: &Path,
        format: PageFormat,
        num_pages: u64,
        description: String,
    ) -> Result<TiffWriter, FileError> {
        let size = file_bytes(&format, num_pages, description.len() as u64);
        let mut writer = TiffWriter {
            out: BufWriter::with_capacity(BUFFER_BYTES, file),
            path: path.to_path_buf(),
            format,
            is_big: size > MAX_CLASSIC_BYTES,
            position: 0,
            num_pages,
            pages_written: 0,
            description,
        };
        let header = writer.header();
        writer.put(&header)?;
        Ok(writer)
    }

    pub(super) fn pages_written(&self) -> u64 {
        self.pages_written
    }

    /// Appends a page whose stored pixels are `pixels`.
    pub(super) fn push(&mut self, pixels: &[u8]) -> Result<(), FileError> {
        let is_first = self.pages_written == 0;
        let is_last = self.pages_written + 1 == self.num_pages;
        let mut description =
            if is_first { std::mem::take(&mut self.description).into_bytes() } else { Vec::new() };
        if is_first {
            description.push(0);
        }
        let directory = self.directory(&description, pixels.len() as u64, is_last);
        self.put(&directory)?;
        self.put(pixels)?;
        if pixels.len() % 2 == 1 {
            self.put(&[0])?;
        }
        self.pages_written += 1;
        Ok(())
    }

    /// Hands everything to the operating system.
    pub(super) fn finish(mut self) -> Result<(), FileError> {
        self.out.flush().map_err(|source| FileError::from_io(&self.path, "write", source))
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), FileError> {
        self.out.write_all(bytes).map_err(|source| FileError::from_io(&self.path, "write", source))?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    fn header(&self) -> Vec<u8> {
        let mark = if cfg!(target_endian = "little") { b"II" } else { b"MM" };
        let mut header = mark.to_vec();
        if self.is_big {
            for number in [43_u16, 8, 0] {
                header.extend(number.to_ne_bytes());
            }
            header.extend(16_u64.to_ne_bytes());
        } else {
            header.extend(42_u16.to_ne_bytes());
            header.extend(8_u32.to_ne_bytes());
        }
        header
    }

    /// The directory of the next page with all its values; the pixels follow it, and then the next directory.
    fn directory(&self, description: &[u8], pixel_bytes: u64, is_last: bool) -> Vec<u8> {
        let mut fields = Fields::new(self.is_big);
        let format = &self.format;
        fields.long(254, 0);
        fields.long(256, format.width);
        fields.long(257, format.height);
        fields.short(258, format.bits);
        fields.short(259, format.compression);
        fields.short(262, 1);
        if !description.is_empty() {
            fields.text(270, description);
        }
        fields.offset(273, PIXELS);
        fields.short(277, 1);
        fields.long(278, format.height);
        fields.offset(279, pixel_bytes);
        if let Some(size_nm) = format.pixel_size_nm {
            let per_centimeter = [RESOLUTION_PIXELS, resolution_denominator(size_nm)];
            fields.rational(282, per_centimeter);
            fields.rational(283, per_centimeter);
            fields.short(296, 3);
        }
        let mut software = super::SOFTWARE.as_bytes().to_vec();
        software.push(0);
        fields.text(305, &software);
        fields.short(339, format.sample_format);
        fields.assemble(self.position, pixel_bytes, is_last)
    }
}

/// Upper bound of the size of a file of uncompressed pages, in bytes.
pub(super) fn file_bytes(format: &PageFormat, num_pages: u64, description_bytes: u64) -> u64 {
    let samples = u64::from(format.height) * u64::from(format.width);
    let pixels = samples.saturating_mul(u64::from(format.bits / 8));
    num_pages.saturating_mul(pixels.saturating_add(PAGE_OVERHEAD_BYTES)).saturating_add(description_bytes)
}

/// Stands for the position of the pixels until it is known; no file is as long.
const PIXELS: u64 = u64::MAX;

/// Pixels per centimeter are [`RESOLUTION_PIXELS`] over this; 1 cm is 1e7 nm.
fn resolution_denominator(size_nm: f64) -> u32 {
    let denominator = f64::from(RESOLUTION_PIXELS) * size_nm / 1e7;
    denominator.round().clamp(1.0, f64::from(u32::MAX)) as u32
}

/// Fields of a directory in ascending order of their tags.
struct Fields {
    is_big: bool,
    fields: Vec<(u16, u16, u64, Vec<u8>)>,
}

impl Fields {
    fn new(is_big: bool) -> Fields {
        Fields { is_big, fields: Vec::new() }
    }

    fn short(&mut self, tag: u16, value: u16) {
        self.fields.push((tag, 3, 1, value.to_ne_bytes().to_vec()));
    }

    fn long(&mut self, tag: u16, value: u32) {
        self.fields.push((tag, 4, 1, value.to_ne_bytes().to_vec()));
    }

    /// A position or length in the file, as wide as the file kind has it.
    fn offset(&mut self, tag: u16, value: u64) {
        let kind = if self.is_big { 16 } else { 4 };
        let bytes = self.offset_bytes(value);
        self.fields.push((tag, kind, 1, bytes));
    }

    fn rational(&mut self, tag: u16, [over, under]: [u32; 2]) {
        let bytes = [over.to_ne_bytes(), under.to_ne_bytes()].concat();
        self.fields.push((tag, 5, 1, bytes));
    }

    fn text(&mut self, tag: u16, text: &[u8]) {
        self.fields.push((tag, 2, text.len() as u64, text.to_vec()));
    }

    fn offset_bytes(&self, value: u64) -> Vec<u8> {
        if self.is_big { value.to_ne_bytes().to_vec() } else { (value as u32).to_ne_bytes().to_vec() }
    }

    /// The bytes of the directory at file position `start` and of all values that do not fit into it.
    fn assemble(&self, start: u64, pixel_bytes: u64, is_last: bool) -> Vec<u8> {
        let (count_size, field_size, slot_size) = if self.is_big { (8, 20, 8) } else { (2, 12, 4) };
        let num_fields = self.fields.len();
        let values_at = count_size + num_fields * field_size + slot_size;
        let spilled: usize = self
            .fields
            .iter()
            .filter(|(.., bytes)| bytes.len() > slot_size)
            .map(|(.., bytes)| bytes.len().next_multiple_of(2))
            .sum();
        let pixels = start + (values_at + spilled) as u64;
        let next = if is_last { 0 } else { pixels + pixel_bytes.next_multiple_of(2) };
        let mut directory = Vec::with_capacity(values_at + spilled);
        let mut values = Vec::with_capacity(spilled);
        match self.is_big {
            true => directory.extend((num_fields as u64).to_ne_bytes()),
            false => directory.extend((num_fields as u16).to_ne_bytes()),
        }
        for (tag, kind, count, bytes) in &self.fields {
            directory.extend(tag.to_ne_bytes());
            directory.extend(kind.to_ne_bytes());
            directory.extend(self.offset_bytes(*count));
            let mut slot = if *tag == 273 {
                self.offset_bytes(pixels)
            } else if bytes.len() > slot_size {
                let position = start + (values_at + values.len()) as u64;
                values.extend(bytes);
                values.resize(values.len().next_multiple_of(2), 0);
                self.offset_bytes(position)
            } else {
                bytes.clone()
            };
            slot.resize(slot_size, 0);
            directory.extend(slot);
        }
        directory.extend(self.offset_bytes(next));
        directory.extend(values);
        directory
    }
}
