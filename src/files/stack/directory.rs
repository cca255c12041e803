//! TIFF and BigTIFF headers and their chain of image file directories (TIFF 6.0, section 2; BigTIFF design).
//!
//! In: an open file. Out: one [`Directory`] after another, and the values of their fields.
//! Never: follows a loop, trusts a count before holding it against the file's length. Fails: [`FileError`] with page and field.

use std::collections::HashSet;

use super::source::{ByteOrder, Source};
use crate::files::{FileError, Place};

/// No writer has more fields than this; a larger count means damage.
const MAX_FIELDS: u64 = 4096;
/// Pages of one file; an entry of the page list takes about 100 bytes.
const MAX_PAGES: usize = 1_000_000;
/// Longest description that is read, in bytes.
const MAX_TEXT: u64 = 32 << 20;
/// Bytes fetched at a directory before its size is known; holds all common directories whole.
const FIRST_FETCH: u64 = 512;

/// Type, count and value of one field; the value is inline or a position in the file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Field {
    kind: u16,
    pub(super) count: u64,
    inline: [u8; 8],
    is_big: bool,
}

/// One image file directory.
#[derive(Debug)]
pub(super) struct Directory {
    fields: Vec<(u16, Field)>,
    pub(super) place: Place,
}

/// Walks the chain of directories of a file.
pub(super) struct Directories<'file> {
    source: &'file Source,
    is_big: bool,
    next: u64,
    visited: HashSet<u64>,
}

impl<'file> Directories<'file> {
    /// Reads the header: sets the byte order of `source` and returns where the first directory is, and whether BigTIFF.
    pub(super) fn read_header(source: &mut Source) -> Result<(u64, bool), FileError> {
        let mut header = [0; 16];
        let held = usize::try_from(source.length).map_or(16, |length| length.min(16));
        source.read(&mut header[..held], 0, Place::Header, "magic number")?;
        source.order = match &header[..2] {
            _ if held == 0 => return Err(not_tiff(source, "the file is empty".to_owned())),
            b"II" => ByteOrder::Little,
            b"MM" => ByteOrder::Big,
            _ => return Err(not_tiff(source, describe_magic(&header[..held]))),
        };
        let version = source.order.u16([header[2], header[3]]);
        let needed = if version == 43 { 16 } else { 8 };
        if held < needed {
            let detail = format!("the file has {held} bytes, a header has {needed}");
            return Err(source.damaged(Place::Header, "magic number", detail));
        }
        match version {
            42 => Ok((u64::from(source.order.u32(array(&header[4..8]))), false)),
            43 if source.order.u16([header[4], header[5]]) == 8 => {
                Ok((source.order.u64(array(&header[8..16])), true))
            }
            43 => Err(source.damaged(Place::Header, "offset size", "BigTIFF offsets must have 8 bytes")),
            _ => Err(not_tiff(source, format!("its version number is {version}, not 42 or 43"))),
        }
    }

    pub(super) fn new(source: &'file Source, first: u64, is_big: bool) -> Directories<'file> {
        Directories { source, is_big, next: first, visited: HashSet::new() }
    }

    /// The next directory, or `None` after the last.
    pub(super) fn advance(&mut self) -> Result<Option<Directory>, FileError> {
        if self.next == 0 {
            return Ok(None);
        }
        let place = Place::Page(self.visited.len() + 1);
        if self.visited.len() >= MAX_PAGES {
            let detail = format!("the file has more than {MAX_PAGES} pages");
            return Err(self.source.unsupported(place, "page list", detail, "Split it into several files"));
        }
        if !self.visited.insert(self.next) {
            let detail = "the list of pages runs in a circle";
            return Err(self.source.damaged(place, "next page", detail));
        }
        self.read_directory(place).map(Some)
    }

    fn read_directory(&mut self, place: Place) -> Result<Directory, FileError> {
        let (count_size, field_size, next_size) = if self.is_big { (8, 20, 8) } else { (2, 12, 4) };
        let fetched = FIRST_FETCH.min(self.source.length.saturating_sub(self.next));
        let mut bytes = vec![0; fetched.max(count_size) as usize];
        self.source.read(&mut bytes, self.next, place, "page directory")?;
        let order = self.source.order;
        let count = match self.is_big {
            true => order.u64(array(&bytes[..8])),
            false => u64::from(order.u16([bytes[0], bytes[1]])),
        };
        if count == 0 || count > MAX_FIELDS {
            let detail = format!("it claims {count} fields");
            return Err(self.source.damaged(place, "page directory", detail));
        }
        let size = (count_size + count * field_size + next_size) as usize;
        if size > bytes.len() {
            bytes.resize(size, 0);
            self.source.read(&mut bytes, self.next, place, "page directory")?;
        }
        let fields_end = size - next_size as usize;
        let fields = bytes[count_size as usize..fields_end]
            .chunks_exact(field_size as usize)
            .map(|field| parse_field(order, field))
            .collect();
        let next = &bytes[fields_end..size];
        self.next = match self.is_big {
            true => order.u64(array(next)),
            false => u64::from(order.u32(array(next))),
        };
        Ok(Directory { fields, place })
    }
}

impl Directory {
    pub(super) fn field(&self, tag: u16) -> Option<Field> {
        let found = self.fields.iter().find(|(candidate, _)| *candidate == tag);
        found.map(|(_, field)| *field)
    }

    /// The single whole number of a field, if the field is there.
    pub(super) fn number(
        &self,
        source: &Source,
        tag: u16,
        name: &'static str,
    ) -> Result<Option<u64>, FileError> {
        let Some(field) = self.field(tag) else {
            return Ok(None);
        };
        match field.first_inline(source.order) {
            Some(number) => Ok(Some(number)),
            None => Err(source.damaged(self.place, name, "it is not a single whole number")),
        }
    }

    /// The text of a field without what follows its first zero byte, if the field is there.
    pub(super) fn text(
        &self,
        source: &Source,
        tag: u16,
        name: &'static str,
    ) -> Result<Option<String>, FileError> {
        let Some(field) = self.field(tag) else {
            return Ok(None);
        };
        if field.kind != 2 && field.kind != 1 && field.kind != 7 {
            return Err(source.damaged(self.place, name, "it is not text"));
        }
        let bytes = field.bytes(source, MAX_TEXT, self.place, name)?;
        let text = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
        Ok(Some(String::from_utf8_lossy(text).into_owned()))
    }

    /// The quotient of a rational field, if it is there and finite.
    pub(super) fn ratio(&self, source: &Source, tag: u16, name: &'static str) -> Option<f64> {
        let field = self.field(tag).filter(|field| field.kind == 5 && field.count == 1)?;
        let bytes = field.bytes(source, 8, self.place, name).ok()?;
        let over = f64::from(source.order.u32(array(bytes.get(..4)?)));
        let under = f64::from(source.order.u32(array(bytes.get(4..8)?)));
        let ratio = over / under;
        (ratio.is_finite() && ratio > 0.0).then_some(ratio)
    }
}

impl Field {
    /// Size of one number of this field's type, when it is a whole number.
    fn number_size(self) -> Option<u64> {
        match self.kind {
            1 => Some(1),
            3 => Some(2),
            4 | 13 => Some(4),
            16 | 18 => Some(8),
            _ => None,
        }
    }

    fn inline_size(self) -> u64 {
        if self.is_big { 8 } else { 4 }
    }

    fn first_inline(self, order: ByteOrder) -> Option<u64> {
        let size = self.number_size()?;
        let fits = self.count == 1 && size <= self.inline_size();
        fits.then(|| decode_number(order, &self.inline[..size as usize]))
    }

    /// All whole numbers of this field, of which there must be exactly `count`.
    pub(super) fn numbers(
        self,
        source: &Source,
        count: u64,
        place: Place,
        name: &'static str,
    ) -> Result<Vec<u64>, FileError> {
        let Some(size) = self.number_size() else {
            return Err(source.damaged(place, name, "it does not hold whole numbers"));
        };
        if self.count != count {
            let detail = format!("it has {} entries where {count} are needed", self.count);
            return Err(source.damaged(place, name, detail));
        }
        let bytes = self.bytes(source, u64::MAX, place, name)?;
        let numbers = bytes.chunks_exact(size as usize);
        Ok(numbers.map(|number| decode_number(source.order, number)).collect())
    }

    fn bytes(
        self,
        source: &Source,
        limit: u64,
        place: Place,
        name: &'static str,
    ) -> Result<Vec<u8>, FileError> {
        let item = match self.kind {
            5 | 10 | 12 => 8,
            _ => self.number_size().unwrap_or(1),
        };
        let size = self.count.saturating_mul(item);
        if size <= self.inline_size() {
            return Ok(self.inline[..size as usize].to_vec());
        }
        let offset = match self.is_big {
            true => source.order.u64(self.inline),
            false => u64::from(source.order.u32(array(&self.inline[..4]))),
        };
        source.ensure_inside(offset, size, place, name)?;
        if size > limit {
            let detail = format!("it has {size} bytes, at most {limit} are read");
            return Err(source.unsupported(place, name, detail, "Export the stack with shorter metadata"));
        }
        let mut bytes = vec![0; size as usize];
        source.read(&mut bytes, offset, place, name)?;
        Ok(bytes)
    }
}

fn parse_field(order: ByteOrder, bytes: &[u8]) -> (u16, Field) {
    let is_big = bytes.len() == 20;
    let count = match is_big {
        true => order.u64(array(&bytes[4..12])),
        false => u64::from(order.u32(array(&bytes[4..8]))),
    };
    let mut inline = [0; 8];
    let value = &bytes[if is_big { 12 } else { 8 }..];
    inline[..value.len()].copy_from_slice(value);
    let field = Field { kind: order.u16([bytes[2], bytes[3]]), count, inline, is_big };
    (order.u16([bytes[0], bytes[1]]), field)
}

fn decode_number(order: ByteOrder, bytes: &[u8]) -> u64 {
    match bytes.len() {
        1 => u64::from(bytes[0]),
        2 => u64::from(order.u16(array(bytes))),
        4 => u64::from(order.u32(array(bytes))),
        _ => order.u64(array(bytes)),
    }
}

/// The first `N` bytes, zeros where there are fewer.
fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    std::array::from_fn(|index| bytes.get(index).copied().unwrap_or(0))
}

fn not_tiff(source: &Source, found: String) -> FileError {
    FileError::NotTiff { path: source.path.clone(), found }
}

fn describe_magic(header: &[u8]) -> String {
    let known = match header {
        [0x89, b'P', b'N', b'G', ..] => " (a PNG image)",
        [0xff, 0xd8, ..] => " (a JPEG image)",
        [0x89, b'H', b'D', b'F', ..] => " (an HDF5 file)",
        [b'P', b'K', ..] => " (a zip archive)",
        [b'D', b'C', b'I', b'M', ..] => " (a Hamamatsu dcimg file)",
        _ => "",
    };
    let shown: Vec<String> = header.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
    format!("it begins with the bytes {}{known}", shown.join(" "))
}
