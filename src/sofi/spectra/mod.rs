//! Says which share of a dye's light each physical channel receives (`T_i`, `R_i`; main text, Table S1).
//!
//! In: numbers measured on a single-stained sample, or spectra of emission, dichroic, filters and cameras in
//! nanometers. Out: [`SpectralResponse`] and [`Species`], proved to lie in `0..=1`; [`Detected`] with the share of
//! the emission that is seen at all.
//! Never: reads files, guesses a missing spectrum, or puts `T` on the short side of a dichroic
//! (the supporting information writes the integral from 0 to the edge; Table S1 has the long side).
//! Fails: [`SpectraError`].
//!
//! | file | what is there |
//! |---|---|
//! | `response` | `T_i`, `R_i`, a species |
//! | `spectrum` | a curve over wavelength, its integrals |
//! | `light_path` | dichroic, filters and quantum efficiency of both cameras together |
//! | `parametric` | curves of a few numbers: emission, dichroic edge, passbands |

mod error;
mod light_path;
mod parametric;
mod response;
mod spectrum;

pub use error::SpectraError;
pub use light_path::{Detected, DichroicCurve, LightPath};
pub use parametric::{EdgeShape, EmissionShape, FilterShape};
pub use response::{Species, SpectralResponse};
pub use spectrum::Spectrum;
