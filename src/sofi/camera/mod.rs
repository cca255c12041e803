//! What each pixel of a camera does to light, from darks and a photon-transfer series.
//!
//! | what | file |
//! |---|---|
//! | mean and variance of every pixel while frames come | [`PixelStatistics`], `statistics.rs` |
//! | offset, gain and read noise with their errors | [`photon_transfer`], `transfer.rs` |
//! | hot, dead and saturated pixels | [`PixelFault`], `faults.rs` |
//! | the maps as the cumulants need them | [`CameraMaps`], `maps.rs` |
//!
//! Never: keeps a frame, lets a pixel that is broken decide about the others.
//! Fails: [`TransferError`] for series that say nothing.

mod faults;
mod maps;
mod statistics;
mod transfer;

pub use faults::PixelFault;
pub use maps::{CameraMaps, pulled_together};
pub use statistics::{PixelMoments, PixelStatistics};
pub use transfer::{PhotonTransfer, TransferError, photon_transfer};

/// The value in the middle; 0 without any.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.filter(|value| !value.is_nan()).collect();
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Standard deviation of all but the outliers: the median distance from the median, as large as for a Gaussian.
fn robust_spread(values: &[f64]) -> f64 {
    let center = median(values.iter().copied());
    1.4826 * median(values.iter().map(|value| (value - center).abs()))
}
