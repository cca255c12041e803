//! What descriptions inside a TIFF file say: channels and their order, pixel size, frame interval.
//!
//! In: the text of the first page's description. Out: [`Metadata`].
//! Never: believes counts without holding them against the pages. Fails: a sentence about what does not fit.

mod imagej;
mod ome;
mod shaped;

use std::time::Duration;

use super::directory::Directory;
use super::source::Source;
use crate::files::FileError;

/// Who wrote the description.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dialect {
    /// No description that is understood.
    #[default]
    Plain,
    /// OME-XML.
    Ome,
    /// ImageJ's `key=value` lines.
    ImageJ,
}

/// Facts from the description, before they are compared with the pages.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Metadata {
    pub(super) dialect: Dialect,
    /// Planes that the description promises, over all axes.
    pub(super) planes: Option<u64>,
    pub(super) channels: u64,
    /// Consecutive planes of one channel before the next channel comes.
    pub(super) run: u64,
    pub(super) channel_names: Vec<String>,
    /// Width and height of a pixel.
    pub(super) pixel_size_nm: Option<[f64; 2]>,
    pub(super) frame_interval: Option<Duration>,
}

/// Reads the description of the first page.
pub(super) fn read(source: &Source, directory: &Directory) -> Result<Metadata, FileError> {
    const FIELD: &str = "ImageDescription";
    let text = directory.text(source, 270, FIELD)?.unwrap_or_default();
    let text = text.trim_start_matches(['\u{feff}', ' ', '\n', '\r', '\t']);
    if text.starts_with("ImageJ=") {
        let resolution = [282, 283].map(|tag| directory.ratio(source, tag, "XResolution"));
        return Ok(imagej::parse(text, resolution));
    }
    let head: String = text.chars().take(400).collect();
    if head.starts_with('<') && head.contains("<OME") {
        return ome::parse(text).map_err(|detail| source.damaged(directory.place, FIELD, detail));
    }
    Ok(Metadata { planes: shaped::planes(text), channels: 1, run: 1, ..Metadata::default() })
}

/// Nanometers in one `unit` of length as microscopy software writes it.
fn nanometers_per(unit: &str) -> Option<f64> {
    match unit {
        "nm" => Some(1.0),
        "µm" | "\u{3bc}m" | "\\u00B5m" | "um" | "micron" | "microns" => Some(1e3),
        "mm" => Some(1e6),
        "cm" => Some(1e7),
        "m" => Some(1e9),
        "Å" | "\u{212b}" => Some(0.1),
        "pm" => Some(1e-3),
        _ => None,
    }
}

/// Seconds in one `unit` of time.
fn seconds_per(unit: &str) -> Option<f64> {
    match unit {
        "s" | "sec" | "secs" | "seconds" => Some(1.0),
        "ms" | "msec" => Some(1e-3),
        "µs" | "\u{3bc}s" | "us" => Some(1e-6),
        "ns" => Some(1e-9),
        "min" => Some(60.0),
        "h" | "hour" | "hours" => Some(3600.0),
        _ => None,
    }
}

/// A duration of a positive, sensible number of seconds.
fn duration(seconds: f64) -> Option<Duration> {
    Duration::try_from_secs_f64(seconds).ok().filter(|duration| !duration.is_zero())
}
