//! Settings as typed become settings that can be believed.
//!
//! In: text in TOML. Out: [`Catalogue`], the dyes and dichroics that the program knows by name.
//! Never: stops at the first fault of a file, guesses a name, reads a file itself.
//! Fails: [`Fault`]s with line, key and remedy; [`DyeError`] for names, with the nearest known ones.

mod analysis;
mod dyes;
mod fault;
mod form;
mod names;

pub use analysis::{AnalysisFaults, AnalysisSettings, RawAnalysis};
pub use dyes::{Catalogue, CatalogueError, Dichroic, DyeError, Fluorophore};
pub use fault::Fault;
pub use names::nearest;
