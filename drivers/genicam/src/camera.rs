//! A GenICam camera behind the contract of cameras.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

use aravis::glib;
use aravis::glib::object::Cast;
use aravis::prelude::{CameraExt, CameraExtManual, DeviceExt};
use aravis::{GvStream, GvStreamPacketResend, GvStreamSocketBuffer};
use sofiscope_hal::{
    Camera, CameraCapabilities, CameraIdentity, CameraSettings, DeviceError, ErrorKind, FrameStream, IdRule,
    Properties, Property, PropertyValue,
};

use crate::opening::{self, Connection};
use crate::probe::Probe;
use crate::stream::{GenicamStream, Parts, give};
use crate::watchdog::Watchdog;
use crate::{GenicamSettings, advice, configuring, properties, raw};

/// Memory for frames that wait to be read.
const BUFFER_BYTES: usize = 256 << 20;
const FEWEST_BUFFERS: usize = 8;
const MOST_BUFFERS: usize = 128;

/// What the network made of the frames since arming.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StreamStatistics {
    /// Frames with every packet.
    pub complete: u64,
    /// Frames without some of their packets.
    pub incomplete: u64,
    /// Packets that never came.
    pub missing_packets: u64,
    /// Packets that came after they were asked for again.
    pub resent_packets: u64,
    /// Frames for which no memory was free, because nobody read.
    pub underruns: u64,
}

/// What camera and stream share.
#[derive(Debug, Default)]
pub(crate) struct Shared {
    pub(crate) is_stopped: AtomicBool,
    pub(crate) complete: AtomicU64,
    pub(crate) incomplete: AtomicU64,
    pub(crate) missing_packets: AtomicU64,
    pub(crate) resent_packets: AtomicU64,
    pub(crate) underruns: AtomicU64,
}

/// A camera that Aravis talks to.
pub struct GenicamCamera {
    settings: GenicamSettings,
    identity: CameraIdentity,
    capabilities: CameraCapabilities,
    /// `None` only after a failed attempt to find a lost camera again.
    connection: Option<Connection>,
    configured: Option<CameraSettings>,
    is_armed: bool,
    shared: Arc<Shared>,
}

impl std::fmt::Debug for GenicamCamera {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("GenicamCamera").field("identity", &self.identity).finish_non_exhaustive()
    }
}

impl GenicamCamera {
    /// Opens the camera and brings it into a known state: whole sensor, nothing automatic.
    ///
    /// # Errors
    /// [`Lost`](ErrorKind::Lost) when no camera answers, [`Identity`](ErrorKind::Identity) when it has another serial
    /// number, [`Busy`](ErrorKind::Busy) when another program has control of it.
    pub fn open(settings: GenicamSettings) -> Result<Self, DeviceError> {
        let connection = Connection::open(&settings)?;
        Ok(Self {
            identity: connection.identity.clone(),
            capabilities: connection.capabilities.clone(),
            connection: Some(connection),
            configured: None,
            is_armed: false,
            shared: Arc::default(),
            settings,
        })
    }

    /// Opens a camera that was lost again and gives it its settings back; it is then to be armed again.
    /// [`Camera::configure`] does the same by itself.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn reconnect(&mut self) -> Result<(), DeviceError> {
        self.mark_stopped();
        self.hang_up();
        let connection = Connection::open(&self.settings)?;
        self.capabilities = connection.capabilities.clone();
        self.identity = connection.identity.clone();
        self.connection = Some(connection);
        if let Some(settings) = self.configured.take() {
            self.configure(&settings)?;
        }
        Ok(())
    }

    /// Whether the camera is gone, or no longer ours.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.connection.as_ref().is_none_or(|connection| connection.is_lost.load(Relaxed))
    }

    /// What the person can do for a faster network, as sentences; empty when nothing is to be improved.
    #[must_use]
    pub fn advice(&self) -> &[String] {
        self.connection.as_ref().map_or(&[], |connection| &connection.advice)
    }

    /// What the network made of the frames since arming.
    #[must_use]
    pub fn statistics(&self) -> StreamStatistics {
        let shared = &self.shared;
        StreamStatistics {
            complete: shared.complete.load(Relaxed),
            incomplete: shared.incomplete.load(Relaxed),
            missing_packets: shared.missing_packets.load(Relaxed),
            resent_packets: shared.resent_packets.load(Relaxed),
            underruns: shared.underruns.load(Relaxed),
        }
    }

    /// Starts one exposure by command, where the trigger source is `Software`.
    ///
    /// # Errors
    /// Whatever the camera says.
    pub fn trigger_by_software(&mut self) -> Result<(), DeviceError> {
        let triggered = self.connected()?.camera.software_trigger();
        triggered.map_err(|cause| self.told("triggering", &cause))
    }

    fn device(&self) -> String {
        format!("{} ({}, S/N {})", self.settings.name, self.identity.model, self.identity.serial)
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.device(), message)
    }

    fn told(&self, doing: &str, cause: &glib::Error) -> DeviceError {
        let error = opening::error(&self.device(), doing, cause);
        if error.kind() == ErrorKind::Lost
            && let Some(connection) = &self.connection
        {
            connection.is_lost.store(true, Relaxed);
        }
        error
    }

    fn connected(&self) -> Result<&Connection, DeviceError> {
        match &self.connection {
            Some(connection) if !connection.is_lost.load(Relaxed) => Ok(connection),
            _ => Err(self.error(ErrorKind::Lost, "is gone; check cable and power, then configure it again")),
        }
    }

    fn hang_up(&mut self) {
        if let Some(connection) = self.connection.take() {
            opening::let_go(connection.is_lost.load(Relaxed), connection);
        }
    }

    fn mark_stopped(&mut self) {
        self.is_armed = false;
        self.shared.is_stopped.store(true, Relaxed);
    }

    /// The stream with its buffers, before anything is exposed.
    fn create_stream(&self, connection: &Connection) -> Result<aravis::Stream, glib::Error> {
        let stream = connection.camera.create_stream()?;
        if let Some(stream) = stream.downcast_ref::<GvStream>() {
            stream.set_socket_buffer(GvStreamSocketBuffer::Fixed);
            stream.set_socket_buffer_size(advice::SOCKET_BUFFER.cast_signed());
            let resend =
                if self.settings.resend { GvStreamPacketResend::Always } else { GvStreamPacketResend::Never };
            stream.set_packet_resend(resend);
            raw::enlarge_receive_buffer(stream.port(), advice::SOCKET_BUFFER);
        }
        let payload = connection.camera.payload()? as usize;
        let buffers = (BUFFER_BYTES / payload.max(1)).clamp(FEWEST_BUFFERS, MOST_BUFFERS);
        for _ in 0..buffers {
            give(&stream, raw::buffer(payload));
        }
        Ok(stream)
    }

    /// How this camera counts its frames.
    fn id_rule(&self, connection: &Connection) -> IdRule {
        let extended = connection.device.string_feature_value("GevGVSPExtendedIDMode");
        let is_short = connection.camera.is_gv_device() && !extended.is_ok_and(|mode| mode == "On");
        let rule =
            if is_short { IdRule::GIGE_VISION_16_BIT } else { IdRule { first: None, ..IdRule::FROM_ZERO } };
        IdRule { first: self.settings.first_block_id.map(sofiscope_hal::BlockId), ..rule }
    }
}

impl Camera for GenicamCamera {
    fn identity(&self) -> &CameraIdentity {
        &self.identity
    }

    fn capabilities(&self) -> &CameraCapabilities {
        &self.capabilities
    }

    fn configure(&mut self, want: &CameraSettings) -> Result<CameraSettings, DeviceError> {
        if self.is_lost() {
            self.reconnect()?;
        }
        if self.is_armed {
            return Err(self.error(ErrorKind::Busy, "is armed; stop it before it is configured"));
        }
        configuring::check(&self.capabilities, want)
            .map_err(|message| self.error(ErrorKind::OutOfRange, message))?;
        let connection = self.connected()?;
        let source = &self.settings.trigger_source;
        let applied = configuring::apply(&connection.camera, &connection.device, source, want);
        match applied {
            Ok(done) => {
                self.configured = Some(done);
                Ok(done)
            }
            Err(cause) => {
                if let Some(before) = &self.configured {
                    // The first fault is the one to tell; a second one shows when the camera is armed.
                    let _restored =
                        configuring::apply(&connection.camera, &connection.device, source, before);
                }
                Err(self.told("configuring", &cause))
            }
        }
    }

    fn arm(&mut self) -> Result<Box<dyn FrameStream>, DeviceError> {
        let connection = self.connected()?;
        let Some(settings) = self.configured else {
            return Err(self.error(ErrorKind::Busy, "was never configured; configure it first"));
        };
        if self.is_armed {
            return Err(self.error(ErrorKind::Busy, "is armed already; stop it first"));
        }
        let stream =
            self.create_stream(connection).map_err(|cause| self.told("preparing the stream", &cause))?;
        let shared = Arc::new(Shared::default());
        let parts = Parts {
            stream,
            camera: connection.camera.clone(),
            device: self.device(),
            settings,
            layout: connection.layout,
            rule: self.id_rule(connection),
            watchdog: Watchdog::new(settings.period, Instant::now()),
            // Without a socket of its own the heartbeat of Aravis alone tells that a camera is gone.
            probe: connection.address.and_then(|address| Probe::open(address).ok()),
            is_lost: connection.is_lost.clone(),
            shared: shared.clone(),
        };
        let started = connection.camera.start_acquisition();
        started.map_err(|cause| self.told("starting exposures", &cause))?;
        self.shared = shared;
        self.is_armed = true;
        Ok(Box::new(GenicamStream::new(parts)))
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        if !self.is_armed {
            return Ok(());
        }
        let stopped = self.connected().map(|connection| connection.camera.stop_acquisition());
        // Only now: what was sent before the camera stopped is still on its way.
        self.mark_stopped();
        stopped?.map_err(|cause| self.told("stopping exposures", &cause))
    }

    fn browse(&mut self) -> Option<&mut dyn Properties> {
        Some(self)
    }
}

impl Properties for GenicamCamera {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        Ok(properties::all(&self.connected()?.device))
    }

    fn set_property(&mut self, name: &str, value: &PropertyValue) -> Result<(), DeviceError> {
        let device = &self.connected()?.device;
        properties::check(device, name, value)
            .map_err(|message| self.error(ErrorKind::OutOfRange, message))?;
        properties::set(device, name, value).map_err(|cause| self.told(&format!("setting {name}"), &cause))
    }
}

impl Drop for GenicamCamera {
    fn drop(&mut self) {
        // Nobody is left to be told; the camera stops by itself when its heartbeat runs out.
        let _stopped = self.stop();
        self.hang_up();
    }
}

/// Time as Aravis takes it.
pub(crate) fn microseconds(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}
