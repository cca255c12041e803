//! One exchange at a time, in step with the laser, or none.
//!
//! In: commands, and what their answers look like. Out: what was answered. Never: takes an answer for one that may
//! belong to the question before: no two exchanges of the same shape follow each other, so that an answer that
//! lags has the wrong shape. Fails: [`Trouble`]; three answers that are none make the laser dark.
//!
//! Lasers that are asked too soon answer with the text before "from then on" (python-microscope, pyLabLib).

use std::time::Duration;

use sofiscope_hal::{DeviceError, ErrorKind};
use sofiscope_serial_line::{Line, LineError};

use crate::reply::{self, Reply};
use crate::{CHANNELS_OFF, MASTER_OFF};

/// Rest between two commands; sooner, its answers begin to lag.
pub(crate) const GAP: Duration = Duration::from_millis(50);
/// Time in which an answer comes.
const PATIENCE: Duration = Duration::from_millis(1000);
/// The same where darkness must be known soon.
const SHORT_PATIENCE: Duration = Duration::from_millis(300);
/// Answers that are none, before the laser is made dark.
const STRIKES: usize = 3;
/// Attempts to get into step when a person waits for it.
const ATTEMPTS: usize = 5;
/// Pause between them.
const PAUSE: Duration = Duration::from_millis(500);
/// Silence of a reboot, at most.
const REBOOT: Duration = Duration::from_secs(8);

/// What an answer looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shape {
    /// No text.
    Taken,
    /// `ON` or `OFF`.
    Switch,
    /// The serial number.
    Serial,
    /// Set levels.
    Levels,
    /// Measured power.
    Power,
    /// Limits of the satellite board.
    Limits,
    /// Anything else: may be the answer to anything.
    Text,
}

/// Why there is no answer.
#[derive(Debug)]
pub(crate) enum Trouble {
    /// It refuses.
    Refused(String),
    /// What came is no answer, or nothing came.
    Garbled { kind: ErrorKind, told: String },
    /// The line is gone.
    Lost(LineError),
}

/// How long to try.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Haste {
    /// Until it works, with a reboot if nothing else does: at start and before light.
    Thorough,
    /// Three strikes.
    Usual,
    /// Darkness must be known within a second.
    Urgent,
}

/// The line to one laser.
pub(crate) struct Link {
    line: Line,
    /// Serial number that must answer.
    serial: String,
    /// Shape of the exchange before; `None` while out of step.
    last: Option<Shape>,
}

impl Link {
    pub(crate) fn new(line: Line, serial: String) -> Self {
        Self { line, serial, last: None }
    }

    /// The error of this laser.
    pub(crate) fn fault(&self, kind: ErrorKind, message: String) -> DeviceError {
        DeviceError::new(kind, self.line.device(), message)
    }

    /// Sends the bytes of darkness; the rest between them, and after them for whoever does it again at once, keeps
    /// the laser in step, and it is dark already.
    pub(crate) fn make_dark(&mut self) -> Result<(), LineError> {
        self.last = None;
        let first = self.line.send(CHANNELS_OFF);
        // Whatever comes meanwhile belongs to nobody, and a line that is gone is told by `send`.
        let _ignored = self.line.drain(GAP, GAP);
        let second = self.line.send(MASTER_OFF);
        let _ignored = self.line.drain(GAP, GAP);
        first.and(second)
    }

    /// Leaves it as other programs expect it: TOPAS before 1.4 waits for the prompt.
    pub(crate) fn take_leave(&mut self) {
        let _ignored = self.line.drain(GAP, GAP);
        let _gone = self.line.send(b"prompt on\r\n");
        self.last = None;
    }

    /// A command that is answered without text.
    pub(crate) fn set(&mut self, command: &str, haste: Haste) -> Result<(), DeviceError> {
        self.ask(command, Shape::Taken, haste, |texts| texts.is_empty().then_some(()))
    }

    /// A question whose answer `read` understands.
    pub(crate) fn ask<T>(
        &mut self,
        command: &str,
        shape: Shape,
        haste: Haste,
        read: impl Fn(&[String]) -> Option<T>,
    ) -> Result<T, DeviceError> {
        let mut last_trouble = None;
        for _strike in 0..if haste == Haste::Urgent { 1 } else { STRIKES } {
            match self.try_once(command, shape, haste, &read) {
                Ok(answer) => return Ok(answer),
                Err(Trouble::Refused(text)) => {
                    self.last = None;
                    return Err(self.fault(ErrorKind::Fault, format!("refuses '{command}': {text}")));
                }
                Err(Trouble::Lost(error)) => {
                    self.last = None;
                    return Err(self.line.error(&error, command));
                }
                Err(Trouble::Garbled { kind, told }) => {
                    self.last = None;
                    last_trouble = Some((kind, told));
                }
            }
        }
        let dark = if self.make_dark().is_ok() { "it was told to be dark" } else { "it cannot be reached" };
        let (kind, told) = last_trouble.unwrap_or((ErrorKind::Timeout, "no answer".to_owned()));
        Err(self
            .fault(kind, format!("'{command}': {told}; {dark}; check its emission light, cable and power")))
    }

    /// The serial number that answers, whichever it is, once the laser is in step; for the first contact.
    pub(crate) fn first_contact(&mut self) -> Result<String, DeviceError> {
        let mut seen = Vec::new();
        for attempt in 0..ATTEMPTS {
            if attempt > 0 {
                seen.extend(
                    self.line.drain(PAUSE, PAUSE).map_err(|error| self.line.error(&error, "waiting"))?,
                );
            }
            match self.greet(PATIENCE, &mut seen) {
                Ok(serial) => return Ok(serial),
                Err(Trouble::Lost(error)) => return Err(self.line.error(&error, "first contact")),
                Err(_) => {}
            }
        }
        // Only what behaves like an iBEAM is told to reboot: nobody knows what this means to another device.
        let talks = |mark: &[u8]| seen.windows(mark.len()).any(|part| part == mark);
        if talks(b"[OK]") || talks(b"CMD> ") || talks(b"iBEAM") {
            return self.reboot().map_err(|trouble| self.told(trouble, "first contact after a reboot"));
        }
        let message = "does not answer like an iBEAM smart; check port, baud rate (115200) and power";
        Err(self.fault(ErrorKind::Protocol, message.to_owned()))
    }

    /// The same, with an error for the caller.
    pub(crate) fn dark(&mut self) -> Result<(), DeviceError> {
        self.make_dark().map_err(|error| self.line.error(&error, "making it dark"))
    }

    /// Reboots it and asks who it is.
    pub(crate) fn restart(&mut self) -> Result<(), DeviceError> {
        let found = self.reboot().map_err(|trouble| self.told(trouble, "reboot"))?;
        self.is_the_one(&found).map_err(|trouble| self.told(trouble, "after a reboot"))
    }

    fn told(&self, trouble: Trouble, doing: &str) -> DeviceError {
        match trouble {
            Trouble::Lost(error) => self.line.error(&error, doing),
            Trouble::Refused(text) => self.fault(ErrorKind::Fault, format!("{doing}: refused with {text}")),
            Trouble::Garbled { kind, told } => {
                self.fault(kind, format!("{doing}: {told}; switch the laser off and on by its key"))
            }
        }
    }

    fn try_once<T>(
        &mut self,
        command: &str,
        shape: Shape,
        haste: Haste,
        read: &impl Fn(&[String]) -> Option<T>,
    ) -> Result<T, Trouble> {
        let patience = if haste == Haste::Urgent { SHORT_PATIENCE } else { PATIENCE };
        if self.last.is_none() {
            self.get_into_step(haste, patience)?;
        } else if self.last == Some(shape) || shape == Shape::Text {
            self.ask_who(patience)?;
        }
        let answer = self.exchange(command, patience, read)?;
        self.last = Some(shape);
        if shape == Shape::Text {
            self.ask_who(patience)?;
        }
        Ok(answer)
    }

    fn get_into_step(&mut self, haste: Haste, patience: Duration) -> Result<(), Trouble> {
        let mut seen = Vec::new();
        let found = match (self.greet(patience, &mut seen), haste) {
            (Err(Trouble::Garbled { .. }), Haste::Thorough) => self.reboot()?,
            (found, _) => found?,
        };
        self.is_the_one(&found)
    }

    /// Switches echo and prompt off, in whatever format that is answered, and asks for the serial number.
    fn greet(&mut self, patience: Duration, seen: &mut Vec<u8>) -> Result<String, Trouble> {
        for command in ["echo off\r\n", "prom off\r\n"] {
            seen.extend(self.line.drain(GAP, 4 * GAP).map_err(Trouble::Lost)?);
            self.line.send(command.as_bytes()).map_err(Trouble::Lost)?;
        }
        seen.extend(self.line.drain(GAP, 4 * GAP).map_err(Trouble::Lost)?);
        self.exchange("talk usual", patience, |texts| texts.is_empty().then_some(()))?;
        let serial = self.exchange("serial", patience, reply::serial)?;
        self.last = Some(Shape::Serial);
        Ok(serial)
    }

    /// The only cure for answers that lag for good (manual); makes it dark on the way.
    fn reboot(&mut self) -> Result<String, Trouble> {
        self.make_dark().map_err(Trouble::Lost)?;
        self.line.drain(GAP, 4 * GAP).map_err(Trouble::Lost)?;
        self.line.send(b"reset system\r\n").map_err(Trouble::Lost)?;
        self.line.drain(REBOOT, 2 * REBOOT).map_err(Trouble::Lost)?;
        self.line.drain(PAUSE, PAUSE).map_err(Trouble::Lost)?;
        self.greet(PATIENCE, &mut Vec::new())
    }

    fn ask_who(&mut self, patience: Duration) -> Result<(), Trouble> {
        if self.last == Some(Shape::Serial) {
            return Ok(());
        }
        let found = self.exchange("serial", patience, reply::serial)?;
        self.last = Some(Shape::Serial);
        self.is_the_one(&found)
    }

    fn is_the_one(&mut self, found: &str) -> Result<(), Trouble> {
        if found == self.serial {
            return Ok(());
        }
        let told = format!("serial number {found} answers where {} did", self.serial);
        Err(Trouble::Garbled { kind: ErrorKind::Identity, told })
    }

    /// Forgets what nobody asked for, asks, rests and understands.
    fn exchange<T>(
        &mut self,
        command: &str,
        patience: Duration,
        read: impl Fn(&[String]) -> Option<T>,
    ) -> Result<T, Trouble> {
        self.line.forget_received().map_err(Trouble::Lost)?;
        self.line.send(format!("{command}\r\n").as_bytes()).map_err(Trouble::Lost)?;
        let bytes = match self.line.receive_when(patience, reply::end) {
            Ok(bytes) => bytes,
            Err(error @ LineError::Lost(_)) => return Err(Trouble::Lost(error)),
            Err(error) => return Err(Trouble::Garbled { kind: ErrorKind::Timeout, told: error.to_string() }),
        };
        // The rest comes after the answer, so that the way to darkness is free at any time.
        let more = self.line.drain(GAP, 4 * GAP).map_err(Trouble::Lost)?;
        if !more.is_empty() {
            return Err(garbled(&[bytes, more].concat()));
        }
        match reply::parse(&bytes) {
            Some(Reply::Refused(text)) => Err(Trouble::Refused(text)),
            Some(Reply::Texts(texts)) if read(&texts).is_some() => {
                read(&texts).ok_or_else(|| garbled(&bytes))
            }
            _ => Err(garbled(&bytes)),
        }
    }
}

fn garbled(bytes: &[u8]) -> Trouble {
    let told = format!("{} is no answer to this", sofiscope_serial_line::line::shown(bytes));
    Trouble::Garbled { kind: ErrorKind::Protocol, told }
}
