//! Commands and their answers.

use std::io;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

use sofiscope_hal::{DeviceError, ErrorKind};

use crate::port::{LineSettings, Port};

/// Longest answer that is taken for one.
const LONGEST_ANSWER: usize = 4096;

/// What went wrong on the line.
#[derive(Debug, thiserror::Error)]
pub enum LineError {
    /// The answer did not come, or not to its end; what had come is given.
    #[error("no complete answer within {} ms; received {}", within.as_millis(), shown(received))]
    Timeout {
        /// The time that was given.
        within: Duration,
        /// What had come.
        received: Vec<u8>,
    },
    /// More bytes than any answer has.
    #[error("{LONGEST_ANSWER} bytes without an end, beginning with {}", shown(received))]
    Endless {
        /// The first of them.
        received: Vec<u8>,
    },
    /// The line is gone.
    #[error("the line is gone ({0})")]
    Lost(#[source] io::Error),
}

/// Bytes as a person can read them.
#[must_use]
pub fn shown(bytes: &[u8]) -> String {
    if bytes.is_empty() { "nothing".to_owned() } else { format!("\"{}\"", bytes.escape_ascii()) }
}

/// One end of a line with the name of the device at the other end; owned by one thread.
pub struct Line {
    port: Box<dyn Port>,
    device: String,
    received: Vec<u8>,
}

impl Line {
    /// A line to a device.
    pub fn new(port: Box<dyn Port>, device: impl Into<String>) -> Self {
        Self { port, device: device.into(), received: Vec::new() }
    }

    /// Opens the port at `path`.
    ///
    /// # Errors
    /// [`Lost`](ErrorKind::Lost) with the reason and what to do.
    pub fn open(path: &Path, settings: LineSettings, device: impl Into<String>) -> Result<Self, DeviceError> {
        let device = device.into();
        match crate::port::open(path, settings) {
            Ok(port) => Ok(Self::new(port, device)),
            Err(error) => Err(DeviceError::new(ErrorKind::Lost, device, error.to_string())),
        }
    }

    /// Name of the device at the other end.
    #[must_use]
    pub fn device(&self) -> &str {
        &self.device
    }

    /// The same fault in the words of the contracts; `doing` tells what was asked.
    #[must_use]
    pub fn error(&self, error: &LineError, doing: &str) -> DeviceError {
        let (kind, next) = match error {
            LineError::Timeout { .. } => (ErrorKind::Timeout, "check power and cable"),
            LineError::Endless { .. } => (ErrorKind::Protocol, "check baud rate and port"),
            LineError::Lost(_) => (ErrorKind::Lost, "check cable and power, then reconnect"),
        };
        DeviceError::new(kind, &self.device, format!("{doing}: {error}; {next}"))
    }

    /// An answer that the protocol does not allow.
    #[must_use]
    pub fn unexpected(&self, doing: &str, expected: &str, answer: &[u8]) -> DeviceError {
        DeviceError::new(
            ErrorKind::Protocol,
            &self.device,
            format!("{doing}: expected {expected}, received {}", shown(answer)),
        )
    }

    /// Sends bytes.
    ///
    /// # Errors
    /// [`LineError::Lost`].
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), LineError> {
        self.port.send(bytes).map_err(LineError::Lost)
    }

    /// Waits for an answer that ends with `end`; the end is taken off.
    ///
    /// # Errors
    /// [`LineError::Timeout`] with all that had come, which is then forgotten; [`LineError::Endless`], [`LineError::Lost`].
    pub fn receive_until(&mut self, end: &[u8], within: Duration) -> Result<Vec<u8>, LineError> {
        self.receive_when(within, |received| {
            let at = received.windows(end.len()).position(|part| part == end)?;
            Some((at, at + end.len()))
        })
    }

    /// Waits for an answer of exactly `length` bytes.
    ///
    /// # Errors
    /// As [`Self::receive_until`].
    pub fn receive_exactly(&mut self, length: usize, within: Duration) -> Result<Vec<u8>, LineError> {
        self.receive_when(within, |received| (received.len() >= length).then_some((length, length)))
    }

    /// Waits until `end_of` finds an answer in what has come: how much of it is answer, and how much is used up.
    ///
    /// # Errors
    /// As [`Self::receive_until`].
    pub fn receive_when(
        &mut self,
        within: Duration,
        mut end_of: impl FnMut(&[u8]) -> Option<(usize, usize)>,
    ) -> Result<Vec<u8>, LineError> {
        let begun = Instant::now();
        // Time that the port says has passed, for ports whose time is not that of this computer.
        let mut waited = Duration::ZERO;
        loop {
            if let Some((answer, used)) = end_of(&self.received) {
                let mut taken: Vec<u8> = self.received.drain(..used).collect();
                taken.truncate(answer);
                return Ok(taken);
            }
            if self.received.len() > LONGEST_ANSWER {
                let mut received = std::mem::take(&mut self.received);
                received.truncate(64);
                return Err(LineError::Endless { received });
            }
            let left = within.saturating_sub(waited.max(begun.elapsed()));
            if left.is_zero() {
                return Err(LineError::Timeout { within, received: std::mem::take(&mut self.received) });
            }
            if self.take_more(left)? == 0 {
                waited += left;
            }
        }
    }

    /// Reads until nothing has come for `quiet`, or for as long as `at_most`, and returns all of it.
    ///
    /// # Errors
    /// [`LineError::Lost`].
    pub fn drain(&mut self, quiet: Duration, at_most: Duration) -> Result<Vec<u8>, LineError> {
        let begun = Instant::now();
        while begun.elapsed() < at_most && self.received.len() < 16 * LONGEST_ANSWER {
            if self.take_more(quiet)? == 0 {
                break;
            }
        }
        Ok(std::mem::take(&mut self.received))
    }

    /// Forgets everything that came and was not read, such as the late answer to an earlier question.
    ///
    /// # Errors
    /// [`LineError::Lost`].
    pub fn forget_received(&mut self) -> Result<(), LineError> {
        self.received.clear();
        self.port.forget_received().map_err(LineError::Lost)
    }

    /// A second handle that only sends, for STOP.
    ///
    /// # Errors
    /// [`LineError::Lost`] when there is none.
    pub fn sender(&self) -> Result<Box<dyn Write + Send>, LineError> {
        self.port.sender().map_err(LineError::Lost)
    }

    fn take_more(&mut self, within: Duration) -> Result<usize, LineError> {
        let mut bytes = [0; 256];
        let num_bytes = self.port.receive(&mut bytes, within).map_err(LineError::Lost)?;
        self.received.extend_from_slice(&bytes[..num_bytes]);
        Ok(num_bytes)
    }
}
