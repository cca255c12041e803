//! How good a result is, from the data alone, while frames still come in.
//!
//! | question | file | source |
//! |---|---|---|
//! | how fine are the details that two halves of the data agree on | [`frc`](self) | Saxton and Baumeister 1982; Nieuwenhuizen et al. 2013 |
//! | up to which frequency does one image hold signal | `decorrelation` | Descloux et al. 2019 |
//! | how far do pixels stand above their own scatter | `signal` | standard error of the mean |
//! | how much light is left | `bleaching` | exponential decay |
//! | how many frames are still needed | `forecast` | square root law; Unser et al. 1987 |
//! | do both cameras see the same exposures | `lag` | cross-correlation of traces |
//!
//! In: images averaged over subsequences, traces of counts. Out: numbers with the law behind them.
//! Never: knows the true sample, keeps frames. Fails: what the data cannot tell is `None`.

mod bleaching;
mod decorrelation;
mod forecast;
mod frc;
mod lag;
mod signal;
mod spectrum;

pub use bleaching::{BinnedTrace, Bleaching, Offset, fit_bleaching};
pub use decorrelation::{Decorrelation, decorrelation};
pub use forecast::{subsequences_for_resolution, subsequences_for_signal_to_noise};
pub use frc::{FourierRingCorrelation, THRESHOLD, balance_sub_grids, fourier_ring_correlation};
pub use lag::{LONGEST_LAG, LagCorrelation, LagCorrelator};
pub use signal::{BRIGHT_QUANTILE, RunningImage, signal_to_noise};
