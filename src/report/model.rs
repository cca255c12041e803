//! The report of one analysis as data: everything a person or a script may ask later.
//!
//! In: numbers and names from the analysis. Out: structs that turn into `report.json` and back.
//! Never: computes results, reads a clock. Fails: never.
//!
//! Numbers that are not finite are written as `null` and read back as NaN.

use serde::{Deserialize, Serialize};

pub use super::model_quality::{
    BleachingCurve, Crosstalk, CrosstalkReference, CurveUnit, FlatteningNotes, Matrix, Resolution,
    ResolutionCurve, ResolutionValue, Species, Unmixing,
};
use super::null;
use crate::display::Rgb;

/// Version of the layout of `report.json`, raised when a field changes its meaning.
pub const FORMAT_VERSION: u32 = 1;

/// Everything about one analysis.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct AnalysisReport {
    /// [`FORMAT_VERSION`] of the program that wrote the report.
    pub format_version: u32,
    /// What was imaged, in the words of the operator; heading of the page.
    pub title: String,
    /// Program that made the analysis.
    pub software: Software,
    /// Command line, as typed.
    pub command: String,
    /// Date and time of the analysis, RFC 3339 with offset.
    pub created: String,
    /// Whether frames came from the simulator; the page then says so in a banner.
    pub simulated: bool,
    /// Sentences the reader must see before the pictures.
    pub warnings: Vec<String>,
    /// Files that were read.
    pub inputs: Vec<InputFile>,
    /// Settings as used, defaults filled in.
    pub settings: Settings,
    /// What became of the frames.
    pub frames: FrameAccount,
    /// What became of each subsequence.
    pub subsequences: Vec<Subsequence>,
    /// The fluorophores, in the order of the pages of the result files.
    pub species: Vec<Species>,
    /// The mixing matrix and what it does to noise.
    pub unmixing: Option<Unmixing>,
    /// Mean intensity of each camera over time.
    pub bleaching: Option<BleachingCurve>,
    /// Crosstalk, where the truth is known.
    pub crosstalk: Option<Crosstalk>,
    /// Resolution of the result images.
    pub resolution: Option<Resolution>,
    /// How long it took.
    pub timing: Option<Timing>,
    /// Files that were written.
    pub outputs: Vec<OutputFile>,
}

/// Name and version of a program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Software {
    /// Name.
    pub name: String,
    /// Version.
    pub version: String,
}

impl Default for Software {
    /// This program.
    fn default() -> Self {
        Self { name: env!("CARGO_PKG_NAME").to_owned(), version: env!("CARGO_PKG_VERSION").to_owned() }
    }
}

/// One file that was read.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputFile {
    /// What it holds, e.g. `R` or `T`.
    pub role: String,
    /// Path as given.
    pub path: String,
    /// Number of frames.
    pub frames: u64,
    /// Height of a frame in camera pixels.
    pub height: u64,
    /// Width of a frame in camera pixels.
    pub width: u64,
    /// Type of one sample, e.g. `uint16`.
    pub sample_type: String,
}

/// Settings as used.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// Cumulant order n.
    pub order: u32,
    /// Exposures per subsequence.
    pub subsequence_length: u64,
    /// Which pixel combinations make an output pixel.
    pub combinations: String,
    /// Time lag of each pixel of the combination, in frames.
    pub lags: Vec<u32>,
    /// Dichroic between the cameras.
    pub dichroic: Option<String>,
    /// How T was brought onto R: method, or calibration file with its residual.
    pub registration: Option<String>,
    /// How the linear system was solved.
    pub unmixing: String,
    /// How the sub-grids were made equal.
    pub flattening: String,
    /// Iterations of the deconvolution; `None` if the images were not linearized.
    pub linearization_iterations: Option<u32>,
    /// Point-spread function.
    pub psf: Option<PsfUsed>,
    /// Pitch of the camera pixels in the sample, in nanometers.
    pub camera_pixel_pitch_nm: Option<f64>,
    /// Exposure time, in milliseconds.
    pub exposure_ms: Option<f64>,
    /// Anything else that was set, as name and value.
    pub other: Vec<(String, String)>,
}

/// Width of the point-spread function.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PsfUsed {
    /// Standard deviation of the Gaussian, in camera pixels.
    #[serde(deserialize_with = "null::number")]
    pub sigma_px: f64,
    /// Where the number came from, e.g. `NA 1.27, 600 nm` or `estimated from the sub-grids`.
    pub source: String,
}

/// What became of the frames (pairs of frames with two cameras).
///
/// `received = used + sum of excluded`; what was lost never arrived.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct FrameAccount {
    /// Frames that arrived.
    pub received: u64,
    /// Frames in the result.
    pub used: u64,
    /// Frames that never arrived, by reason.
    pub lost: Vec<FrameCount>,
    /// Frames that arrived and were left out, by reason.
    pub excluded: Vec<FrameCount>,
}

impl FrameAccount {
    /// Number of lost frames.
    #[must_use]
    pub fn num_lost(&self) -> u64 {
        self.lost.iter().map(|count| count.frames).sum()
    }

    /// Number of excluded frames.
    #[must_use]
    pub fn num_excluded(&self) -> u64 {
        self.excluded.iter().map(|count| count.frames).sum()
    }
}

/// A number of frames and why.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameCount {
    /// Why.
    pub reason: String,
    /// How many.
    pub frames: u64,
}

/// One subsequence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Subsequence {
    /// Exposure index of the first exposure.
    pub first_exposure: u64,
    /// Frames (pairs) it has.
    pub frames: u64,
    /// Whether it is part of the result.
    #[serde(flatten)]
    pub fate: SubsequenceFate,
}

/// Whether a subsequence is part of the result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub enum SubsequenceFate {
    /// It is, with this weight; the weights of all used ones add up to 1.
    Used {
        /// Share in the mean over the subsequences.
        #[serde(deserialize_with = "null::number")]
        weight: f64,
    },
    /// It is not.
    Skipped {
        /// Why.
        reason: String,
    },
}

/// How long it took.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Timing {
    /// Wall time from the first frame read to the last file written, in seconds.
    #[serde(deserialize_with = "null::number")]
    pub seconds: f64,
    /// Frame pairs per second of wall time.
    #[serde(deserialize_with = "null::number")]
    pub pairs_per_second: f64,
    /// Wall time of single steps, as name and seconds.
    pub steps: Vec<(String, f64)>,
}

/// One file that was written.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputFile {
    /// Path.
    pub path: String,
    /// What it holds.
    pub content: String,
}

impl Species {
    /// The color of the species in composites, or white.
    #[must_use]
    pub fn display_color(&self) -> Rgb {
        self.color.unwrap_or(crate::display::WHITE)
    }
}
