//! The instrument's end of the socket.
//!
//! In: what the sequencer wants of the light. Out: requests, and proofs that the sequencer makes progress.
//! Never: sends a proof by itself: [`GuardClient::prove`] is called by the loop whose progress it proves.
//! Fails: [`DeviceError`]; when the guard is gone, a second one is started only to make everything dark.

use std::collections::BTreeMap;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use sofiscope_hal::{DeviceError, ErrorKind};

use super::message::{Answer, FromGuard, LightsState, Messages, Numbered, Received, RefusedKind, Request};
use super::safety::Trip;

/// Shortest time between two proofs.
const PROOF_EVERY: Duration = Duration::from_millis(30);
/// How long an answer may take; a laser on a slow line needs seconds.
const PATIENCE: Duration = Duration::from_secs(20);
/// How long the devices may take to be opened: a board that boots, lasers that are asked one after another.
const SETUP_PATIENCE: Duration = Duration::from_secs(60);

/// Starts a guard process whose standard input is the other end of the socket.
///
/// # Errors
/// When the program cannot be started.
pub fn start_process(mut program: Command) -> io::Result<(Child, UnixStream)> {
    let (ours, theirs) = UnixStream::pair()?;
    let child = program.stdin(Stdio::from(OwnedFd::from(theirs))).stdout(Stdio::null()).spawn()?;
    Ok((child, ours))
}

/// The guard as the instrument sees it.
#[derive(Debug)]
pub struct GuardClient {
    messages: Messages,
    number: u64,
    proof: u64,
    proved: Instant,
    trip: Option<Trip>,
    is_gone: bool,
}

impl GuardClient {
    /// Lets the guard at the other end of the socket open the devices of an instrument file.
    ///
    /// # Errors
    /// What the guard says of devices that it could not open; [`Lost`](ErrorKind::Lost) when it is gone.
    pub fn set_up(socket: UnixStream, instrument: &str) -> Result<(Self, LightsState), DeviceError> {
        let mut client = Self {
            messages: Messages::new(socket),
            number: 0,
            proof: 0,
            proved: Instant::now(),
            trip: None,
            is_gone: false,
        };
        match client.ask(Request::Setup(instrument.to_owned()), SETUP_PATIENCE)? {
            Answer::State(state) => Ok((client, *state)),
            other => Err(unexpected(&other)),
        }
    }

    /// Proves that the caller makes progress; cheap enough for every round of a loop.
    pub fn prove(&mut self) {
        self.send_proof();
        // Trips are heard with the next question, or here.
        self.listen();
    }

    fn send_proof(&mut self) {
        if self.is_gone || self.proved.elapsed() < PROOF_EVERY {
            return;
        }
        self.proved = Instant::now();
        self.proof += 1;
        let proof = Numbered { number: 0, request: Request::Proof(self.proof) };
        if self.messages.send(&proof).is_err() {
            self.is_gone = true;
        }
    }

    /// Why everything went dark by itself since it was armed last.
    pub fn trip(&mut self) -> Option<Trip> {
        self.listen();
        if self.is_gone && self.trip.is_none() {
            self.trip = Some(Trip::DeviceLost("the laser guard is gone".to_owned()));
        }
        self.trip.clone()
    }

    /// A person arms: the emission indicator goes on.
    ///
    /// # Errors
    /// What the guard says.
    pub fn arm(&mut self) -> Result<(), DeviceError> {
        self.trip = None;
        self.done(Request::Arm)
    }

    /// Nothing shall shine until armed again.
    ///
    /// # Errors
    /// What the guard says; everything is to be taken as on.
    pub fn disarm(&mut self) -> Result<(), DeviceError> {
        self.done(Request::Disarm)
    }

    /// These lines, milliwatts by nanometers, and no others; waits for the emission indicator.
    ///
    /// # Errors
    /// [`OutOfRange`](ErrorKind::OutOfRange) for lines and powers that are not there, [`Fault`](ErrorKind::Fault)
    /// when not armed, tripped, or a laser stays dark; everything is dark then.
    pub fn light(&mut self, power_mw: &BTreeMap<u32, f64>) -> Result<(), DeviceError> {
        let begun = Instant::now();
        loop {
            match self.ask(Request::Light(power_mw.clone()), PATIENCE)? {
                Answer::Done => return Ok(()),
                Answer::Refused { kind: RefusedKind::Indicator, .. } if begun.elapsed() < PATIENCE => {
                    // Nothing is expected; this is how the indicator's time is waited for.
                    self.listen_for(Duration::from_millis(50));
                }
                other => return Err(unexpected(&other)),
            }
        }
    }

    /// No light.
    ///
    /// # Errors
    /// What the guard says; everything is to be taken as on.
    pub fn darken(&mut self) -> Result<(), DeviceError> {
        self.done(Request::Darken)
    }

    /// Pulses for the cameras from the controller's clock.
    ///
    /// # Errors
    /// What the controller says.
    pub fn start_train(&mut self, period: Duration, pulses: Option<u64>) -> Result<(), DeviceError> {
        let period_ns = u64::try_from(period.as_nanos()).unwrap_or(u64::MAX);
        self.done(Request::StartTrain { period_ns, pulses })
    }

    /// No pulses any more.
    ///
    /// # Errors
    /// What the controller says.
    pub fn stop_train(&mut self) -> Result<(), DeviceError> {
        self.done(Request::StopTrain)
    }

    /// What the devices say.
    ///
    /// # Errors
    /// [`Lost`](ErrorKind::Lost) when the guard is gone.
    pub fn state(&mut self) -> Result<LightsState, DeviceError> {
        match self.ask(Request::State, PATIENCE)? {
            Answer::State(state) => Ok(*state),
            other => Err(unexpected(&other)),
        }
    }

    fn done(&mut self, request: Request) -> Result<(), DeviceError> {
        match self.ask(request, PATIENCE)? {
            Answer::Done => Ok(()),
            other => Err(unexpected(&other)),
        }
    }

    /// Asks and waits; waiting for an answer of the guard is progress as long as the answer may still come.
    fn ask(&mut self, request: Request, patience: Duration) -> Result<Answer, DeviceError> {
        self.number += 1;
        let asked = Numbered { number: self.number, request };
        if self.messages.send(&asked).is_err() {
            self.is_gone = true;
            return Err(gone());
        }
        let begun = Instant::now();
        while begun.elapsed() < patience {
            match self.messages.receive::<FromGuard>(PROOF_EVERY) {
                Ok(Received::Message(FromGuard::Answer { number, answer })) if number == self.number => {
                    return Ok(answer);
                }
                Ok(Received::Message(message)) => self.hear(message),
                Ok(Received::Nothing) => {}
                Ok(Received::Gone) | Err(_) => {
                    self.is_gone = true;
                    return Err(gone());
                }
            }
            // Not `prove`, which would hear the answer and take it for a late one.
            self.send_proof();
        }
        let message = format!("no answer within {} s; everything is to be taken as on", patience.as_secs());
        Err(DeviceError::new(ErrorKind::Timeout, "laser guard", message))
    }

    fn hear(&mut self, message: FromGuard) {
        match message {
            FromGuard::Tripped(trip) => {
                self.trip.get_or_insert(trip);
            }
            // The answer to a question that was given up.
            FromGuard::Answer { number, .. } => tracing::debug!(number, "a late answer of the laser guard"),
        }
    }

    fn listen(&mut self) {
        self.listen_for(Duration::ZERO);
    }

    fn listen_for(&mut self, within: Duration) {
        match self.messages.receive::<FromGuard>(within) {
            Ok(Received::Message(message)) => self.hear(message),
            Ok(Received::Nothing) => {}
            Ok(Received::Gone) | Err(_) => self.is_gone = true,
        }
    }
}

fn gone() -> DeviceError {
    DeviceError::new(
        ErrorKind::Lost,
        "laser guard",
        "its process is gone; take all lasers as on and use their keys",
    )
}

fn unexpected(answer: &Answer) -> DeviceError {
    match answer {
        Answer::Refused { kind, message } => {
            DeviceError::new(kind.error_kind(), "laser guard", message.clone())
        }
        other => DeviceError::new(ErrorKind::Protocol, "laser guard", format!("unexpected answer {other:?}")),
    }
}
