//! One question, one answer; what to do when it is not that.
//!
//! Set commands are answered by nothing, so each is followed by `?err`. Reading an error does not always clear it
//! (`!err` does), so an old one is cleared before the next command, and what is found after it belongs to it.
//!
//! After a missing or wrong answer the line is out of step: a late answer may still come. It is brought back by a
//! question whose answer looks like no other, `?version`; whatever stands before that answer is old.

use std::time::Duration;

use sofiscope_hal::{DeviceError, ErrorKind};
use sofiscope_serial_line::{Line, LineError};

use crate::{codes, reply};

/// Time for an answer, as the maker's own library has it.
const ANSWER_WITHIN: Duration = Duration::from_millis(1500);
/// The same for `?err`.
const ERROR_WITHIN: Duration = Duration::from_millis(1000);
/// Quiet after which a lone CR has been taken.
const QUIET: Duration = Duration::from_millis(10);
/// Longest wait for that quiet.
const QUIET_AT_MOST: Duration = Duration::from_millis(200);
/// How often something is read before that is given up; nothing else is ever repeated.
const TRIES: usize = 3;
/// Lines that may stand before an answer.
const LINES_BETWEEN: usize = 32;

pub(crate) struct Dialog {
    line: Line,
    is_out_of_step: bool,
    is_talked_to: bool,
}

impl Dialog {
    pub(crate) fn new(line: Line) -> Self {
        Self { line, is_out_of_step: false, is_talked_to: false }
    }

    pub(crate) fn device(&self) -> &str {
        self.line.device()
    }

    /// A handle that only sends.
    pub(crate) fn sender(&self) -> Result<Box<dyn std::io::Write + Send>, DeviceError> {
        self.line.sender().map_err(|error| self.line.error(&error, "opening a way for STOP"))
    }

    /// Says hello and asks who is there, without changing anything: it may be another device.
    pub(crate) fn greet(&mut self) -> Result<String, DeviceError> {
        let mut tries = TRIES;
        loop {
            self.discard_half_commands()?;
            let version = self.ask_once("?version", "its version", ANSWER_WITHIN, &reply::text);
            tries -= 1;
            match version {
                Err(error) if tries > 0 && error.kind() != ErrorKind::Lost => {}
                version => {
                    self.is_out_of_step = false;
                    return version;
                }
            }
        }
    }

    /// Reads something; asked again when the answer is missing or is none.
    pub(crate) fn ask<T>(
        &mut self,
        question: &str,
        expected: &str,
        read: impl Fn(&[u8]) -> Option<T>,
    ) -> Result<T, DeviceError> {
        let within = if question == "?err" { ERROR_WITHIN } else { ANSWER_WITHIN };
        let mut tries = TRIES;
        loop {
            self.come_in_step()?;
            let answer = self.ask_once(question, expected, within, &read);
            tries -= 1;
            match answer {
                Err(error) if tries > 0 && error.kind() != ErrorKind::Lost => {}
                answer => return answer,
            }
        }
    }

    /// Sets something, once; asks whether it was taken.
    pub(crate) fn tell(&mut self, command: &str) -> Result<(), DeviceError> {
        self.clear_errors(command)?;
        self.send(command)?;
        self.accepted(command)
    }

    /// Sees to it that an error found later belongs to `command`.
    pub(crate) fn clear_errors(&mut self, command: &str) -> Result<(), DeviceError> {
        if self.error_code()? == 0 {
            return Ok(());
        }
        self.send("!err")?;
        match self.error_code()? {
            0 => Ok(()),
            lasting => Err(codes::refusal(self.device(), command, lasting)),
        }
    }

    /// Whether the controller has taken `command`.
    pub(crate) fn accepted(&mut self, command: &str) -> Result<(), DeviceError> {
        let code = self.error_code()?;
        if code == 0 {
            return Ok(());
        }
        self.send("!err")?;
        Err(codes::refusal(self.device(), command, code))
    }

    /// The code of the newest error.
    pub(crate) fn error_code(&mut self) -> Result<u16, DeviceError> {
        self.ask("?err", "an error code", reply::error_code)
    }

    /// Sends a command, in one piece.
    pub(crate) fn send(&mut self, command: &str) -> Result<(), DeviceError> {
        let sent = self.line.send(format!("{command}\r").as_bytes());
        sent.map_err(|error| self.failed(&error, command))
    }

    fn ask_once<T>(
        &mut self,
        question: &str,
        expected: &str,
        within: Duration,
        read: &impl Fn(&[u8]) -> Option<T>,
    ) -> Result<T, DeviceError> {
        self.line.forget_received().map_err(|error| self.line.error(&error, question))?;
        self.send(question)?;
        for _ in 0..LINES_BETWEEN {
            let answer = self.line.receive_until(b"\r", within);
            let answer = answer.map_err(|error| self.failed(&error, question))?;
            if reply::is_autostatus(&answer) {
                self.is_talked_to = true;
                continue;
            }
            if let Some(value) = read(&answer) {
                return Ok(value);
            }
            self.is_out_of_step = true;
            return Err(self.line.unexpected(question, expected, &answer));
        }
        self.is_out_of_step = true;
        Err(self.line.unexpected(question, expected, b"autostatus without end"))
    }

    fn come_in_step(&mut self) -> Result<(), DeviceError> {
        if self.is_out_of_step {
            self.discard_half_commands()?;
            self.send("!autostatus 0")?;
            self.send("?version")?;
            self.skip_to_version()?;
            self.is_out_of_step = false;
        }
        if std::mem::take(&mut self.is_talked_to) {
            self.send("!autostatus 0")?;
        }
        Ok(())
    }

    fn skip_to_version(&mut self) -> Result<(), DeviceError> {
        for _ in 0..LINES_BETWEEN {
            let answer = self.line.receive_until(b"\r", ANSWER_WITHIN);
            let answer = answer.map_err(|error| self.failed(&error, "?version"))?;
            if answer.windows(5).any(|part| part == b"TANGO") {
                return Ok(());
            }
        }
        Err(self.line.unexpected("?version", "TANGO", b"many other lines"))
    }

    fn discard_half_commands(&mut self) -> Result<(), DeviceError> {
        self.send("")?;
        let drained = self.line.drain(QUIET, QUIET_AT_MOST);
        drained.map(drop).map_err(|error| self.failed(&error, "an empty command"))
    }

    fn failed(&mut self, error: &LineError, doing: &str) -> DeviceError {
        self.is_out_of_step = true;
        self.line.error(error, &format!("'{doing}'"))
    }
}
