//! Step 1 of the paper: camera T onto camera R.
//!
//! | what | file |
//! |---|---|
//! | mirror and affine map | [`ReflectedFromTransmitted`], `transform.rs` |
//! | weights that keep the point-spread function | [`Interpolation`], `interpolation.rs` |
//! | which pixels of T make a pixel of R | [`Resampler`], `resampling.rs` |
//! | rows of T on the pixels of R | [`Stretch`], `stretch.rs` |
//! | beads, to a fraction of a pixel | [`find_beads`], `beads.rs` |
//! | which bead is which, mirror included | [`match_beads`], `matching.rs`, `fit.rs` |
//! | places that blink together | [`CoarseCorrelation`], [`PatchCorrelation`], `correlation.rs` |
//! | noise of T's pixels from their mean | [`NoiseLine`], `noise.rs` |
//!
//! Never: makes up a value for a pixel whose partner is not on the sensor.
//! Fails: [`TransformError`] for maps that cannot be used.

mod beads;
mod correlation;
mod fit;
mod interpolation;
mod matching;
mod noise;
mod resampling;
mod stretch;
mod transform;

pub use beads::{Bead, find_beads};
pub use correlation::{CoarseCorrelation, PatchCorrelation, shifted};
pub use fit::{PointPair, distance, fit_affine, root_mean_square};
pub use interpolation::{Interpolation, PADDED_TAPS, TAPS};
pub use matching::{BeadMatch, MatchError, match_beads, without_outliers};
pub use noise::NoiseLine;
pub use resampling::{REGISTER, Resampler};
pub use stretch::{FRAMES_TOGETHER, LINES, Stretch};
pub use transform::{Affine, Mirror, ReflectedFromTransmitted, TransformError};

/// How the frames of T are registered on the way into the cumulants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RegistrationSettings {
    /// Where R sees what T sees.
    pub transform: ReflectedFromTransmitted,
    /// How values between pixels are made.
    pub interpolation: Interpolation,
    /// Noise of camera T.
    pub noise: NoiseLine,
}
