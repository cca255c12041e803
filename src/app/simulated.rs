//! The simulated instrument as a rig for the sequencer; chosen by name in the configuration, never as a fallback.

use super::hardware::StageHandle;
use crate::acquisition::{FocusGauge, Patience};
use crate::config::TriggerKind;
use crate::control::contracts::{Illumination, StageDrive};
use crate::control::plan::{
    AcquisitionEvent, CameraWish, Duties, FocusWish, OnRecordDrop, Readback, RecordingFormat,
};
use crate::control::sequencer::{CameraStation, Devices};
use crate::control::stop_rule::StopRule;
use sofiscope_hal::{Camera, CameraIdentity, Channel, DeviceError, Region, TriggerSource};
use sofiscope_sim::instrument::Pace;
use sofiscope_sim::{InstrumentSettings, SimulatedInstrument, Source};
use std::collections::BTreeMap;
use std::time::Duration;

/// Devices and who they are.
pub(super) struct Rig {
    pub(super) devices: Devices,
    pub(super) facts: RigFacts,
}

/// What does not change while devices are open.
#[derive(Debug, Clone)]
pub(super) struct RigFacts {
    pub(super) identities: [CameraIdentity; 2],
    /// Columns and rows of the sensors.
    pub(super) sensors: [(u32, u32); 2],
    pub(super) shortest_periods: [Duration; 2],
    pub(super) saturation_counts: [u16; 2],
    /// What the focus lock says of every frame.
    pub(super) focus: FocusGauge,
}

/// Lasers that light nothing; the simulated sample shines by itself.
#[derive(Debug, Clone, Copy)]
struct SimulatedLasers;

impl Illumination for SimulatedLasers {
    fn on(&mut self, power_mw: &BTreeMap<u32, f64>) -> Result<(), DeviceError> {
        tracing::info!(?power_mw, "simulated lasers on");
        Ok(())
    }

    fn off(&mut self) -> Result<(), DeviceError> {
        tracing::info!("simulated lasers off");
        Ok(())
    }
}

/// Both simulated cameras and their trigger in front of a source.
pub(super) fn rig(source: Source, settings: InstrumentSettings, trigger: TriggerKind) -> Rig {
    rig_of(&SimulatedInstrument::new(source, settings), trigger, None)
}

/// The devices of a simulated microscope, with its stage.
pub(super) fn rig_of(
    instrument: &SimulatedInstrument,
    trigger: TriggerKind,
    stage: Option<&StageHandle>,
) -> Rig {
    let cameras = instrument.cameras();
    let identities = cameras.each_ref().map(|camera| camera.identity().clone());
    let capabilities = cameras.each_ref().map(|camera| camera.capabilities().clone());
    let stations = Channel::BOTH.into_iter().zip(cameras).map(|(channel, camera)| {
        let (width, height) = (camera.capabilities().sensor_width, camera.capabilities().sensor_height);
        let region = Region { left: 0, top: 0, width, height };
        CameraStation { channel, camera: Box::new(camera), region }
    });
    let trigger: Option<Box<dyn TriggerSource>> = match trigger {
        TriggerKind::Simulated => Some(Box::new(instrument.trigger())),
        // Only simulated cameras are in front of a simulated source, and only its own pulses reach them.
        TriggerKind::FreeRunning | TriggerKind::Gates | TriggerKind::TeensyPulse => None,
    };
    let devices = Devices::new(
        stations.collect(),
        trigger,
        Box::new(SimulatedLasers),
        stage.map(|stage| Box::new(stage.clone()) as Box<dyn StageDrive>),
    );
    let facts = RigFacts {
        identities,
        sensors: capabilities.each_ref().map(|camera| (camera.sensor_width, camera.sensor_height)),
        shortest_periods: capabilities.each_ref().map(|camera| camera.shortest_period),
        saturation_counts: capabilities.each_ref().map(|camera| camera.saturation_counts),
        focus: FocusGauge::default(),
    };
    Rig { devices, facts }
}

/// Cameras without a clock wait; those with one do not.
pub(super) fn patience_of(pace: Pace) -> Patience {
    match pace {
        Pace::Unpaced => Patience::Patient,
        Pace::RealTime { .. } => Patience::Live,
    }
}

/// One series of exposures without anything else.
pub(super) fn series(period: Duration, exposures: u64, recording: RecordingFormat) -> AcquisitionEvent {
    AcquisitionEvent {
        series: 0,
        position: None,
        cameras: CameraWish {
            exposure: period,
            period,
            regions: [None, None],
            trigger: None,
            readback: Readback::Accept,
        },
        exposures: Some(exposures),
        stop: StopRule::default(),
        laser_power_mw: BTreeMap::new(),
        duties: Duties {
            recording,
            on_record_drop: OnRecordDrop::Stop,
            focus: FocusWish::Off,
            focus_gate: None,
        },
    }
}
