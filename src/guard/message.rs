//! What goes over the socket between the instrument process and its guard: one line of JSON per message.

use std::collections::BTreeMap;
use std::io;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sofiscope_hal::{DeviceIdentity, ErrorKind, GateState, LaserState};

use super::safety::{Phase, Trip};

/// Longest message; the instrument file is the longest.
const LONGEST: usize = 1 << 20;

/// What the instrument process asks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Request {
    /// The devices, as the text of the instrument file; the first request, and only once.
    Setup(String),
    /// A person arms.
    Arm,
    /// Nothing shall shine until armed again.
    Disarm,
    /// These lines, milliwatts by nanometers, and no others.
    Light(BTreeMap<u32, f64>),
    /// No light.
    Darken,
    /// Pulses for the cameras.
    StartTrain {
        /// Nanoseconds from pulse to pulse.
        period_ns: u64,
        /// How many; `None` until stopped.
        pulses: Option<u64>,
    },
    /// No pulses any more.
    StopTrain,
    /// Progress has been made; another number than last time. Never answered.
    Proof(u64),
    /// What do the devices say?
    State,
}

/// A request with the number under which it is answered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Numbered {
    /// Counts the requests of a client.
    pub number: u64,
    /// The request.
    pub request: Request,
}

/// What one laser and its gate do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LineState {
    /// Which laser.
    pub identity: DeviceIdentity,
    /// Nanometers.
    pub wavelength_nm: u32,
    /// Its gate.
    pub gate: u8,
    /// What it said last; `None` when it could not be asked: to be taken as on.
    pub laser: Option<LaserState>,
}

/// What everything in the guard's hand does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LightsState {
    /// What may shine.
    pub phase: Phase,
    /// Which controller.
    pub controller: DeviceIdentity,
    /// Whether the controller closes its gates by itself when nobody is there.
    pub has_watchdog: bool,
    /// What the controller said last; `None` when it could not be asked: to be taken as open.
    pub gates: Option<GateState>,
    /// The lasers.
    pub lines: Vec<LineState>,
}

/// What the guard answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Answer {
    /// It is done.
    Done,
    /// It is not done, and why.
    Refused {
        /// What the asker can do.
        kind: RefusedKind,
        /// What happened and what to do next.
        message: String,
    },
    /// What the devices say.
    State(Box<LightsState>),
}

/// Kinds of refusal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RefusedKind {
    /// Not armed, or tripped.
    Safety,
    /// The emission indicator has to be on for longer; ask again.
    Indicator,
    /// A line, power or period that is not there.
    OutOfRange,
    /// A device is gone, silent or at fault.
    Device,
}

impl RefusedKind {
    /// The same in the words of the contracts.
    #[must_use]
    pub fn error_kind(self) -> ErrorKind {
        match self {
            Self::Indicator => ErrorKind::Busy,
            Self::OutOfRange => ErrorKind::OutOfRange,
            Self::Safety | Self::Device => ErrorKind::Fault,
        }
    }
}

/// What comes from the guard.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FromGuard {
    /// The answer to a request.
    Answer {
        /// Number of the request.
        number: u64,
        /// The answer.
        answer: Answer,
    },
    /// Everything went dark; said as soon as it happens, whether asked or not.
    Tripped(Trip),
}

/// One end of the socket.
#[derive(Debug)]
pub struct Messages {
    socket: UnixStream,
    received: Vec<u8>,
}

/// What came of waiting for a message.
#[derive(Debug)]
pub enum Received<M> {
    /// A message.
    Message(M),
    /// None yet.
    Nothing,
    /// The other end is gone.
    Gone,
}

impl Messages {
    /// Speaks over `socket`.
    #[must_use]
    pub fn new(socket: UnixStream) -> Self {
        Self { socket, received: Vec::new() }
    }

    /// Sends one message.
    ///
    /// # Errors
    /// When the other end is gone, or has not taken messages for a second.
    pub fn send(&mut self, message: &impl Serialize) -> io::Result<()> {
        let mut line = serde_json::to_vec(message)?;
        line.push(b'\n');
        self.socket.set_write_timeout(Some(Duration::from_secs(1)))?;
        self.socket.write_all(&line)
    }

    /// Waits for a message, at most `within`.
    ///
    /// # Errors
    /// When something came that is no message of this kind.
    pub fn receive<M: DeserializeOwned>(&mut self, within: Duration) -> io::Result<Received<M>> {
        if let Some(message) = self.take()? {
            return Ok(Received::Message(message));
        }
        // A timeout of zero would wait for ever.
        self.socket.set_read_timeout(Some(within.max(Duration::from_millis(1))))?;
        let mut bytes = [0; 4096];
        match self.socket.read(&mut bytes) {
            Ok(0) => Ok(Received::Gone),
            Ok(num_bytes) => {
                self.received.extend_from_slice(&bytes[..num_bytes]);
                Ok(self.take()?.map_or(Received::Nothing, Received::Message))
            }
            Err(error)
                if matches!(
                    error.kind(),
                    io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
                ) =>
            {
                Ok(Received::Nothing)
            }
            Err(_) => Ok(Received::Gone),
        }
    }

    fn take<M: DeserializeOwned>(&mut self) -> io::Result<Option<M>> {
        let Some(end) = self.received.iter().position(|byte| *byte == b'\n') else {
            if self.received.len() > LONGEST {
                return Err(io::Error::other("a message without an end"));
            }
            return Ok(None);
        };
        let line: Vec<u8> = self.received.drain(..=end).collect();
        Ok(Some(serde_json::from_slice(&line)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair() -> (Messages, Messages) {
        let (one, other) = UnixStream::pair().unwrap();
        (Messages::new(one), Messages::new(other))
    }

    #[test]
    fn messages_arrive_as_they_were_sent() {
        let (mut client, mut guard) = pair();
        let requests = [
            Request::Setup("name = \"a\\nb\"\n".to_owned()),
            Request::Light(BTreeMap::from([(488, 2.5), (561, 80.0)])),
            Request::StartTrain { period_ns: 20_000_000, pulses: Some(4000) },
            Request::Proof(7),
        ];
        for (number, request) in (0..).zip(requests) {
            let sent = Numbered { number, request };
            client.send(&sent).unwrap();
            match guard.receive::<Numbered>(Duration::from_secs(5)).unwrap() {
                Received::Message(received) => assert_eq!(received, sent),
                other => panic!("{other:?}"),
            }
        }
        drop(client);
        assert!(matches!(guard.receive::<Numbered>(Duration::from_secs(5)).unwrap(), Received::Gone));
    }

    #[test]
    fn halves_are_put_together_and_nonsense_is_told() {
        let (client, mut guard) = pair();
        let mut socket = client.socket;
        socket.write_all(b"{\"number\":1,\"requ").unwrap();
        assert!(matches!(guard.receive::<Numbered>(Duration::from_secs(5)).unwrap(), Received::Nothing));
        socket.write_all(b"est\":\"arm\"}\n???\n").unwrap();
        match guard.receive::<Numbered>(Duration::from_secs(5)).unwrap() {
            Received::Message(Numbered { number: 1, request: Request::Arm }) => {}
            other => panic!("{other:?}"),
        }
        assert!(guard.receive::<Numbered>(Duration::from_secs(5)).is_err());
    }
}
