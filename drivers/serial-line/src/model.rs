//! The other end of the line as a pure state machine, and a port that talks to it without a wire.
//!
//! A model never reads a clock: its time is given to it. Behind a [`ModelPort`] time passes only while the driver
//! waits, so that tests with models never wait; behind a pseudo-terminal it is the time of the wall.

use std::io;
use std::io::Write;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::port::{Port, gone};

/// A device at the other end of a line.
pub trait LineModel: Send {
    /// Bytes that have come over the line at `now`, the time since power was switched on; it never goes back.
    fn receive(&mut self, bytes: &[u8], now: Duration);

    /// Lets time pass until `now`, appends the bytes that are due, and tells when it wants to be asked again
    /// at the latest; `None` when nothing will happen by itself.
    fn advance(&mut self, now: Duration, out: &mut Vec<u8>) -> Option<Duration>;

    /// Whether the plug is in; a model that is unplugged looks like a port that has gone.
    fn plugged(&self) -> bool {
        true
    }
}

/// A model with its clock, shared between ports and the test that looks at it.
struct Shared<M> {
    model: M,
    now: Duration,
}

/// A port with a model at its other end; its time passes only in [`Port::receive`].
pub struct ModelPort<M> {
    shared: Arc<Mutex<Shared<M>>>,
    pending: Vec<u8>,
}

impl<M: LineModel + 'static> ModelPort<M> {
    /// Plugs the model in.
    pub fn new(model: M) -> Self {
        Self { shared: Arc::new(Mutex::new(Shared { model, now: Duration::ZERO })), pending: Vec::new() }
    }

    /// A second port to the same model: for the test that looks at it, and for opening it again.
    #[must_use]
    pub fn again(&self) -> Self {
        Self { shared: Arc::clone(&self.shared), pending: Vec::new() }
    }

    /// Looks at the model, or changes it.
    pub fn with<T>(&self, look: impl FnOnce(&mut M, Duration) -> T) -> T {
        let mut shared = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        let now = shared.now;
        look(&mut shared.model, now)
    }

    /// Lets time pass; what the model sends meanwhile waits in the port.
    pub fn pass(&mut self, time: Duration) {
        let mut shared = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        let until = shared.now + time;
        while shared.now < until {
            let Shared { model, now } = &mut *shared;
            let next = model.advance(*now, &mut self.pending);
            *now = next.filter(|next| *next > *now).map_or(until, |next| next.min(until));
        }
        let Shared { model, now } = &mut *shared;
        model.advance(*now, &mut self.pending);
    }
}

impl<M: LineModel + 'static> Port for ModelPort<M> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        Sender(Arc::clone(&self.shared)).write_all(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], within: Duration) -> io::Result<usize> {
        let mut shared = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        let until = shared.now + within;
        loop {
            let Shared { model, now } = &mut *shared;
            if !model.plugged() {
                return Err(gone());
            }
            let next = model.advance(*now, &mut self.pending);
            if !self.pending.is_empty() || *now >= until {
                break;
            }
            *now = next.filter(|next| *next > *now).map_or(until, |next| next.min(until));
        }
        let num_bytes = bytes.len().min(self.pending.len());
        for (place, byte) in bytes.iter_mut().zip(self.pending.drain(..num_bytes)) {
            *place = byte;
        }
        Ok(num_bytes)
    }

    fn forget_received(&mut self) -> io::Result<()> {
        self.pass(Duration::ZERO);
        self.pending.clear();
        Ok(())
    }

    fn sender(&self) -> io::Result<Box<dyn Write + Send>> {
        Ok(Box::new(Sender(Arc::clone(&self.shared))))
    }
}

struct Sender<M>(Arc<Mutex<Shared<M>>>);

impl<M: LineModel> Write for Sender<M> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut shared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Shared { model, now } = &mut *shared;
        if !model.plugged() {
            return Err(gone());
        }
        model.receive(bytes, *now);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Line, LineError};

    /// Answers every byte after 100 ms.
    #[derive(Default)]
    struct Slow {
        due: Vec<(Duration, u8)>,
        unplugged: bool,
    }

    impl LineModel for Slow {
        fn receive(&mut self, bytes: &[u8], now: Duration) {
            self.due.extend(bytes.iter().map(|byte| (now + Duration::from_millis(100), *byte)));
        }

        fn advance(&mut self, now: Duration, out: &mut Vec<u8>) -> Option<Duration> {
            out.extend(self.due.extract_if(.., |(at, _)| *at <= now).map(|(_, byte)| byte));
            self.due.first().map(|(at, _)| *at)
        }

        fn plugged(&self) -> bool {
            !self.unplugged
        }
    }

    #[test]
    fn time_passes_only_while_somebody_waits() {
        let port = ModelPort::new(Slow::default());
        let mut line = Line::new(Box::new(port.again()), "echo");
        line.send(b"abc\r").unwrap();
        assert_eq!(port.with(|_, now| now), Duration::ZERO);
        assert_eq!(line.receive_until(b"\r", Duration::from_secs(1)).unwrap(), b"abc");
        assert_eq!(port.with(|_, now| now), Duration::from_millis(100));
    }

    #[test]
    fn a_late_answer_is_not_the_next_one() {
        let mut line = Line::new(Box::new(ModelPort::new(Slow::default())), "echo");
        line.send(b"late\r").unwrap();
        let error = line.receive_until(b"\r", Duration::from_millis(50)).unwrap_err();
        assert!(matches!(error, LineError::Timeout { .. }), "{error}");
        assert_eq!(line.drain(Duration::from_millis(200), Duration::from_secs(5)).unwrap(), b"late\r");
        line.send(b"new\r").unwrap();
        assert_eq!(line.receive_until(b"\r", Duration::from_secs(1)).unwrap(), b"new");
    }

    #[test]
    fn an_unplugged_model_is_lost() {
        let port = ModelPort::new(Slow::default());
        let mut line = Line::new(Box::new(port.again()), "echo");
        port.with(|model, _| model.unplugged = true);
        let error = line.receive_exactly(1, Duration::from_secs(1)).unwrap_err();
        assert_eq!(line.error(&error, "reading").kind(), sofiscope_hal::ErrorKind::Lost);
        assert!(line.send(b"x").is_err());
    }
}
