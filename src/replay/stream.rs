//! The frames of one armed replay camera.
//!
//! In: a source, the timeline of both cameras. Out: frames at their time, one per call.
//! Never: allocates, leaves a frame out because the reader is slow. Fails: as [`FrameStream`] says.

use super::camera::{Cut, Reel};
use super::source::SourceFrame;
use super::timeline::Due;
use super::{Repeat, ReplayError};
use crate::recording::RecordingError;
use sofiscope_hal::clock::nanoseconds;
use sofiscope_hal::{
    BlockId, DeviceError, DeviceTime, ErrorKind, ExposureIndex, FrameInfo, FrameStatus, FrameStream,
    HostTime, Region,
};
use std::sync::Arc;
use std::time::Duration;

/// The frames of one armed replay camera.
pub(super) struct ReplayStream {
    reel: Arc<Reel>,
    /// Which arming this is.
    run: u64,
    cut: Cut,
    device: String,
    /// Part of the recorded frame that is delivered.
    window: Window,
    /// Memory for a whole frame, where only a part is delivered.
    whole: Vec<u16>,
    /// Frame that comes next.
    next: u64,
    /// Times that the end was reached.
    round: u64,
    /// Facts of the frame that comes next, once known.
    ahead: Option<SourceFrame>,
}

/// A part of a recorded frame, in pixels from its corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    pub(super) part: Region,
    pub(super) recorded_width: usize,
    pub(super) recorded_pixels: usize,
}

impl Window {
    fn is_whole(self) -> bool {
        self.part.num_pixels() == self.recorded_pixels
    }

    /// Copies the part out of a whole frame.
    fn cut(self, whole: &[u16], counts: &mut [u16]) {
        let Region { left, top, width, .. } = self.part;
        let rows = whole.chunks_exact(self.recorded_width).skip(top as usize);
        for (row, part) in rows.zip(counts.chunks_exact_mut(width as usize)) {
            part.copy_from_slice(&row[left as usize..][..width as usize]);
        }
    }
}

impl ReplayStream {
    /// Takes all the memory that it will ever need.
    pub(super) fn new(reel: Arc<Reel>, run: u64, device: String, window: Window) -> Self {
        let whole = if window.is_whole() { Vec::new() } else { vec![0; window.recorded_pixels] };
        let cut = reel.cut();
        let next = cut.begin;
        Self { reel, run, cut, device, window, whole, next, round: 0, ahead: None }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.device.clone(), message)
    }

    fn fault(&self, error: &ReplayError) -> DeviceError {
        self.error(ErrorKind::Fault, error.to_string())
    }

    /// Facts of the frame that comes next, with its time; `None` at the end.
    fn look_ahead(&mut self) -> Result<Option<SourceFrame>, ReplayError> {
        let reel = Arc::clone(&self.reel);
        let mut source = reel.source();
        while self.ahead.is_none() {
            let cut = self.cut;
            if self.next >= source.frames() {
                // A camera without a single frame has no second round.
                if self.reel.repeat == Repeat::Once || self.next == cut.begin {
                    return Ok(None);
                }
                self.next = cut.begin;
                self.round += 1;
            }
            let frame = source.frame(self.next)?;
            let exposure = frame.exposure.0.checked_sub(self.reel.origin).ok_or_else(|| self.order(frame))?;
            if exposure < cut.start {
                // A frame from before the begin that came late; each round has others.
                self.next += 1;
                continue;
            }
            self.ahead = Some(SourceFrame { exposure: ExposureIndex(exposure), ..frame });
        }
        Ok(self.ahead)
    }

    fn order(&self, frame: SourceFrame) -> ReplayError {
        let reason =
            format!("frame {} has the number {}, which is before the first", self.next, frame.exposure.0);
        ReplayError::Refused { reason }
    }

    /// Nanoseconds from the begin of the replay to the moment at which a frame is delivered.
    fn position(&self, frame: SourceFrame) -> u64 {
        let cut = self.cut;
        let in_round = frame.received.0.saturating_sub(cut.begin_ns);
        in_round.saturating_add(cut.round_ns.saturating_mul(self.round))
    }

    fn deliver(&mut self, frame: SourceFrame, counts: &mut [u16]) -> Result<FrameInfo, DeviceError> {
        let status = match self.read(counts) {
            Ok(()) => frame.status,
            // One frame is lost and said to be; the others are as good as before.
            Err(error @ ReplayError::Recording(RecordingError::BadCrc { .. })) => {
                tracing::error!(%error, "a recorded frame is left out");
                FrameStatus::Incomplete
            }
            Err(error) => return Err(self.fault(&error)),
        };
        self.ahead = None;
        self.next += 1;
        let cut = self.cut;
        let exposures = cut.exposures.wrapping_mul(self.round);
        Ok(FrameInfo {
            exposure: ExposureIndex((frame.exposure.0 - cut.start).wrapping_add(exposures)),
            block_id: BlockId(frame.block_id.0.wrapping_add(exposures)),
            epoch: frame.epoch,
            device_time: DeviceTime(frame.device_time.0.wrapping_add(cut.round_ns.wrapping_mul(self.round))),
            status,
        })
    }

    fn read(&mut self, counts: &mut [u16]) -> Result<(), ReplayError> {
        let mut source = self.reel.source();
        if self.window.is_whole() {
            return source.read(self.next, counts);
        }
        source.read(self.next, &mut self.whole)?;
        self.window.cut(&self.whole, counts);
        Ok(())
    }
}

impl FrameStream for ReplayStream {
    fn next_frame(&mut self, counts: &mut [u16], timeout: Duration) -> Result<FrameInfo, DeviceError> {
        let expected = self.window.part.num_pixels();
        if counts.len() != expected {
            let message = format!("memory for {} pixels was given where {expected} are needed", counts.len());
            return Err(self.error(ErrorKind::OutOfRange, message));
        }
        let reel = Arc::clone(&self.reel);
        let timeline = &reel.timeline;
        let deadline = HostTime(timeline.clock.now().0.saturating_add(nanoseconds(timeout)));
        loop {
            let heard = timeline.bell.rings();
            let Some(frame) = self.look_ahead().map_err(|error| self.fault(&error))? else {
                return Err(self.error(ErrorKind::Ended, "the replay is at its end"));
            };
            let now = timeline.clock.now();
            let wake = match timeline.due((reel.channel, self.run), self.position(frame), now) {
                Due::Now => return self.deliver(frame, counts),
                Due::Never => return Err(self.error(ErrorKind::Ended, "was stopped")),
                Due::At(at) => at.min(deadline),
                Due::Held => deadline,
            };
            if now >= deadline {
                let message = format!("no frame came within {} ms", timeout.as_millis());
                return Err(self.error(ErrorKind::Timeout, message));
            }
            timeline.clock.wait(&timeline.bell, heard, wake);
        }
    }
}
