//! Sensors of the focus error: a spot on a camera, a quadrant detector.
//!
//! | module | what |
//! |---|---|
//! | [`spot`] | where a spot is on an image; pure |
//! | [`camera`] | [`SpotSensor`], any camera that watches the reflected beam |
//! | [`quadrant`] | [`QuadrantSensor`], a split detector on two analog inputs |
//!
//! In: frames or volts. Out: [`FocusReading`](sofiscope_hal::FocusReading)s. Never: has a clock of its own, knows
//! nanometers (the calibration of the focus lock does), invents a reading where none was taken.
//! Fails: [`Timeout`](sofiscope_hal::ErrorKind::Timeout) without a usable frame,
//! [`Lost`](sofiscope_hal::ErrorKind::Lost) when the device is gone.

pub mod camera;
pub mod quadrant;
pub mod spot;

pub use camera::{SpotSensor, SpotSettings};
pub use quadrant::{AnalogInput, QuadrantSensor, QuadrantSettings};
pub use spot::{Measured, SpotFinder, SpotForm, SpotMethod};

use sofiscope_hal::HostTime;

/// The monotonic clock of this computer.
pub type Now = Box<dyn Fn() -> HostTime + Send>;
