//! Turns cumulant images of spectral channels into cumulant images of species (step 3; Eq. 2, S2, S4).
//!
//! In: the spectral responses, and one float32 image per spectral channel, all of one shape,
//! in the order of [`UnmixingMatrix::spectral_channels`] (two cameras: `u = 0..=n` pixels from T).
//! Out: one float32 image per species, in the order the species were given.
//! Never: mixes neighboring pixels, clips or invents values; NaN in any channel is NaN in every species.
//! Fails: [`UnmixingError`]; dyes that cannot be told apart are named.

mod contradiction;
mod diagnosis;
mod error;
mod jacobi;
mod matrix;
mod nonnegative;
#[cfg(test)]
pub(super) mod reference;
#[cfg(test)]
mod tests;
mod unmixer;

pub use contradiction::{Contradiction, contradictions};
pub use error::UnmixingError;
pub(super) use jacobi::{SingularValues, pseudo_inverse};
pub use matrix::UnmixingMatrix;
pub(super) use matrix::{channel_sets, mixing_matrix};
pub use unmixer::{Unmixer, UnmixingMethod};

/// Systems with a larger condition number are refused.
pub const MAX_CONDITION: f64 = 1e6;
/// Largest cumulant order accepted.
pub const MAX_ORDER: usize = 12;
/// Most species that [`UnmixingMethod::NonNegative`] accepts: it keeps a solver for every subset.
pub const MAX_NON_NEGATIVE_SPECIES: usize = 10;
