//! Why a mixture cannot be unmixed, in words that name the dyes.
//!
//! In: a cause. Out: [`UnmixingError`]. Never: a bare number without its meaning. Fails: not at all.

use thiserror::Error;

/// Why a mixture cannot be unmixed.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum UnmixingError {
    /// Nothing to unmix.
    #[error("no species given")]
    NoSpecies,
    /// Order outside `1..=MAX_ORDER`, or no physical channel.
    #[error("cumulant order {order} with {physical_channels} physical channels is not supported")]
    Order {
        /// The order asked for.
        order: usize,
        /// Number of physical channels.
        physical_channels: usize,
    },
    /// More unknowns than equations.
    #[error("{species} species but only {spectral_channels} spectral channels: use a higher order")]
    TooManySpecies {
        /// Number of species.
        species: usize,
        /// Number of spectral channels, `C(n + N_p - 1, n)`.
        spectral_channels: usize,
    },
    /// A share of light is not a number in `0..=1`.
    #[error("{name}: the share {value} of its light is not a number between 0 and 1")]
    Coefficient {
        /// The species.
        name: String,
        /// Its bad share.
        value: f64,
    },
    /// A species that no channel sees.
    #[error("{name} is seen by no channel")]
    Invisible {
        /// The species.
        name: String,
    },
    /// The number of names and of columns of proportions differ.
    #[error("{names} names for {columns} species")]
    Names {
        /// Number of names.
        names: usize,
        /// Number of species in the proportions.
        columns: usize,
    },
    /// Condition number above [`MAX_CONDITION`](super::MAX_CONDITION).
    #[error("cannot be told apart: {} (condition number {condition:.3e})", describe(groups))]
    Indistinguishable {
        /// Each group holds the names of species that look alike to these channels.
        groups: Vec<Vec<String>>,
        /// Condition number of the matrix.
        condition: f64,
    },
    /// Channel images are missing, superfluous or of different shapes.
    #[error("expected {expected} channel images of one shape, got {got}")]
    Images {
        /// Number of spectral channels.
        expected: usize,
        /// What was given instead.
        got: String,
    },
    /// The chosen method cannot be used on this system.
    #[error("unmixing method: {0}")]
    Method(String),
}

fn describe(groups: &[Vec<String>]) -> String {
    let groups: Vec<String> = groups.iter().map(|group| group.join(" and ")).collect();
    groups.join("; ")
}
