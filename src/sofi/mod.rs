//! The mathematics of the paper: pure functions and states, one file per step of its Figure 2.
//!
//! | step | file | paper |
//! |---|---|---|
//! | offset, gain, noise and faults of every pixel | [`camera`] | |
//! | 1: camera T onto camera R | [`registration`] | step 1 |
//! | which pixels make which virtual pixel | [`grid`] | Fig. 1b |
//! | 2: running spatio-temporal and spectral cross-cumulants | [`cumulant`] | Eq. 2, S2, S4 |
//! | 3: species from spectral channels | [`unmixing`], [`spectra`], [`response`] | Eq. 2, S2, Table S1 |
//! | which dyes and which dichroic | [`dye_choice`] | Fig. S2, Table S1 |
//! | 4: equal weights for the shifted sub-grids | [`flattening`], [`psf`], [`psf_width`] | Eq. S6 |
//! | 5: brightness that is linear again | [`linearization`], [`convolution`] | main text, step 5 |
//! | on-time ratio, brightness and density from three orders | [`balancing`] | bSOFI |
//! | signal-to-noise, resolution, bleaching while frames come in | [`quality`] | |
//!
//! Never: reads a clock or a file, draws a random number, knows a device.

pub mod balancing;
pub mod camera;
pub mod convolution;
pub mod cumulant;
pub mod dye_choice;
pub mod flattening;
pub mod grid;
pub mod linearization;
mod prefetch;
pub mod psf;
pub mod psf_width;
pub mod quality;
pub mod registration;
pub mod response;
pub mod spectra;
pub mod unmixing;
