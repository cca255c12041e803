//! Trigger controllers without the hardware.
//!
//! | module | what |
//! |---|---|
//! | [`gatekeeper`] | [`VirtualGatekeeper`]: the firmware of the board itself, with pins on the optical table |
//! | [`arduino`] | [`VirtualArduino`]: protocol 5 of Micro-Manager, with its defects behind flags |
//! | [`teensy_pulse`] | [`VirtualTeensyPulse`]: the TeensyPulseGenerator of Micro-Manager |
//! | [`pins`] | [`Bench`]: where they stand; [`ExposureLine`]: the camera's exposure output |
//!
//! In: bytes, the interlock and the newest pulse of the optical table. Out: bytes; gates, levels and pulses on the
//! table, and every change of a gate in the emission log. Never: reads a clock; what was due is done at the time
//! at which it was due, also when the model is asked late. Fails: when the emission log cannot be written.

pub mod arduino;
pub mod gatekeeper;
pub mod pins;
pub mod teensy_pulse;
#[cfg(test)]
mod tests;

pub use arduino::{ArduinoDefects, ArduinoKind, VirtualArduino};
pub use gatekeeper::{BoardSetup, VirtualGatekeeper};
pub use pins::{Bench, ExposureLine};
pub use teensy_pulse::VirtualTeensyPulse;
