//! Running spatio-temporal and spectral cross-cumulants (paper, step 2; Eq. 2, S2, S4).
//!
//! In: exposures of all channels, in the order of time, gaps allowed; they are free again when `push` returns.
//! Out: at any moment the cumulants averaged over subsequences, the mean and the variance images.
//! Never: grows with the number of exposures, starts a thread, lets the division into blocks change a bit.
//! Fails: [`SettingsError`] before the first exposure, [`PushError`] for exposures that do not fit.
//!
//! ```
//! use sofiscope::sofi::cumulant::{CumulantEngine, CumulantSettings, Exposure, Incomplete, Serial};
//!
//! let mut engine = CumulantEngine::<u16>::new(CumulantSettings::new(2, 2, 4), 8, 8)?;
//! for index in 0..4u16 {
//!     let (r, t) = ([100 + index; 64], [100 - index; 64]);
//!     engine.push(&Serial, &[Exposure { index: u64::from(index), planes: &[&r, &t] }])?;
//! }
//! let drawing = engine.draw(&Serial, Incomplete::AtLeastHalf).ok_or("no complete subsequence")?;
//! let center = [8, 8];
//! assert_eq!(drawing.cumulants.len(), 3);
//! assert!((drawing.cumulants[0][center] - 1.25).abs() < 1e-6);
//! assert!((drawing.cumulants[1][center] + 1.25).abs() < 1e-6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod algebra;
mod bias;
mod binned;
mod drawing;
mod engine;
mod finalize;
mod kernel;
mod layout;
mod moments;
mod plan;
mod registered;
mod ring;
mod second_order;
mod settings;
mod shift;
mod terms;
mod workers;

pub use binned::Binning;
pub use drawing::{Drawing, Incomplete, PixelMask};
pub use engine::{CumulantEngine, Exposure, MergeError, PushError, RunSummary};
pub use kernel::Count;
pub use settings::{CumulantSettings, SettingsError};
pub use workers::{Serial, Workers};
