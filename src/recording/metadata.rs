//! What a recording says of itself: the plan it began with, as `recording.json`.
//!
//! In: [`RecordingPlan`]. Out: [`Metadata`], written once before the first frame, and read back.
//! Never: a number that only the end knows. Fails: [`RecordingError`] naming file and field.

use super::RecordingError;
use crate::acquisition::Conditions;
use serde::{Deserialize, Serialize};
use sofiscope_hal::{CameraIdentity, CameraSettings, Channel};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Name of the file.
pub(super) const METADATA: &str = "recording.json";
/// Version of the layout that this program writes.
const FORMAT_VERSION: u32 = 1;
/// A text longer than this is no metadata of ours.
const MAX_METADATA_BYTES: u64 = 1 << 20;
/// Sides of a frame; beyond any sensor.
const MAX_SIDE: u32 = 1 << 15;
/// Frames that are read into memory; 2^26 pixels are 128 MiB.
const MAX_PIXELS: usize = 1 << 26;

/// The file format of the images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// BigTIFF with one page per frame, and OME-XML at the end.
    OmeTiff,
    /// Zarr version 3, sharded, with OME-NGFF 0.5 metadata.
    OmeZarr,
}

/// One camera as it was set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraDescription {
    /// Which camera.
    pub identity: CameraIdentity,
    /// What it does, read back from it; the region gives the size of a frame.
    pub settings: CameraSettings,
    /// Side of a pixel in the sample, in nm.
    pub pixel_size_nm: Option<f64>,
}

impl CameraDescription {
    /// Rows of a frame.
    #[must_use]
    pub fn height(&self) -> usize {
        self.settings.region.height as usize
    }

    /// Columns of a frame.
    #[must_use]
    pub fn width(&self) -> usize {
        self.settings.region.width as usize
    }

    /// Pixels of a frame.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.settings.region.num_pixels()
    }

    /// Bytes of a frame.
    #[must_use]
    pub fn frame_bytes(&self) -> usize {
        self.pixels() * size_of::<u16>()
    }
}

/// What shall be recorded.
#[derive(Debug, Clone)]
pub struct RecordingPlan {
    /// The directory to create.
    pub directory: PathBuf,
    /// The file format of the images.
    pub format: Format,
    /// The cameras in the order R, T.
    pub cameras: [CameraDescription; 2],
    /// Exposures, if their number is known.
    pub planned_exposures: Option<u64>,
    /// True if anything in the instrument is not a physical device.
    pub simulated: bool,
    /// Place and light, which stay as they are.
    pub conditions: Conditions,
    /// Names and texts of files to keep beside the frames: instrument, plan, calibrations.
    pub provenance: Vec<(String, String)>,
}

/// `recording.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metadata {
    /// Always `sofiscope recording`.
    pub kind: String,
    /// Version of the layout.
    pub format_version: u32,
    /// When the recording was created, in UTC.
    pub created: jiff::Timestamp,
    /// Program and version.
    pub program: String,
    /// The file format of the images.
    pub format: Format,
    /// The cameras in the order R, T.
    pub cameras: [CameraDescription; 2],
    /// Exposures, if their number was known.
    pub planned_exposures: Option<u64>,
    /// True if anything in the instrument is not a physical device.
    pub simulated: bool,
    /// Place and light; unknown in recordings of before.
    #[serde(default)]
    pub conditions: Conditions,
    /// Files kept beside the frames.
    pub provenance: Vec<String>,
}

const KIND: &str = "sofiscope recording";

impl Metadata {
    pub(super) fn of(plan: &RecordingPlan, created: jiff::Timestamp) -> Result<Self, RecordingError> {
        let metadata = Self {
            kind: KIND.to_owned(),
            format_version: FORMAT_VERSION,
            created,
            program: concat!("sofiscope ", env!("CARGO_PKG_VERSION")).to_owned(),
            format: plan.format,
            cameras: plan.cameras.clone(),
            planned_exposures: plan.planned_exposures,
            simulated: plan.simulated,
            conditions: plan.conditions,
            provenance: plan.provenance.iter().map(|(name, _)| name.clone()).collect(),
        };
        match metadata.fault() {
            None => Ok(metadata),
            Some((field, detail)) => Err(RecordingError::Refused {
                path: plan.directory.clone(),
                reason: format!("{field}: {detail}"),
            }),
        }
    }

    /// Reads the file of a recording.
    pub(super) fn read(directory: &Path) -> Result<Self, RecordingError> {
        let path = directory.join(METADATA);
        let text = read_text(&path, MAX_METADATA_BYTES)?;
        let metadata: Self = serde_json::from_str(&text)
            .map_err(|error| RecordingError::damaged(&path, "JSON", error.to_string()))?;
        match metadata.fault() {
            None => Ok(metadata),
            Some((field, detail)) => Err(RecordingError::damaged(&path, field, detail)),
        }
    }

    fn fault(&self) -> Option<(String, String)> {
        let fault = |field: &str, detail: String| Some((field.to_owned(), detail));
        if self.kind != KIND || self.format_version != FORMAT_VERSION {
            let detail = format!("{:?} {} is not read by this program", self.kind, self.format_version);
            return fault("format_version", detail);
        }
        for (camera, channel) in self.cameras.iter().zip(Channel::BOTH) {
            let region = camera.settings.region;
            let sides = 1..=MAX_SIDE;
            let fits = sides.contains(&region.height) && sides.contains(&region.width);
            if !fits || camera.pixels() > MAX_PIXELS {
                let detail = format!("{} x {} pixels are no frame", region.height, region.width);
                return fault(&format!("cameras.{}.settings.region", channel.letter()), detail);
            }
            if camera.pixel_size_nm.is_some_and(|size| !size.is_finite() || size <= 0.0) {
                let detail = "the pixel size is no positive number".to_owned();
                return fault(&format!("cameras.{}.pixel_size_nm", channel.letter()), detail);
            }
        }
        let is_free = |name: &String| {
            let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
            !name.is_empty() && !name.starts_with('.') && name.bytes().all(plain) && !is_ours(name)
        };
        match self
            .provenance
            .iter()
            .enumerate()
            .find(|(at, name)| !is_free(name) || self.provenance[..*at].contains(name))
        {
            Some((_, name)) => fault("provenance", format!("{name:?} cannot be the name of a file here")),
            None => None,
        }
    }

    /// Name of the image file or directory of one camera.
    #[must_use]
    pub fn image_name(&self, channel: Channel) -> String {
        image_name(self.format, channel)
    }

    /// Bytes per second that both cameras deliver, with their padding.
    pub(super) fn bytes_per_second(&self) -> u64 {
        let rate = |camera: &CameraDescription| {
            let period = camera.settings.period.as_secs_f64();
            if period > 0.0 { stride(camera) as f64 / period } else { 0.0 }
        };
        self.cameras.iter().map(rate).sum::<f64>() as u64
    }
}

/// Bytes of a frame in the file: whole pages.
pub(super) fn stride(camera: &CameraDescription) -> u64 {
    camera.frame_bytes().next_multiple_of(super::direct::PAGE) as u64
}

pub(super) fn image_name(format: Format, channel: Channel) -> String {
    let camera = match channel {
        Channel::Reflected => "reflection",
        Channel::Transmitted => "transmission",
    };
    let ending = match format {
        Format::OmeTiff => "tif",
        Format::OmeZarr => "zarr",
    };
    format!("{camera}.ome.{ending}")
}

fn is_ours(name: &str) -> bool {
    name.starts_with("recording.")
        || name.starts_with("ledger.")
        || name.starts_with("events.")
        || name.contains(".ome.")
}

/// A text of at most `max` bytes.
pub(super) fn read_text(path: &Path, max: u64) -> Result<String, RecordingError> {
    let mut text = String::new();
    std::fs::File::open(path)
        .and_then(|file| file.take(max + 1).read_to_string(&mut text))
        .map_err(|source| RecordingError::storage(path, "read", source))?;
    if text.len() as u64 > max {
        return Err(RecordingError::damaged(path, "length", format!("more than {max} bytes")));
    }
    Ok(text)
}
