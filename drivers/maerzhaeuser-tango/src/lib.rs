//! Märzhäuser TANGO stage controllers over a serial line.
//!
//! | module | what |
//! |---|---|
//! | [`tango`] | [`Tango`], the stage: start-up, moves, homing, what it is doing |
//! | `dialog` | one question, one answer; what to do when it is not that |
//! | `reply` | answers to values, and nothing else |
//! | `codes` | the controller's errors in words |
//! | `grid` | places as the controller takes them, never outside the envelope |
//! | `watch` | what was begun, and how long it may take |
//! | `brake` | STOP, past everything |
//! | `properties` | velocity, acceleration, backlash, joystick |
//!
//! In: places in micrometers. Out: one outstanding command on the line.
//! Never: sends a target outside the envelope, repeats a move, takes a late answer for the next one, waits for
//! the end of a motion. Fails: `Identity` for another device, `Busy` before homing, `Fault` with the controller's
//! own words; whatever fails during a motion sends STOP and leaves the place unknown.
//!
//! Sources of the protocol: Micro-Manager's `Marzhauser` adapter, the `Tango_DLL` header, storm-control,
//! PYME and the HEPHY comet driver; never tried on hardware.

mod brake;
mod codes;
mod dialog;
mod grid;
mod properties;
mod reply;
pub mod tango;
mod watch;

pub use tango::{Clock, LINE_SETTINGS, Tango, TangoSettings};
