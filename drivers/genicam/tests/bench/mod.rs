//! A simulated camera in a thread, a driver that talks to it, and pulses for both.
#![allow(dead_code, clippy::allow_attributes, reason = "each test binary uses another part of the bench")]

use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use sofiscope_genicam::{GenicamCamera, GenicamSettings};
use sofiscope_hal::conformance::CameraRig;
use sofiscope_hal::{
    Camera, CameraSettings, DeviceError, ErrorKind, FrameInfo, FrameStream, Region, TriggerMode,
    TriggerSource,
};
use sofiscope_virtual::gige::{Exposure, FrameSource, GigeCamera, GigeRecord, GigeSettings};
use sofiscope_virtual::table::{OpticalTable, Quantity};

/// Serial number of the cameras on this bench.
pub(crate) const SERIAL: &str = "SIM-1";

/// The count that the simulated camera gives a pixel.
pub(crate) fn count_of(exposure: u64, pixel: usize) -> u16 {
    (exposure.wrapping_mul(31) as usize + pixel * 7) as u16
}

fn scene(exposure: &Exposure, counts: &mut [u16]) {
    for (pixel, count) in counts.iter_mut().enumerate() {
        *count = count_of(exposure.index, pixel);
    }
}

/// A simulated camera that lives in a thread.
pub(crate) struct Fake {
    pub(crate) record: GigeRecord,
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<std::io::Result<()>>>,
}

impl Fake {
    pub(crate) fn start(settings: GigeSettings) -> Self {
        Self::start_with(settings, scene)
    }

    pub(crate) fn start_with(settings: GigeSettings, source: impl FrameSource + 'static) -> Self {
        let camera = GigeCamera::open(settings, source).expect("an address of this computer");
        let (record, over) = (camera.record(), Arc::new(AtomicBool::new(false)));
        let flag = over.clone();
        let thread = Some(std::thread::spawn(move || camera.serve(&flag)));
        Self { record, over, thread }
    }

    /// As if its power went.
    pub(crate) fn unplug(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        if let Some(Err(panic)) = self.thread.take().map(JoinHandle::join) {
            std::panic::resume_unwind(panic);
        }
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
    }
}

/// Pulses on the optical table, from a thread.
pub(crate) struct Pulses {
    table: OpticalTable,
    train: Option<(SyncSender<()>, JoinHandle<()>)>,
}

impl Pulses {
    pub(crate) fn new(table: OpticalTable) -> Self {
        Self { table, train: None }
    }
}

impl TriggerSource for Pulses {
    fn start(&mut self, period: Duration, pulses: Option<u64>) -> Result<(), DeviceError> {
        if self.train.is_some() {
            return Err(DeviceError::new(ErrorKind::Busy, "pulses", "a train is running"));
        }
        if period.is_zero() {
            return Err(DeviceError::new(ErrorKind::OutOfRange, "pulses", "a period of zero"));
        }
        let (stop, stopped) = sync_channel(1);
        let table = self.table.clone();
        let train = std::thread::spawn(move || {
            let mut next = sofiscope_virtual::monotonic();
            for _ in 0..pulses.unwrap_or(u64::MAX) {
                let wait = next.saturating_sub(sofiscope_virtual::monotonic());
                if stopped.recv_timeout(wait) != Err(RecvTimeoutError::Timeout) {
                    return;
                }
                table.set(Quantity::LastPulse, next.as_secs_f64());
                table.set(Quantity::Pulses, table.get(Quantity::Pulses) + 1.0);
                next += period;
            }
        });
        self.train = Some((stop, train));
        Ok(())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        if let Some((stop, train)) = self.train.take() {
            drop(stop);
            train.join().expect("a train does not panic");
        }
        Ok(())
    }
}

/// A driver, and what it needs to expose.
pub(crate) struct Rig {
    pub(crate) camera: GenicamCamera,
    pub(crate) pulses: Option<Pulses>,
    pub(crate) settings: CameraSettings,
}

impl CameraRig for Rig {
    fn camera(&mut self) -> &mut dyn Camera {
        &mut self.camera
    }

    fn trigger(&mut self) -> Option<&mut dyn TriggerSource> {
        self.pulses.as_mut().map(|pulses| pulses as &mut dyn TriggerSource)
    }

    fn settings(&self) -> CameraSettings {
        self.settings
    }

    fn patience(&self) -> Duration {
        Duration::from_secs(5)
    }
}

pub(crate) fn settings(width: u32, height: u32, period_ms: u64) -> CameraSettings {
    CameraSettings {
        region: Region { left: 0, top: 0, width, height },
        exposure: Duration::from_millis(period_ms / 2),
        period: Duration::from_millis(period_ms),
        trigger: TriggerMode::FreeRunning,
    }
}

pub(crate) fn driver(address: Ipv4Addr) -> GenicamSettings {
    let settings = GenicamSettings::new("camera R", SERIAL).at(address);
    GenicamSettings { packet_size: Some(1036), ..settings }
}

/// An address of this computer that belongs to one test, as tests run side by side.
pub(crate) fn address(test: u8, camera: u8) -> Ipv4Addr {
    Ipv4Addr::new(127, 78, test, camera)
}

/// The next frame, or the error that is not "not yet".
pub(crate) fn next(stream: &mut dyn FrameStream, counts: &mut [u16]) -> Result<FrameInfo, DeviceError> {
    let begun = Instant::now();
    loop {
        match stream.next_frame(counts, Duration::from_millis(50)) {
            Err(error) if error.kind() == ErrorKind::Timeout && begun.elapsed() < Duration::from_secs(10) => {
            }
            answer => return answer,
        }
    }
}
