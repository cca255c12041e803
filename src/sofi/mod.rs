//! Pure mathematics of the paper, one file per step.

pub mod balancing;
pub mod convolution;
pub mod flattening;
pub mod linearization;
pub mod psf;
pub mod spectra;
pub mod unmixing;
