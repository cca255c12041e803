//! The devices in the sequencer's hand.
//!
//! In: what a step of the plan wants. Out: devices that do it, and what they really do.
//! Never: stops at the first device that fails to stop. Fails: [`DataPathError::Device`] with the device's own words.

use std::collections::BTreeMap;
use std::time::Duration;

use sofiscope_hal::{
    Camera, CameraSettings, Channel, DeviceError, ErrorKind, Properties, Property, PropertyValue, Region,
    TriggerMode, TriggerSource,
};

use super::readback::mismatches;
use crate::control::contracts::{ArmedCamera, DataPathError, FocusHold, Illumination, StageDrive};
use crate::control::plan::{AcquisitionEvent, FocusWish, Readback};

/// One camera in its place.
pub struct CameraStation {
    /// Its side of the dichroic.
    pub channel: Channel,
    /// The camera.
    pub camera: Box<dyn Camera>,
    /// Region where the plan names none.
    pub region: Region,
}

/// Everything that the sequencer moves.
pub struct Devices {
    cameras: Vec<CameraStation>,
    trigger: Option<Box<dyn TriggerSource>>,
    pacer: Option<Box<dyn TriggerSource>>,
    lasers: Box<dyn Illumination>,
    stage: Option<Box<dyn StageDrive>>,
    focus: Option<Box<dyn FocusHold>>,
    actual: Vec<CameraSettings>,
}

impl Devices {
    /// One or two cameras, what starts their exposures (nothing where they run by themselves), lasers and stage.
    #[must_use]
    pub fn new(
        cameras: Vec<CameraStation>,
        trigger: Option<Box<dyn TriggerSource>>,
        lasers: Box<dyn Illumination>,
        stage: Option<Box<dyn StageDrive>>,
    ) -> Self {
        Self { cameras, trigger, pacer: None, lasers, stage, focus: None, actual: Vec::new() }
    }

    /// The same with something that holds cameras which otherwise run by themselves, as a replay does.
    #[must_use]
    pub fn with_pacer(mut self, pacer: Box<dyn TriggerSource>) -> Self {
        self.pacer = Some(pacer);
        self
    }

    /// The same with a focus lock.
    #[must_use]
    pub fn with_focus(mut self, focus: Option<Box<dyn FocusHold>>) -> Self {
        self.focus = focus;
        self
    }

    /// What each camera really does since the last setting up, in the order of the cameras.
    #[must_use]
    pub fn actual(&self) -> &[CameraSettings] {
        &self.actual
    }

    /// All properties of a camera with their present values; none of a camera that has nothing to browse.
    ///
    /// # Errors
    /// Whatever the camera says.
    pub fn camera_properties(&mut self, channel: Channel) -> Result<Vec<Property>, DeviceError> {
        self.browse(channel).map_or(Ok(Vec::new()), Properties::properties)
    }

    /// Changes a property of a camera that is not at work.
    ///
    /// # Errors
    /// [`OutOfRange`](ErrorKind::OutOfRange) where there is no such camera or property; whatever the camera says.
    pub fn set_camera_property(
        &mut self,
        channel: Channel,
        name: &str,
        value: &PropertyValue,
    ) -> Result<(), DeviceError> {
        match self.browse(channel) {
            Some(properties) => properties.set_property(name, value),
            None => Err(DeviceError::new(
                ErrorKind::OutOfRange,
                channel.to_string(),
                format!("has no property '{name}'"),
            )),
        }
    }

    fn browse(&mut self, channel: Channel) -> Option<&mut dyn Properties> {
        self.cameras.iter_mut().find(|station| station.channel == channel)?.camera.browse()
    }

    pub(super) fn is_triggered(&self) -> bool {
        self.actual.iter().any(|settings| settings.trigger == TriggerMode::External)
    }

    /// Whether exposures can be held back for a while.
    pub(super) fn can_pause(&self) -> bool {
        self.pacer.is_some() || self.is_triggered()
    }

    /// Time from exposure to exposure that every camera can follow.
    pub(super) fn period(&self) -> Option<Duration> {
        self.actual.iter().map(|settings| settings.period).max()
    }

    /// Moves to the position, configures all cameras and compares what they read back.
    pub(super) fn set_up(&mut self, event: &AcquisitionEvent) -> Result<(), DataPathError> {
        if let Some(position) = &event.position {
            let stage = self.stage.as_mut().ok_or_else(|| {
                device("the plan names a stage position, and the instrument has no stage; remove stage_positions")
            })?;
            stage.move_to(position).map_err(DataPathError::from)?;
        }
        if event.duties.focus == FocusWish::Hold {
            let focus = self.focus.as_mut().ok_or_else(|| {
                device("the plan wants the focus lock to hold, and the instrument has none; write focus_lock: none")
            })?;
            focus.lock().map_err(DataPathError::from)?;
        }
        self.actual.clear();
        let mut complaints = Vec::new();
        for station in &mut self.cameras {
            let want = CameraSettings {
                region: event.cameras.regions[station.channel.index()].unwrap_or(station.region),
                exposure: event.cameras.exposure,
                period: event.cameras.period,
                trigger: event.cameras.trigger.unwrap_or(match self.trigger {
                    Some(_) => TriggerMode::External,
                    None => TriggerMode::FreeRunning,
                }),
            };
            let actual = station.camera.configure(&want).map_err(DataPathError::from)?;
            let step = station.camera.capabilities().exposure_step;
            let differences = mismatches(&want, &actual, step);
            complaints.extend(differences.iter().map(|found| format!("{}: {found}", station.channel)));
            self.actual.push(actual);
        }
        if !complaints.is_empty() && event.cameras.readback == Readback::Refuse {
            let list = complaints.join("; ");
            return Err(device(&format!(
                "{list}; change the plan, or write accept_readback: true to take what the cameras do"
            )));
        }
        self.compare_cameras()?;
        if self.is_triggered() && self.trigger.is_none() {
            return Err(device("the plan wants an external trigger, and the instrument has none"));
        }
        Ok(())
    }

    /// Frames of both cameras make pairs only if size and pace agree.
    fn compare_cameras(&self) -> Result<(), DataPathError> {
        let [r, t] = self.actual.as_slice() else {
            return Ok(());
        };
        let same_size = (r.region.width, r.region.height) == (t.region.width, t.region.height);
        if same_size && r.exposure == t.exposure && r.period == t.period && r.trigger == t.trigger {
            return Ok(());
        }
        Err(device(&format!(
            "the cameras do different things: {} x {} pixels, exposure {:?}, period {:?} and \
             {} x {} pixels, exposure {:?}, period {:?}; choose values that both can do",
            r.region.width,
            r.region.height,
            r.exposure,
            r.period,
            t.region.width,
            t.region.height,
            t.exposure,
            t.period,
        )))
    }

    /// Arms all cameras; when one fails, the teardown stops those before it.
    pub(super) fn arm(&mut self) -> Result<Vec<ArmedCamera>, DataPathError> {
        let stations = self.cameras.iter_mut().zip(&self.actual);
        stations
            .map(|(station, &settings)| {
                let stream = station.camera.arm().map_err(DataPathError::from)?;
                Ok(ArmedCamera { channel: station.channel, settings, stream })
            })
            .collect()
    }

    pub(super) fn lasers_on(&mut self, power_mw: &BTreeMap<u32, f64>) -> Result<(), DataPathError> {
        if power_mw.is_empty() {
            return Ok(());
        }
        self.lasers.on(power_mw).map_err(DataPathError::from)
    }

    pub(super) fn lasers_off(&mut self) -> Result<(), DataPathError> {
        self.lasers.off().map_err(DataPathError::from)
    }

    /// Holds the light on; whatever took it away is a matter of safety.
    pub(super) fn hold(&mut self) -> Result<(), DataPathError> {
        self.lasers.hold().map_err(|error| DataPathError::Safety(error.to_string()))
    }

    /// Looks at the focus lock, where there is one; a lost lock is told and ends nothing.
    pub(super) fn look_at_focus(&mut self) -> Result<(), DataPathError> {
        self.focus.as_mut().map_or(Ok(()), |focus| focus.look().map_err(DataPathError::from))
    }

    pub(super) fn start_trigger(&mut self, pulses: Option<u64>) -> Result<(), DataPathError> {
        let period = self.period().unwrap_or_default();
        if let Some(pacer) = &mut self.pacer {
            pacer.start(period, pulses)?;
        }
        match &mut self.trigger {
            Some(trigger) if self.actual.iter().any(|settings| settings.trigger == TriggerMode::External) => {
                trigger.start(period, pulses).map_err(DataPathError::from)
            }
            _ => Ok(()),
        }
    }

    pub(super) fn stop_trigger(&mut self) -> Result<(), DataPathError> {
        let outcomes = [&mut self.trigger, &mut self.pacer].map(|source| match source {
            Some(source) => source.stop(),
            None => Ok(()),
        });
        outcomes.into_iter().collect::<Result<(), _>>().map_err(DataPathError::from)
    }

    /// Stops every camera, also those behind one that fails to stop.
    pub(super) fn stop_cameras(&mut self) -> Result<(), DataPathError> {
        let outcomes: Vec<_> = self.cameras.iter_mut().map(|station| station.camera.stop()).collect();
        outcomes.into_iter().collect::<Result<(), _>>().map_err(DataPathError::from)
    }
}

/// Whatever way the sequencer goes, a panic included, nothing stays on behind it.
impl Drop for Devices {
    fn drop(&mut self) {
        for outcome in [self.lasers_off(), self.stop_trigger(), self.stop_cameras()] {
            if let Err(error) = outcome {
                tracing::error!("a device could not be turned off at the end: {error}");
            }
        }
    }
}

fn device(message: &str) -> DataPathError {
    DataPathError::Device(message.to_owned())
}
