//! The instrument file: what is connected where, its limits and its defaults.
//!
//! In: text in TOML. Out: [`Instrument`]. Never: takes a simulated device for one that is missing,
//! reads the keys of the simulator's `[faults]`, opens a device or a file.
//! Fails: [`InstrumentFaults`], all faults at once with line and remedy.

mod checked;
mod hardware;
mod raw;

use std::collections::BTreeMap;
use std::time::Duration;

use sofiscope_hal::{Channel, Region};

use super::Fault;

pub use hardware::{
    FocusEntry, GatesEntry, GatesKind, Hardware, LaserEntry, LaserLink, PortEntry, StageEntry, StageLink,
    VirtualEntry,
};

/// The version of the format that this program reads.
const VERSION: u64 = 1;

/// What stands behind a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraKind {
    /// The simulated sample; visibly labeled wherever the camera is named.
    Simulated,
    /// A camera that speaks GenICam.
    Genicam,
    /// A Hamamatsu camera through the maker's library.
    Dcam,
}

impl CameraKind {
    /// Every kind with the name it has in instrument files.
    pub const NAMES: [(&'static str, Self); 3] =
        [("simulated", Self::Simulated), ("genicam", Self::Genicam), ("dcam", Self::Dcam)];

    /// The name in instrument files.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize].0
    }
}

/// What starts the exposures of both cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TriggerKind {
    /// The simulated source of pulses.
    Simulated,
    /// Nothing: each camera runs by itself.
    FreeRunning,
    /// The controller of the gates, from the same clock.
    Gates,
    /// A TeensyPulseGenerator of its own.
    TeensyPulse,
}

impl TriggerKind {
    /// Every kind with the name it has in instrument files.
    pub const NAMES: [(&'static str, Self); 4] = [
        ("simulated", Self::Simulated),
        ("free-running", Self::FreeRunning),
        ("gates", Self::Gates),
        ("micromanager-teensy-pulse", Self::TeensyPulse),
    ];
}

/// One camera of the instrument.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraEntry {
    /// Its side of the dichroic.
    pub channel: Channel,
    /// What stands behind it.
    pub kind: CameraKind,
    /// The serial number it must have; `None` only for simulated cameras.
    pub serial: Option<String>,
    /// Network address, for cameras that are reached by one.
    pub address: Option<String>,
    /// Path of the maker's library, where it is not where the system looks for it.
    pub library: Option<String>,
    /// Time of one exposure where the plan names none.
    pub exposure: Duration,
    /// Time from exposure to exposure where the plan names none.
    pub period: Duration,
    /// Part of the sensor where the plan names none; `None` for the whole sensor.
    pub region: Option<Region>,
    /// The file of the maps of its pixels, from the folder of the instrument file; where given.
    pub maps_file: Option<String>,
}

/// What the simulated devices look at and how they behave.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    /// Name of a built-in scene, or path of a scene file.
    pub scene: String,
    /// Seed in place of the scene's own.
    pub seed: Option<u64>,
    /// Pace of the simulated clock: 1 for real time, 0 for as fast as frames are taken.
    pub speed: f64,
    /// Frames that are computed before and played again and again; `None` to compute each as it comes.
    pub film_frames: Option<u64>,
    /// Path of a file with faults to play.
    pub fault_scenario: Option<String>,
    /// The table `[faults]`, unread: its keys are the simulator's.
    pub faults: Option<toml::Table>,
}

/// What must not be exceeded.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Limits {
    /// Shortest time from exposure to exposure.
    pub shortest_period: Option<Duration>,
    /// Longest time of one exposure.
    pub longest_exposure: Option<Duration>,
    /// Most power of each laser line, milliwatts by nanometers; a line that is not listed does not exist.
    pub laser_power_mw: BTreeMap<u32, f64>,
}

/// An instrument that can be believed; made by [`Instrument::from_toml`] only.
#[derive(Debug, Clone, PartialEq)]
pub struct Instrument {
    name: String,
    cameras: Vec<CameraEntry>,
    trigger: TriggerKind,
    pixel_pitch_nm: f64,
    numerical_aperture: Option<f64>,
    dichroic: Option<String>,
    registration_file: Option<String>,
    response_file: Option<String>,
    limits: Limits,
    hardware: Hardware,
    simulation: Option<Simulation>,
}

/// Everything that is wrong with an instrument file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
pub struct InstrumentFaults {
    /// All faults in the order of lines.
    pub faults: Vec<Fault>,
}

impl Instrument {
    /// Reads an instrument file.
    ///
    /// # Errors
    /// All its faults.
    pub fn from_toml(text: &str) -> Result<Self, InstrumentFaults> {
        checked::read(text)
    }

    /// The simulated instrument that ships with the program, `config/simulated.toml`.
    #[must_use]
    pub fn simulated_toml() -> &'static str {
        include_str!("../../../config/simulated.toml")
    }

    /// The name of the instrument.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// One or two cameras, R before T.
    #[must_use]
    pub fn cameras(&self) -> &[CameraEntry] {
        &self.cameras
    }

    /// The camera of one channel.
    #[must_use]
    pub fn camera(&self, channel: Channel) -> Option<&CameraEntry> {
        self.cameras.iter().find(|camera| camera.channel == channel)
    }

    /// What starts the exposures.
    #[must_use]
    pub fn trigger(&self) -> TriggerKind {
        self.trigger
    }

    /// Size of a camera pixel in the sample, nanometers.
    #[must_use]
    pub fn pixel_pitch_nm(&self) -> f64 {
        self.pixel_pitch_nm
    }

    /// Numerical aperture of the objective, where given.
    #[must_use]
    pub fn numerical_aperture(&self) -> Option<f64> {
        self.numerical_aperture
    }

    /// The dichroic between the cameras, where given.
    #[must_use]
    pub fn dichroic(&self) -> Option<&str> {
        self.dichroic.as_deref()
    }

    /// The file of the registration of camera T onto camera R, from this file's folder; where given.
    #[must_use]
    pub fn registration_file(&self) -> Option<&str> {
        self.registration_file.as_deref()
    }

    /// The file of measured shares of the dyes' light, from this file's folder; where given.
    #[must_use]
    pub fn response_file(&self) -> Option<&str> {
        self.response_file.as_deref()
    }

    /// What must not be exceeded.
    #[must_use]
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Everything beside the cameras.
    #[must_use]
    pub fn hardware(&self) -> &Hardware {
        &self.hardware
    }

    /// The virtual instrument that ships with the program, `config/virtual.toml`.
    #[must_use]
    pub fn virtual_toml() -> &'static str {
        include_str!("../../../config/virtual.toml")
    }

    /// What simulated devices look at; there exactly if a device is simulated.
    #[must_use]
    pub fn simulation(&self) -> Option<&Simulation> {
        self.simulation.as_ref()
    }
}
