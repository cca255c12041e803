//! The trigger controller: digital gates that let laser light through, analog levels, and the clock of the cameras.
//!
//! A gate that nobody holds closes: controllers with a watchdog do that themselves, the others are only accepted
//! together with a guard.

use crate::{DeviceError, DeviceIdentity, Volts};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Which gates are open: bit 0 is the first output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct GatePattern(pub u8);

impl GatePattern {
    /// All gates closed.
    pub const CLOSED: Self = Self(0);

    /// Whether no gate is open.
    #[must_use]
    pub fn is_closed(self) -> bool {
        self == Self::CLOSED
    }

    /// Whether gate `line`, from 0, is open.
    #[must_use]
    pub fn has(self, line: u8) -> bool {
        line < 8 && self.0 & (1 << line) != 0
    }

    /// The same pattern with gate `line` open.
    #[must_use]
    pub fn with(self, line: u8) -> Self {
        Self(self.0 | 1_u8.checked_shl(u32::from(line)).unwrap_or(0))
    }
}

/// What a controller can do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GateCapabilities {
    /// Digital outputs, at most 8.
    pub gates: u8,
    /// Analog outputs.
    pub levels: u8,
    /// Longest pattern sequence that is stepped through by triggers; 0 when there are none.
    pub sequence: u32,
    /// Time after the last heartbeat within which it closes all gates by itself; `None` without a watchdog.
    pub watchdog: Option<Duration>,
    /// Whether each gate has a longest time it stays open.
    pub limits_on_time: bool,
    /// Whether it makes the pulses that start exposures.
    pub makes_triggers: bool,
}

/// Why a controller keeps its gates closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GateTrip {
    /// No heartbeat came in time.
    Watchdog,
    /// A gate was open for longer than it may be.
    OnTime,
    /// The interlock input is open.
    Interlock,
    /// It was told to close for good.
    Commanded,
    /// It has been reset since it was armed.
    Reset,
}

/// What a controller tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct GateState {
    /// Outputs as they really are.
    pub open: GatePattern,
    /// Whether gates may open at all.
    pub armed: bool,
    /// The first reason since it was armed last; stays until a person arms it again.
    pub trip: Option<GateTrip>,
    /// Changes with every reset of the controller: another number means that its settings are gone.
    pub epoch: u32,
}

/// A trigger controller.
pub trait GateController: Send {
    /// Which controller this is.
    fn identity(&self) -> &DeviceIdentity;

    /// What it can do.
    fn capabilities(&self) -> &GateCapabilities;

    /// Lets gates open from now on, as the act of a person; clears a trip whose reason is gone.
    ///
    /// # Errors
    /// [`Fault`](crate::ErrorKind::Fault) while the reason of a trip still holds, such as an open interlock.
    fn arm(&mut self) -> Result<(), DeviceError>;

    /// Closes everything and lets nothing open until armed again; twice is no error.
    ///
    /// # Errors
    /// Any error means that gates are to be taken as open.
    fn disarm(&mut self) -> Result<(), DeviceError>;

    /// Opens exactly these gates.
    ///
    /// # Errors
    /// [`OutOfRange`](crate::ErrorKind::OutOfRange) for gates that are not there,
    /// [`Fault`](crate::ErrorKind::Fault) unless armed.
    fn set_gates(&mut self, open: GatePattern) -> Result<(), DeviceError>;

    /// Sets one analog output.
    ///
    /// # Errors
    /// [`OutOfRange`](crate::ErrorKind::OutOfRange) for outputs and levels that are not there.
    fn set_level(&mut self, output: u8, level: Volts) -> Result<(), DeviceError>;

    /// Loads patterns and steps through them, one per exposure, until stopped.
    ///
    /// # Errors
    /// [`OutOfRange`](crate::ErrorKind::OutOfRange) for sequences that are empty, too long, or of gates that are
    /// not there, [`Fault`](crate::ErrorKind::Fault) unless armed.
    fn begin_sequence(&mut self, patterns: &[GatePattern]) -> Result<(), DeviceError>;

    /// Ends a sequence with all gates closed.
    ///
    /// # Errors
    /// Whatever the controller says; gates are then to be taken as open.
    fn end_sequence(&mut self) -> Result<(), DeviceError>;

    /// Says that somebody is still there; does nothing on controllers without a watchdog.
    ///
    /// # Errors
    /// Whatever the controller says.
    fn heartbeat(&mut self) -> Result<(), DeviceError>;

    /// What it tells.
    ///
    /// # Errors
    /// Whatever the controller says; gates are then to be taken as open.
    fn state(&mut self) -> Result<GateState, DeviceError>;
}
