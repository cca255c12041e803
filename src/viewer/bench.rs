//! What the window sees of the instrument, and what it can ask for.
//!
//! In: nothing. Out: [`BenchStatus`] and [`Pictures`] as data, [`BenchCommand`]s, the trait [`Bench`] between both.
//! Never: waits, talks to a device. Fails: a command that cannot be taken says so.

mod colors;
mod registration;
mod status;

pub use colors::{ColorsAsk, ColorsStatus, ColorsStep, DyeInUse, FoundShare, MarkedRegions};
pub use registration::{
    FoundRegistration, RegisterBy, RegistrationAsk, RegistrationStatus, RegistrationStep,
};
pub use status::{
    Activity, BenchStatus, DeviceCard, Event, FocusStatus, Gravity, InstrumentCard, LaserStatus, PropertyRow,
    ReplayStatus, RunNumbers, StageStatus,
};

use super::as_seen::AsSeen;
use crate::reconstruction::{CameraLook, SofiLook};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// The instrument behind the window. No call waits.
pub trait Bench {
    /// How things stand now; the same `Arc` as long as nothing has changed.
    fn status(&self) -> Arc<BenchStatus>;

    /// The newest pictures; the same `Arc`s as long as there are no newer ones.
    fn pictures(&self) -> Pictures;

    /// Asks for something. What becomes of it is told by the status and its events.
    ///
    /// # Errors
    /// [`Refused`] when too much is asked for already.
    fn ask(&self, command: BenchCommand) -> Result<(), Refused>;

    /// STOP: lasers off, motion stopped, run aborted; never queued behind other commands.
    fn stop(&self);

    /// Writes a picture of a pane into a file that must not exist yet; what becomes of it is told by the events.
    ///
    /// # Errors
    /// [`Refused`] when too much is written already.
    fn keep_picture(&self, picture: AsSeen) -> Result<(), Refused>;

    /// Settings of the analysis or plan that a text describes: faults for people, or an estimate.
    ///
    /// # Errors
    /// All faults of the plan, one per line.
    fn judge_plan(&self, text: &str) -> Result<PlanEstimate, String>;
}

/// Too much is asked for already, or the instrument is gone.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the instrument is busy with earlier commands; try again")]
pub struct Refused;

/// The newest pictures.
#[derive(Debug, Clone, Default)]
pub struct Pictures {
    /// Both cameras.
    pub cameras: Option<Arc<CameraLook>>,
    /// The running result.
    pub sofi: Option<Arc<SofiLook>>,
}

/// What can be asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum BenchCommand {
    /// Open the simulated microscope.
    OpenSimulated,
    /// Open the instrument of a file.
    OpenInstrument(PathBuf),
    /// Close the instrument.
    CloseInstrument,
    /// Show the cameras and the running analysis, recording nothing; again with other settings while it goes on.
    Live(LiveSettings),
    /// Carry out a plan; recording and results go to a new directory.
    Run {
        /// YAML or JSON.
        plan: String,
        /// Must not exist yet.
        out: PathBuf,
    },
    /// Play a recording.
    Replay {
        /// The recording's directory.
        recording: PathBuf,
        /// Times the original speed; infinite for as fast as possible.
        speed: f64,
        /// First exposure to play.
        from: u64,
    },
    /// Hold the run or replay, and go on after it.
    Pause,
    /// Go on after a pause.
    Resume,
    /// Another speed of the replay under way from now on; infinite for as fast as possible.
    ReplaySpeed(f64),
    /// Go on with another exposure of the recording; the running result begins anew there.
    Seek(u64),
    /// Something of the focus lock.
    Focus(FocusAsk),
    /// End what is under way in good order.
    Finish,
    /// Move the stage to a place, micrometers.
    MoveStage {
        /// Along the rows of the camera.
        x_um: f64,
        /// Along the columns.
        y_um: f64,
    },
    /// Write the images of the last run or live view as they are now into a new directory.
    SaveResults(PathBuf),
    /// Something of the registration of the cameras.
    Registration(RegistrationAsk),
    /// Something of how the dyes divide between the cameras.
    Colors(ColorsAsk),
    /// Change a property of a camera, see [`DeviceCard::properties`]; refused unless nothing is under way.
    SetProperty {
        /// Role of the device.
        device: String,
        /// Name of the property.
        property: String,
        /// As typed.
        value: String,
    },
}

/// What can be asked of the focus lock.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum FocusAsk {
    /// Find the signal and hold it.
    Lock,
    /// Stand still.
    Release,
    /// Sweep around the present place and learn how signal and focus error go together.
    Calibrate,
    /// Move the drive by this many nanometers, while the lock is off.
    MoveBy(f64),
}

/// How the live view is taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LiveSettings {
    /// Time of one exposure and from exposure to exposure.
    pub exposure: Duration,
    /// Left, top, width, height in camera pixels; none for the whole sensor.
    pub region: Option<[u32; 4]>,
    /// Order of the cumulants.
    pub order: usize,
    /// Exposures per subsequence.
    pub subsequence: u64,
    /// Dyes by their names; empty for those of the instrument.
    pub species: Vec<String>,
    /// Laser lines that the person has armed, milliwatts by nanometers.
    pub laser_power_mw: BTreeMap<u32, f64>,
    /// Whether the focus lock shall hold.
    pub hold_focus: bool,
}

impl Default for LiveSettings {
    fn default() -> Self {
        Self {
            exposure: Duration::from_millis(20),
            region: None,
            order: 2,
            subsequence: 200,
            species: Vec::new(),
            laser_power_mw: BTreeMap::new(),
            hold_focus: false,
        }
    }
}

/// What a plan will do.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PlanEstimate {
    /// One line per check: passed, warned or failed, and why.
    pub checks: Vec<(Gravity, String)>,
    /// Whether it may begin.
    pub may_begin: bool,
    /// How long it takes, if that is certain.
    pub duration: Option<Duration>,
    /// Bytes that it records.
    pub bytes: Option<u64>,
    /// Series and exposures of each.
    pub series: usize,
    /// Exposures of each series.
    pub exposures: Option<u64>,
}
