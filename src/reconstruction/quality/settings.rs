//! What is watched, and why it cannot be.

use super::CENTRAL_SIDE;
use crate::sofi::cumulant::{CumulantSettings, SettingsError};
use crate::sofi::unmixing::UnmixingMatrix;
use std::time::Duration;

/// How quality is watched.
#[derive(Debug, Clone)]
pub struct QualitySettings {
    /// The cumulants, as the live analysis computes them.
    pub cumulants: CumulantSettings,
    /// Height of the frames, camera pixels.
    pub height: usize,
    /// Width of the frames, camera pixels.
    pub width: usize,
    /// Longest side of the central part that is looked at, camera pixels.
    pub central_side: usize,
    /// Dyes, if images per species are wanted.
    pub matrix: Option<UnmixingMatrix>,
    /// Counts at which a pixel is saturated.
    pub saturation_counts: u16,
    /// Counts that do not bleach (camera offset and background) per channel, where known.
    pub offset_counts: Option<Vec<f64>>,
    /// Pixel pitch in the sample, nanometers, if known.
    pub pixel_pitch_nm: Option<f64>,
    /// Time from exposure to exposure, if known.
    pub period: Option<Duration>,
}

impl QualitySettings {
    /// For frames of this size, with nothing known of dyes, pixel pitch, time and offset.
    #[must_use]
    pub fn new(cumulants: CumulantSettings, height: usize, width: usize) -> Self {
        Self {
            cumulants,
            height,
            width,
            central_side: CENTRAL_SIDE,
            matrix: None,
            saturation_counts: u16::MAX,
            offset_counts: None,
            pixel_pitch_nm: None,
            period: None,
        }
    }
}

/// Why quality cannot be watched.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum QualityError {
    /// The cumulant settings, or the size of the central part, cannot be used.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The dyes do not belong to these cumulants.
    #[error(
        "the unmixing is for {rows} spectral channels of order {order}, not for those of these cumulants"
    )]
    Matrix {
        /// Spectral channels of the matrix.
        rows: usize,
        /// Order of the matrix.
        order: usize,
    },
    /// There is not one offset per channel.
    #[error("{given} offsets were given for {channels} channels")]
    Offsets {
        /// Offsets given.
        given: usize,
        /// Channels.
        channels: usize,
    },
}
