//! Files of settings in TOML, read so that every fault is told at once, with line, key and remedy.
//!
//! In: text. Out: values within their limits, or all [`Fault`]s of the text.
//! Never: stops at the first fault, leaves an unknown key unsaid, knows what a key means.
//! Fails: not at all; a faulty key yields a stand-in that no one sees, as a file with any fault gives no settings.
//!
//! ```
//! let text = "seed = 3\nperiods = 10.0\n";
//! let faults = sofiscope_form::Faults::new(text);
//! let period = sofiscope_form::read(&faults, |form| {
//!     form.whole_if_any("seed", 0..=9);
//!     form.number("period", 0.0..=1.0)
//! });
//! assert_eq!(period, Some(0.0));
//! let said: Vec<String> = faults.into_list().iter().map(ToString::to_string).collect();
//! assert_eq!(
//!     said,
//!     [
//!         "line 2: `periods` is not a known key; remove it, or write `period` if that was meant",
//!         "`period` is missing; add `period = ...`, a number from 0 to 1",
//!     ],
//! );
//! ```

mod fault;
mod form;
mod names;

pub use fault::{Fault, Faults, counted};
pub use form::{Form, read};
pub use names::{nearest, plain};
