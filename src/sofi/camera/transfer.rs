//! Offset, gain and read noise of every pixel, from a dark recording and flats of several levels.
//!
//! The variance of a pixel over its mean is a line, `v_l - v_0 = g (m_l - o)` (photon transfer; Janesick 2007), whose
//! slope is the gain. Each level counts by the inverse variance that the camera's median gain predicts for `v_l`,
//! `2 v^2 / (n - 1)`, not by the one that was measured, as that would prefer variances that came out low by chance.
//! For Poisson light, what the error of the mean adds and what it shares with that of the variance cancel.
//!
//! In: [`PixelMoments`] of a dark and of flats. Out: [`PhotonTransfer`], with a standard error for every number.
//! Never: uses a level at which a pixel was saturated. Fails: [`TransferError`].

use super::faults::faults;
use super::{PixelMoments, median};
use ndarray::Array2;

/// A level is left out for a pixel that was saturated in a larger share of its frames.
const MOST_SATURATED: f32 = 0.0;

/// Fewest frames of a recording.
const LEAST_FRAMES: u64 = 10;

/// What is known of every pixel of a camera, `(height, width)`.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotonTransfer {
    /// Mean without light, counts.
    pub offset: Array2<f32>,
    /// Counts per electron; NaN where no level could be used.
    pub gain: Array2<f32>,
    /// Variance without light, counts squared; holds that of rounding to whole counts.
    pub read_variance: Array2<f32>,
    /// Standard error of the offset, counts.
    pub offset_error: Array2<f32>,
    /// Standard error of the gain, counts per electron.
    pub gain_error: Array2<f32>,
    /// Standard error of the variance without light, counts squared.
    pub read_variance_error: Array2<f32>,
    /// Faults as [`PixelFault`](super::PixelFault) bits, 0 for a good pixel.
    pub faults: Array2<u8>,
}

/// Why a series says nothing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TransferError {
    /// Too few frames.
    #[error("a recording has {0} frames; take at least 10, in practice some hundred or more")]
    Frames(u64),
    /// Not a single flat.
    #[error("no flat was given; take flats of several levels of even light, or darks alone say no gain")]
    NoFlat,
    /// Recordings of different sizes.
    #[error("the recordings differ in size; read the same region in all of them")]
    Size,
    /// Flats as dark as the dark.
    #[error("the flats are no brighter than the dark; check which recording is which, and the lamp")]
    NoLight,
    /// Nothing but saturated flats.
    #[error("all flats are saturated; take them with less light")]
    Saturated,
}

/// One level of light at one pixel.
struct Level {
    light: f64,
    excess: f64,
    freedom: f64,
}

/// Offset, gain and read noise of every pixel, and which of them are broken.
///
/// # Errors
/// [`TransferError`] for recordings that do not belong together or say nothing.
pub fn photon_transfer(dark: &PixelMoments, flats: &[PixelMoments]) -> Result<PhotonTransfer, TransferError> {
    check(dark, flats)?;
    let offset = dark.mean.clone();
    let read_variance = dark.variance.clone();
    let typical = typical_gain(dark, flats)?;
    let fitted = Array2::from_shape_fn(offset.dim(), |place| {
        let noise = f64::from(read_variance[place]);
        let at_dark = 2.0 * noise * noise / dark.freedom as f64;
        let of_offset = noise / dark.frames as f64;
        gain_of(&levels(dark, flats, place), typical, noise, (at_dark, of_offset))
    });
    let error = |value: &dyn Fn(f64) -> f64| read_variance.mapv(|v| value(f64::from(v)) as f32);
    let (frames, freedom) = (dark.frames as f64, dark.freedom as f64);
    Ok(PhotonTransfer {
        gain: fitted.mapv(|(gain, _)| gain as f32),
        gain_error: fitted.mapv(|(_, error)| error as f32),
        offset_error: error(&|variance| (variance / frames).sqrt()),
        read_variance_error: error(&|variance| variance * (2.0 / freedom).sqrt()),
        faults: faults(dark, flats),
        offset,
        read_variance,
    })
}

fn check(dark: &PixelMoments, flats: &[PixelMoments]) -> Result<(), TransferError> {
    if flats.is_empty() {
        return Err(TransferError::NoFlat);
    }
    for recording in flats.iter().chain([dark]) {
        if recording.mean.dim() != dark.mean.dim() {
            return Err(TransferError::Size);
        }
        if recording.frames < LEAST_FRAMES {
            return Err(TransferError::Frames(recording.frames));
        }
    }
    Ok(())
}

/// The levels that a pixel can be judged by.
fn levels<'a>(
    dark: &'a PixelMoments,
    flats: &'a [PixelMoments],
    place: (usize, usize),
) -> impl Iterator<Item = Level> + Clone + use<'a> {
    let is_usable = move |flat: &&PixelMoments| flat.saturated_share[place] <= MOST_SATURATED;
    flats.iter().filter(is_usable).map(move |flat| Level {
        light: f64::from(flat.mean[place]) - f64::from(dark.mean[place]),
        excess: f64::from(flat.variance[place]) - f64::from(dark.variance[place]),
        freedom: flat.freedom as f64,
    })
}

/// The gain of most pixels.
fn typical_gain(dark: &PixelMoments, flats: &[PixelMoments]) -> Result<f64, TransferError> {
    let mut are_saturated = true;
    let gains = dark.mean.indexed_iter().filter_map(|(place, _)| {
        let (mut light, mut excess) = (0.0, 0.0);
        for level in levels(dark, flats, place) {
            are_saturated = false;
            light += level.light;
            excess += level.excess;
        }
        (light > 0.0).then_some(excess / light)
    });
    let typical = median(gains);
    match (are_saturated, typical > 0.0) {
        (true, _) => Err(TransferError::Saturated),
        (_, false) => Err(TransferError::NoLight),
        _ => Ok(typical),
    }
}

/// Slope through the origin and its standard error; `dark` holds the variances of the dark's variance and mean.
fn gain_of(
    levels: &(impl Iterator<Item = Level> + Clone),
    typical: f64,
    noise: f64,
    (at_dark, of_offset): (f64, f64),
) -> (f64, f64) {
    let (mut squared, mut mixed, mut linear) = (0.0, 0.0, 0.0);
    for Level { light, excess, freedom } in levels.clone() {
        let variance = (noise + typical * light.max(0.0)).max(f64::MIN_POSITIVE);
        let weight = freedom / (2.0 * variance * variance);
        squared += weight * light * light;
        mixed += weight * light * excess;
        linear += weight * light;
    }
    if squared <= 0.0 {
        return (f64::NAN, f64::NAN);
    }
    let gain = mixed / squared;
    // All levels share the dark.
    let shared = (linear / squared).powi(2) * (at_dark + gain * gain * of_offset);
    (gain, (1.0 / squared + shared).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(mean: f32, variance: f32) -> PixelMoments {
        let filled = |value| Array2::from_elem((4, 4), value);
        PixelMoments {
            frames: 100,
            freedom: 96,
            mean: filled(mean),
            variance: filled(variance),
            saturated_share: filled(0.0),
            flicker: 0.0,
        }
    }

    #[test]
    fn a_line_gives_its_slope_and_saturated_levels_do_not_count() {
        let dark = moments(100.0, 9.0);
        let mut flats = vec![moments(300.0, 9.0 + 440.0), moments(1100.0, 9.0 + 2200.0)];
        let mut saturated = moments(4095.0, 0.0);
        saturated.saturated_share.fill(1.0);
        flats.push(saturated);
        let found = photon_transfer(&dark, &flats).unwrap();
        assert!(found.gain.iter().all(|gain| (gain - 2.2).abs() < 1e-5), "{}", found.gain);
        assert!((found.offset_error[[0, 0]] - 0.3).abs() < 1e-6);
        // The brightest level alone would give 2.2 sqrt(2 / 96), and a little for the read noise.
        let one = 2.2 * (2.0_f32 / 96.0).sqrt();
        assert!((0.6 * one..one).contains(&found.gain_error[[0, 0]]), "{}", found.gain_error);
    }

    #[test]
    fn series_that_say_nothing_are_refused() {
        let (dark, flat) = (moments(100.0, 9.0), moments(300.0, 449.0));
        assert_eq!(photon_transfer(&dark, &[]), Err(TransferError::NoFlat));
        assert_eq!(photon_transfer(&dark, std::slice::from_ref(&dark)), Err(TransferError::NoLight));
        let few = PixelMoments { frames: 3, ..flat.clone() };
        assert_eq!(photon_transfer(&dark, &[few]), Err(TransferError::Frames(3)));
        let mut bright = flat;
        bright.saturated_share.fill(0.5);
        assert_eq!(photon_transfer(&dark, &[bright]), Err(TransferError::Saturated));
    }
}
