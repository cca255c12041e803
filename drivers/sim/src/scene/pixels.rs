//! How the pixels of one camera differ from each other.
//!
//! In: the table `[camera.pixels]` of a scene file. Out: [`PixelSpread`], within its limits.
//! Never: depends on the seed of the sample, as a camera stays what it is when another sample is under it.

use serde::{Deserialize, Serialize};

use sofiscope_form::Form;

/// Differences between the pixels of one camera; all zero unless the scene says otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PixelSpread {
    /// Which camera this is: another seed gives another one of the same make.
    pub seed: u64,
    /// Standard deviation of the offset, counts.
    pub offset_spread_counts: f64,
    /// Standard deviation of the gain as a share of it.
    pub gain_spread: f64,
    /// Standard deviation of the logarithm of the read noise.
    pub read_noise_spread: f64,
    /// Share of the pixels that are hot.
    pub hot_share: f64,
    /// Least and most mean dark electrons of a hot pixel per exposure.
    pub hot_electrons: [f64; 2],
    /// Share of the pixels that see no light.
    pub dead_share: f64,
}

impl Default for PixelSpread {
    /// All pixels alike.
    fn default() -> Self {
        Self {
            seed: 1,
            offset_spread_counts: 0.0,
            gain_spread: 0.0,
            read_noise_spread: 0.0,
            hot_share: 0.0,
            hot_electrons: [200.0, 5000.0],
            dead_share: 0.0,
        }
    }
}

impl PixelSpread {
    /// Whether all pixels are alike.
    #[must_use]
    pub fn is_even(&self) -> bool {
        let spreads = [self.offset_spread_counts, self.gain_spread, self.read_noise_spread];
        spreads.iter().chain(&[self.hot_share, self.dead_share]).all(|&spread| spread == 0.0)
    }

    pub(super) fn read(form: &Form<'_>, default: Self) -> Self {
        let spread = Self {
            seed: form.whole_if_any("seed", 0..=i64::MAX as u64).unwrap_or(default.seed),
            offset_spread_counts: form.number_or(
                "offset_spread_counts",
                default.offset_spread_counts,
                0.0..=1000.0,
            ),
            gain_spread: form.number_or("gain_spread", default.gain_spread, 0.0..=0.2),
            read_noise_spread: form.number_or("read_noise_spread", default.read_noise_spread, 0.0..=2.0),
            hot_share: form.number_or("hot_share", default.hot_share, 0.0..=0.5),
            hot_electrons: form.pair_if_any("hot_electrons", 0.0..=1e6).unwrap_or(default.hot_electrons),
            dead_share: form.number_or("dead_share", default.dead_share, 0.0..=0.5),
        };
        if spread.hot_electrons[1] < spread.hot_electrons[0] {
            form.fault("hot_electrons", "has its ends exchanged", "give the least, then the most");
        }
        spread
    }
}
