//! Spectra from texts: measured ones from CSV, parametric ones from TOML.
//!
//! In: texts. Out: [`Spectrum`](crate::sofi::spectra::Spectrum)s, [`ParametricSpectra`].
//! Never: takes a parametric curve for a measured one, stops at the first fault.
//! Fails: [`SpectrumFaults`] with line, what is wrong and the remedy.

mod csv;
mod parametric;

pub use csv::{CsvSpectrum, ValueUnit, read_spectrum};
pub use parametric::{ParametricDichroic, ParametricSpectra};

use super::Fault;

/// Everything that is wrong with a spectrum or a file of spectra; at least one fault.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", list(faults))]
pub struct SpectrumFaults {
    /// The faults in the order of lines.
    pub faults: Vec<Fault>,
}

/// Most faults that are written out.
const MOST_WRITTEN: usize = 3;

fn list(faults: &[Fault]) -> String {
    let mut written: Vec<String> = faults.iter().take(MOST_WRITTEN).map(ToString::to_string).collect();
    if let Some(more) = faults.len().checked_sub(MOST_WRITTEN).filter(|more| *more > 0) {
        written.push(format!("and {more} more"));
    }
    written.join("; ")
}
