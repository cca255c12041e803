//! One camera's frames into pool memory, as fast as the camera gives them.
//!
//! In: a [`FrameStream`], a [`FramePool`]. Out: [`Grabbed`] to the pairing, in order of delivery.
//! Never: waits for a consumer (unless its source is patient), allocates, looks at pixels.
//! Fails: ends with the camera's error; frames without memory are [`Loss::NoBuffer`].

use super::{FrameFacts, FramePool, Grabbed, Loss, Surroundings};
use crate::pipeline::{Refused, Sender};
use sofiscope_hal::{Channel, DeviceError, ErrorKind, FrameInfo, FrameStatus, FrameStream, HostTime};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// How long one wait for a frame lasts before the grabber looks whether it should stop.
const TURN: Duration = Duration::from_millis(50);

/// How long a patient grabber sleeps before it looks for free memory again.
const PATIENT_LOOK: Duration = Duration::from_micros(200);

/// Frames that a full queue refused and that are still to be told as losses.
const MOST_REFUSED: usize = 16_384;

/// This computer's monotonic clock, counted from the preparation of the run.
#[derive(Debug, Clone, Copy)]
pub struct HostClock {
    origin: Instant,
}

impl HostClock {
    /// A clock that begins now.
    #[must_use]
    pub fn start() -> Self {
        Self { origin: Instant::now() }
    }

    /// The time now.
    #[must_use]
    pub fn now(&self) -> HostTime {
        HostTime(self.origin.elapsed().as_nanos() as u64)
    }
}

/// Whether a source can wait for memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Patience {
    /// A camera: light does not wait, frames without memory are lost.
    Live,
    /// A file or a simulator without a clock: it waits, and nothing is lost for want of memory.
    Patient,
}

/// Why a grabber ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum GrabberEnd {
    /// The stream is over.
    Ended,
    /// It was told to stop.
    Stopped,
    /// The camera failed.
    Failed(DeviceError),
    /// The pairing is gone.
    Abandoned,
}

/// What others may know of a grabber while it works.
#[derive(Debug, Default)]
pub struct GrabberStatus {
    /// Frames that came, usable or not.
    pub frames: AtomicU64,
    /// When the last one came, nanoseconds of the host clock; 0 before the first.
    pub last_frame_ns: AtomicU64,
}

/// The work of one grabbing thread.
pub struct Grabber {
    /// The camera.
    pub channel: Channel,
    /// Its frames.
    pub stream: Box<dyn FrameStream>,
    /// Memory for them.
    pub pool: FramePool,
    /// Pixels of a frame.
    pub pixels: usize,
    /// To the pairing.
    pub to_pairing: Sender<Grabbed>,
    /// Whether the source can wait.
    pub patience: Patience,
    /// The clock that stamps frames.
    pub clock: HostClock,
    /// What surrounds them.
    pub surroundings: Surroundings,
    /// Set from outside to end the work.
    pub stop: Arc<AtomicBool>,
    /// What others see.
    pub status: Arc<GrabberStatus>,
}

impl std::fmt::Debug for Grabber {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Grabber").field("channel", &self.channel).finish_non_exhaustive()
    }
}

impl Grabber {
    /// Grabs until the stream ends, the camera fails or `stop` is set.
    pub fn run(mut self) -> GrabberEnd {
        let mut spare = vec![0_u16; self.pixels];
        let mut refused = VecDeque::with_capacity(MOST_REFUSED);
        loop {
            if self.stop.load(Ordering::Acquire) {
                return GrabberEnd::Stopped;
            }
            let grabbed = match self.grab(&mut spare) {
                Ok(grabbed) => grabbed,
                Err(error) if error.kind() == ErrorKind::Timeout => continue,
                Err(error) if error.kind() == ErrorKind::Ended => return GrabberEnd::Ended,
                Err(error) => return GrabberEnd::Failed(error),
            };
            if self.hand_over(grabbed, &mut refused).is_err() {
                return GrabberEnd::Abandoned;
            }
        }
    }

    fn grab(&mut self, spare: &mut [u16]) -> Result<Grabbed, DeviceError> {
        while self.patience == Patience::Patient
            && self.pool.take().is_none()
            && !self.stop.load(Ordering::Acquire)
        {
            thread::park_timeout(PATIENT_LOOK);
        }
        let Some(mut memory) = self.pool.take() else {
            let info = self.stream.next_frame(spare, TURN)?;
            return Ok(Grabbed::Lost(self.facts(info), reason_of(info.status).unwrap_or(Loss::NoBuffer)));
        };
        let info = self.stream.next_frame(memory.counts_mut(), TURN)?;
        let (received, conditions) = (self.clock.now(), self.surroundings.now());
        let facts = FrameFacts { channel: self.channel, info, received, conditions };
        let grabbed = match reason_of(info.status) {
            None => Grabbed::Frame(memory.into_frame(facts)),
            Some(reason) => Grabbed::Lost(facts, reason),
        };
        self.note(facts);
        Ok(grabbed)
    }

    fn facts(&self, info: FrameInfo) -> FrameFacts {
        let (received, conditions) = (self.clock.now(), self.surroundings.now());
        let facts = FrameFacts { channel: self.channel, info, received, conditions };
        self.note(facts);
        facts
    }

    fn note(&self, facts: FrameFacts) {
        self.status.frames.fetch_add(1, Ordering::Relaxed);
        self.status.last_frame_ns.store(facts.received.0, Ordering::Relaxed);
    }

    /// Hands over in order: frames that the pairing refused before come first, as losses.
    fn hand_over(&mut self, grabbed: Grabbed, refused: &mut VecDeque<FrameFacts>) -> Result<(), Abandoned> {
        while let Some(&facts) = refused.front() {
            match self.to_pairing.send(Grabbed::Lost(facts, Loss::QueueFull)) {
                Ok(()) => refused.pop_front(),
                Err(Refused::Full(_)) => break,
                Err(Refused::Closed(_)) => return Err(Abandoned),
            };
        }
        if !refused.is_empty() {
            remember(grabbed.facts(), refused);
            return Ok(());
        }
        match self.to_pairing.send(grabbed) {
            Ok(()) => Ok(()),
            Err(Refused::Full(grabbed)) => {
                remember(grabbed.facts(), refused);
                Ok(())
            }
            Err(Refused::Closed(_)) => Err(Abandoned),
        }
    }
}

/// The pairing is gone.
struct Abandoned;

/// Beyond the capacity only the gap in exposures tells of a frame.
fn remember(facts: FrameFacts, refused: &mut VecDeque<FrameFacts>) {
    if refused.len() < MOST_REFUSED {
        refused.push_back(facts);
    }
}

/// Why a frame with this status cannot be used.
fn reason_of(status: FrameStatus) -> Option<Loss> {
    match status {
        FrameStatus::Complete => None,
        FrameStatus::Incomplete => Some(Loss::Incomplete),
        FrameStatus::SizeMismatch => Some(Loss::SizeMismatch),
    }
}
