//! One exchange at a time, in step with the laser, or none.
//!
//! In: commands, and what their answers look like. Out: what was answered. Never: takes a late answer for the next
//! one: no two exchanges of the same shape follow each other, so that an answer too many has the wrong shape.
//! Fails: [`Trouble`]; three answers that are none make the laser dark.

use std::time::Duration;

use sofiscope_hal::{DeviceError, ErrorKind};
use sofiscope_serial_line::{Line, LineError};

use crate::DARK;
use crate::reply::{self, Reply};

/// Rest between two commands.
const GAP: Duration = Duration::from_millis(100);
/// Silence after which nothing more of an answer comes.
const QUIET: Duration = Duration::from_millis(200);
/// Time in which an answer comes.
const PATIENCE: Duration = Duration::from_millis(1000);
/// The same where darkness must be known soon.
const SHORT_PATIENCE: Duration = Duration::from_millis(300);
/// Answers that are none, before the laser is made dark.
const STRIKES: usize = 3;

/// What an answer looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shape {
    /// An empty line.
    Taken,
    /// `ENABLED` or `DISABLED`.
    Status,
    /// A power.
    Power,
    /// Model and version.
    Version,
    /// Anything else: may be the answer to anything.
    Text,
}

/// Why there is no answer.
#[derive(Debug)]
pub(crate) enum Trouble {
    Refused(u32),
    Garbled { kind: ErrorKind, told: String },
    Lost(LineError),
}

/// How long to try.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Haste {
    /// Three strikes.
    Usual,
    /// Darkness must be known within a second.
    Urgent,
}

/// The line to one laser.
pub(crate) struct Link {
    line: Line,
    /// Version that must answer; whichever says SMD12 at the first contact.
    version: Option<String>,
    /// Shape of the exchange before; `None` while out of step.
    last: Option<Shape>,
}

impl Link {
    pub(crate) fn new(line: Line) -> Self {
        Self { line, version: None, last: None }
    }

    /// The error of this laser.
    pub(crate) fn fault(&self, kind: ErrorKind, message: String) -> DeviceError {
        DeviceError::new(kind, self.line.device(), message)
    }

    /// The version that answers, whichever it is.
    pub(crate) fn first_contact(&mut self) -> Result<String, DeviceError> {
        let version = self.ask("VERSION?", Shape::Version, Haste::Usual, reply::version)?;
        self.version = Some(version.clone());
        Ok(version)
    }

    /// Sends the bytes of darkness, and reads nothing.
    pub(crate) fn make_dark(&mut self) -> Result<(), DeviceError> {
        self.last = None;
        self.line.send(DARK).map_err(|error| self.line.error(&error, "making it dark"))
    }

    /// Sends OFF before anything else; whether it was obeyed is for the status to tell.
    pub(crate) fn off_at_once(&mut self) -> Result<(), DeviceError> {
        if self.last.is_none() {
            return self.make_dark();
        }
        match self.exchange("OFF", SHORT_PATIENCE, reply::taken) {
            Ok(()) => {
                self.last = Some(Shape::Taken);
                Ok(())
            }
            Err(Trouble::Lost(error)) => Err(self.line.error(&error, "OFF")),
            // Once more, and in any case: the status is asked for after getting into step.
            Err(_) => self.make_dark(),
        }
    }

    /// A command that is answered with an empty line.
    pub(crate) fn set(&mut self, command: &str, haste: Haste) -> Result<(), DeviceError> {
        self.ask(command, Shape::Taken, haste, reply::taken)
    }

    /// A question whose answer `read` understands.
    pub(crate) fn ask<T>(
        &mut self,
        command: &str,
        shape: Shape,
        haste: Haste,
        read: impl Fn(&str) -> Option<T>,
    ) -> Result<T, DeviceError> {
        let mut last_trouble = None;
        for _strike in 0..if haste == Haste::Urgent { 1 } else { STRIKES } {
            match self.try_once(command, shape, haste, &read) {
                Ok(answer) => return Ok(answer),
                Err(Trouble::Refused(number)) => {
                    self.last = None;
                    let told =
                        format!("refuses '{command}' with error {number}; see the manual of the supply");
                    return Err(self.fault(ErrorKind::Fault, told));
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
        let known = self.version.is_some();
        let dark = match known.then(|| self.make_dark()) {
            Some(Ok(())) => "it was told to be dark",
            Some(Err(_)) => "it cannot be reached",
            None => "nothing was switched",
        };
        let (kind, told) = last_trouble.unwrap_or((ErrorKind::Timeout, "no answer".to_owned()));
        Err(self
            .fault(kind, format!("'{command}': {told}; {dark}; check its emission light, cable and power")))
    }

    /// The hour meters: three lines and, on most supplies, an empty one that must not become the next answer.
    pub(crate) fn timers(&mut self) -> Result<Vec<String>, DeviceError> {
        let first = self.ask("TIMERS?", Shape::Text, Haste::Usual, reply::something)?;
        Ok(first.split('\n').map(str::to_owned).collect())
    }

    fn try_once<T>(
        &mut self,
        command: &str,
        shape: Shape,
        haste: Haste,
        read: &impl Fn(&str) -> Option<T>,
    ) -> Result<T, Trouble> {
        let patience = if haste == Haste::Urgent { SHORT_PATIENCE } else { PATIENCE };
        if self.last.is_none() {
            self.get_into_step(patience)?;
        } else if self.last == Some(shape) || shape == Shape::Text {
            self.ask_version(patience)?;
        }
        let answer = self.exchange(command, patience, read)?;
        self.last = Some(shape);
        if shape == Shape::Text {
            self.ask_version(patience)?;
        }
        Ok(answer)
    }

    /// Ends what may be half a command, and waits until all late answers have come.
    fn get_into_step(&mut self, patience: Duration) -> Result<(), Trouble> {
        self.line.forget_received().map_err(Trouble::Lost)?;
        self.line.send(b"\r").map_err(Trouble::Lost)?;
        self.line.drain(QUIET, 2 * patience).map_err(Trouble::Lost)?;
        self.ask_version(patience)
    }

    fn ask_version(&mut self, patience: Duration) -> Result<(), Trouble> {
        if self.last == Some(Shape::Version) {
            return Ok(());
        }
        let found = self.exchange("VERSION?", patience, reply::version)?;
        self.last = Some(Shape::Version);
        match &self.version {
            Some(version) if *version != found => {
                let told = format!("{found} answers where {version} did");
                Err(Trouble::Garbled { kind: ErrorKind::Identity, told })
            }
            _ => Ok(()),
        }
    }

    /// Forgets what nobody asked for, asks, rests and understands; several lines are joined by `\n`.
    fn exchange<T>(
        &mut self,
        command: &str,
        patience: Duration,
        read: impl Fn(&str) -> Option<T>,
    ) -> Result<T, Trouble> {
        self.line.forget_received().map_err(Trouble::Lost)?;
        self.line.send(format!("{command}\r").as_bytes()).map_err(Trouble::Lost)?;
        let mut bytes = match self.line.receive_until(b"\r\n", patience) {
            Ok(bytes) => bytes,
            Err(error @ LineError::Lost(_)) => return Err(Trouble::Lost(error)),
            Err(error) => return Err(Trouble::Garbled { kind: ErrorKind::Timeout, told: error.to_string() }),
        };
        let several = command == "TIMERS?";
        let rest = if several { QUIET } else { GAP };
        let more = self.line.drain(rest, 10 * rest).map_err(Trouble::Lost)?;
        if !more.is_empty() {
            bytes.extend(b"\r\n");
            bytes.extend(more);
            if !several {
                return Err(garbled(&bytes));
            }
        }
        understood(&bytes, read)
    }
}

fn understood<T>(bytes: &[u8], read: impl Fn(&str) -> Option<T>) -> Result<T, Trouble> {
    let mut texts = Vec::new();
    for line in bytes.split(|byte| *byte == b'\n') {
        match reply::parse(line.strip_suffix(b"\r").unwrap_or(line)) {
            Some(Reply::Refused(number)) => return Err(Trouble::Refused(number)),
            Some(Reply::Text(text)) => texts.push(text),
            None => return Err(garbled(bytes)),
        }
    }
    read(texts.join("\n").trim_end()).ok_or_else(|| garbled(bytes))
}

fn garbled(bytes: &[u8]) -> Trouble {
    let told = format!("{} is no answer to this", sofiscope_serial_line::line::shown(bytes));
    Trouble::Garbled { kind: ErrorKind::Protocol, told }
}
