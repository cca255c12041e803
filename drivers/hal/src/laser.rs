//! Lasers.
//!
//! Light reaches the sample only while three things hold: the laser emits, its gate is open, and somebody keeps
//! holding it on. A driver does the first; [gates](crate::gate) and guard do the others.

use crate::{DeviceError, DeviceIdentity, Milliwatts, Properties};
use serde::{Deserialize, Serialize};

/// Whether a laser emits, as read back from it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Emission {
    /// It says that it is dark.
    Off,
    /// It says that it emits.
    On,
    /// It could not be asked: to be taken as on.
    UnknownAssumeOn,
}

/// Whether the interlock lets the laser emit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Interlock {
    /// Closed: the laser may emit.
    Closed,
    /// Open: the laser must not emit.
    Open,
    /// The laser has no way to tell.
    NotReported,
}

/// Everything that a laser tells.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LaserState {
    /// Whether it emits.
    pub emission: Emission,
    /// Power that was set, read back.
    pub power_set: Milliwatts,
    /// Power that it measures itself; `None` where it does not. Under a gate this is an average.
    pub power_measured: Option<Milliwatts>,
    /// Interlock or key.
    pub interlock: Interlock,
    /// A fault of its own, as it words it.
    pub fault: Option<String>,
}

/// A laser.
pub trait Laser: Properties + Send {
    /// Which laser this is.
    fn identity(&self) -> &DeviceIdentity;

    /// Wavelength, nanometers.
    fn wavelength_nm(&self) -> u32;

    /// The most that may be asked of it: the cap of the configuration or the laser's own, whichever is less.
    fn power_cap(&self) -> Milliwatts;

    /// Sets the power without touching emission, and reads it back.
    ///
    /// # Errors
    /// [`OutOfRange`](crate::ErrorKind::OutOfRange) below zero or beyond the cap: refused, not clipped, and
    /// no byte is sent. [`Fault`](crate::ErrorKind::Fault) when another power is read back.
    fn set_power(&mut self, power: Milliwatts) -> Result<(), DeviceError>;

    /// Lets it emit, and reads back that it does.
    ///
    /// # Errors
    /// [`Fault`](crate::ErrorKind::Fault) when it stays dark: interlock, key, or a channel that is switched off.
    fn switch_on(&mut self) -> Result<(), DeviceError>;

    /// Makes it dark, and reads back that it is. Twice is no error.
    ///
    /// # Errors
    /// Any error means that it is to be taken as emitting.
    fn switch_off(&mut self) -> Result<(), DeviceError>;

    /// What it tells.
    ///
    /// # Errors
    /// Whatever the device says; it is then to be taken as emitting.
    fn state(&mut self) -> Result<LaserState, DeviceError>;

    /// The shortest way to darkness, without reading anything back: for the paths on which time is short.
    ///
    /// # Errors
    /// When nothing could be sent.
    fn make_dark(&mut self) -> Result<(), DeviceError>;
}
