//! Play, pause, speed and place of a replay, from any thread.
//!
//! In: wishes. Out: nothing. Never: waits. Fails: [`ReplayError`] for a place that is not there.

use super::ReplayError;
use super::camera::{Cut, Reel};
use super::source::FrameSource;
use super::timeline::ReplaySpeed;
use sofiscope_hal::clock::nanoseconds;
use sofiscope_hal::{DeviceError, TriggerSource};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

/// Frames by which one may have come late.
const REORDER: u64 = 64;

/// Play, pause, speed and place; clones act on the same replay.
#[derive(Debug, Clone)]
pub struct ReplayControl {
    pub(super) reels: [Arc<Reel>; 2],
    pub(super) exposures: u64,
    pub(super) period: Duration,
}

impl ReplayControl {
    /// Holds the next frame back until [`resume`](Self::resume).
    pub fn pause(&self) {
        self.reels[0].timeline.pause();
    }

    /// Goes on where it was paused; the pause takes no time of the recording.
    pub fn resume(&self) {
        self.reels[0].timeline.resume();
    }

    /// Whether it is paused.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.reels[0].timeline.is_paused()
    }

    /// Another speed from now on; a multiple that is no number or out of range is brought to the nearest
    /// of 0.001 to 1 000 000.
    pub fn set_speed(&self, speed: ReplaySpeed) {
        self.reels[0].timeline.set_speed(speed);
    }

    /// The speed.
    #[must_use]
    pub fn speed(&self) -> ReplaySpeed {
        self.reels[0].timeline.speed()
    }

    /// The exposure of the recording that is the first one after arming.
    #[must_use]
    pub fn start(&self) -> u64 {
        self.reels[0].cut().start
    }

    /// Begins with this exposure of the recording when both cameras are armed again; it is exposure 0 then.
    ///
    /// # Errors
    /// [`ReplayError::Refused`] beyond the end and while a camera is armed; [`ReplayError`] when facts of frames
    /// cannot be read.
    pub fn seek(&self, exposure: u64) -> Result<(), ReplayError> {
        if exposure >= self.exposures {
            let reason =
                format!("exposure {exposure} of {} is beyond the end; choose another", self.exposures);
            return Err(ReplayError::Refused { reason });
        }
        if !self.reels[0].timeline.is_idle() {
            let reason = "a camera is armed; stop both before seeking".to_owned();
            return Err(ReplayError::Refused { reason });
        }
        let parts = [self.part(0, exposure)?, self.part(1, exposure)?];
        let begin_ns = parts.iter().filter_map(|part| part.times).map(|(first, _)| first).min().unwrap_or(0);
        let end_ns = parts.iter().filter_map(|part| part.times).map(|(_, last)| last).max().unwrap_or(0);
        let round_ns = end_ns.saturating_sub(begin_ns).saturating_add(nanoseconds(self.period));
        for (reel, part) in self.reels.iter().zip(parts) {
            let exposures = self.exposures - exposure;
            let cut = Cut { start: exposure, exposures, begin: part.begin, begin_ns, round_ns };
            *reel.cut.lock().unwrap_or_else(PoisonError::into_inner) = cut;
        }
        Ok(())
    }

    /// Exposures of the whole recording, and the time from one to the next.
    #[must_use]
    pub fn extent(&self) -> (u64, Duration) {
        (self.exposures, self.period)
    }

    fn part(&self, camera: usize, start: u64) -> Result<Part, ReplayError> {
        let reel = &self.reels[camera];
        let mut source = reel.source();
        let start = start.saturating_add(reel.origin);
        let begin = first_from(source.as_mut(), start)?;
        if begin == source.frames() {
            return Ok(Part { begin, times: None });
        }
        let first = source.frame(begin)?;
        let last = source.frames() - 1;
        let last = source.frame(last)?;
        Ok(Part { begin, times: Some((first.received.0, last.received.0)) })
    }
}

/// Frames come by the times of the recording: start lets them go on, stop holds them back.
impl TriggerSource for ReplayControl {
    fn start(&mut self, _period: Duration, _pulses: Option<u64>) -> Result<(), DeviceError> {
        self.resume();
        Ok(())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.pause();
        Ok(())
    }
}

/// The frames of one camera that are played.
#[derive(Debug, Clone, Copy)]
struct Part {
    begin: u64,
    /// When the first and the last were received.
    times: Option<(u64, u64)>,
}

/// The first frame of an exposure from `start` on; the number of frames where there is none.
fn first_from(source: &mut dyn FrameSource, start: u64) -> Result<u64, ReplayError> {
    let frames = source.frames();
    let (mut low, mut high) = (0, frames);
    while low < high {
        let middle = low + (high - low) / 2;
        if source.frame(middle)?.exposure.0 < start { low = middle + 1 } else { high = middle }
    }
    for frame in low.saturating_sub(REORDER)..frames {
        if source.frame(frame)?.exposure.0 >= start {
            return Ok(frame);
        }
    }
    Ok(frames)
}
