//! Which dyes, which dichroic: how well a mixture could be unmixed, before anything is bought or stained
//! (supporting information, "Optimization of multicolor SOFI via eigenvalue and eigenvector analysis"; Fig. S2).
//!
//! In: shares of light `P[channel, dye]`, or emissions that ideal edges divide; an order `n`.
//! Out: [`Merit`] (eigenvalues, singular values, condition, noise), the best edges, the crosstalk that an error of
//! one share would cause. Any number of dyes and of physical channels.
//! Never: refuses a mixture that cannot be unmixed (it has the merit 0); knows the name of a dye.
//! Fails: [`ChoiceError`].
//!
//! | file | what is there |
//! |---|---|
//! | `merit` | what a mixing matrix is worth |
//! | `sensitivity` | crosstalk from a wrong `T_i` |
//! | `edges` | ideal step edges: sweep, best place |

mod edges;
mod error;
mod merit;
mod sensitivity;
#[cfg(test)]
mod tests;

pub use edges::{BestEdges, EdgeRange, EdgeSplit};
pub use error::ChoiceError;
pub use merit::{Criterion, Merit, spectral_channels};
pub use sensitivity::crosstalk_percent;
