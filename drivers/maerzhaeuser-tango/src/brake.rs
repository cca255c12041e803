//! STOP: one byte past everything that waits.
//!
//! In: a second handle of the port. Out: 0x03, which the controller obeys at any place of the stream.
//! Never: waits for the thread that owns the stage, nor for an answer.
//!
//! A move that is being begun while STOP comes must not follow it onto the line. Whoever begins one counts the STOPs
//! before and after it is sent, and sends another STOP when one came between. The count rises before the byte goes
//! out, so that no order of the two threads lets a move survive.

use std::io;
use std::io::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use sofiscope_hal::{DeviceError, ErrorKind, StopMotion};

/// The abort of one byte (Ctrl-C).
const ABORT: &[u8] = &[0x03];

pub(crate) struct Brake {
    device: String,
    stops: AtomicU64,
    sender: Mutex<Box<dyn Write + Send>>,
}

impl Brake {
    pub(crate) fn new(device: &str, sender: Box<dyn Write + Send>) -> Arc<Self> {
        Arc::new(Self { device: device.to_owned(), stops: AtomicU64::new(0), sender: Mutex::new(sender) })
    }

    /// STOPs so far, of whomever.
    pub(crate) fn stops(&self) -> u64 {
        self.stops.load(Ordering::SeqCst)
    }

    /// A new line to the same controller; stoppers that were handed out go on working.
    pub(crate) fn replace(&self, sender: Box<dyn Write + Send>) {
        *self.sender.lock().unwrap_or_else(PoisonError::into_inner) = sender;
    }

    /// Sends STOP.
    pub(crate) fn stop(&self) -> io::Result<()> {
        self.stops.fetch_add(1, Ordering::SeqCst);
        // The lock is held for one byte; the handle waits 100 ms at most where the system has no room for it.
        self.sender.lock().unwrap_or_else(PoisonError::into_inner).write_all(ABORT)
    }
}

/// STOP in other hands.
pub(crate) struct Stopper(pub(crate) Arc<Brake>);

impl StopMotion for Stopper {
    fn stop_motion(&self) -> Result<(), DeviceError> {
        self.0.stop().map_err(|error| {
            let message =
                format!("STOP could not be sent ({error}); take the stage as moving and switch it off");
            DeviceError::new(ErrorKind::Lost, &self.0.device, message)
        })
    }
}
