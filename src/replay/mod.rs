//! Frames from files through cameras that are none, into the same pipeline as live frames.
//!
//! ```text
//! recording, TIFF, Zarr, dcimg, raw ─► open ─► FrameSource R, T ─► ReplayCamera R, T ─► acquisition
//!                                                 ReplayControl: play, pause, speed, place ─┘
//! ```
//!
//! In: one path or two. Out: two cameras behind the contracts of `sofiscope_hal`, and what is known of the frames.
//! Never: invents a frame, hides that it is a replay, scales or inverts counts, waits but in `next_frame`.
//! Fails: [`ReplayError`] naming file and field, before memory is asked for in vain.
//!
//! Frames that were lost are absent, so the pipeline finds the same gaps again.
//! Numbers of exposures, frame ids, times of the cameras and intervals of arrival are those of the recording.

mod camera;
mod control;
mod dcimg;
mod error;
mod open;
mod raw;
mod recorded;
mod source;
mod stack;
mod stream;
mod timeline;
mod zarr;

use crate::acquisition::Loss;
use sofiscope_hal::{Clock, MonotonicClock};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

pub use camera::ReplayCamera;
pub use control::ReplayControl;
pub use error::ReplayError;
pub use open::open;
pub use source::{FrameSource, SourceFrame};
pub use timeline::ReplaySpeed;

/// What comes after the last frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Repeat {
    /// The end.
    #[default]
    Once,
    /// The first frame again; exposures and times go on.
    Forever,
}

/// How to replay.
#[derive(Debug, Clone)]
pub struct ReplayOptions {
    /// How fast.
    pub speed: ReplaySpeed,
    /// The exposure of the recording that is the first one after arming.
    pub start: u64,
    /// What comes after the last frame.
    pub repeat: Repeat,
    /// Period of files that do not say theirs, and instead of what stacks say; recordings know theirs.
    pub period: Option<Duration>,
    /// Side of a pixel in the sample, instead of what the files say, in nm.
    pub pixel_size_nm: Option<f64>,
    /// The clock by which frames come.
    pub clock: Arc<dyn Clock>,
}

impl Default for ReplayOptions {
    fn default() -> Self {
        Self {
            speed: ReplaySpeed::Max,
            start: 0,
            repeat: Repeat::Once,
            period: None,
            pixel_size_nm: None,
            clock: Arc::new(MonotonicClock::default()),
        }
    }
}

/// A replay, ready to be armed.
#[derive(Debug)]
pub struct Replay {
    /// Camera R and camera T.
    pub cameras: [ReplayCamera; 2],
    /// What is known of the frames.
    pub info: ReplayInfo,
    /// Play, pause, speed and place.
    pub control: ReplayControl,
}

/// What is known of the frames of a replay; exposures are numbered as in the recording.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayInfo {
    /// Rows of a frame.
    pub height: u32,
    /// Columns of a frame.
    pub width: u32,
    /// Exposures, with those whose frames were lost.
    pub exposures: u64,
    /// Time from exposure to exposure.
    pub period: Duration,
    /// True when no file says the period and it is only assumed.
    pub is_period_assumed: bool,
    /// Side of a pixel in the sample, in nm.
    pub pixel_size_nm: Option<f64>,
    /// True when the frames were recorded from anything but physical cameras.
    pub simulated: bool,
    /// Exposures that the live analysis had not got, and why.
    pub left_out: BTreeMap<u64, Loss>,
    /// Names and texts that say how a recording was made: plan, instrument.
    pub provenance: Vec<(String, String)>,
    /// One line for reports.
    pub description: String,
}

impl ReplayInfo {
    /// [`left_out`](Self::left_out) in the numbers of a replay that begins with exposure `start`.
    #[must_use]
    pub fn left_out_from(&self, start: u64) -> BTreeMap<u64, Loss> {
        self.left_out.range(start..).map(|(exposure, reason)| (exposure - start, *reason)).collect()
    }
}
