//! Where the frames of one camera come from.
//!
//! In: a number of a frame. Out: what is known of it, and its pixels.
//! Never: both cameras in one source; each has file handles of its own. Fails: [`ReplayError`] with file and field.

use super::ReplayError;
use rustix::fs::OFlags;
use sofiscope_hal::{BlockId, DeviceTime, Epoch, ExposureIndex, FrameStatus, HostTime};
use std::fs::{File, OpenOptions};
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Frames, and exposures with those that were lost, of one replay; 11 hours at 100 per second.
pub(super) const MAX_EXPOSURES: u64 = 1 << 22;
/// Sides of a frame; beyond any sensor.
pub(super) const MAX_SIDE: u64 = 1 << 15;
/// Pixels of a frame; 2^26 are 128 MiB.
pub(super) const MAX_PIXELS: u64 = 1 << 26;

/// One frame as the camera delivered it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SourceFrame {
    /// The exposure.
    pub exposure: ExposureIndex,
    /// The camera's own counter.
    pub block_id: BlockId,
    /// How often the camera had restarted its counter.
    pub epoch: Epoch,
    /// Begin of the exposure on the camera's clock.
    pub device_time: DeviceTime,
    /// When it was received; both cameras count from the same moment.
    pub received: HostTime,
    /// Whether the pixels can be used.
    pub status: FrameStatus,
}

/// The frames of one camera in the order in which they were delivered.
pub trait FrameSource: std::fmt::Debug + Send {
    /// Frames there are; those that were lost are not among them.
    fn frames(&self) -> u64;

    /// What is known of a frame, from 0.
    ///
    /// # Errors
    /// [`ReplayError`] for facts that cannot be read or contradict each other, and beyond the end.
    fn frame(&mut self, frame: u64) -> Result<SourceFrame, ReplayError>;

    /// Reads the pixels of a frame, row by row.
    ///
    /// # Errors
    /// [`ReplayError`] for memory of another size, pixels that cannot be read, and beyond the end.
    fn read(&mut self, frame: u64, counts: &mut [u16]) -> Result<(), ReplayError>;
}

/// How the frames of a source are numbered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Numbering {
    /// By exposures since both cameras were armed.
    Exposures,
    /// By counting what is in the file; nothing tells of a lost frame.
    Counted,
    /// By the camera's own stamps, of which this is the first.
    Stamped(u64),
}

/// A source and what is known of it as a whole.
#[derive(Debug)]
pub(super) struct Opened {
    pub(super) path: PathBuf,
    pub(super) source: Box<dyn FrameSource>,
    pub(super) height: u32,
    pub(super) width: u32,
    /// The highest exposure and one.
    pub(super) exposures: u64,
    pub(super) numbering: Numbering,
    pub(super) period: Option<Duration>,
    pub(super) pixel_size_nm: Option<f64>,
    pub(super) saturation_counts: u16,
    /// True when the file says that no physical camera made it.
    pub(super) simulated: bool,
    /// The kind of file, for people.
    pub(super) kind: &'static str,
}

/// Refuses sizes that no frame has.
pub(super) fn check_size(path: &Path, field: &str, height: u64, width: u64) -> Result<(), ReplayError> {
    let sides = 1..=MAX_SIDE;
    if sides.contains(&height) && sides.contains(&width) && height * width <= MAX_PIXELS {
        return Ok(());
    }
    Err(ReplayError::damaged(path, field, format!("{height} x {width} pixels are no frame")))
}

/// Refuses more frames than are replayed.
pub(super) fn check_frames(path: &Path, field: &str, frames: u64) -> Result<(), ReplayError> {
    if (1..=MAX_EXPOSURES).contains(&frames) {
        return Ok(());
    }
    Err(ReplayError::damaged(path, field, format!("{frames} frames where 1 to {MAX_EXPOSURES} are replayed")))
}

/// Refuses frames beyond the end and memory that does not fit.
pub(super) fn check_read(
    path: &Path,
    (frame, frames): (u64, u64),
    (given, expected): (usize, usize),
) -> Result<(), ReplayError> {
    if frame < frames && given == expected {
        return Ok(());
    }
    let reason = format!(
        "frame {frame} of {frames} in {} with memory for {given} of {expected} pixels was asked for",
        path.display()
    );
    Err(ReplayError::Refused { reason })
}

/// A regular file and its length.
#[derive(Debug)]
pub(super) struct SourceFile {
    pub(super) path: PathBuf,
    pub(super) length: u64,
    file: File,
}

impl SourceFile {
    /// Opens a regular file; pipes and devices are refused and keep nobody waiting.
    pub(super) fn open(path: &Path) -> Result<Self, ReplayError> {
        Self::open_with(path, OFlags::NONBLOCK)
    }

    /// As [`open`](Self::open), but refuses links.
    pub(super) fn open_unlinked(path: &Path) -> Result<Self, ReplayError> {
        Self::open_with(path, OFlags::NONBLOCK | OFlags::NOFOLLOW)
    }

    fn open_with(path: &Path, flags: OFlags) -> Result<Self, ReplayError> {
        let failed = |source| ReplayError::io(path, "open", source);
        let file = OpenOptions::new()
            .read(true)
            .custom_flags(flags.bits().cast_signed())
            .open(path)
            .map_err(failed)?;
        let metadata = file.metadata().map_err(failed)?;
        if !metadata.is_file() {
            return Err(ReplayError::damaged(path, "kind of file", "a directory, device or pipe"));
        }
        Ok(Self { path: path.to_path_buf(), length: metadata.len(), file })
    }

    /// Fills `bytes` from `offset`; `field` names them in errors.
    pub(super) fn read(&self, bytes: &mut [u8], offset: u64, field: &str) -> Result<(), ReplayError> {
        self.check_inside(offset, bytes.len() as u64, field)?;
        self.file.read_exact_at(bytes, offset).map_err(|source| ReplayError::io(&self.path, "read", source))
    }

    /// Refuses a section that reaches past the end of the file.
    pub(super) fn check_inside(&self, offset: u64, count: u64, field: &str) -> Result<(), ReplayError> {
        if offset.checked_add(count).is_some_and(|end| end <= self.length) {
            return Ok(());
        }
        let detail =
            format!("{count} bytes at {offset} reach past the end of the file, {} bytes", self.length);
        Err(ReplayError::damaged(&self.path, field, detail))
    }

    /// The whole text of a file of at most `max` bytes.
    pub(super) fn text(&self, max: u64) -> Result<String, ReplayError> {
        if self.length > max {
            let detail = format!("{} bytes where at most {max} are read", self.length);
            return Err(ReplayError::damaged(&self.path, "length", detail));
        }
        let mut bytes = vec![0; self.length as usize];
        self.read(&mut bytes, 0, "text")?;
        String::from_utf8(bytes).map_err(|error| ReplayError::damaged(&self.path, "text", error.to_string()))
    }
}

/// Spreads the bytes in the second half over all as 16-bit numbers; each is read before its place is written.
pub(super) fn widen(bytes: &mut [u8]) {
    let samples = bytes.len() / 2;
    for index in 0..samples {
        let count = u16::from(bytes[samples + index]);
        bytes[2 * index..2 * index + 2].copy_from_slice(&count.to_ne_bytes());
    }
}
