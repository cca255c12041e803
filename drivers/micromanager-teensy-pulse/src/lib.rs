//! The TeensyPulseGenerator of Micro-Manager, a clock for cameras.
//!
//! In: a period and a number of pulses. Out: frames of five bytes, echoes compared.
//! Never: takes a late or shifted answer for the one it waits for; leaves a train running after it lost the thread.
//! Fails: as the contract of [`TriggerSource`] says.
//!
//! Frames, defaults and quirks were read in the firmware and its host adapter
//! (<https://github.com/micro-manager/mmCoreAndDevices/tree/main/DeviceAdapters/TeensyPulseGenerator>): parameters
//! are little-endian whatever the comment in the firmware says, a finite train ends without a word, and a stray
//! pulse can come before the first start or stop after power-up, so that the driver stops once.

#[cfg(test)]
mod tests;

use std::time::Duration;

use sofiscope_hal::{DeviceError, ErrorKind, TriggerSource};
use sofiscope_serial_line::{Line, LineError, LineSettings};

/// The host adapter of Micro-Manager waits a second.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);
/// The same while frames are being found again: silence is the usual answer then.
const SYNC_WITHIN: Duration = Duration::from_millis(50);
/// Pairs that are sent at most until answers stand by themselves; five would do, were nothing lost.
const SYNC_PAIRS: usize = 12;
const VERSION: u32 = 1;
const ENQUIRY: u8 = 0xFF;

mod command {
    pub(crate) const VERSION: u8 = 0;
    pub(crate) const START: u8 = 1;
    pub(crate) const STOP: u8 = 2;
    pub(crate) const INTERVAL: u8 = 3;
    pub(crate) const WIDTH: u8 = 4;
    pub(crate) const WAIT: u8 = 5;
    pub(crate) const NUMBER: u8 = 6;
}

/// A Teensy with the pulse generator of Micro-Manager.
pub struct TeensyPulse {
    line: Line,
    pulse_width_us: u32,
    /// Pulses that the generator said it had sent when it was stopped last.
    pulses: u32,
}

impl TeensyPulse {
    /// How the port is to be opened; native USB does not care.
    #[must_use]
    pub fn line_settings() -> LineSettings {
        LineSettings::new(115_200)
    }

    /// Finds the generator and stops it.
    ///
    /// # Errors
    /// [`OutOfRange`](ErrorKind::OutOfRange) for a pulse width that it cannot make, [`Timeout`](ErrorKind::Timeout)
    /// when nothing answers, [`Identity`](ErrorKind::Identity) for another version.
    pub fn connect(line: Line, pulse_width: Duration) -> Result<Self, DeviceError> {
        let width = u32::try_from(pulse_width.as_micros()).ok().filter(|width| *width > 0);
        let Some(pulse_width_us) = width else {
            let message = format!("a pulse width of {pulse_width:?}: at least 1 µs, below an hour");
            return Err(DeviceError::new(ErrorKind::OutOfRange, line.device(), message));
        };
        let mut generator = Self { line, pulse_width_us, pulses: 0 };
        generator.resynchronize()?;
        Ok(generator)
    }

    /// Whether a train runs; a finite one ends without a word, so it is asked.
    ///
    /// # Errors
    /// Whatever the line says.
    pub fn is_running(&mut self) -> Result<bool, DeviceError> {
        let enquiry = [ENQUIRY, command::START];
        Ok(self.again(&enquiry, command::START, "asking whether a train runs")? != 0)
    }

    /// Ends the train and tells how many pulses it had.
    ///
    /// # Errors
    /// Whatever the line says; pulses may then go on.
    pub fn stop_and_count(&mut self) -> Result<u32, DeviceError> {
        self.pulses = self.again(&frame(command::STOP, 0), command::STOP, "stopping")?;
        Ok(self.pulses)
    }

    /// Pulses of the train that was stopped last.
    #[must_use]
    pub fn pulses(&self) -> u32 {
        self.pulses
    }

    /// Asks, and once more after finding the frames again; only for what may be asked twice.
    fn again(&mut self, bytes: &[u8], order: u8, doing: &str) -> Result<u32, DeviceError> {
        match self.ask(bytes, order, ANSWER_WITHIN) {
            Ok(value) => Ok(value),
            Err(error @ LineError::Lost(_)) => Err(self.line.error(&error, doing)),
            Err(_) => {
                self.resynchronize()?;
                let answered = self.ask(bytes, order, ANSWER_WITHIN);
                answered.map_err(|error| self.line.error(&error, doing))
            }
        }
    }

    /// Sets a value and compares its echo.
    fn set(&mut self, order: u8, value: u32, doing: &str) -> Result<(), DeviceError> {
        let echo = self.again(&frame(order, value), order, doing)?;
        if echo == value {
            return Ok(());
        }
        let message = format!("{doing}: set {value}, the generator says {echo}; reconnect it");
        Err(self.error(ErrorKind::Fault, &message))
    }

    /// The value in an answer of five bytes that begins with `order`.
    fn ask(&mut self, bytes: &[u8], order: u8, within: Duration) -> Result<u32, LineError> {
        self.line.forget_received()?;
        self.line.send(bytes)?;
        let answer = self.line.receive_exactly(5, within)?;
        match *answer.as_slice() {
            [first, a, b, c, d] if first == order => Ok(u32::from_le_bytes([a, b, c, d])),
            _ => Err(LineError::Timeout { within, received: answer }),
        }
    }

    /// Pairs that are an enquiry, or fill up a frame that was cut, until two enquiries in a row have the version
    /// as their only answer: one alone may have come from a frame that the pair filled up with its first byte.
    /// Then a stop, because what was filled up may have been a start.
    fn resynchronize(&mut self) -> Result<(), DeviceError> {
        let mut in_a_row = 0;
        for _ in 0..SYNC_PAIRS {
            in_a_row = match self.enquire_alone()? {
                Some(VERSION) => in_a_row + 1,
                Some(other) if in_a_row > 0 => {
                    let message = format!("firmware version {other} instead of {VERSION}; flash it again");
                    return Err(self.error(ErrorKind::Identity, &message));
                }
                Some(_) => 1,
                None => 0,
            };
            if in_a_row == 2 {
                let stopped = self.ask(&frame(command::STOP, 0), command::STOP, ANSWER_WITHIN);
                self.pulses = stopped.map_err(|error| self.line.error(&error, "stopping"))?;
                return Ok(());
            }
        }
        let message = format!("{SYNC_PAIRS} times asked for its version, no answer; check cable and port");
        Err(self.error(ErrorKind::Timeout, &message))
    }

    /// The version, if it is all that comes.
    fn enquire_alone(&mut self) -> Result<Option<u32>, DeviceError> {
        let asked = self.ask(&[ENQUIRY, command::VERSION], command::VERSION, SYNC_WITHIN);
        let alone = match asked {
            Ok(version) => {
                self.line.drain(SYNC_WITHIN, 20 * SYNC_WITHIN).map(|rest| rest.is_empty().then_some(version))
            }
            Err(error @ LineError::Lost(_)) => Err(error),
            Err(_) => Ok(None),
        };
        alone.map_err(|error| self.line.error(&error, "looking for the generator"))
    }

    fn error(&self, kind: ErrorKind, message: &str) -> DeviceError {
        DeviceError::new(kind, self.line.device(), message)
    }
}

fn frame(order: u8, value: u32) -> [u8; 5] {
    let [a, b, c, d] = value.to_le_bytes();
    [order, a, b, c, d]
}

impl TriggerSource for TeensyPulse {
    fn start(&mut self, period: Duration, pulses: Option<u64>) -> Result<(), DeviceError> {
        let period_us = u32::try_from((period.as_nanos() + 500) / 1000).ok().filter(|period| *period >= 2);
        let number = pulses.map_or(Ok(0), u32::try_from).ok().filter(|_| pulses != Some(0));
        let (Some(period_us), Some(number)) = (period_us, number) else {
            let message =
                format!("a train of {pulses:?} pulses every {period:?}: at least one, 2 µs to 71 min");
            return Err(self.error(ErrorKind::OutOfRange, &message));
        };
        if self.is_running()? {
            return Err(self.error(ErrorKind::Busy, "starting a train: one runs already; stop it first"));
        }
        self.set(command::WAIT, 0, "waiting for no input")?;
        self.set(command::WIDTH, self.pulse_width_us.min(period_us / 2), "setting the pulse width")?;
        self.set(command::INTERVAL, period_us, "setting the period")?;
        self.set(command::NUMBER, number, "setting the number of pulses")?;
        let started = self.ask(&frame(command::START, 0), command::START, ANSWER_WITHIN);
        match started {
            Ok(_) => Ok(()),
            // Nobody knows whether it started: it is stopped, and the caller decides.
            Err(error) => {
                let error = self.line.error(&error, "starting a train");
                self.resynchronize()?;
                Err(error)
            }
        }
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.stop_and_count().map(drop)
    }
}
