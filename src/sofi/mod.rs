//! The mathematics of the paper: pure functions and states, one file per step of its Figure 2.
//!
//! | step | file | paper |
//! |---|---|---|
//! | which pixels make which virtual pixel | [`grid`] | Fig. 1b |
//! | running spatio-temporal and spectral cross-cumulants | [`cumulant`] | Eq. 2, S2, S4 |
//!
//! Never: reads a clock, a file or a random number, starts a thread, knows a device.

pub mod cumulant;
pub mod grid;
