//! Focus lock: holds the sample in focus by what a sensor sees of a reflected beam.
//!
//! ```text
//! FocusSensor ─► reading ─► FocusLock::step(reading, now) ─► Correction ─► FocusDrive
//!                             │ calibration: signal ─► focus error, nanometers
//!                             └ servo: error ─► step of the drive
//! ```
//!
//! In: [`FocusReading`](sofiscope_hal::FocusReading)s and the time. Out: [`Correction`]s, the error of the moment,
//! how well it holds. Never: moves on a reading it does not trust, leaves the range of the drive, takes a step
//! larger than the slew limit while locked, searches twice without a person.
//! Fails: goes to [`FocusLock::Lost`] or [`FocusLock::Off`] with the reason; the drive then stays where it is.
//!
//! | module | what |
//! |---|---|
//! | [`calibration`] | from a sweep to slope, zero and trust limits |
//! | [`servo`] | PI in steps, with dead band, slew limit and range; pure |
//! | [`lock`] | off, searching, probing, locked, lost; pure |
//! | [`run`] | the thread that feeds them |

pub mod calibration;
pub mod lock;
pub mod run;
pub mod servo;
#[cfg(test)]
mod tests;

pub use calibration::{Calibration, CalibrationError, SweepPoint, Trust};
pub use lock::{Correction, FocusLock, LockEnd, LockSettings};
pub use run::{FocusCommand, FocusError, FocusLoop, FocusRemote, FocusStatus};
pub use servo::{Servo, ServoSettings};
