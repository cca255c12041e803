//! A camera that watches the reflected beam, as a sensor of the focus error.
//!
//! In: frames of any camera behind the contract. Out: one reading for each exposure, always of the newest frame.
//! Never: uses a frame with missing pixels, allocates while frames come, goes back to an earlier exposure.
//! Fails: [`Timeout`](ErrorKind::Timeout) without a usable frame in time; [`Lost`](ErrorKind::Lost) when the
//! camera or its stream is gone: open the sensor again.

use std::mem;
use std::time::Duration;

use sofiscope_hal::{
    Camera, CameraSettings, DeviceError, DeviceIdentity, ErrorKind, FocusReading, FocusSensor, FrameInfo,
    FrameStatus, FrameStream, HostTime, Region, TriggerMode,
};

use crate::Now;
use crate::spot::{SpotFinder, SpotForm, SpotMethod};

/// Unusable frames in a row after which the time is taken to be over, whatever the clock says.
const MOST_UNUSABLE: u32 = 64;
/// Frames that may wait behind the one that was read; older ones are not worth a reading.
const MOST_WAITING: u32 = 8;

/// How the camera shall watch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpotSettings {
    /// What changes with the focus.
    pub method: SpotMethod,
    /// Part of the sensor in which spots can be.
    pub region: Region,
    /// Time of one exposure.
    pub exposure: Duration,
    /// Time from one exposure to the next.
    pub period: Duration,
    /// Expected width of a spot (σ of a Gaussian), pixels.
    pub sigma_px: f64,
}

/// A spot on a camera; its signal is the column on the sensor, or the distance of two spots, in pixels.
pub struct SpotSensor {
    camera: Box<dyn Camera>,
    stream: Box<dyn FrameStream>,
    identity: DeviceIdentity,
    finder: SpotFinder,
    settings: CameraSettings,
    /// First column of the region, where the signal is a column of the sensor.
    left_px: f64,
    now: Now,
    newest: Vec<u16>,
    next: Vec<u16>,
    last: Option<FocusReading>,
}

impl SpotSensor {
    /// Configures and arms a camera; it exposes by itself from here on. `now` is the clock of the readings.
    ///
    /// # Errors
    /// [`OutOfRange`](ErrorKind::OutOfRange) for a width of the spot that is none or a region that is too small;
    /// else whatever the camera says.
    pub fn open(mut camera: Box<dyn Camera>, want: &SpotSettings, now: Now) -> Result<Self, DeviceError> {
        let identity = identity_of(camera.as_ref());
        if !(want.sigma_px > 0.0 && want.sigma_px.is_finite()) {
            let message = format!("a spot cannot be {} px wide; give its σ in pixels", want.sigma_px);
            return Err(DeviceError::new(ErrorKind::OutOfRange, identity.to_string(), message));
        }
        let SpotSettings { region, exposure, period, .. } = *want;
        let wanted = CameraSettings { region, exposure, period, trigger: TriggerMode::FreeRunning };
        let settings = camera.configure(&wanted)?;
        let Region { left, width, height, .. } = settings.region;
        if width < 2 || height == 0 {
            let message = format!("a region of {width} × {height} px has no room for a spot; make it larger");
            return Err(DeviceError::new(ErrorKind::OutOfRange, identity.to_string(), message));
        }
        let form = SpotForm {
            width: width as usize,
            height: height as usize,
            sigma_px: want.sigma_px,
            saturation_counts: camera.capabilities().saturation_counts,
        };
        let stream = camera.arm()?;
        let pixels = settings.region.num_pixels();
        Ok(Self {
            camera,
            stream,
            identity,
            finder: SpotFinder::new(want.method, form),
            settings,
            left_px: match want.method {
                SpotMethod::Centroid => f64::from(left),
                SpotMethod::TwoSpots => 0.0,
            },
            now,
            newest: vec![0; pixels],
            next: vec![0; pixels],
            last: None,
        })
    }

    /// What the camera really does.
    #[must_use]
    pub fn settings(&self) -> CameraSettings {
        self.settings
    }

    /// Stops the camera; readings then fail as [`Lost`](ErrorKind::Lost).
    ///
    /// # Errors
    /// Whatever the camera says.
    pub fn stop(&mut self) -> Result<(), DeviceError> {
        self.camera.stop()
    }

    /// The next frame that can be used, in `newest`; of several that wait already, the newest.
    fn newest_frame(&mut self, timeout: Duration) -> Result<(FrameInfo, HostTime), DeviceError> {
        let begun = (self.now)();
        let mut left = timeout;
        let mut found = None;
        for _ in 0..MOST_UNUSABLE {
            let info = self.stream.next_frame(&mut self.newest, left).map_err(|error| self.told(error))?;
            let at = (self.now)();
            if self.is_usable(&info) {
                found = Some((info, at));
                break;
            }
            left = timeout.saturating_sub(at.since(begun));
            if left.is_zero() {
                break;
            }
        }
        let Some((mut info, mut at)) = found else { return Err(self.unusable(timeout)) };
        for _ in 0..MOST_WAITING {
            // An error here is no matter of the frame that is there; it comes again with the next reading.
            let Ok(later) = self.stream.next_frame(&mut self.next, Duration::ZERO) else { break };
            if self.is_usable(&later) && later.exposure >= info.exposure {
                mem::swap(&mut self.newest, &mut self.next);
                (info, at) = (later, (self.now)());
            }
        }
        Ok((info, at))
    }

    /// Complete, and no earlier exposure than the last one read.
    fn is_usable(&self, info: &FrameInfo) -> bool {
        info.status == FrameStatus::Complete && self.last.is_none_or(|last| info.exposure.0 >= last.number)
    }

    /// The end of a stream is the loss of the sensor; all else is as the camera said it.
    fn told(&self, error: DeviceError) -> DeviceError {
        if error.kind() != ErrorKind::Ended {
            return error;
        }
        let message = "its stream has ended, no more frames come; open the focus sensor again";
        DeviceError::new(ErrorKind::Lost, self.identity.to_string(), message)
    }

    fn unusable(&self, timeout: Duration) -> DeviceError {
        let message = format!(
            "all frames within {} ms were incomplete or late; check cable and packet size, then read again",
            timeout.as_millis()
        );
        DeviceError::new(ErrorKind::Timeout, self.identity.to_string(), message)
    }
}

impl FocusSensor for SpotSensor {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn read(&mut self, timeout: Duration) -> Result<FocusReading, DeviceError> {
        let (info, at) = self.newest_frame(timeout)?;
        if let Some(last) = self.last.filter(|last| last.number == info.exposure.0) {
            return Ok(last);
        }
        let found = self.finder.measure(&self.newest);
        let reading = FocusReading {
            number: info.exposure.0,
            at,
            signal: if found.shape > 0.0 { found.signal + self.left_px } else { 0.0 },
            light: found.light,
            saturated: found.saturated,
            shape: found.shape,
        };
        self.last = Some(reading);
        Ok(reading)
    }
}

impl Drop for SpotSensor {
    fn drop(&mut self) {
        // Nobody is left who could answer an error; a camera that is gone has stopped by itself.
        drop(self.camera.stop());
    }
}

fn identity_of(camera: &dyn Camera) -> DeviceIdentity {
    let camera = camera.identity().clone();
    DeviceIdentity {
        vendor: camera.vendor,
        model: camera.model,
        serial: camera.serial,
        firmware: camera.firmware,
        simulated: camera.simulated,
    }
}
