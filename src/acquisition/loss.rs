//! Why a frame is not where it should be.

use serde::{Deserialize, Serialize};

/// The reason why one consumer does not have a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum Loss {
    /// The camera or its transport never delivered it.
    UpstreamGap,
    /// It came with packets missing.
    Incomplete,
    /// It came after its turn was over.
    Timeout,
    /// It came in a size that was not configured.
    SizeMismatch,
    /// Its checksum is wrong.
    BadCrc,
    /// No memory was free when it came.
    NoBuffer,
    /// The consumer's queue was full.
    QueueFull,
    /// It was left out so that more important consumers keep up.
    ShedByPolicy,
    /// The disk is full.
    DiskFull,
    /// The disk or file system failed.
    IoError,
    /// The other camera's frame of this exposure is missing.
    Unpaired,
    /// The camera's clock says that it is not the exposure that its number claims.
    Misaligned,
    /// It came from a device that is not part of the run.
    ForeignSource,
    /// It was on its way when the run was aborted.
    Stopping,
    /// It was on its way when the program was killed; found by recovery.
    CrashTail,
    /// The focus error was larger than the plan allows, or no lock held.
    OutOfFocus,
}

impl Loss {
    /// Every reason; frames are recorded with its place in here, so new ones come last.
    pub const ALL: [Self; 16] = [
        Self::UpstreamGap,
        Self::Incomplete,
        Self::Timeout,
        Self::SizeMismatch,
        Self::BadCrc,
        Self::NoBuffer,
        Self::QueueFull,
        Self::ShedByPolicy,
        Self::DiskFull,
        Self::IoError,
        Self::Unpaired,
        Self::Misaligned,
        Self::ForeignSource,
        Self::Stopping,
        Self::CrashTail,
        Self::OutOfFocus,
    ];

    /// The name in ledgers and reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::UpstreamGap => "UPSTREAM_GAP",
            Self::Incomplete => "INCOMPLETE",
            Self::Timeout => "TIMEOUT",
            Self::SizeMismatch => "SIZE_MISMATCH",
            Self::BadCrc => "BAD_CRC",
            Self::NoBuffer => "NO_BUFFER",
            Self::QueueFull => "QUEUE_FULL",
            Self::ShedByPolicy => "SHED_BY_POLICY",
            Self::DiskFull => "DISK_FULL",
            Self::IoError => "IO_ERROR",
            Self::Unpaired => "UNPAIRED",
            Self::Misaligned => "MISALIGNED",
            Self::ForeignSource => "FOREIGN_SOURCE",
            Self::Stopping => "STOPPING",
            Self::CrashTail => "CRASH_TAIL",
            Self::OutOfFocus => "OUT_OF_FOCUS",
        }
    }

    /// The reason for people, to follow a number of frames: "3 frames never delivered by the camera".
    #[must_use]
    pub fn in_words(self) -> &'static str {
        match self {
            Self::UpstreamGap => "never delivered by the camera or its cable",
            Self::Incomplete => "came with packets missing",
            Self::Timeout => "came too late",
            Self::SizeMismatch => "came in a wrong size",
            Self::BadCrc => "have a wrong checksum",
            Self::NoBuffer => "found no free memory",
            Self::QueueFull => "found a full queue",
            Self::ShedByPolicy => "left out to keep up",
            Self::DiskFull => "not written, as the disk is full",
            Self::IoError => "not written, as the disk failed",
            Self::Unpaired => "without their partner from the other camera",
            Self::Misaligned => "of another exposure by the camera's clock",
            Self::ForeignSource => "from a camera that is not part of the run",
            Self::Stopping => "on their way when the run was stopped",
            Self::CrashTail => "on their way when the program ended",
            Self::OutOfFocus => "out of focus",
        }
    }

    /// The reason with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|loss| loss.name() == name)
    }
}

impl std::fmt::Display for Loss {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_serialized_form_and_lead_back() {
        for loss in Loss::ALL {
            assert_eq!(serde_json::to_string(&loss).unwrap(), format!("\"{loss}\""));
            assert_eq!(Loss::named(loss.name()), Some(loss));
            assert!(!loss.in_words().contains('_') && loss.in_words().len() > 5);
        }
    }
}
