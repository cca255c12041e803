//! Virtual lasers: the Toptica iBEAM smart, the Laser Quantum SMD12, and a laser without a data link.
//!
//! | module | what |
//! |---|---|
//! | [`head`] | [`Head`]: the only way from a model to light on the optical table, and its log |
//! | [`ibeam`] | [`IbeamSmart`], ASCII lines with echo, prompt and `[OK]` |
//! | [`smd12`] | [`Smd12`], ASCII lines, with a slow ramp |
//! | [`diode`] | [`Diode`], which follows the level and the gate of the trigger controller |
//!
//! In: bytes, and level, gates and interlock of the table. Out: bytes; wavelength and power of one line of the
//! table; every change of emission in the log. Never: emits while the interlock is open, or again when it closes.
//! Fails: as its faults say, on purpose.

pub mod diode;
pub mod head;
pub mod ibeam;
pub mod noise;
pub mod smd12;

pub use diode::Diode;
pub use head::{Head, Place};
pub use ibeam::IbeamSmart;
pub use smd12::Smd12;

use std::time::Duration;

/// How often a model looks at the interlock.
pub const LOOKS_EVERY: Duration = Duration::from_millis(5);
