//! Commands to the board and their answers: numbered, checked, asked again where that is safe.
//!
//! In: a command. Out: the answer to this command and no other. Never: takes a late, foreign or broken answer for
//! the one that it waits for. Fails: `Timeout` after three times, `Lost` without a line.

use std::io::Write;
use std::time::Duration;

use sofiscope_hal::{DeviceError, ErrorKind};
use sofiscope_serial_line::{Line, LineError};

use crate::frame::{self, Content, Greeting, Reply, Report, command, status};

/// How often a command is sent. The board does it once, however often it comes: its number stays the same.
const TRIES: u32 = 3;
/// How long an answer takes at most: 44 characters are 4 ms, a USB converter adds up to 16 ms. Three times this
/// is less than the watchdog.
const ANSWER_WITHIN: Duration = Duration::from_millis(60);
/// An Uno is silent for up to 2 s after its port was opened (Optiboot, and the reset by DTR).
const BOOT: Duration = Duration::from_millis(2200);
/// Lines that are read past while an answer is awaited.
const STRAY_LINES: usize = 16;

pub(crate) struct Link {
    line: Line,
    number: u16,
    /// The epoch that the board had when it was greeted last.
    pub(crate) epoch: u16,
    /// Whether the board knows our numbers.
    is_greeted: bool,
}

impl Link {
    /// Greets the board, patiently: it may be booting.
    pub(crate) fn open(line: Line) -> Result<(Self, Greeting), DeviceError> {
        let mut link = Self { line, number: 0, epoch: 0, is_greeted: false };
        let greeting = match link.greet() {
            Err(error) if error.kind() == ErrorKind::Timeout => {
                link.drain(BOOT)?;
                link.greet()?
            }
            other => other?,
        };
        Ok((link, greeting))
    }

    fn drain(&mut self, quiet: Duration) -> Result<(), DeviceError> {
        let drained = self.line.drain(quiet, 2 * quiet);
        drained.map(drop).map_err(|error| self.line.error(&error, "waiting for the board to boot"))
    }

    /// Says hello; afterwards the board counts from our number.
    pub(crate) fn greet(&mut self) -> Result<Greeting, DeviceError> {
        self.is_greeted = false;
        let reply = self.ask(command::HELLO, &[])?;
        let Content::Greeting(greeting) = reply.content else {
            return Err(self.error(ErrorKind::Protocol, "greeting: the board does not say who it is"));
        };
        self.is_greeted = true;
        self.epoch = reply.epoch;
        Ok(greeting)
    }

    /// Asks, and tells what the board answered: its epoch, a status, and the report of its outputs.
    pub(crate) fn exchange(&mut self, order: u8, payload: &[u8]) -> Result<(u16, u8, Report), DeviceError> {
        for _ in 0..2 {
            if !self.is_greeted {
                let known = self.epoch;
                self.greet()?;
                // Orders of the epoch before are refused by the board; the caller sees that.
                self.epoch = known;
            }
            let reply = self.ask(order, payload)?;
            let Content::Report(report) = reply.content else {
                return Err(self.error(ErrorKind::Protocol, "the board told who it is instead of its state"));
            };
            if reply.status != status::NUMBER {
                return Ok((reply.epoch, reply.status, report));
            }
            // Not done: the board counts otherwise, for example since a command of ours was lost.
            self.is_greeted = false;
        }
        Err(self
            .error(ErrorKind::Protocol, "the board refuses our numbers: does another program use the port?"))
    }

    fn ask(&mut self, order: u8, payload: &[u8]) -> Result<Reply, DeviceError> {
        self.number = self.number.wrapping_add(1);
        let epoch = if order == command::HELLO { 0 } else { self.epoch };
        let bytes = frame::written(self.number, order, epoch, payload);
        let doing = format!("command {order:02X}");
        self.line.forget_received().map_err(|error| self.line.error(&error, &doing))?;
        let mut last = None;
        for _ in 0..TRIES {
            let answered = self.line.send(&bytes).and_then(|()| self.answer(order));
            match answered {
                Ok(Some(reply)) => return Ok(reply),
                Ok(None) => {}
                Err(error @ LineError::Lost(_)) => {
                    self.is_greeted = false;
                    return Err(self.line.error(&error, &doing));
                }
                Err(error) => last = Some(error),
            }
        }
        self.is_greeted = false;
        Err(match last {
            Some(error) => self.line.error(&error, &format!("{doing}, sent {TRIES} times")),
            None => {
                self.error(ErrorKind::Protocol, &format!("{doing}: only foreign lines came; check the port"))
            }
        })
    }

    /// The answer to the command that was sent last; `None` when too much else came.
    fn answer(&mut self, order: u8) -> Result<Option<Reply>, LineError> {
        for _ in 0..STRAY_LINES {
            let line = self.line.receive_until(b"\n", ANSWER_WITHIN)?;
            let reply = frame::read(&line);
            if let Some(reply) = reply.filter(|reply| reply.number == self.number && reply.command == order) {
                return Ok(Some(reply));
            }
        }
        Ok(None)
    }

    pub(crate) fn sender(&self) -> Result<Box<dyn Write + Send>, DeviceError> {
        self.line.sender().map_err(|error| self.line.error(&error, "opening a second handle"))
    }

    pub(crate) fn error(&self, kind: ErrorKind, message: &str) -> DeviceError {
        DeviceError::new(kind, self.line.device(), message)
    }
}
