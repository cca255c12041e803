//! The motorized stage that carries the sample.
//!
//! Motion is started and then watched: no call waits for the end of a move, so that the thread that owns the
//! stage is never away when STOP comes. STOP itself has a way of its own, [`StopMotion`], past every queue.

use crate::{DeviceError, DeviceIdentity, Micrometers, Properties};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// A place of the stage.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StagePoint {
    /// Along the long side.
    pub x: Micrometers,
    /// Along the short side.
    pub y: Micrometers,
}

/// Where the stage may go.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageEnvelope {
    /// Allowed x.
    pub x: RangeInclusive<Micrometers>,
    /// Allowed y.
    pub y: RangeInclusive<Micrometers>,
}

impl StageEnvelope {
    /// Whether a place lies inside.
    #[must_use]
    pub fn contains(&self, point: StagePoint) -> bool {
        self.x.contains(&point.x) && self.y.contains(&point.y)
    }
}

/// What the stage is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Motion {
    /// Standing, ready for a move.
    Still,
    /// Moving, by a command of ours.
    Moving,
    /// A person moves it by hand or joystick.
    ByHand,
    /// Its place is not known: never homed, contact lost during a move, or a move that failed.
    Unknown,
}

/// Ends all motion at once, from any thread, past every queue; STOP on the wire within 20 ms.
pub trait StopMotion: Send + Sync {
    /// Sends STOP.
    ///
    /// # Errors
    /// When STOP could not be sent; the stage is then to be taken as moving.
    fn stop_motion(&self) -> Result<(), DeviceError>;
}

/// A motorized stage.
pub trait Stage: Properties + Send {
    /// Which stage this is.
    fn identity(&self) -> &DeviceIdentity;

    /// Where it may go: the limits of the configuration within those of the device.
    fn envelope(&self) -> &StageEnvelope;

    /// Where it is, read from the device.
    ///
    /// # Errors
    /// Whatever the device says.
    fn position(&mut self) -> Result<StagePoint, DeviceError>;

    /// Begins a move; a move that is under way is replaced.
    ///
    /// # Errors
    /// [`OutOfRange`](crate::ErrorKind::OutOfRange) outside the envelope: refused, not clipped, and no byte is
    /// sent. [`Busy`](crate::ErrorKind::Busy) while a person moves it.
    fn move_to(&mut self, target: StagePoint) -> Result<(), DeviceError>;

    /// What it is doing.
    ///
    /// # Errors
    /// [`Fault`](crate::ErrorKind::Fault) when the device reports one: limit switch, timeout, aborted move.
    fn motion(&mut self) -> Result<Motion, DeviceError>;

    /// A handle that stops it from anywhere.
    fn stopper(&self) -> Box<dyn StopMotion>;

    /// Begins the search for its end switches, which defines where it is. An explicit act of a person: the
    /// whole travel is crossed.
    ///
    /// # Errors
    /// Whatever the device says.
    fn begin_homing(&mut self) -> Result<(), DeviceError>;
}
