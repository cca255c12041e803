//! What the sequencer needs beside cameras and trigger: the data path, light, stage and a clock.
//!
//! In: nothing. Out: traits. Never: talks to a device. Fails: as each trait says.

use std::collections::BTreeMap;

use serde::Serialize;
use sofiscope_hal::{CameraSettings, Channel, DeviceError, FrameStream, HostTime};

use super::plan::{AcquisitionEvent, StagePosition};
use super::run_state::FinishReason;

/// An armed camera on its way to the data path.
pub struct ArmedCamera {
    /// Its side of the dichroic.
    pub channel: Channel,
    /// What it really does.
    pub settings: CameraSettings,
    /// Its frames.
    pub stream: Box<dyn FrameStream>,
}

/// What failed on the way of the frames.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DataPathError {
    /// A camera is gone or answers nonsense.
    #[error("{0}")]
    Device(String),
    /// The recording failed.
    #[error("{0}")]
    Recording(String),
    /// Light was taken away for safety.
    #[error("{0}")]
    Safety(String),
}

impl From<DeviceError> for DataPathError {
    fn from(error: DeviceError) -> Self {
        Self::Device(error.to_string())
    }
}

/// How far the frames of a series have come.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PathProgress {
    /// Exposures that are settled: received, or known to be lost.
    pub exposures: u64,
    /// Frames that the recording lost.
    pub record_drops: u64,
    /// Signal-to-noise of each species; empty as long as there is none.
    pub snr: Vec<f64>,
    /// Resolution, nanometers.
    pub resolution_nm: Option<f64>,
    /// What failed, once.
    pub failure: Option<DataPathError>,
}

/// Whether something is still under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drain {
    /// Ask again.
    UnderWay,
    /// All is through.
    Done,
}

/// How a series ended; written exactly once for each series that was prepared.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StopRecord {
    /// Which series of the plan, from 0.
    pub series: usize,
    /// Why it ended.
    pub reason: FinishReason,
    /// Exposures that were settled.
    pub exposures: u64,
    /// Frames that the recording lost.
    pub record_drops: u64,
    /// Seconds of acquisition, pauses not counted.
    pub acquired_s: f64,
    /// Laser energy, millijoules of all lines together.
    pub dose_mj: f64,
    /// Everything that failed, in order, also while the series was being ended.
    pub failures: Vec<String>,
}

/// The way of the frames from the cameras on: grabbing, pairing, recording, analysis. No call waits for frames.
pub trait DataPath {
    /// Opens the recording and takes the streams over; frames are awaited from here on.
    ///
    /// # Errors
    /// [`DataPathError`]; nothing half-open is left.
    fn arm(&mut self, event: &AcquisitionEvent, cameras: Vec<ArmedCamera>) -> Result<(), DataPathError>;

    /// How far the frames have come.
    fn progress(&mut self) -> PathProgress;

    /// Lets everything under way through, after the cameras were stopped; called again while it is under way.
    ///
    /// # Errors
    /// [`DataPathError`]; draining is then over.
    fn drain(&mut self) -> Result<Drain, DataPathError>;

    /// Gives up what is under way and marks it as lost.
    fn abandon(&mut self);

    /// Closes the recording; nothing happens when none is open.
    ///
    /// # Errors
    /// [`DataPathError`]; the recording is then as good as it could be made.
    fn close(&mut self) -> Result<(), DataPathError>;

    /// Writes how the series ended; called once for every series that was prepared.
    ///
    /// # Errors
    /// [`DataPathError`].
    fn write_stop_record(&mut self, record: &StopRecord) -> Result<(), DataPathError>;
}

/// The lasers of the instrument.
pub trait Illumination: Send {
    /// Turns these lines on, milliwatts by nanometers, and all others off.
    ///
    /// # Errors
    /// [`OutOfRange`](sofiscope_hal::ErrorKind::OutOfRange) for a line or power that is not there, and then all are off.
    fn on(&mut self, power_mw: &BTreeMap<u32, f64>) -> Result<(), DeviceError>;

    /// Holds the light on for another moment; called in every round of the loop that makes a run progress, and
    /// without it the light goes.
    ///
    /// # Errors
    /// What has made everything dark meanwhile.
    fn hold(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    /// Turns all lines off; twice is no error.
    ///
    /// # Errors
    /// Whatever the lasers say; they are then to be taken as on.
    fn off(&mut self) -> Result<(), DeviceError>;
}

/// An instrument without lasers of its own: whatever lights the sample is not in its hand.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoLasers;

impl Illumination for NoLasers {
    fn on(&mut self, power_mw: &BTreeMap<u32, f64>) -> Result<(), DeviceError> {
        match power_mw.iter().find(|(_, power)| **power > 0.0) {
            None => Ok(()),
            Some((line, _)) => Err(DeviceError::new(
                sofiscope_hal::ErrorKind::OutOfRange,
                "lasers",
                format!(
                    "the plan wants light at {line} nm, and the instrument has no lasers; remove the line"
                ),
            )),
        }
    }

    fn off(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// The stage with the sample.
pub trait StageDrive: Send {
    /// Moves to a position and waits until it is reached.
    ///
    /// # Errors
    /// [`OutOfRange`](sofiscope_hal::ErrorKind::OutOfRange) beyond the limits, and then nothing has moved.
    fn move_to(&mut self, position: &StagePosition) -> Result<(), DeviceError>;
}

/// The focus lock.
pub trait FocusHold: Send {
    /// Locks, and waits until it holds.
    ///
    /// # Errors
    /// Why it does not hold; the drive then stays where it is.
    fn lock(&mut self) -> Result<(), DeviceError>;

    /// Looks whether it still holds, and remembers how well.
    ///
    /// # Errors
    /// Why it holds no longer.
    fn look(&mut self) -> Result<(), DeviceError>;
}

/// The monotonic clock of this computer.
pub trait Clock {
    /// Now.
    fn now(&self) -> HostTime;
}
