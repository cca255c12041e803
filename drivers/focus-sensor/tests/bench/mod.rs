//! A camera in memory that watches the virtual spot, in virtual time, and inputs that see the same beam.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use sofiscope_focus_sensor::{AnalogInput, Now};
use sofiscope_hal::{
    Bell, BlockId, Camera, CameraCapabilities, CameraIdentity, CameraSettings, Clock, DeviceError,
    DeviceIdentity, DeviceTime, Epoch, ErrorKind, ExposureIndex, FrameInfo, FrameStatus, FrameStream,
    HostTime, ManualClock, Region, TriggerMode,
};
use sofiscope_virtual::OpticalTable;
use sofiscope_virtual::spot::{FocusSpot, SpotScene};
use sofiscope_virtual::table::Quantity;

pub(crate) const PERIOD: Duration = Duration::from_millis(5);

/// What goes wrong with frames, by number of the delivery.
#[derive(Debug, Default)]
pub(crate) struct Faults {
    pub(crate) incomplete: BTreeSet<u64>,
    /// The frame before comes again, half a period later.
    pub(crate) doubled: BTreeSet<u64>,
}

/// What camera and test share.
#[derive(Debug, Default)]
pub(crate) struct Shared {
    pub(crate) clock: ManualClock,
    pub(crate) silent: AtomicBool,
    pub(crate) stopped: AtomicBool,
    pub(crate) faults: Mutex<Faults>,
}

impl Shared {
    pub(crate) fn now(self: &Arc<Self>) -> Now {
        let shared = Arc::clone(self);
        Box::new(move || shared.clock.now())
    }

    fn wait_until(&self, until: HostTime) {
        let bell = Bell::default();
        self.clock.wait(&bell, bell.rings(), until);
    }
}

pub(crate) struct MemoryCamera {
    identity: CameraIdentity,
    capabilities: CameraCapabilities,
    settings: Option<CameraSettings>,
    spot: FocusSpot,
    shared: Arc<Shared>,
}

impl MemoryCamera {
    pub(crate) fn new(table: &OpticalTable, scene: SpotScene, shared: &Arc<Shared>) -> Self {
        Self {
            identity: CameraIdentity {
                vendor: "nobody".into(),
                model: "camera in memory".into(),
                serial: "F1".into(),
                firmware: "1".into(),
                simulated: true,
            },
            capabilities: CameraCapabilities {
                sensor_width: 640,
                sensor_height: 480,
                region_step: 8,
                exposure: Duration::from_micros(10)..=Duration::from_secs(1),
                exposure_step: Duration::from_micros(1),
                shortest_period: PERIOD,
                saturation_counts: scene.saturation_counts,
            },
            settings: None,
            spot: FocusSpot::new(table.clone(), scene),
            shared: Arc::clone(shared),
        }
    }
}

impl Camera for MemoryCamera {
    fn identity(&self) -> &CameraIdentity {
        &self.identity
    }

    fn capabilities(&self) -> &CameraCapabilities {
        &self.capabilities
    }

    fn configure(&mut self, want: &CameraSettings) -> Result<CameraSettings, DeviceError> {
        let step = |value: u32| value / 8 * 8;
        let Region { left, top, width, height } = want.region;
        let region = Region { left: step(left), top: step(top), width: step(width), height: step(height) };
        let done = CameraSettings { region, period: want.period.max(PERIOD), ..*want };
        assert_eq!(want.trigger, TriggerMode::FreeRunning, "nobody gives pulses to the focus camera");
        Ok(*self.settings.insert(done))
    }

    fn arm(&mut self) -> Result<Box<dyn FrameStream>, DeviceError> {
        let settings =
            self.settings.ok_or_else(|| DeviceError::new(ErrorKind::Busy, "camera", "configure first"))?;
        let begun = self.shared.clock.now();
        let (spot, shared) = (self.spot.clone(), Arc::clone(&self.shared));
        Ok(Box::new(MemoryStream { settings, spot, shared, begun, delivered: 0, next: 0 }))
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.shared.stopped.store(true, SeqCst);
        Ok(())
    }
}

struct MemoryStream {
    settings: CameraSettings,
    spot: FocusSpot,
    shared: Arc<Shared>,
    begun: HostTime,
    delivered: u64,
    next: u64,
}

impl MemoryStream {
    /// When an exposure has been read out.
    fn ready(&self, exposure: u64) -> HostTime {
        HostTime(self.begun.0 + (exposure + 1) * self.settings.period.as_nanos() as u64)
    }
}

impl FrameStream for MemoryStream {
    fn next_frame(&mut self, counts: &mut [u16], timeout: Duration) -> Result<FrameInfo, DeviceError> {
        assert_eq!(counts.len(), self.settings.region.num_pixels());
        if self.shared.stopped.load(SeqCst) {
            return Err(DeviceError::new(ErrorKind::Ended, "camera", "stopped"));
        }
        let faults = self.shared.faults.lock().unwrap();
        let doubled = self.next > 0 && faults.doubled.contains(&self.delivered);
        let exposure = self.next - u64::from(doubled);
        let late = u64::from(doubled) * self.settings.period.as_nanos() as u64 / 2;
        let (ready, now) = (HostTime(self.ready(exposure).0 + late), self.shared.clock.now());
        if ready.since(now) > timeout || self.shared.silent.load(SeqCst) {
            self.shared.wait_until(HostTime(now.0 + timeout.as_nanos() as u64));
            return Err(DeviceError::new(ErrorKind::Timeout, "camera", "no frame yet"));
        }
        self.shared.wait_until(ready);
        let is_whole = !faults.incomplete.contains(&self.delivered);
        let at = Duration::from_nanos(ready.0);
        self.spot.render(self.settings.region, exposure, at, counts);
        self.delivered += 1;
        self.next = exposure + 1;
        Ok(FrameInfo {
            exposure: ExposureIndex(exposure),
            block_id: BlockId(exposure),
            epoch: Epoch(0),
            device_time: DeviceTime(ready.0),
            status: if is_whole { FrameStatus::Complete } else { FrameStatus::Incomplete },
        })
    }
}

/// Two halves of a detector on the beam of the table: 2.5 V each in focus, all on one side at ± 1000 nm.
pub(crate) struct Halves {
    pub(crate) table: OpticalTable,
    pub(crate) noise: u32,
}

impl AnalogInput for Halves {
    fn read(&mut self, channel: u8) -> Result<f64, DeviceError> {
        let sign = match channel {
            0 => 1.0,
            1 => -1.0,
            _ => return Err(DeviceError::new(ErrorKind::OutOfRange, "inputs", "there are channels 0 and 1")),
        };
        self.noise = self.noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = f64::from(self.noise >> 16) / 65_536.0 * 0.01;
        let blocked = self.table.get(Quantity::FocusBeamBlocked) != 0.0;
        let share = (self.table.focus_error_nm(Duration::ZERO) / 1000.0).clamp(-1.0, 1.0);
        let light = if blocked { 0.0 } else { 2.5 * (1.0 + sign * share) };
        Ok(0.1 + light + noise)
    }
}

pub(crate) fn detector_identity() -> DeviceIdentity {
    DeviceIdentity {
        vendor: "nobody".into(),
        model: "split detector".into(),
        serial: String::new(),
        firmware: String::new(),
        simulated: true,
    }
}
