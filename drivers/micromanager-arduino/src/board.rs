//! Bytes to and from the board.
//!
//! In: a command. Out: what follows its echo. Never: repeats a command by itself: nothing tells whether it was done.
//! Fails: `Timeout` for silence, `Protocol` for another echo; then [`Board::resynchronize`].

use std::time::Duration;

use sofiscope_hal::{DeviceError, ErrorKind};
use sofiscope_serial_line::Line;

use crate::command;

/// Time for an answer: the host adapter of Micro-Manager waits 250 ms.
const ANSWER_WITHIN: Duration = Duration::from_millis(250);
/// Opening the port resets an Uno; its boot loader takes up to 2 s.
const BOOT: Duration = Duration::from_millis(2000);
/// The firmware waits up to 1000 ms for each byte that belongs to a command; after more it is at a beginning.
const SILENCE: Duration = Duration::from_millis(1100);
const NAME: &[u8] = b"MM-Ard";
const VERSION: &[u8] = b"5";

pub(crate) struct Board {
    line: Line,
}

impl Board {
    /// Waits until a board that was reset by the opening of its port has booted.
    pub(crate) fn open(line: Line) -> Result<Self, DeviceError> {
        let mut board = Self { line };
        board.quiet(BOOT)?;
        Ok(board)
    }

    /// Sends nothing until the board is at the beginning of a command, whatever it was waiting for.
    pub(crate) fn resynchronize(&mut self) -> Result<(), DeviceError> {
        self.quiet(SILENCE)
    }

    fn quiet(&mut self, time: Duration) -> Result<(), DeviceError> {
        let drained = self.line.drain(time, 4 * time);
        drained.map(drop).map_err(|error| self.line.error(&error, "waiting for silence"))
    }

    /// The name of the board, when it is one; asks once more after a silence.
    pub(crate) fn identify(&mut self) -> Result<String, DeviceError> {
        let name = match self.text(command::IDENTITY, "asking who it is") {
            Err(error) if error.kind() == ErrorKind::Timeout => {
                self.quiet(BOOT)?;
                self.text(command::IDENTITY, "asking who it is")?
            }
            other => other?,
        };
        if !name.starts_with(NAME) {
            let message = format!("\"{}\" instead of \"MM-Ard\"; check the port", name.escape_ascii());
            return Err(self.error(ErrorKind::Identity, &message));
        }
        let version = self.text(command::VERSION, "asking for the protocol version")?;
        if version != VERSION {
            let message =
                format!("protocol {} instead of 5; flash the firmware again", version.escape_ascii());
            return Err(self.error(ErrorKind::Identity, &message));
        }
        Ok(String::from_utf8_lossy(&name).into_owned())
    }

    fn text(&mut self, order: u8, doing: &str) -> Result<Vec<u8>, DeviceError> {
        self.send(&[order], doing)?;
        let answer = self.line.receive_until(b"\r\n", ANSWER_WITHIN);
        answer.map_err(|error| self.line.error(&error, doing))
    }

    /// Sends a command; its first byte comes back, and then the answer.
    pub(crate) fn ask<const SENT: usize, const ANSWER: usize>(
        &mut self,
        order: [u8; SENT],
        doing: &str,
    ) -> Result<[u8; ANSWER], DeviceError> {
        self.ask_echoed(order, &order[..1], doing)
    }

    /// Sends a command; `echo` comes back, and then the answer.
    pub(crate) fn ask_echoed<const SENT: usize, const ANSWER: usize>(
        &mut self,
        order: [u8; SENT],
        echo: &[u8],
        doing: &str,
    ) -> Result<[u8; ANSWER], DeviceError> {
        self.send(&order, doing)?;
        self.receive(echo, doing)
    }

    /// Loads a sequence that is shorter than the memory.
    pub(crate) fn upload(&mut self, patterns: &[u8]) -> Result<(), DeviceError> {
        let doing = "loading patterns";
        let length = u16::try_from(patterns.len());
        let [high, low] = length.map_err(|_| self.error(ErrorKind::OutOfRange, doing))?.to_be_bytes();
        let echo = [command::UPLOAD, high, low];
        self.send(&[&echo, patterns].concat(), doing)?;
        self.receive(&echo, doing).map(|[]| ())
    }

    fn send(&mut self, bytes: &[u8], doing: &str) -> Result<(), DeviceError> {
        let sent = self.line.forget_received().and_then(|()| self.line.send(bytes));
        sent.map_err(|error| self.line.error(&error, doing))
    }

    fn receive<const ANSWER: usize>(
        &mut self,
        echo: &[u8],
        doing: &str,
    ) -> Result<[u8; ANSWER], DeviceError> {
        let received = self.line.receive_exactly(echo.len() + ANSWER, ANSWER_WITHIN);
        let received = received.map_err(|error| self.line.error(&error, doing))?;
        match (received.strip_prefix(echo), received.last_chunk::<ANSWER>()) {
            (Some(_), Some(answer)) => Ok(*answer),
            _ => {
                let expected = format!("the echo \"{}\"", echo.escape_ascii());
                Err(self.line.unexpected(doing, &expected, &received))
            }
        }
    }

    pub(crate) fn error(&self, kind: ErrorKind, message: &str) -> DeviceError {
        DeviceError::new(kind, self.line.device(), message)
    }
}
