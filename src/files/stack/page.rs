//! One page of a stack: what its directory says about size, sample type and where the pixels are.
//!
//! In: a directory. Out: [`Page`] and its [`Geometry`], both proved to be of a kind that is read.
//! Never: touches pixels. Fails: [`FileError`] naming the page and the field that is damaged or unsupported.

use super::SampleType;
use super::directory::{Directory, Field};
use super::source::Source;
use crate::files::{FileError, Place};

/// Largest frame that is read, in bytes as stored in memory by the file's sample type.
const MAX_FRAME_BYTES: u64 = 256 << 20;
/// Most strips or tiles of one page.
const MAX_CHUNKS: u64 = 1 << 22;
/// No supported compression shrinks more (zstd: a run of 128 KiB in 4 bytes).
const MAX_SHRINKAGE: u64 = 40_000;

/// Size and sample type, the same for all pages of a stack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Geometry {
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) sample: SampleType,
}

impl Geometry {
    pub(super) fn row_bytes(self) -> usize {
        self.width * self.sample.bytes()
    }

    pub(super) fn frame_bytes(self) -> usize {
        self.height * self.row_bytes()
    }
}

impl std::fmt::Display for Geometry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} x {} {}", self.height, self.width, self.sample.name())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    Lzw,
    Deflate,
    Zstd,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Predictor {
    None,
    Horizontal,
    FloatingPoint,
}

/// Where the pixels of one page are and how they are packed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Page {
    pub(super) place: Place,
    pub(super) compression: Compression,
    pub(super) predictor: Predictor,
    /// Rows of a strip or tile.
    pub(super) chunk_height: usize,
    /// Width of a strip or tile; a tile may reach over the right edge.
    pub(super) chunk_width: usize,
    pub(super) is_tiled: bool,
    pub(super) num_chunks: u64,
    offsets: Field,
    byte_counts: Option<Field>,
}

/// Position and length in the file of one strip or tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Chunk {
    pub(super) offset: u64,
    pub(super) bytes: u64,
}

impl Page {
    /// Reads a directory; `None` for thumbnails and masks, which belong to another page.
    pub(super) fn parse(
        source: &Source,
        directory: &Directory,
    ) -> Result<Option<(Page, Geometry)>, FileError> {
        if is_secondary(source, directory)? {
            return Ok(None);
        }
        ensure_gray(source, directory)?;
        let geometry = parse_geometry(source, directory)?;
        let compression = parse_compression(source, directory)?;
        let predictor = parse_predictor(source, directory, compression, geometry.sample)?;
        let page = parse_layout(source, directory, geometry, compression, predictor)?;
        page.ensure_plausible(source, geometry)?;
        Ok(Some((page, geometry)))
    }

    /// Positions of all strips or tiles, each proved to lie inside the file.
    pub(super) fn chunks(&self, source: &Source, geometry: Geometry) -> Result<Vec<Chunk>, FileError> {
        let place = self.place;
        let offsets = self.offsets.numbers(source, self.num_chunks, place, "StripOffsets")?;
        let counts = match self.byte_counts {
            Some(field) => field.numbers(source, self.num_chunks, place, "StripByteCounts")?,
            None => vec![geometry.frame_bytes() as u64; offsets.len()],
        };
        let chunks = offsets.into_iter().zip(counts);
        let mut located = Vec::with_capacity(self.num_chunks as usize);
        for (index, (offset, bytes)) in chunks.enumerate() {
            // The lengths of uncompressed data follow from the size; some writers give others.
            let bytes = match self.compression {
                Compression::None => self.raw_bytes(geometry, index),
                _ => bytes,
            };
            source.ensure_inside(offset, bytes, place, "StripOffsets")?;
            located.push(Chunk { offset, bytes });
        }
        Ok(located)
    }

    /// Rows that the strip or tile `index` has to give to the picture.
    pub(super) fn rows_of(&self, geometry: Geometry, index: usize) -> usize {
        let top = index / self.chunks_across(geometry) * self.chunk_height;
        self.chunk_height.min(geometry.height - top)
    }

    pub(super) fn chunks_across(&self, geometry: Geometry) -> usize {
        geometry.width.div_ceil(self.chunk_width)
    }

    /// Bytes of one row of a strip or tile.
    pub(super) fn chunk_row_bytes(&self, geometry: Geometry) -> usize {
        self.chunk_width * geometry.sample.bytes()
    }

    /// Bytes needed of an uncompressed strip or tile; the rows below the picture are not.
    fn raw_bytes(&self, geometry: Geometry, index: usize) -> u64 {
        (self.rows_of(geometry, index) * self.chunk_row_bytes(geometry)) as u64
    }

    /// Refuses sizes that the file cannot hold, before any memory is asked for.
    fn ensure_plausible(&self, source: &Source, geometry: Geometry) -> Result<(), FileError> {
        let frame = geometry.frame_bytes() as u64;
        let capacity = match self.compression {
            Compression::None => source.length,
            _ => source.length.saturating_mul(MAX_SHRINKAGE),
        };
        if frame > capacity {
            let detail = format!("{geometry} pixels need {frame} bytes, the file has {}", source.length);
            return Err(source.damaged(self.place, "ImageWidth and ImageLength", detail));
        }
        if self.num_chunks == 1 {
            self.chunks(source, geometry)?;
        }
        Ok(())
    }
}

fn is_secondary(source: &Source, directory: &Directory) -> Result<bool, FileError> {
    const REDUCED_OR_MASK: u64 = 1 | 4;
    let new = directory.number(source, 254, "NewSubfileType")?.unwrap_or(0);
    let old = directory.number(source, 255, "SubfileType")?.unwrap_or(1);
    Ok(new & REDUCED_OR_MASK != 0 || old == 2)
}

/// Refuses color, palettes, inverted gray and other things that are no camera counts.
fn ensure_gray(source: &Source, directory: &Directory) -> Result<(), FileError> {
    const NAME: &str = "PhotometricInterpretation";
    const REMEDY: &str = "Convert it to gray (Fiji: Image > Type) with black as zero";
    let samples = directory.number(source, 277, "SamplesPerPixel")?.unwrap_or(1);
    let found = match directory.number(source, 262, NAME)?.unwrap_or(1) {
        1 if samples == 1 => None,
        1 => Some(format!("{samples} samples per pixel instead of 1")),
        0 => Some("MinIsWhite, gray levels run from white to black".to_owned()),
        2 => Some(format!("RGB color with {samples} samples per pixel")),
        3 => Some("colors from a palette".to_owned()),
        other => Some(format!("interpretation {other} is not gray")),
    };
    if let Some(found) = found {
        return Err(source.unsupported(directory.place, NAME, found, REMEDY));
    }
    if directory.number(source, 266, "FillOrder")?.unwrap_or(1) != 1 {
        return Err(source.unsupported(
            directory.place,
            "FillOrder",
            "reversed bits",
            "Save it again with Fiji",
        ));
    }
    Ok(())
}

fn parse_geometry(source: &Source, directory: &Directory) -> Result<Geometry, FileError> {
    let place = directory.place;
    let width = required(source, directory, 256, "ImageWidth")?;
    let height = required(source, directory, 257, "ImageLength")?;
    if width == 0 || height == 0 {
        let detail = format!("a page of {height} x {width} pixels has none");
        return Err(source.damaged(place, "ImageWidth and ImageLength", detail));
    }
    let bits = directory.number(source, 258, "BitsPerSample")?.unwrap_or(1);
    let format = directory.number(source, 339, "SampleFormat")?.unwrap_or(1);
    let sample = match (bits, format) {
        (8, 1) => SampleType::Uint8,
        (16, 1) => SampleType::Uint16,
        (32, 3) => SampleType::Float32,
        _ => {
            let kind = match format {
                1 => "unsigned integer",
                2 => "signed integer",
                3 => "floating-point",
                _ => "unknown",
            };
            let detail = format!("{bits}-bit {kind} samples are not read");
            let remedy = "Save it as 8-bit or 16-bit unsigned integers or as 32-bit floating point";
            return Err(source.unsupported(place, "BitsPerSample", detail, remedy));
        }
    };
    let bytes = width.saturating_mul(height).saturating_mul(sample.bytes() as u64);
    if bytes > MAX_FRAME_BYTES {
        let detail =
            format!("{height} x {width} pixels need {bytes} bytes, at most {MAX_FRAME_BYTES} are read");
        let remedy = "Crop the stack, or copy the file again if that size is wrong";
        return Err(source.unsupported(place, "ImageWidth and ImageLength", detail, remedy));
    }
    Ok(Geometry { height: height as usize, width: width as usize, sample })
}

fn parse_compression(source: &Source, directory: &Directory) -> Result<Compression, FileError> {
    let code = directory.number(source, 259, "Compression")?.unwrap_or(1);
    let name = match code {
        1 => return Ok(Compression::None),
        5 => return Ok(Compression::Lzw),
        8 | 32_946 => return Ok(Compression::Deflate),
        50_000 => return Ok(Compression::Zstd),
        2..=4 => " (fax)",
        6 | 7 | 34_892 => " (JPEG)",
        32_773 => " (PackBits)",
        33_003..=33_005 | 34_712 => " (JPEG 2000)",
        34_887 => " (LERC)",
        34_925 => " (LZMA)",
        50_001 | 34_927 => " (WebP)",
        50_002 | 52_546 => " (JPEG XL)",
        _ => "",
    };
    let detail = format!("compression {code}{name} is not read");
    let remedy = "Save it uncompressed or with LZW, Deflate or zstd";
    Err(source.unsupported(directory.place, "Compression", detail, remedy))
}

fn parse_predictor(
    source: &Source,
    directory: &Directory,
    compression: Compression,
    sample: SampleType,
) -> Result<Predictor, FileError> {
    let code = directory.number(source, 317, "Predictor")?.unwrap_or(1);
    match (code, compression, sample) {
        (1, _, _) => Ok(Predictor::None),
        (2, Compression::Lzw | Compression::Deflate | Compression::Zstd, _) => Ok(Predictor::Horizontal),
        (3, Compression::Lzw | Compression::Deflate | Compression::Zstd, SampleType::Float32) => {
            Ok(Predictor::FloatingPoint)
        }
        _ => {
            let detail = format!("predictor {code} does not go with this compression and sample type");
            Err(source.unsupported(directory.place, "Predictor", detail, "Save it again without predictor"))
        }
    }
}

fn parse_layout(
    source: &Source,
    directory: &Directory,
    geometry: Geometry,
    compression: Compression,
    predictor: Predictor,
) -> Result<Page, FileError> {
    let place = directory.place;
    let is_tiled = directory.field(324).is_some();
    let (chunk_height, chunk_width) = match is_tiled {
        true => tile_size(source, directory, geometry)?,
        false => (rows_per_strip(source, directory, geometry)?, geometry.width),
    };
    let (offsets_tag, counts_tag) = if is_tiled { (324, 325) } else { (273, 279) };
    let Some(offsets) = directory.field(offsets_tag) else {
        return Err(source.damaged(place, "StripOffsets", "the field is missing"));
    };
    let num_chunks = (geometry.height.div_ceil(chunk_height) as u64)
        .saturating_mul(geometry.width.div_ceil(chunk_width) as u64);
    if num_chunks > MAX_CHUNKS {
        let detail = format!("{num_chunks} strips or tiles in one page");
        return Err(source.unsupported(place, "RowsPerStrip", detail, "Save it with larger strips"));
    }
    let byte_counts = directory.field(counts_tag);
    if byte_counts.is_none() && (compression != Compression::None || num_chunks != 1) {
        return Err(source.damaged(place, "StripByteCounts", "the field is missing"));
    }
    Ok(Page {
        place,
        compression,
        predictor,
        chunk_height,
        chunk_width,
        is_tiled,
        num_chunks,
        offsets,
        byte_counts,
    })
}

fn rows_per_strip(source: &Source, directory: &Directory, geometry: Geometry) -> Result<usize, FileError> {
    let rows = directory.number(source, 278, "RowsPerStrip")?.unwrap_or(u64::MAX);
    match rows.min(geometry.height as u64) {
        0 => Err(source.damaged(directory.place, "RowsPerStrip", "it is zero")),
        rows => Ok(rows as usize),
    }
}

fn tile_size(
    source: &Source,
    directory: &Directory,
    geometry: Geometry,
) -> Result<(usize, usize), FileError> {
    let width = required(source, directory, 322, "TileWidth")?;
    let height = required(source, directory, 323, "TileLength")?;
    let bytes = width.saturating_mul(height).saturating_mul(geometry.sample.bytes() as u64);
    if bytes == 0 || bytes > MAX_FRAME_BYTES {
        let detail = format!("tiles of {height} x {width} pixels");
        return Err(source.damaged(directory.place, "TileWidth and TileLength", detail));
    }
    Ok((height as usize, width as usize))
}

fn required(source: &Source, directory: &Directory, tag: u16, name: &'static str) -> Result<u64, FileError> {
    match directory.number(source, tag, name)? {
        Some(number) => Ok(number),
        None => Err(source.damaged(directory.place, name, "the field is missing")),
    }
}
