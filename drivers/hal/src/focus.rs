//! Focus: the drive that moves objective or sample along the optical axis, and the sensor that sees the error.

use crate::{DeviceError, DeviceIdentity, HostTime, Nanometers, Properties};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::time::Duration;

/// Which way brings the objective closer to the sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Toward {
    /// A larger z is closer to the sample.
    Up,
    /// A smaller z is closer to the sample.
    Down,
}

/// A drive along the optical axis: the piezo.
pub trait FocusDrive: Properties + Send {
    /// Which drive this is.
    fn identity(&self) -> &DeviceIdentity;

    /// Where it may go: the limits of the configuration within those of the device.
    fn range(&self) -> RangeInclusive<Nanometers>;

    /// Where it is, measured.
    ///
    /// # Errors
    /// Whatever the device says.
    fn position(&mut self) -> Result<Nanometers, DeviceError>;

    /// Sets where it shall be; returns before it is there.
    ///
    /// # Errors
    /// [`OutOfRange`](crate::ErrorKind::OutOfRange) outside the range: refused, not clipped, nothing is sent.
    fn move_to(&mut self, target: Nanometers) -> Result<(), DeviceError>;

    /// Holds it where it is; holding twice is no error.
    ///
    /// # Errors
    /// Whatever the device says.
    fn hold(&mut self) -> Result<(), DeviceError> {
        let here = self.position()?;
        let range = self.range();
        self.move_to(if here < *range.start() {
            *range.start()
        } else if here > *range.end() {
            *range.end()
        } else {
            here
        })
    }
}

/// What the sensor saw, with all that is needed to trust it or not.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FocusReading {
    /// Counts the readings of the sensor; the same number twice is the same reading.
    pub number: u64,
    /// When it was taken.
    pub at: HostTime,
    /// The signal that changes with focus: position, distance or difference, in units of the sensor
    /// (pixels of a spot camera, ratio of a quadrant detector).
    pub signal: f64,
    /// Light on the sensor, in units of the sensor, background taken off.
    pub light: f64,
    /// Share of the sensor's spot that is saturated, 0 to 1.
    pub saturated: f64,
    /// How well the spot looked like one, 0 (nothing) to 1.
    pub shape: f64,
}

/// A sensor of the focus error.
pub trait FocusSensor: Send {
    /// Which sensor this is.
    fn identity(&self) -> &DeviceIdentity;

    /// Waits for the next reading.
    ///
    /// # Errors
    /// [`Timeout`](crate::ErrorKind::Timeout) when none came in time, [`Lost`](crate::ErrorKind::Lost).
    fn read(&mut self, timeout: Duration) -> Result<FocusReading, DeviceError>;
}
