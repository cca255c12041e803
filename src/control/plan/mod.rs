//! What to do, as data: an acquisition plan in the shape of useq-schema's `MDASequence`.
//!
//! In: YAML or JSON. Out: [`Plan`], its [`AcquisitionEvent`]s and its duration; YAML again.
//! Never: touches a device, ignores a key, has a default for the power of a laser.
//! Fails: [`PlanFaults`], all faults at once with line and remedy; what is not supported is refused by name.
//!
//! ```yaml
//! time_plan: {interval: 0, loops: 4000}      # interval 0: as the cameras' period says
//! keep_shutter_open_across: [t]
//! metadata:
//!   sofiscope:
//!     cameras: {exposure_ms: 20.0, period_ms: 20.5}
//!     analysis: {order: 2, species: [Alexa Fluor 488, Atto 565], dichroic: zt 594 RDC}
//!     focus_lock: hold
//!     focus_gate_nm: 50                      # pairs farther out of focus are recorded and not analyzed
//! ```

mod checked;
mod events;
mod fits;
mod raw;
#[cfg(test)]
mod tests;
mod write;

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;
use serde_json::{Map, Value};
use sofiscope_hal::{Channel, Nanometers, Region, TriggerMode};

use super::stop_rule::StopRule;
use crate::config::{Fault, RawAnalysis};

pub use events::{AcquisitionEvent, Duties};
pub use raw::{
    RawAxes, RawCameras, RawChannel, RawInterval, RawParts, RawPlan, RawPosition, RawRegion, RawRegions,
    RawRun, RawStop, RawTime, RawTop,
};

/// The version of the additions under `metadata.sofiscope`.
pub const VERSION: u64 = 1;

/// Everything that is wrong with a plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
pub struct PlanFaults {
    /// All faults in the order of lines.
    pub faults: Vec<Fault>,
}

/// A place on the stage.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct StagePosition {
    /// Name in results.
    pub name: Option<String>,
    /// Micrometers; `None` for where the stage is.
    pub x_um: Option<f64>,
    /// Micrometers; `None` for where the stage is.
    pub y_um: Option<f64>,
    /// Micrometers; `None` for where the focus is.
    pub z_um: Option<f64>,
}

/// What the cameras are asked to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraWish {
    /// Time of one exposure.
    pub exposure: Duration,
    /// Time from exposure to exposure.
    pub period: Duration,
    /// Region of R and T; `None` for the instrument's.
    pub regions: [Option<Region>; 2],
    /// What starts exposures; `None` for the instrument's way.
    pub trigger: Option<TriggerMode>,
    /// What happens when a camera does something else.
    pub readback: Readback,
}

/// What happens when a camera does something else than it was asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Readback {
    /// The start is refused.
    #[default]
    Refuse,
    /// The run goes on with what the cameras really do, as long as both do the same.
    Accept,
}

/// What happens when the recording loses a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnRecordDrop {
    /// The run ends and keeps what it has.
    #[default]
    Stop,
    /// The run goes on and marks the gap.
    Continue,
}

impl OnRecordDrop {
    const NAMES: [(&'static str, Self); 2] = [("stop", Self::Stop), ("continue", Self::Continue)];
}

/// In which format frames are recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RecordingFormat {
    /// One BigTIFF per camera.
    #[default]
    OmeTiff,
    /// One OME-Zarr.
    OmeZarr,
    /// Nothing is recorded.
    None,
}

impl RecordingFormat {
    const NAMES: [(&'static str, Self); 3] =
        [("ome-tiff", Self::OmeTiff), ("ome-zarr", Self::OmeZarr), ("none", Self::None)];
}

/// Whether the focus lock holds during a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FocusWish {
    /// It is left as it is.
    #[default]
    Off,
    /// It must hold before the first exposure; a series during which it is lost says so.
    Hold,
}

impl FocusWish {
    const NAMES: [(&'static str, Self); 2] = [("none", Self::Off), ("hold", Self::Hold)];
}

const TRIGGERS: [(&str, TriggerMode); 2] =
    [("external", TriggerMode::External), ("free-running", TriggerMode::FreeRunning)];

/// A plan that can be believed; made by [`Plan::from_text`] or from a [`RawPlan`] only.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    uid: Option<String>,
    channel: Option<RawChannel>,
    positions: Vec<StagePosition>,
    loops: Option<u64>,
    cameras: CameraWish,
    analysis: RawAnalysis,
    laser_power_mw: BTreeMap<u32, f64>,
    stop: StopRule,
    on_record_drop: OnRecordDrop,
    recording: RecordingFormat,
    focus: FocusWish,
    focus_gate: Option<Nanometers>,
    metadata: Map<String, Value>,
}

impl Plan {
    /// Reads a plan in YAML or JSON.
    ///
    /// # Errors
    /// All its faults.
    pub fn from_text(text: &str) -> Result<Self, PlanFaults> {
        checked::read(text)
    }

    /// The stage positions, in order; empty for the place where the stage is.
    #[must_use]
    pub fn positions(&self) -> &[StagePosition] {
        &self.positions
    }

    /// Exposures of each series; `None` when only the stop rule ends it.
    #[must_use]
    pub fn loops(&self) -> Option<u64> {
        self.loops
    }

    /// What the cameras are asked to do.
    #[must_use]
    pub fn cameras(&self) -> &CameraWish {
        &self.cameras
    }

    /// Region that a plan wishes for a camera.
    #[must_use]
    pub fn region(&self, channel: Channel) -> Option<Region> {
        self.cameras.regions[channel.index()]
    }

    /// Settings of the live analysis, as a settings file of `analyze` has them; they are without faults.
    #[must_use]
    pub fn analysis(&self) -> &RawAnalysis {
        &self.analysis
    }

    /// Power of each laser line, milliwatts by nanometers; a line that is not listed stays off.
    #[must_use]
    pub fn laser_power_mw(&self) -> &BTreeMap<u32, f64> {
        &self.laser_power_mw
    }

    /// Ends of a series beside the number of loops.
    #[must_use]
    pub fn stop_rule(&self) -> &StopRule {
        &self.stop
    }

    /// What happens when the recording loses a frame.
    #[must_use]
    pub fn on_record_drop(&self) -> OnRecordDrop {
        self.on_record_drop
    }

    /// In which format frames are recorded.
    #[must_use]
    pub fn recording(&self) -> RecordingFormat {
        self.recording
    }

    /// Whether the focus lock holds.
    #[must_use]
    pub fn focus(&self) -> FocusWish {
        self.focus
    }

    /// Pairs with a larger focus error, and those without a lock, are recorded and not analyzed.
    #[must_use]
    pub fn focus_gate(&self) -> Option<Nanometers> {
        self.focus_gate
    }

    /// Metadata of other programs, as it came.
    #[must_use]
    pub fn metadata(&self) -> &Map<String, Value> {
        &self.metadata
    }
}
