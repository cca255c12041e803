//! Result images written as float32 OME-TIFF, one page per channel.
//!
//! In: planes of equal size with their names, the pixel size of the fine grid and the settings used. Out: one file.
//! Never: scales values, writes over an existing file; NaN stays NaN. Fails: [`FileError`] when the disk does or a plane does not fit.

use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::FileError;
use super::ome_xml::{OmeImage, document};
use super::stack_writer::{not_writable, page_format};
use super::tiff_writer::TiffWriter;

/// How the pixels of a result are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Storage {
    /// As they are: fastest, and every program reads them.
    #[default]
    Uncompressed,
    /// Deflate, lossless.
    Deflate,
}

/// What is said about a result image beside its pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResultHeader {
    /// Name of the image.
    pub name: String,
    /// Name of each page, such as `RR` or `AF647`.
    pub channels: Vec<String>,
    /// Rows of each page, in pixels of the fine grid.
    pub height: usize,
    /// Columns of each page, in pixels of the fine grid.
    pub width: usize,
    /// Pixel size of the fine grid in the sample, in nanometers.
    pub pixel_size_nm: Option<f64>,
    /// Free text for a reader.
    pub description: String,
    /// Settings of the analysis as keys and values.
    pub settings: Vec<(String, String)>,
    /// How the pixels are stored.
    pub storage: Storage,
}

/// Writes one page per channel to the new file `path`; each plane has `height * width` values, row by row.
///
/// # Errors
/// [`FileError::OutputExists`], [`FileError::NotWritable`] when planes and header disagree, [`FileError::DiskFull`] and its kin.
pub fn write_result(path: &Path, header: &ResultHeader, planes: &[&[f32]]) -> Result<(), FileError> {
    let sizes = [planes.len(), header.height, header.width];
    let mut format = page_format(path, sizes, 32, header.pixel_size_nm)?;
    ensure_consistent(path, header, planes)?;
    if header.storage == Storage::Deflate {
        format.compression = 8;
    }
    let mut writer = TiffWriter::create(path, format, planes.len() as u64, ome(header))?;
    for plane in planes {
        let bytes = bytemuck::cast_slice(plane);
        match header.storage {
            Storage::Uncompressed => writer.push(bytes)?,
            Storage::Deflate => writer.push(&deflate(path, bytes)?)?,
        }
    }
    writer.finish()
}

fn ensure_consistent(path: &Path, header: &ResultHeader, planes: &[&[f32]]) -> Result<(), FileError> {
    if planes.len() != header.channels.len() {
        let reason = format!("{} pages have {} names", planes.len(), header.channels.len());
        return Err(not_writable(path, reason));
    }
    let expected = header.height * header.width;
    match planes.iter().find(|plane| plane.len() != expected) {
        None => Ok(()),
        Some(plane) => {
            let reason = format!("a page has {expected} pixels, not {}", plane.len());
            Err(not_writable(path, reason))
        }
    }
}

fn ome(header: &ResultHeader) -> String {
    document(&OmeImage {
        name: &header.name,
        description: &header.description,
        sample: "float",
        height: header.height,
        width: header.width,
        channels: &header.channels,
        frames: 1,
        pixel_size_nm: header.pixel_size_nm,
        frame_interval_s: None,
        delta_t_s: &[],
        settings: &header.settings,
    })
}

fn deflate(path: &Path, bytes: &[u8]) -> Result<Vec<u8>, FileError> {
    let mut packer = ZlibEncoder::new(Vec::new(), Compression::default());
    packer
        .write_all(bytes)
        .and_then(|()| packer.finish())
        .map_err(|source| FileError::from_io(path, "compress", source))
}
