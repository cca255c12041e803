//! A simulated camera: settings, arming, stopping.
//!
//! In: settings. Out: what the camera does, and a stream when armed.
//! Never: waits. Fails: as [`Camera`] says.
//! The light of an exposure is that of the scene, whatever exposure time is set.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::time::Duration;

use sofiscope_hal::clock::nanoseconds;
use sofiscope_hal::{
    Camera, CameraCapabilities, CameraIdentity, CameraSettings, Channel, DeviceError, ErrorKind, FrameStream,
    Properties, Property, PropertyValue, Region,
};

use super::cooling::Cooling;
use super::oracle::Oracle;
use super::schedule::{Schedule, Timing};
use super::settings::CameraBehavior;
use super::source::{Source, Viewfinder};
use super::stage::SamplePlace;
use super::stream::{Parts, SimulatedStream};

/// Readout of one row of an ORCA-Flash4.0: two rows at once in 9.744 us.
const ROW_READOUT_NS: u64 = 4872;
const EXPOSURE_STEP: Duration = Duration::from_micros(1);
const LONGEST_EXPOSURE: Duration = Duration::from_secs(10);
const LONGEST_PERIOD: Duration = Duration::from_secs(3600);
/// Time on the camera's clock between one arming and the next.
const BETWEEN_RUNS_NS: u64 = 100_000_000_000;

/// What makes a simulated camera.
#[derive(Debug, Clone)]
pub(super) struct Body {
    pub(super) channel: Channel,
    pub(super) source: Source,
    pub(super) seed: u64,
    pub(super) limit: u64,
    pub(super) behavior: CameraBehavior,
    pub(super) timing: Arc<Timing>,
    pub(super) oracle: Oracle,
    pub(super) dead: Arc<AtomicBool>,
    pub(super) place: SamplePlace,
}

/// A simulated camera.
#[derive(Debug)]
pub struct SimulatedCamera {
    body: Body,
    identity: CameraIdentity,
    capabilities: CameraCapabilities,
    settings: Option<CameraSettings>,
    armed: Option<Arc<Schedule>>,
    runs: u64,
    cooling: Cooling,
}

impl SimulatedCamera {
    pub(super) fn new(body: Body) -> Self {
        let identity = CameraIdentity {
            vendor: "sofiscope".into(),
            model: "simulated camera".into(),
            serial: format!("SIM-{}", body.channel.letter()),
            firmware: env!("CARGO_PKG_VERSION").into(),
            simulated: true,
        };
        let [height, width] = body.source.size();
        let capabilities = CameraCapabilities {
            sensor_width: width as u32,
            sensor_height: height as u32,
            region_step: 1,
            exposure: EXPOSURE_STEP..=LONGEST_EXPOSURE,
            exposure_step: EXPOSURE_STEP,
            shortest_period: readout(height as u32),
            saturation_counts: body.source.saturation_counts(body.channel),
        };
        Self {
            body,
            identity,
            capabilities,
            settings: None,
            armed: None,
            runs: 0,
            cooling: Cooling::default(),
        }
    }

    fn device(&self) -> String {
        format!("{} ({}, S/N {})", self.body.channel, self.identity.model, self.identity.serial)
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.device(), message)
    }

    fn check_alive(&self) -> Result<(), DeviceError> {
        if self.body.dead.load(SeqCst) {
            return Err(self.error(ErrorKind::Lost, "does not answer; check cable and power"));
        }
        Ok(())
    }

    fn check_region(&self, region: Region) -> Result<(), DeviceError> {
        let (width, height) = (self.capabilities.sensor_width, self.capabilities.sensor_height);
        let fits = |start: u32, length: u32, limit: u32| {
            length > 0 && start.checked_add(length).is_some_and(|end| end <= limit)
        };
        if fits(region.left, region.width, width) && fits(region.top, region.height, height) {
            return Ok(());
        }
        let message = format!(
            "a region of {} x {} pixels from column {}, row {} is not within the {width} x {height} pixels \
             of the sensor",
            region.width, region.height, region.left, region.top
        );
        Err(self.error(ErrorKind::OutOfRange, message))
    }
}

impl Camera for SimulatedCamera {
    fn identity(&self) -> &CameraIdentity {
        &self.identity
    }

    fn capabilities(&self) -> &CameraCapabilities {
        &self.capabilities
    }

    fn configure(&mut self, want: &CameraSettings) -> Result<CameraSettings, DeviceError> {
        self.check_alive()?;
        if self.armed.is_some() {
            return Err(self.error(ErrorKind::Busy, "is armed; stop it before changing settings"));
        }
        self.check_region(want.region)?;
        if !self.capabilities.exposure.contains(&want.exposure) {
            let (shortest, longest) = self.capabilities.exposure.clone().into_inner();
            let message =
                format!("an exposure of {:?} is outside {shortest:?} to {longest:?}", want.exposure);
            return Err(self.error(ErrorKind::OutOfRange, message));
        }
        if want.period > LONGEST_PERIOD {
            let message = format!("a period of {:?} is above {LONGEST_PERIOD:?}", want.period);
            return Err(self.error(ErrorKind::OutOfRange, message));
        }
        let step_ns = nanoseconds(EXPOSURE_STEP);
        let exposure = Duration::from_nanos((nanoseconds(want.exposure) + step_ns / 2) / step_ns * step_ns);
        let period = want.period.max(exposure).max(readout(want.region.height));
        let settings = CameraSettings { exposure, period, ..*want };
        self.settings = Some(settings);
        Ok(settings)
    }

    fn arm(&mut self) -> Result<Box<dyn FrameStream>, DeviceError> {
        self.check_alive()?;
        let Some(settings) = self.settings else {
            return Err(self.error(ErrorKind::Busy, "was never configured; configure it first"));
        };
        if self.armed.is_some() {
            return Err(self.error(ErrorKind::Busy, "is armed already; stop it first"));
        }
        if self.body.behavior.faults.start_fails {
            return Err(self.error(ErrorKind::Fault, "cannot start exposures (status 0x8001, simulated)"));
        }
        let schedule = self.body.timing.schedule(self.body.channel, &settings);
        let body = &self.body;
        let offset_ns = nanoseconds(body.behavior.clock.offset);
        let parts = Parts {
            device: self.device(),
            channel: body.channel,
            seed: body.seed,
            behavior: body.behavior.clone(),
            timing: body.timing.clone(),
            schedule: schedule.clone(),
            view: Viewfinder::new(body.source.clone(), body.channel, settings.region, body.place.clone()),
            record: body.oracle.begin(body.channel),
            source_end: body.source.end(),
            limit: body.limit,
            clock_ns: offset_ns.wrapping_add(self.runs.wrapping_mul(BETWEEN_RUNS_NS)),
            dead: body.dead.clone(),
        };
        self.runs += 1;
        self.armed = Some(schedule);
        Ok(Box::new(SimulatedStream::new(parts)))
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        if let Some(schedule) = self.armed.take() {
            schedule.stop();
        }
        self.check_alive()
    }

    fn browse(&mut self) -> Option<&mut dyn Properties> {
        Some(self)
    }
}

impl Properties for SimulatedCamera {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        self.check_alive()?;
        Ok(self.cooling.properties())
    }

    fn set_property(&mut self, name: &str, value: &PropertyValue) -> Result<(), DeviceError> {
        self.check_alive()?;
        if self.armed.is_some() {
            return Err(self.error(ErrorKind::Busy, format!("is armed; stop it before changing '{name}'")));
        }
        self.cooling =
            self.cooling.with(name, value).map_err(|why| self.error(ErrorKind::OutOfRange, why))?;
        Ok(())
    }
}

impl Drop for SimulatedCamera {
    fn drop(&mut self) {
        if let Some(schedule) = self.armed.take() {
            schedule.stop();
        }
    }
}

/// Shortest period of a region with this many rows.
fn readout(rows: u32) -> Duration {
    Duration::from_nanos(ROW_READOUT_NS * u64::from(rows))
}
