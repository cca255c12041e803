//! What starts the exposures of all cameras together.

use crate::DeviceError;
use std::time::Duration;

/// A source of trigger pulses that every camera receives.
pub trait TriggerSource: Send {
    /// Begins a train of pulses, `period` apart; `pulses` of them, or until stopped.
    ///
    /// # Errors
    /// [`Busy`](crate::ErrorKind::Busy) while a train runs, [`OutOfRange`](crate::ErrorKind::OutOfRange) for
    /// periods that the source cannot make.
    fn start(&mut self, period: Duration, pulses: Option<u64>) -> Result<(), DeviceError>;

    /// Ends the train; stopping twice is no error.
    ///
    /// # Errors
    /// Whatever the source says; pulses may then go on.
    fn stop(&mut self) -> Result<(), DeviceError>;
}
