//! One channel of a TIFF stack as the frames of a camera.
//!
//! In: a path. Out: page `k` as exposure `k`, one period after the other.
//! Never: knows of a frame that the camera lost. Fails: [`ReplayError`] with file, page and field.

use super::ReplayError;
use super::source::{FrameSource, Numbering, Opened, SourceFrame, check_frames, check_read, check_size};
use crate::files::{ImageStack, SampleType};
use sofiscope_hal::clock::nanoseconds;
use sofiscope_hal::{BlockId, DeviceTime, Epoch, ExposureIndex, FrameStatus, HostTime};
use std::path::Path;
use std::time::Duration;

/// Period of frames whose file says nothing of time.
pub(super) const PERIOD_UNKNOWN: Duration = Duration::from_millis(10);

/// Frames that follow each other without a gap, `period` apart.
#[derive(Debug, Clone, Copy)]
pub(super) struct Even {
    pub(super) period: Duration,
}

impl Even {
    pub(super) fn frame(self, frame: u64) -> SourceFrame {
        let time_ns = nanoseconds(self.period).saturating_mul(frame);
        SourceFrame {
            exposure: ExposureIndex(frame),
            block_id: BlockId(frame),
            epoch: Epoch(0),
            device_time: DeviceTime(time_ns),
            received: HostTime(time_ns),
            status: FrameStatus::Complete,
        }
    }
}

/// One channel of a stack.
#[derive(Debug)]
struct StackFrames {
    stack: ImageStack,
    even: Even,
}

/// Opens each channel of a stack with a handle of its own.
pub(super) fn open(path: &Path, period: Option<Duration>) -> Result<Vec<Opened>, ReplayError> {
    let first = ImageStack::open(path)?;
    let info = first.info().clone();
    if info.sample == SampleType::Float32 {
        let remedy = "Cameras deliver 16-bit counts; read this file with `sofiscope analyze`";
        return Err(ReplayError::unsupported(path, "sample type", "float32", remedy));
    }
    if info.channels > 2 {
        let remedy = "Save two channels, R before T";
        return Err(ReplayError::unsupported(path, "channels", info.channels.to_string(), remedy));
    }
    check_size(path, "ImageWidth and ImageLength", info.height as u64, info.width as u64)?;
    check_frames(path, "page list", info.frames as u64)?;
    let known = period.or(info.frame_interval.filter(|interval| !interval.is_zero()));
    let even = Even { period: known.unwrap_or(PERIOD_UNKNOWN) };
    let mut stacks = vec![first];
    if info.channels == 2 {
        let mut second = ImageStack::open(path)?;
        if second.info() != &info {
            return Err(ReplayError::damaged(path, "page list", "it changed while it was read"));
        }
        second.select_channel(1)?;
        stacks.push(second);
    }
    let opened = stacks.into_iter().map(|stack| Opened {
        path: path.to_path_buf(),
        source: Box::new(StackFrames { stack, even }),
        height: info.height as u32,
        width: info.width as u32,
        exposures: info.frames as u64,
        numbering: Numbering::Counted,
        period: known,
        pixel_size_nm: info.pixel_size_nm.map(|[width, _]| width),
        saturation_counts: if info.sample == SampleType::Uint8 { 255 } else { u16::MAX },
        simulated: info.is_simulated(),
        kind: "TIFF",
    });
    Ok(opened.collect())
}

impl FrameSource for StackFrames {
    fn frames(&self) -> u64 {
        self.stack.info().frames as u64
    }

    fn frame(&mut self, frame: u64) -> Result<SourceFrame, ReplayError> {
        Ok(self.even.frame(frame))
    }

    fn read(&mut self, frame: u64, counts: &mut [u16]) -> Result<(), ReplayError> {
        let info = self.stack.info();
        let expected = info.height * info.width;
        check_read(self.stack.path(), (frame, info.frames as u64), (counts.len(), expected))?;
        self.stack.seek(frame as usize)?;
        self.stack.read_counts(counts)?;
        Ok(())
    }
}
