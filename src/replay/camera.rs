//! A camera that delivers recorded frames.
//!
//! In: the recorded settings, or a part of the recorded region. Out: what was asked for, and a stream when armed.
//! Never: does what was not recorded, claims to be the camera that it replays. Fails: as [`Camera`] says.

use super::Repeat;
use super::source::FrameSource;
use super::stream::{ReplayStream, Window};
use super::timeline::Timeline;
use sofiscope_hal::{
    Camera, CameraCapabilities, CameraIdentity, CameraSettings, Channel, DeviceError, ErrorKind, FrameStream,
    Region, TriggerMode,
};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What camera and stream of one channel share.
#[derive(Debug)]
pub(super) struct Reel {
    pub(super) channel: Channel,
    pub(super) source: Mutex<Box<dyn FrameSource>>,
    /// Number of the source's exposure 0.
    pub(super) origin: u64,
    pub(super) timeline: Arc<Timeline>,
    pub(super) repeat: Repeat,
    pub(super) cut: Mutex<Cut>,
}

/// Which part of the recording is played.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Cut {
    /// First exposure.
    pub(super) start: u64,
    /// Exposures of one round.
    pub(super) exposures: u64,
    /// First frame of this camera.
    pub(super) begin: u64,
    /// Received time at which the replay begins, for both cameras.
    pub(super) begin_ns: u64,
    /// Time of one round.
    pub(super) round_ns: u64,
}

impl Reel {
    pub(super) fn cut(&self) -> Cut {
        *self.cut.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn source(&self) -> MutexGuard<'_, Box<dyn FrameSource>> {
        self.source.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A camera that delivers recorded frames.
#[derive(Debug)]
pub struct ReplayCamera {
    reel: Arc<Reel>,
    identity: CameraIdentity,
    capabilities: CameraCapabilities,
    recorded: CameraSettings,
    settings: Option<CameraSettings>,
    is_armed: bool,
}

impl ReplayCamera {
    pub(super) fn new(
        reel: Arc<Reel>,
        identity: CameraIdentity,
        recorded: CameraSettings,
        saturation_counts: u16,
    ) -> Self {
        let Region { left, top, width, height } = recorded.region;
        let capabilities = CameraCapabilities {
            sensor_width: left + width,
            sensor_height: top + height,
            region_step: 1,
            exposure: recorded.exposure..=recorded.exposure,
            exposure_step: recorded.exposure,
            shortest_period: recorded.period,
            saturation_counts,
        };
        Self { reel, identity, capabilities, recorded, settings: None, is_armed: false }
    }

    /// The settings of the recording, free-running: those that [`configure`](Camera::configure) takes.
    #[must_use]
    pub fn recorded_settings(&self) -> CameraSettings {
        self.recorded
    }

    /// The side of the dichroic.
    #[must_use]
    pub fn channel(&self) -> Channel {
        self.reel.channel
    }

    fn device(&self) -> String {
        format!("{} ({}, S/N {})", self.reel.channel, self.identity.model, self.identity.serial)
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.device(), message)
    }

    /// Where a region lies in the recorded one, if it does.
    fn part(&self, region: Region) -> Option<Region> {
        let recorded = self.recorded.region;
        let left = region.left.checked_sub(recorded.left)?;
        let top = region.top.checked_sub(recorded.top)?;
        let fits = left.checked_add(region.width)? <= recorded.width
            && top.checked_add(region.height)? <= recorded.height
            && region.num_pixels() > 0;
        fits.then_some(Region { left, top, ..region })
    }
}

impl Camera for ReplayCamera {
    fn identity(&self) -> &CameraIdentity {
        &self.identity
    }

    fn capabilities(&self) -> &CameraCapabilities {
        &self.capabilities
    }

    fn configure(&mut self, want: &CameraSettings) -> Result<CameraSettings, DeviceError> {
        if self.is_armed {
            return Err(self.error(ErrorKind::Busy, "is armed; stop it before changing settings"));
        }
        let refuse = |what: String| Err(self.error(ErrorKind::OutOfRange, what));
        let recorded = self.recorded;
        if self.part(want.region).is_none() {
            let Region { left, top, width, height } = recorded.region;
            return refuse(format!(
                "only {width} x {height} pixels from column {left}, row {top} were recorded; ask for a part of them"
            ));
        }
        if want.exposure != recorded.exposure || want.period != recorded.period {
            return refuse(format!(
                "an exposure of {:?} and a period of {:?} were recorded, {:?} and {:?} were asked for; \
                 ask for what was recorded",
                recorded.exposure, recorded.period, want.exposure, want.period
            ));
        }
        if want.trigger != TriggerMode::FreeRunning {
            return refuse("a replay has no trigger; ask for free-running exposures".to_owned());
        }
        self.settings = Some(*want);
        Ok(*want)
    }

    fn arm(&mut self) -> Result<Box<dyn FrameStream>, DeviceError> {
        let Some(part) = self.settings.and_then(|settings| self.part(settings.region)) else {
            return Err(self.error(ErrorKind::Busy, "was never configured; configure it first"));
        };
        if self.is_armed {
            return Err(self.error(ErrorKind::Busy, "is armed already; stop it first"));
        }
        self.is_armed = true;
        let run = self.reel.timeline.arm(self.reel.channel);
        let window = Window {
            part,
            recorded_width: self.recorded.region.width as usize,
            recorded_pixels: self.recorded.region.num_pixels(),
        };
        Ok(Box::new(ReplayStream::new(Arc::clone(&self.reel), run, self.device(), window)))
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        if std::mem::take(&mut self.is_armed) {
            self.reel.timeline.stop(self.reel.channel);
        }
        Ok(())
    }
}

impl Drop for ReplayCamera {
    fn drop(&mut self) {
        if self.is_armed {
            self.reel.timeline.stop(self.reel.channel);
        }
    }
}
