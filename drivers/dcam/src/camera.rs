//! One camera behind DCAM-API: settings, arming, stopping.
//!
//! In: serial number, [`DcamOptions`], settings. Out: settings read back, and a [`DcamStream`] when armed.
//! Never: opens a camera by its place in the list; changes a setting while armed.
//! Fails: as [`Camera`] says; after a setting was refused half-way the camera must be configured anew.

use std::sync::Arc;
use std::time::Duration;

use sofiscope_hal::{
    Camera, CameraCapabilities, CameraIdentity, CameraSettings, DeviceError, ErrorKind, FrameStream,
    Properties,
};

use crate::api::{Dcam, Device};
use crate::capture::{Capture, LossCounts, Losses};
use crate::ffi::ids::{Id, StringId, mode};
use crate::settings::{self, DcamOptions, REGION_STEP};
use crate::stream::DcamStream;

/// A camera that DCAM-API controls: an ORCA-Flash4.0.
#[derive(Debug)]
pub struct DcamCamera {
    pub(crate) device: Arc<Device>,
    identity: CameraIdentity,
    capabilities: CameraCapabilities,
    options: DcamOptions,
    settings: Option<CameraSettings>,
    armed: Option<Arc<Capture>>,
    /// The run before, of which frames may still be read.
    finished: Option<Arc<Capture>>,
    losses: Arc<LossCounts>,
}

impl DcamCamera {
    /// Opens the camera with a serial number, as in `S/N: 100123` or `100123`, and reads what it can do.
    ///
    /// # Errors
    /// [`Identity`](ErrorKind::Identity) when no camera has it, with those that are there;
    /// [`Busy`](ErrorKind::Busy) when another program uses it; whatever the camera says.
    pub fn open(dcam: &Arc<Dcam>, serial: &str, options: DcamOptions) -> Result<Self, DeviceError> {
        let mut device = dcam.device(serial)?;
        let identity = identity_of(&device)?;
        device.rename(format!("camera {} (S/N {})", identity.model, identity.serial));
        let capabilities = capabilities_of(&device)?;
        Ok(Self {
            device: Arc::new(device),
            identity,
            capabilities,
            options,
            settings: None,
            armed: None,
            finished: None,
            losses: Arc::default(),
        })
    }

    /// What the present or last run lost.
    #[must_use]
    pub fn losses(&self) -> Losses {
        self.losses.read()
    }

    /// What the configuration said.
    #[must_use]
    pub fn options(&self) -> DcamOptions {
        self.options
    }

    /// Whether it is armed.
    #[must_use]
    pub fn is_armed(&self) -> bool {
        self.armed.is_some()
    }

    pub(crate) fn capture(&self) -> Option<&Arc<Capture>> {
        self.armed.as_ref()
    }

    /// An error of this camera.
    pub(crate) fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.device.name(), message)
    }

    /// Gives back the buffers of the run before.
    fn forget_finished(&mut self) {
        if let Some(finished) = self.finished.take() {
            finished.release();
        }
    }
}

impl Camera for DcamCamera {
    fn identity(&self) -> &CameraIdentity {
        &self.identity
    }

    fn capabilities(&self) -> &CameraCapabilities {
        &self.capabilities
    }

    fn configure(&mut self, want: &CameraSettings) -> Result<CameraSettings, DeviceError> {
        if self.is_armed() {
            return Err(self.error(ErrorKind::Busy, "is armed; stop it before changing settings"));
        }
        settings::check(&self.device, &self.capabilities, self.options, want)?;
        self.forget_finished();
        self.settings = None;
        let done = settings::apply(&self.device, self.options, want)?;
        self.settings = Some(done);
        Ok(done)
    }

    fn arm(&mut self) -> Result<Box<dyn FrameStream>, DeviceError> {
        let Some(settings) = self.settings else {
            return Err(self.error(ErrorKind::Busy, "was never configured; configure it first"));
        };
        if self.is_armed() {
            return Err(self.error(ErrorKind::Busy, "is armed already; stop it first"));
        }
        self.forget_finished();
        settings::set_trigger(&self.device, self.options, settings.trigger)?;
        let buffers = self.options.buffers_for(&settings);
        self.losses = Arc::default();
        let capture = Arc::new(Capture::begin(self.device.clone(), buffers, self.losses.clone())?);
        self.armed = Some(capture.clone());
        Ok(Box::new(DcamStream::new(capture, &settings, buffers)))
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        let Some(capture) = self.armed.take() else { return Ok(()) };
        let stopped = capture.stop();
        self.finished = Some(capture);
        stopped
    }

    fn browse(&mut self) -> Option<&mut dyn Properties> {
        Some(self)
    }
}

impl Drop for DcamCamera {
    fn drop(&mut self) {
        if let Err(error) = self.stop() {
            tracing::warn!("{error}");
        }
    }
}

fn identity_of(device: &Device) -> Result<CameraIdentity, DeviceError> {
    let (vendor, model) = (device.string(StringId::VENDOR)?, device.string(StringId::MODEL)?);
    let camera = device.string(StringId::CAMERA_VERSION)?;
    let driver = device.string(StringId::DRIVER_VERSION)?;
    let serial = device.string(StringId::CAMERA_ID)?;
    // Stand-ins say in every text that they are simulated.
    let simulated = format!("{vendor} {model} {driver}").to_lowercase().contains("simulated");
    Ok(CameraIdentity {
        simulated,
        vendor,
        model,
        serial: serial.trim_start_matches("S/N").trim_start_matches(':').trim().to_owned(),
        firmware: format!("camera {camera}, driver {driver}"),
    })
}

/// Reads the limits of the whole sensor.
fn capabilities_of(device: &Device) -> Result<CameraCapabilities, DeviceError> {
    device.set(Id::SUBARRAY_MODE, mode::OFF)?;
    let pixels = |id| device.attribute(id).map(|found| found.greatest.round() as u32);
    let exposure = device.attribute(Id::EXPOSURE_TIME)?;
    let step = settings::duration(exposure.step);
    Ok(CameraCapabilities {
        sensor_width: pixels(Id::SUBARRAY_WIDTH)?,
        sensor_height: pixels(Id::SUBARRAY_HEIGHT)?,
        region_step: REGION_STEP,
        exposure: settings::duration(exposure.least)..=settings::duration(exposure.greatest),
        exposure_step: step.max(Duration::from_nanos(1)),
        shortest_period: settings::duration(device.value(Id::READOUT_TIME)?),
        saturation_counts: u16::MAX,
    })
}
