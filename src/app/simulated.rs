//! The simulated instrument as a rig for the sequencer; chosen by name in the configuration, never as a fallback.

use crate::acquisition::Patience;
use crate::control::contracts::NoLasers;
use crate::control::plan::{AcquisitionEvent, CameraWish, Duties, OnRecordDrop, Readback, RecordingFormat};
use crate::control::sequencer::{CameraStation, Devices};
use crate::control::stop_rule::StopRule;
use sofiscope_hal::{Camera, CameraIdentity, Channel, Region};
use sofiscope_sim::instrument::Pace;
use sofiscope_sim::{InstrumentSettings, Oracle, SimulatedInstrument, Source};
use std::collections::BTreeMap;
use std::time::Duration;

/// Devices and who they are.
pub(super) struct Rig {
    pub(super) devices: Devices,
    pub(super) identities: [CameraIdentity; 2],
    /// Knows what the simulated cameras did.
    pub(super) oracle: Oracle,
}

/// Both simulated cameras and their trigger in front of a source.
pub(super) fn rig(source: Source, settings: InstrumentSettings) -> Rig {
    let instrument = SimulatedInstrument::new(source, settings);
    let cameras = instrument.cameras();
    let identities = cameras.each_ref().map(|camera| camera.identity().clone());
    let stations = Channel::BOTH.into_iter().zip(cameras).map(|(channel, camera)| {
        let (width, height) = (camera.capabilities().sensor_width, camera.capabilities().sensor_height);
        let region = Region { left: 0, top: 0, width, height };
        CameraStation { channel, camera: Box::new(camera), region }
    });
    let trigger = Box::new(instrument.trigger());
    let devices = Devices::new(stations.collect(), Some(trigger), Box::new(NoLasers), None);
    Rig { devices, identities, oracle: instrument.oracle() }
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
        duties: Duties { recording, on_record_drop: OnRecordDrop::Stop },
    }
}
