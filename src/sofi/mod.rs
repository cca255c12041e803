//! Pure mathematics of the paper, one file per step.

pub mod spectra;
pub mod unmixing;
