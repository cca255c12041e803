//! Why a choice cannot be judged.
//!
//! In: a cause. Out: [`ChoiceError`]. Never: a bare number without its meaning. Fails: not at all.

use thiserror::Error;

/// Why a choice cannot be judged.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ChoiceError {
    /// No dye, no channel, an order of 0 or above the limit of the unmixing.
    #[error("{dyes} dyes, {channels} channels and order {order} make no mixture")]
    Empty {
        /// Number of dyes.
        dyes: usize,
        /// Number of physical channels.
        channels: usize,
        /// Cumulant order.
        order: usize,
    },
    /// More unknowns than equations.
    #[error(
        "{dyes} dyes cannot be told apart by {spectral_channels} spectral channels \
         (order {order}, {channels} physical channels)"
    )]
    TooManyDyes {
        /// Number of dyes.
        dyes: usize,
        /// Number of spectral channels, `C(n + N_p - 1, n)`.
        spectral_channels: usize,
        /// Cumulant order.
        order: usize,
        /// Number of physical channels.
        channels: usize,
    },
    /// A share is not a number in `0..=1`.
    #[error("the share {value} of dye {dye} is not a number between 0 and 1")]
    Share {
        /// Place of the dye, from 0.
        dye: usize,
        /// The value.
        value: f64,
    },
    /// No place for the edges.
    #[error("edges need wavelengths from {from_nm} nm up to above it, not to {to_nm} nm")]
    Range {
        /// Lowest edge, nanometers.
        from_nm: f64,
        /// Highest edge, nanometers.
        to_nm: f64,
    },
    /// A dye sends no light through the filters.
    #[error("dye {dye} sends no light through the filters")]
    Dark {
        /// Place of the dye, from 0.
        dye: usize,
    },
}
