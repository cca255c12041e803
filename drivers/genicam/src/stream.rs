//! The frames of one armed camera.
//!
//! In: buffers that Aravis filled. Out: counts in the caller's memory, exposures since arming.
//! Never: allocates per frame; passes an incomplete frame for a complete one. Fails: as [`FrameStream`] says;
//! `Timeout` names a stall and what may cause it, `Lost` comes within a second.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

use aravis::prelude::StreamExt;
use aravis::{Buffer, BufferPayloadType, BufferStatus};
use sofiscope_hal::{
    BlockId, CameraSettings, DeviceError, DeviceTime, ErrorKind, ExposureNumbering, FrameInfo, FrameStatus,
    FrameStream, TriggerMode,
};

use crate::camera::{Shared, microseconds};
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
    pub(crate) numbering: ExposureNumbering,
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
    /// Nothing is received any more, what is there can be read.
    Draining,
    Ended,
}

/// The frames of one armed GenICam camera.
pub struct GenicamStream {
    // The order of the fields is the order in which they go: the stream before the camera.
    stream: aravis::Stream,
    _camera: aravis::Camera,
    device: String,
    settings: CameraSettings,
    layout: Layout,
    numbering: ExposureNumbering,
    watchdog: Watchdog,
    probe: Option<Probe>,
    is_lost: Arc<AtomicBool>,
    shared: Arc<Shared>,
    phase: Phase,
    /// Time of the newest frame that told one, for those whose leader is missing.
    newest: Option<(BlockId, DeviceTime)>,
}

impl std::fmt::Debug for GenicamStream {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("GenicamStream").field("device", &self.device).finish_non_exhaustive()
    }
}

impl GenicamStream {
    pub(crate) fn new(parts: Parts) -> Self {
        let Parts { stream, camera, device, settings, layout, numbering, .. } = parts;
        let Parts { watchdog, probe, is_lost, shared, .. } = parts;
        Self {
            stream,
            _camera: camera,
            device,
            settings,
            layout,
            numbering,
            watchdog,
            probe,
            is_lost,
            shared,
            phase: Phase::Running,
            newest: None,
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
        let (id, time_ns) = (BlockId(buffer.frame_id()), buffer.timestamp());
        // The time of a frame whose leader is lost would be that of the frame before it in this buffer.
        buffer.set_timestamp(0);
        self.stream.push_buffer(buffer);
        let status = status?;
        self.count(status);
        Some(self.number(id, time_ns, status))
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

    fn number(&mut self, id: BlockId, time_ns: u64, status: FrameStatus) -> Result<FrameInfo, DeviceError> {
        let device_time = self.time_of(id, time_ns);
        let (exposure, epoch) = self.numbering.exposure_of(id, device_time).map_err(|error| {
            self.error(ErrorKind::Protocol, format!("{error}; stop and arm the camera again"))
        })?;
        if time_ns != 0 {
            self.newest = Some((id, device_time));
        }
        Ok(FrameInfo { exposure, block_id: id, epoch, device_time, status })
    }

    /// The time that the frame tells; where its leader is lost, so many periods after one that told it.
    fn time_of(&self, id: BlockId, time_ns: u64) -> DeviceTime {
        match self.newest {
            Some((newest, time)) if time_ns == 0 => {
                // Past the wrap the counter skips 0, hence 65535 ids to a turn.
                let ahead =
                    if id.0 >= newest.0 { id.0 - newest.0 } else { (id.0 + 65_535).saturating_sub(newest.0) };
                let period_ns = u64::try_from(self.settings.period.as_nanos()).unwrap_or(u64::MAX);
                DeviceTime(time.0.wrapping_add(ahead.wrapping_mul(period_ns)))
            }
            _ => DeviceTime(time_ns),
        }
    }

    /// What follows from silence: `Some` when no frame will come any more.
    fn over(&mut self, now: Instant) -> Option<DeviceError> {
        match self.phase {
            Phase::Running if self.shared.is_stopped.load(Relaxed) => self.phase = Phase::Finishing(now),
            Phase::Running => return self.watch(now),
            Phase::Finishing(since) if now.saturating_duration_since(since) >= AFTERMATH => {
                self.stream.stop_thread(false);
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

impl FrameStream for GenicamStream {
    fn next_frame(&mut self, counts: &mut [u16], timeout: Duration) -> Result<FrameInfo, DeviceError> {
        let expected = self.settings.region.num_pixels();
        if counts.len() != expected {
            let message = format!("memory for {} pixels was given where {expected} are needed", counts.len());
            return Err(self.error(ErrorKind::OutOfRange, message));
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
