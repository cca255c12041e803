//! The frames of one run.
//!
//! In: memory of the caller. Out: pixels and [`FrameInfo`], one frame per call, in the order of exposures.
//! Never: waits longer than a slice without looking whether the camera was stopped, allocates per frame, ends a run
//! because a frame was lost. Fails: as [`FrameStream`] says.
//!
//! The frame stamp, which begins with 0 at each start, is the block id; gaps in it are lost frames. With
//! synchronous readout frame stamp 0 is the exposure that began with the first pulse (see
//! [`PulseInput`](crate::PulseInput)), so that exposure 0 is the same on all cameras that hear the same pulses.
//! The time stamp is made when the library has the frame, a constant readout after the exposure; it is the
//! device time as it came.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use sofiscope_hal::{
    BlockId, CameraSettings, DeviceError, DeviceTime, ErrorKind, ExposureNumbering, FrameInfo, FrameStatus,
    FrameStream, IdRule,
};

use crate::capture::{Buffers, Capture};
use crate::ffi::ids::event;
use crate::ffi::{Failure, FrameHeader};
use crate::ring::{Place, Ring};

/// Longest wait before looking whether the camera was stopped.
const SLICE: Duration = Duration::from_millis(100);

/// Frame stamps are 32 bit and begin with 0 at the start of each run.
const FRAME_STAMPS: IdRule =
    IdRule { first: Some(BlockId(0)), smallest: 0, largest: u32::MAX as u64, reorder: 64 };

/// The frames of one run of a camera.
#[derive(Debug)]
pub struct DcamStream {
    capture: Arc<Capture>,
    ring: Ring,
    numbering: ExposureNumbering,
    width: usize,
    num_pixels: usize,
    /// Frame stamp that should come next.
    expected: u64,
}

impl DcamStream {
    pub(crate) fn new(capture: Arc<Capture>, settings: &CameraSettings, buffers: u32) -> Self {
        Self {
            capture,
            ring: Ring::new(buffers),
            numbering: ExposureNumbering::new(FRAME_STAMPS, settings.period),
            width: settings.region.width as usize,
            num_pixels: settings.region.num_pixels(),
            expected: 0,
        }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.capture.device.name(), message)
    }

    /// The next frame, if one is finished.
    fn ready(&mut self, counts: &mut [u16]) -> Result<Option<FrameInfo>, DeviceError> {
        let capture = self.capture.clone();
        let buffers = capture.buffers();
        if *buffers == Buffers::Released {
            return Err(self.error(ErrorKind::Ended, "was stopped and its buffers given back"));
        }
        self.observe()?;
        let Some(place) = self.ring.next() else { return Ok(None) };
        let (library, camera) = (capture.device.functions(), capture.device.handle());
        let copied = library.copy_frame(camera, place.slot, self.width, counts);
        let header = copied.map_err(|failure| {
            capture.device.error(&format!("frame {} cannot be read", place.number), failure)
        })?;
        self.observe()?;
        let torn = self.ring.is_gone(place);
        drop(buffers);
        self.ring.done(place);
        self.info(place, header, torn).map(Some)
    }

    fn observe(&mut self) -> Result<(), DeviceError> {
        let device = &self.capture.device;
        let newest = device.functions().newest(device.handle());
        let newest = newest.map_err(|failure| device.error("does not tell its newest frame", failure))?;
        self.ring.observe(newest.slot, newest.count);
        Ok(())
    }

    fn info(&mut self, place: Place, header: FrameHeader, torn: bool) -> Result<FrameInfo, DeviceError> {
        self.count_losses(place, header, torn);
        let microseconds = u64::try_from(header.microseconds).unwrap_or(0);
        let device_time = DeviceTime(u64::from(header.seconds) * 1_000_000_000 + microseconds * 1000);
        let block_id = BlockId(u64::from(header.frame_stamp));
        let numbered = self.numbering.exposure_of(block_id, device_time);
        let (exposure, epoch) = numbered.map_err(|error| {
            self.error(ErrorKind::Protocol, format!("{error}; stop and arm the camera again"))
        })?;
        let status = match (header.copied, torn) {
            (false, _) => FrameStatus::SizeMismatch,
            (true, true) => FrameStatus::Incomplete,
            (true, false) => FrameStatus::Complete,
        };
        Ok(FrameInfo { exposure, block_id, epoch, device_time, status })
    }

    /// Counts what the ring lost and what the frame stamps say is missing beside it.
    fn count_losses(&mut self, place: Place, header: FrameHeader, torn: bool) {
        let losses = &self.capture.losses;
        let name = self.capture.device.name();
        let gap = u64::from(header.frame_stamp).saturating_sub(self.expected);
        let missing = gap.saturating_sub(place.overwritten);
        if place.overwritten > 0 {
            losses.overwritten.fetch_add(place.overwritten, Ordering::Relaxed);
            tracing::error!(
                "{name}: {} frames before frame stamp {} were overwritten before they were read",
                place.overwritten,
                header.frame_stamp
            );
        }
        if missing > 0 {
            losses.missing.fetch_add(missing, Ordering::Relaxed);
            tracing::error!("{name}: {missing} frames before frame stamp {} are missing", header.frame_stamp);
        }
        if torn {
            losses.torn.fetch_add(1, Ordering::Relaxed);
            tracing::error!("{name}: frame stamp {} was overwritten while it was read", header.frame_stamp);
        }
        self.expected = u64::from(header.frame_stamp) + 1;
    }

    /// Waits for a frame or the stop, one slice at most.
    fn wait(&self, time: Duration) -> Result<(), DeviceError> {
        // Rounded up, as a wait of 0 ms would not wait at all.
        let milliseconds = i32::try_from(time.min(SLICE).as_micros().div_ceil(1000)).unwrap_or(1);
        let losses = &self.capture.losses;
        let name = self.capture.device.name();
        match self.capture.wait(event::FRAME_READY | event::STOPPED, milliseconds) {
            Ok(_) | Err(Failure::TIMEOUT | Failure::ABORT) => Ok(()),
            Err(failure @ (Failure::LOSTFRAME | Failure::MISSINGFRAME_TROUBLE)) => {
                losses.reported.fetch_add(1, Ordering::Relaxed);
                tracing::error!("{name}: the library lost a frame: {failure}");
                Ok(())
            }
            Err(Failure::TOOFREQUENTTRIGGER) => {
                losses.too_frequent.fetch_add(1, Ordering::Relaxed);
                tracing::error!("{name}: a trigger came too early and was dropped; take a longer period");
                Ok(())
            }
            Err(failure) => Err(self.capture.device.error("cannot be waited for", failure)),
        }
    }
}

impl FrameStream for DcamStream {
    fn next_frame(&mut self, counts: &mut [u16], timeout: Duration) -> Result<FrameInfo, DeviceError> {
        if counts.len() != self.num_pixels {
            let message =
                format!("memory for {} pixels was given where {} are needed", counts.len(), self.num_pixels);
            return Err(self.error(ErrorKind::OutOfRange, message));
        }
        let begun = Instant::now();
        loop {
            // Looked at first: what was finished before the stop is then found by the look at the frames.
            let stopping = self.capture.is_stopping();
            if let Some(info) = self.ready(counts)? {
                return Ok(info);
            }
            if stopping {
                self.capture.release();
                return Err(self.error(ErrorKind::Ended, "was stopped"));
            }
            let left = timeout.saturating_sub(begun.elapsed());
            if left.is_zero() {
                return Err(self.error(ErrorKind::Timeout, format!("no frame came within {timeout:?}")));
            }
            self.wait(left)?;
        }
    }
}
