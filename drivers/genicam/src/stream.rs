//! The frames of one armed camera.
//!
//! In: buffers that Aravis filled. Out: counts in the caller's memory, exposures since arming.
//! Never: allocates per frame; passes an incomplete frame for a complete one. Fails: as [`FrameStream`] says;
//! `Timeout` names a stall and what may cause it, `Lost` comes within a second.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

use aravis::prelude::StreamExt;
use aravis::{Buffer, BufferPayloadType, BufferStatus};
use sofiscope_hal::{
    CameraSettings, DeviceError, ErrorKind, ExposureNumbering, FrameInfo, FrameStatus, FrameStream, IdRule,
    TriggerMode,
};

use crate::camera::{Shared, microseconds};
use crate::naming::{MOST_NAMELESS, Named, Names, UNKNOWN};
use crate::opening::let_go;
use crate::probe::Probe;
use crate::raw;
use crate::unpacking::Layout;
use crate::watchdog::{Advice, Watchdog};

/// Longest wait before the flags are looked at.
const TURN: Duration = Duration::from_millis(20);
/// Time for the last packets after a stop; longer than Aravis keeps an incomplete frame (100 ms).
const AFTERMATH: Duration = Duration::from_millis(150);

/// What a stream is made of.
pub(crate) struct Parts {
    pub(crate) stream: aravis::Stream,
    /// Kept until the stream is gone, which Aravis wants to be gone first.
    pub(crate) camera: aravis::Camera,
    pub(crate) device: String,
    pub(crate) settings: CameraSettings,
    pub(crate) layout: Layout,
    pub(crate) rule: IdRule,
    pub(crate) watchdog: Watchdog,
    pub(crate) probe: Option<Probe>,
    pub(crate) is_lost: Arc<AtomicBool>,
    pub(crate) shared: Arc<Shared>,
}

/// How far the end is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Running,
    /// Stopped; frames may still be on their way since then.
    Finishing(Instant),
    /// Nothing comes any more, what is there can be read.
    Draining,
    Ended,
}

/// The frames of one armed GenICam camera.
pub struct GenicamStream {
    stream: aravis::Stream,
    /// There until the stream is dropped, which goes before its camera.
    camera: Option<aravis::Camera>,
    device: String,
    settings: CameraSettings,
    layout: Layout,
    /// Begins with the first frame that tells its id.
    numbering: Option<ExposureNumbering>,
    watchdog: Watchdog,
    probe: Option<Probe>,
    is_lost: Arc<AtomicBool>,
    shared: Arc<Shared>,
    phase: Phase,
    names: Names,
    /// Frames without a leader that came before the first with one; their numbers are known since.
    owed: VecDeque<Named>,
}

impl std::fmt::Debug for GenicamStream {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("GenicamStream").field("device", &self.device).finish_non_exhaustive()
    }
}

impl GenicamStream {
    pub(crate) fn new(parts: Parts) -> Self {
        let Parts { stream, camera, device, settings, layout, .. } = parts;
        let Parts { watchdog, probe, is_lost, shared, .. } = parts;
        let names = Names::new(parts.rule, settings.period);
        Self {
            stream,
            camera: Some(camera),
            device,
            settings,
            layout,
            numbering: None,
            watchdog,
            probe,
            is_lost,
            shared,
            phase: Phase::Running,
            names,
            owed: VecDeque::with_capacity(MOST_NAMELESS),
        }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.device.clone(), message)
    }

    /// A buffer that Aravis has done with, within `wait`.
    fn pop(&self, wait: Duration) -> Option<Buffer> {
        match microseconds(wait) {
            0 => self.stream.try_pop_buffer(),
            wait => self.stream.timeout_pop_buffer(wait),
        }
    }

    /// Takes what a buffer holds and gives the buffer back; `None` for one that was never filled.
    fn take(&mut self, buffer: Buffer, counts: &mut [u16]) -> Option<Result<FrameInfo, DeviceError>> {
        let status = self.receive(&buffer, counts);
        let (id, time_ns) = (buffer.frame_id(), buffer.timestamp());
        give(&self.stream, buffer);
        let status = status?;
        self.count(status);
        self.names.name(id, time_ns).map(|named| self.number(named, status))
    }

    /// Copies the pixels, if they are all there.
    fn receive(&self, buffer: &Buffer, counts: &mut [u16]) -> Option<FrameStatus> {
        match buffer.status() {
            BufferStatus::Success => {}
            BufferStatus::MissingPackets | BufferStatus::WrongPacketId | BufferStatus::Timeout => {
                return Some(FrameStatus::Incomplete);
            }
            BufferStatus::SizeMismatch | BufferStatus::PayloadNotSupported => {
                return Some(FrameStatus::SizeMismatch);
            }
            _ => return None,
        }
        let has_image =
            matches!(buffer.payload_type(), BufferPayloadType::Image | BufferPayloadType::ExtendedChunkData);
        if !has_image {
            return Some(FrameStatus::SizeMismatch);
        }
        let region = self.settings.region;
        let size = (buffer.image_width(), buffer.image_height());
        let is_as_configured = size == (region.width.cast_signed(), region.height.cast_signed())
            && buffer.image_pixel_format().raw() == self.layout as u32;
        let is_whole = is_as_configured && self.layout.unpack(raw::bytes(buffer), counts);
        Some(if is_whole { FrameStatus::Complete } else { FrameStatus::SizeMismatch })
    }

    fn count(&self, status: FrameStatus) {
        if status == FrameStatus::Complete {
            self.shared.complete.fetch_add(1, Relaxed);
        } else {
            self.shared.incomplete.fetch_add(1, Relaxed);
            self.look_at_counters();
        }
    }

    fn look_at_counters(&self) {
        for (name, counter) in [
            ("n_missing_packets", &self.shared.missing_packets),
            ("n_resent_packets", &self.shared.resent_packets),
            ("n_underruns", &self.shared.underruns),
        ] {
            counter.store(self.stream.info_uint64_by_name(name), Relaxed);
        }
    }

    fn number(&mut self, named: Named, status: FrameStatus) -> Result<FrameInfo, DeviceError> {
        let Named { id, time } = named;
        let numbering = self.numbering.get_or_insert_with(|| {
            let before = self.names.nameless();
            let rule = self.names.rule();
            let first = rule.first.or(before.first().map(|named| named.id));
            self.owed.extend(before);
            ExposureNumbering::new(IdRule { first, ..rule }, self.settings.period)
        });
        let (exposure, epoch) = numbering.exposure_of(id, time).map_err(|error| {
            DeviceError::new(
                ErrorKind::Protocol,
                self.device.clone(),
                format!("{error}; stop and arm the camera again"),
            )
        })?;
        Ok(FrameInfo { exposure, block_id: id, epoch, device_time: time, status })
    }

    /// What follows from silence: `Some` when no frame will come any more.
    fn over(&mut self, now: Instant) -> Option<DeviceError> {
        match self.phase {
            Phase::Running if self.shared.is_stopped.load(Relaxed) => self.phase = Phase::Finishing(now),
            Phase::Running => return self.watch(now),
            Phase::Finishing(since) if now.saturating_duration_since(since) >= AFTERMATH => {
                self.look_at_counters();
                self.phase = Phase::Draining;
            }
            Phase::Finishing(_) => {}
            Phase::Draining | Phase::Ended => {
                self.phase = Phase::Ended;
                return Some(self.error(ErrorKind::Ended, "was stopped, and no exposure is left"));
            }
        }
        None
    }

    fn watch(&mut self, now: Instant) -> Option<DeviceError> {
        let probe = self.probe.as_mut();
        let answer = probe.and_then(Probe::answer);
        let advice = match &self.probe {
            Some(_) => self.watchdog.step(now, answer),
            None => Advice::Wait,
        };
        let silence_ms = self.watchdog.silence(now).as_millis();
        let message = match advice {
            Advice::Wait if self.is_lost.load(Relaxed) => {
                format!("control of the camera was lost {silence_ms} ms after its last frame")
            }
            Advice::Wait => return None,
            Advice::Ask => {
                self.probe.as_mut()?.ask();
                return None;
            }
            Advice::Gone => {
                format!("sent no frame for {silence_ms} ms, and its control channel does not answer")
            }
            Advice::ControlLost => {
                "control of the camera was lost: it did not hear from this program in time".into()
            }
        };
        self.is_lost.store(true, Relaxed);
        let next = "check cable and power; configuring it again opens it again";
        Some(self.error(ErrorKind::Lost, format!("{message}; {next}")))
    }

    fn timeout(&self, timeout: Duration, now: Instant) -> DeviceError {
        let message = match self.watchdog.stall(now) {
            Some(silence) if self.watchdog.control_answers() => {
                self.look_at_counters();
                let trigger = match self.settings.trigger {
                    TriggerMode::External => "whether trigger pulses arrive, ",
                    TriggerMode::FreeRunning => "",
                };
                format!(
                    "no frames for {} ms, though its control channel answers; check {trigger}that no firewall keeps \
                     its packets away, and that the network takes packets of this size",
                    silence.as_millis()
                )
            }
            _ => format!("no frame came within {} ms", timeout.as_millis()),
        };
        self.error(ErrorKind::Timeout, message)
    }
}

/// Gives a buffer to Aravis. What it writes only with a leader is wiped, or else a frame whose leader is lost would
/// have id and time of the frame before it in this buffer.
pub(crate) fn give(stream: &aravis::Stream, buffer: Buffer) {
    buffer.set_frame_id(UNKNOWN);
    buffer.set_timestamp(0);
    stream.push_buffer(buffer);
}

impl Drop for GenicamStream {
    fn drop(&mut self) {
        if let Some(camera) = self.camera.take() {
            let_go(self.is_lost.load(Relaxed), (self.stream.clone(), camera));
        }
    }
}

impl FrameStream for GenicamStream {
    fn next_frame(&mut self, counts: &mut [u16], timeout: Duration) -> Result<FrameInfo, DeviceError> {
        let expected = self.settings.region.num_pixels();
        if counts.len() != expected {
            let message = format!("memory for {} pixels was given where {expected} are needed", counts.len());
            return Err(self.error(ErrorKind::OutOfRange, message));
        }
        if let Some(named) = self.owed.pop_front() {
            return self.number(named, FrameStatus::Incomplete);
        }
        let begun = Instant::now();
        let mut waited = Duration::ZERO;
        loop {
            // What is there is taken before anything is said of silence.
            while let Some(buffer) = self.pop(timeout.saturating_sub(waited).min(self.turn())) {
                if self.phase == Phase::Running {
                    self.watchdog.frame(Instant::now());
                }
                if let Some(taken) = self.take(buffer, counts) {
                    return taken;
                }
            }
            let now = Instant::now();
            if let Some(error) = self.over(now) {
                return Err(error);
            }
            waited = now.saturating_duration_since(begun);
            if waited >= timeout && self.phase != Phase::Draining {
                return Err(self.timeout(timeout, now));
            }
        }
    }
}

impl GenicamStream {
    /// How long one wait lasts.
    fn turn(&self) -> Duration {
        if matches!(self.phase, Phase::Running | Phase::Finishing(_)) { TURN } else { Duration::ZERO }
    }
}
