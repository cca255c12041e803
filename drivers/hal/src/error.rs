//! What a device can answer beside what was asked of it.
//!
//! The kind tells the caller what it can do; the text names device, expectation and finding for the person.

/// What the caller can do about an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ErrorKind {
    /// Nothing came within the time given; asking again is fine.
    Timeout,
    /// The stream is over: no frame will come any more.
    Ended,
    /// A value outside of what the device can do; choose another.
    OutOfRange,
    /// The device cannot do this in its present state, for example configure while armed.
    Busy,
    /// The device is gone: unplugged, powered off, or its process died.
    Lost,
    /// The device answers with something that its protocol does not allow.
    Protocol,
    /// Another device than the one wanted.
    Identity,
    /// The device reports a fault of its own.
    Fault,
}

/// An answer that is not the one asked for.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{device}: {message}")]
pub struct DeviceError {
    /// What the caller can do.
    kind: ErrorKind,
    /// The device as the person knows it, for example `camera R (ORCA-Flash4.0, S/N 000123)`.
    device: String,
    /// What happened, with numbers, and what to do next.
    message: String,
}

impl DeviceError {
    /// An error of one device.
    pub fn new(kind: ErrorKind, device: impl Into<String>, message: impl Into<String>) -> Self {
        Self { kind, device: device.into(), message: message.into() }
    }

    /// What the caller can do.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }

    /// The device that answered.
    #[must_use]
    pub fn device(&self) -> &str {
        &self.device
    }
}
