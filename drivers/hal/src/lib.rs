//! Contracts between the instrument and its devices: the words both sides use.
//!
//! | module | contract |
//! |---|---|
//! | [`camera`] | [`Camera`], settings and read-back; [`FrameStream`], pixels into the caller's memory |
//! | [`trigger`] | [`TriggerSource`], what starts the exposures of all cameras together |
//! | [`stage`] | [`Stage`], the sample along x and y; [`StopMotion`], past every queue |
//! | [`travel`] | [`SafeTravel`], long moves of the stage only with the objective retracted |
//! | [`focus`] | [`FocusDrive`], the piezo; [`FocusSensor`], which sees the error |
//! | [`laser`] | [`Laser`], with caps and read-back |
//! | [`gate`] | [`GateController`], which lets the light through and never without somebody holding it |
//! | [`property`] | [`Properties`], for the property browser |
//! | [`identity`] | [`DeviceIdentity`], told by the device itself |
//! | [`units`] | quantities with their unit, always finite |
//! | [`numbering`] | raw frame ids to [`ExposureIndex`], at the driver's edge |
//! | [`time`] | clocks that must never be mixed |
//! | [`clock`] | how cameras made of software wait for their time |
//! | [`error`] | [`DeviceError`]: which device, what happened, what the caller can do |
//! | [`conformance`] | what every driver must pass |
//!
//! In: nothing. Out: types and traits. Never: talks to a device, starts a thread; only [`clock`] reads one.

pub mod camera;
pub mod clock;
pub mod conformance;
pub mod error;
pub mod focus;
pub mod gate;
pub mod identity;
pub mod laser;
pub mod numbering;
pub mod property;
pub mod stage;
pub mod time;
pub mod travel;
pub mod trigger;
pub mod units;

pub use camera::{
    Camera, CameraCapabilities, CameraIdentity, CameraSettings, FrameInfo, FrameStatus, FrameStream, Region,
    TriggerMode,
};
pub use clock::{Bell, Clock, ManualClock, MonotonicClock};
pub use error::{DeviceError, ErrorKind};
pub use focus::{FocusDrive, FocusReading, FocusSensor, Toward};
pub use gate::{GateCapabilities, GateController, GatePattern, GateState, GateTrip};
pub use identity::DeviceIdentity;
pub use laser::{Emission, Interlock, Laser, LaserState};
pub use numbering::{BlockId, Epoch, ExposureNumbering, IdRule};
pub use property::{Properties, Property, PropertyRange, PropertyValue};
pub use stage::{Motion, Stage, StageEnvelope, StagePoint, StopMotion};
pub use time::{DeviceTime, HostTime};
pub use travel::{Route, SafeTravel};
pub use trigger::TriggerSource;
pub use units::{Celsius, Micrometers, MillimetersPerSecond, Milliwatts, Nanometers, NotFinite, Volts};

use serde::{Deserialize, Serialize};

/// The two physical detection channels behind the emission dichroic (paper, Fig. 1a).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Channel {
    /// Camera R: the short-wavelength side of the dichroic.
    Reflected,
    /// Camera T: the long-wavelength side of the dichroic.
    Transmitted,
}

impl Channel {
    /// Both channels in the order in which files and results list them.
    pub const BOTH: [Self; 2] = [Self::Reflected, Self::Transmitted];

    /// Place in arrays of both channels.
    #[must_use]
    pub fn index(self) -> usize {
        match self {
            Self::Reflected => 0,
            Self::Transmitted => 1,
        }
    }

    /// The other channel.
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::Reflected => Self::Transmitted,
            Self::Transmitted => Self::Reflected,
        }
    }

    /// `R` or `T`, as tables name it.
    #[must_use]
    pub fn letter(self) -> char {
        match self {
            Self::Reflected => 'R',
            Self::Transmitted => 'T',
        }
    }
}

impl std::fmt::Display for Channel {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "camera {}", self.letter())
    }
}

/// Exposures since the cameras were armed; never wraps; the pairing key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ExposureIndex(pub u64);
