//! Laser Quantum gem lasers on an SMD12 supply over a serial line.
//!
//! | module | what |
//! |---|---|
//! | [`driver`] | [`Smd12`], the laser behind the contract |
//! | `link` | one exchange at a time, in step with the laser, or none |
//! | `ramp` | whether the power is where it should be by now |
//! | `reply` | what an answer says, and whether it is one |
//!
//! In: a line, a clock, wavelength, identity and cap of the configuration. Out: [`Smd12`].
//! Never: sends a power above its cap; waits for the ramp; believes an answer that may belong to another question;
//! stays on after three answers that were none, or when it is dropped. Fails: `DeviceError`; the laser has then
//! been told to be dark.
//!
//! Dialect: adapters of Micro-Manager (LaserQuantumLaser) and qudi (laserquantum), iSIM notes of EPFL.

pub mod driver;
mod link;
mod properties;
mod ramp;
mod reply;

pub use driver::{Clock, Smd12, Smd12Settings};
pub use ramp::Ramp;

use sofiscope_serial_line::LineSettings;

/// The bytes that make it dark, for whoever holds the line when nothing else can.
///
/// The first return ends a command that was under way.
pub const DARK: &[u8] = b"\rOFF\r";

/// How its bytes stand on the wire: 9600 8N1.
#[must_use]
pub fn line_settings() -> LineSettings {
    LineSettings::new(9600)
}
