//! The simulated pulse generator that both cameras listen to.
//!
//! In: period and number of pulses. Out: exposures of all cameras armed with an external trigger.
//! Fails: [`ErrorKind::Busy`] while a train runs, [`ErrorKind::OutOfRange`] for periods it cannot make.

use std::sync::Arc;
use std::time::Duration;

use sofiscope_hal::{DeviceError, ErrorKind, TriggerSource};

use super::schedule::Timing;

const NAME: &str = "trigger (simulated)";
const SHORTEST: Duration = Duration::from_micros(1);
const LONGEST: Duration = Duration::from_secs(3600);

/// The simulated pulse generator.
#[derive(Debug)]
pub struct SimulatedTrigger {
    timing: Arc<Timing>,
}

impl SimulatedTrigger {
    pub(super) fn new(timing: Arc<Timing>) -> Self {
        Self { timing }
    }
}

impl TriggerSource for SimulatedTrigger {
    fn start(&mut self, period: Duration, pulses: Option<u64>) -> Result<(), DeviceError> {
        if !(SHORTEST..=LONGEST).contains(&period) {
            let message = format!("a period of {period:?} is outside {SHORTEST:?} to {LONGEST:?}");
            return Err(DeviceError::new(ErrorKind::OutOfRange, NAME, message));
        }
        if self.timing.start(period, pulses) {
            Ok(())
        } else {
            Err(DeviceError::new(ErrorKind::Busy, NAME, "a train of pulses is running; stop it first"))
        }
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.timing.stop();
        Ok(())
    }
}
