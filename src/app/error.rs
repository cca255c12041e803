//! Why a command ended without its result, and the exit code that scripts see.

use crate::files::FileError;

/// A failed command: what, where, and what to do next.
#[derive(Debug, thiserror::Error)]
pub enum AppError {
    /// Wrong arguments or configuration (exit code 2).
    #[error("{0}")]
    Usage(String),
    /// A device failed (exit code 3).
    #[error("{0}")]
    Device(String),
    /// Data that cannot be analyzed (exit code 4).
    #[error("{0}")]
    Data(String),
    /// A safety trip ended it (exit code 5).
    #[error("{0}")]
    Safety(String),
    /// A file could not be read or written (exit code 2 or 4).
    #[error(transparent)]
    File(#[from] FileError),
}

impl From<sofiscope_hal::DeviceError> for AppError {
    fn from(error: sofiscope_hal::DeviceError) -> Self {
        Self::Device(error.to_string())
    }
}

impl AppError {
    /// 2 usage or configuration, 3 device, 4 data, 5 safety trip.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) => 2,
            Self::Device(_) => 3,
            Self::Data(_) => 4,
            Self::Safety(_) => 5,
            Self::File(error) => error.kind().exit_code(),
        }
    }

    /// A usage error from anything that explains itself.
    pub fn usage(reason: impl std::fmt::Display) -> Self {
        Self::Usage(reason.to_string())
    }

    /// A data error from anything that explains itself.
    pub fn data(reason: impl std::fmt::Display) -> Self {
        Self::Data(reason.to_string())
    }
}
