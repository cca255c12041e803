//! Cameras: settings on the control path, pixels on the data path.
//!
//! A [`Camera`] is configured, armed and stopped by the thread that owns its handle.
//! Arming gives a [`FrameStream`], which moves to the thread that grabs frames.
//! The contracts fit GenICam (`Width`, `ExposureTime`, `TriggerMode`, block ids) and DCAM
//! (`SUBARRAY`, `EXPOSURETIME`, `TRIGGERSOURCE`, frame stamps) alike.

use crate::{BlockId, DeviceError, DeviceTime, Epoch, ExposureIndex, Properties};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::time::Duration;

/// Which camera this is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CameraIdentity {
    /// Maker.
    pub vendor: String,
    /// Model as the maker names it.
    pub model: String,
    /// Serial number; cameras are told apart by it and by nothing else.
    pub serial: String,
    /// Firmware or driver version.
    pub firmware: String,
    /// True for anything that is not a physical camera; shown in window, log and recording.
    pub simulated: bool,
}

/// Part of the sensor, in sensor pixels from its upper left corner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// First column.
    pub left: u32,
    /// First row.
    pub top: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Region {
    /// Pixels of the region.
    #[must_use]
    pub fn num_pixels(self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// What starts an exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TriggerMode {
    /// The camera itself, one exposure after another from the moment it is armed.
    FreeRunning,
    /// A pulse that all cameras receive; exposure 0 begins with the first pulse after arming.
    External,
}

/// What a camera is asked to do, or does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct CameraSettings {
    /// Part of the sensor that is read.
    pub region: Region,
    /// Time of one exposure.
    pub exposure: Duration,
    /// Time from the begin of one exposure to the begin of the next.
    pub period: Duration,
    /// What starts an exposure.
    pub trigger: TriggerMode,
}

/// What a camera can do.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CameraCapabilities {
    /// Columns of the sensor.
    pub sensor_width: u32,
    /// Rows of the sensor.
    pub sensor_height: u32,
    /// Position and size of a region are multiples of this many pixels.
    pub region_step: u32,
    /// Exposure times.
    pub exposure: RangeInclusive<Duration>,
    /// Exposure times are rounded to multiples of this.
    pub exposure_step: Duration,
    /// Shortest period at the full region.
    pub shortest_period: Duration,
    /// Largest count that a pixel can have.
    pub saturation_counts: u16,
}

/// Whether the pixels of a frame can be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrameStatus {
    /// Every pixel is there.
    Complete,
    /// Packets are missing; the pixels must not be used.
    Incomplete,
    /// The frame has not the size that was configured; the pixels must not be used.
    SizeMismatch,
}

/// What a camera says of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameInfo {
    /// The exposure, counted since arming.
    pub exposure: ExposureIndex,
    /// The camera's own counter, as it came.
    pub block_id: BlockId,
    /// How often the camera has restarted its counter since arming.
    pub epoch: Epoch,
    /// Begin of the exposure on the camera's clock.
    pub device_time: DeviceTime,
    /// Whether the pixels can be used.
    pub status: FrameStatus,
}

/// A camera's settings and state.
pub trait Camera: Send {
    /// Which camera this is.
    fn identity(&self) -> &CameraIdentity;

    /// What it can do.
    fn capabilities(&self) -> &CameraCapabilities;

    /// Sets what is wanted and returns what the camera really does, read back from it.
    ///
    /// # Errors
    /// [`OutOfRange`](crate::ErrorKind::OutOfRange) with the limit, and then nothing has changed;
    /// [`Busy`](crate::ErrorKind::Busy) while armed.
    fn configure(&mut self, want: &CameraSettings) -> Result<CameraSettings, DeviceError>;

    /// Makes the camera ready for its first exposure; exposures are counted from here.
    ///
    /// # Errors
    /// [`Busy`](crate::ErrorKind::Busy) when armed already or never configured.
    fn arm(&mut self) -> Result<Box<dyn FrameStream>, DeviceError>;

    /// Ends exposures; the stream delivers what is finished and then says
    /// [`Ended`](crate::ErrorKind::Ended). Stopping twice is no error.
    ///
    /// # Errors
    /// Whatever the camera says; it is then in an unknown state.
    fn stop(&mut self) -> Result<(), DeviceError>;

    /// Everything of the camera that a person may look at or change beside what a run sets; none where there is
    /// nothing.
    fn browse(&mut self) -> Option<&mut dyn Properties> {
        None
    }
}

/// The frames of one armed camera.
pub trait FrameStream: Send {
    /// Waits for the next frame and writes its pixels, row by row, into the caller's memory.
    ///
    /// Frames come in the order in which the camera delivers them, which may differ from the order of exposures.
    /// With a status other than [`FrameStatus::Complete`] the memory holds anything.
    ///
    /// # Errors
    /// [`Timeout`](crate::ErrorKind::Timeout), [`Ended`](crate::ErrorKind::Ended),
    /// [`Lost`](crate::ErrorKind::Lost); [`OutOfRange`](crate::ErrorKind::OutOfRange) unless `counts` has one
    /// place for each pixel of the configured region.
    fn next_frame(&mut self, counts: &mut [u16], timeout: Duration) -> Result<FrameInfo, DeviceError>;
}
