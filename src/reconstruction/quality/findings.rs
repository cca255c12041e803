//! What the watching found, and how many exposures are still needed.

use super::drift::CameraDrift;
use crate::sofi::quality::{
    FourierRingCorrelation, LagCorrelation, subsequences_for_resolution, subsequences_for_signal_to_noise,
};
use serde::{Deserialize, Serialize};

/// Quality after a number of subsequences; `None` wherever the data cannot tell yet.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, Serialize)]
pub struct Quality {
    /// Subsequences that count.
    pub subsequences: u64,
    /// Exposures in them.
    pub exposures: u64,
    /// Exposures per subsequence.
    pub subsequence_exposures: u64,
    /// Signal-to-noise per spectral channel: median over the bright pixels of mean over standard error;
    /// noise alone gives about 1.6.
    pub snr_channels: Vec<Option<f64>>,
    /// The same per species (bright: above half of the 99.5th percentile); empty without dyes.
    pub snr_species: Vec<Option<f64>>,
    /// Variance of bright pixels beyond photon and read noise, over that of this noise, per camera, in the newest
    /// subsequence; where the camera's maps are known.
    pub blinking_to_noise: Vec<Option<f64>>,
    /// Resolution by Fourier ring correlation per species, or per spectral channel without dyes.
    pub resolution: Vec<Resolution>,
    /// Bleaching per channel, R and T.
    pub bleaching: Vec<Option<BleachingState>>,
    /// Whether both cameras see the same exposures; for two channels.
    pub lag: Option<LagCheck>,
    /// Where the cameras lie against their registration; for two channels.
    pub drift: Option<CameraDrift>,
    /// Share of the pixels, per channel, that were saturated at least once in the newest subsequence.
    pub saturated_share: Vec<f64>,
    /// Pixels per channel that did not change at all in the newest subsequence.
    pub dead_pixels: Vec<u64>,
}

/// The finest detail on which both halves of the subsequences agree.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, Serialize)]
pub struct Resolution {
    /// Camera pixels.
    pub camera_px: Option<f64>,
    /// Nanometers, if the pixel pitch is known.
    pub nm: Option<f64>,
    /// Whether both halves agree down to two fine pixels, so that the resolution is at least as good as it says.
    pub is_pixel_limited: bool,
    /// The finest structure that the image itself holds, by decorrelation analysis, camera pixels.
    pub decorrelation_camera_px: Option<f64>,
    /// The correlation, on the fine grid; left out of reports for its length.
    #[serde(skip)]
    pub curve: Option<FourierRingCorrelation>,
}

/// How the light of one camera bleaches.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
pub struct BleachingState {
    /// Exposures until half of the signal is gone.
    pub half_time_exposures: f64,
    /// Seconds until then, if the period is known.
    pub half_time_s: Option<f64>,
    /// One standard deviation below and above, exposures; no upper bound is `null` in reports.
    pub half_time_range_exposures: [f64; 2],
    /// Signal now over signal at the begin.
    pub left: f64,
}

/// Correlation of both cameras against the lag of T.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
pub struct LagCheck {
    /// Lag of the highest correlation, -3 to 3 exposures; must be 0.
    pub peak: i32,
    /// How far it stands above the next, standard errors.
    pub significance: f64,
    /// Whether the cameras are in step, where the data can tell.
    pub in_step: Option<bool>,
    /// Correlations for T late by -3 to 3 exposures.
    pub correlations: [f64; 7],
}

impl From<LagCorrelation> for LagCheck {
    fn from(found: LagCorrelation) -> Self {
        let (peak, significance, in_step) = (found.peak(), found.significance(), found.in_step());
        Self { peak, significance, in_step, correlations: found.correlations }
    }
}

impl Quality {
    /// Exposures still needed until every species (spectral channel without dyes) has this signal-to-noise.
    ///
    /// By the square root law, with bleaching where it was found; `None` when it is never reached.
    #[must_use]
    pub fn exposures_for_snr(&self, wanted: f64) -> Option<u64> {
        let all = if self.snr_species.is_empty() { &self.snr_channels } else { &self.snr_species };
        let half_times = self.bleaching.iter().flatten().map(|bleaching| bleaching.half_time_exposures);
        let constant = half_times
            .reduce(f64::min)
            .map(|half_time| half_time / std::f64::consts::LN_2 / self.subsequence_exposures as f64);
        self.still(
            all.iter()
                .map(|snr| subsequences_for_signal_to_noise((*snr)?, self.subsequences, wanted, constant)),
        )
    }

    /// Exposures still needed until every image is resolved to this many camera pixels; `None` when that is
    /// never reached or nothing can be said yet.
    #[must_use]
    pub fn exposures_for_resolution(&self, wanted_camera_px: f64, order: usize) -> Option<u64> {
        let wanted = wanted_camera_px * order as f64;
        self.still(self.resolution.iter().map(|resolution| {
            subsequences_for_resolution(resolution.curve.as_ref()?, self.subsequences, wanted)
        }))
    }

    fn still(&self, subsequences: impl Iterator<Item = Option<u64>>) -> Option<u64> {
        let slowest = subsequences.collect::<Option<Vec<u64>>>()?.into_iter().max()?;
        Some((slowest - self.subsequences) * self.subsequence_exposures)
    }
}
