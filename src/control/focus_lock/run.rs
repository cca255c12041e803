//! The thread that reads the sensor, asks the lock and moves the drive.
//!
//! In: a sensor, a drive, commands from a bounded queue. Out: [`FocusStatus`], always the newest; the focus error
//! of the moment for every frame. Never: moves on its own while the lock is off. Fails: into the status; the
//! drive stays where it is, and when the thread ends too.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, TryRecvError, bounded};
use serde::{Deserialize, Serialize};
use sofiscope_hal::{DeviceError, ErrorKind, FocusDrive, FocusReading, FocusSensor, HostTime, Nanometers};

use super::calibration::{Calibration, SweepPoint};
use super::lock::{Correction, FocusLock, LockEnd, LockSettings};
use super::servo::ServoSettings;

/// Longest wait for a reading; a sensor of 100 readings per second has ten in this time.
const READING: Duration = Duration::from_millis(100);
/// Commands that may wait.
const COMMANDS: usize = 8;
/// Places of a calibration sweep, to each side of its middle.
const SWEEP_PLACES: i32 = 20;
/// Readings that are averaged at each place.
const SWEEP_READINGS: u32 = 5;
/// Time after which the drive has followed a step of the sweep.
const SETTLE: Duration = Duration::from_millis(120);

/// The monotonic clock of this computer.
pub type Now = Box<dyn Fn() -> HostTime + Send>;

/// What can be asked of the focus loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FocusCommand {
    /// Find the signal and hold it.
    Lock,
    /// Stand still.
    Release,
    /// Go there; only while the lock is off.
    MoveTo(Nanometers),
    /// Sweep ± this around the present place and take the calibration found.
    Calibrate(Nanometers),
}

/// What the focus loop does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
pub struct FocusStatus {
    /// `off`, `searching`, `probing`, `locked` or `lost`.
    pub state: String,
    /// Why it does not hold, for people.
    pub reason: Option<String>,
    /// Focus error, nanometers, while locked.
    pub error_nm: Option<f64>,
    /// Share of good readings lately, 0 to 1.
    pub quality: f64,
    /// Place of the drive, nanometers.
    pub z_nm: f64,
    /// Newest reading.
    pub reading: Option<FocusReading>,
    /// The calibration in use.
    pub calibration: Option<Calibration>,
    /// What a device said last, when it was no reading.
    pub fault: Option<String>,
}

/// The focus error of the moment, for whoever writes down frames.
#[derive(Debug, Clone)]
pub struct FocusError(Arc<AtomicU64>);

impl Default for FocusError {
    fn default() -> Self {
        Self(Arc::new(AtomicU64::new(f64::NAN.to_bits())))
    }
}

impl FocusError {
    /// Nanometers; `None` while nothing holds.
    #[must_use]
    pub fn now_nm(&self) -> Option<f64> {
        Some(f64::from_bits(self.0.load(Ordering::Acquire))).filter(|error| error.is_finite())
    }

    fn set(&self, error_nm: Option<f64>) {
        self.0.store(error_nm.unwrap_or(f64::NAN).to_bits(), Ordering::Release);
    }
}

/// Asks and looks from any thread; does not keep the focus loop alive.
#[derive(Debug, Clone)]
pub struct FocusRemote {
    commands: Weak<Sender<FocusCommand>>,
    status: Arc<Mutex<FocusStatus>>,
}

impl FocusRemote {
    /// Asks for something; what becomes of it is told by the status.
    ///
    /// # Errors
    /// [`Busy`](ErrorKind::Busy) when too much waits, [`Lost`](ErrorKind::Lost) when the loop has ended.
    pub fn ask(&self, command: FocusCommand) -> Result<(), DeviceError> {
        send(self.commands.upgrade().as_deref(), command)
    }

    /// What it does now.
    #[must_use]
    pub fn status(&self) -> FocusStatus {
        self.status.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn send(commands: Option<&Sender<FocusCommand>>, command: FocusCommand) -> Result<(), DeviceError> {
    match commands.map(|commands| commands.try_send(command)) {
        Some(Ok(())) => Ok(()),
        Some(Err(crossbeam_channel::TrySendError::Full(_))) => {
            Err(DeviceError::new(ErrorKind::Busy, "focus lock", "it is busy; ask again"))
        }
        _ => Err(DeviceError::new(ErrorKind::Lost, "focus lock", "its thread has ended")),
    }
}

/// The other end of the thread; the drive stands still when this is dropped.
pub struct FocusLoop {
    commands: Option<Arc<Sender<FocusCommand>>>,
    status: Arc<Mutex<FocusStatus>>,
    error: FocusError,
    thread: Option<JoinHandle<()>>,
}

impl FocusLoop {
    /// Starts the thread.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn spawn(
        sensor: Box<dyn FocusSensor>,
        drive: Box<dyn FocusDrive>,
        calibration: Option<Calibration>,
        servo: ServoSettings,
        now: Now,
    ) -> std::io::Result<Self> {
        let (commands, asked) = bounded(COMMANDS);
        let (status, error) = (Arc::default(), FocusError::default());
        let mut owner = Owner {
            sensor,
            drive,
            calibration,
            servo,
            now,
            lock: FocusLock::default(),
            z: Nanometers::ZERO,
            reading: None,
            fault: None,
            status: Arc::clone(&status),
            error: error.clone(),
        };
        let thread =
            std::thread::Builder::new().name("focus-lock".to_owned()).spawn(move || owner.live(&asked))?;
        Ok(Self { commands: Some(Arc::new(commands)), status, error, thread: Some(thread) })
    }

    /// Asks for something.
    ///
    /// # Errors
    /// [`Busy`](ErrorKind::Busy) when too much waits, [`Lost`](ErrorKind::Lost) when the thread has ended.
    pub fn ask(&self, command: FocusCommand) -> Result<(), DeviceError> {
        send(self.commands.as_deref(), command)
    }

    /// A way to ask and look from anywhere.
    #[must_use]
    pub fn remote(&self) -> FocusRemote {
        let commands = self.commands.as_ref().map(Arc::downgrade).unwrap_or_default();
        FocusRemote { commands, status: Arc::clone(&self.status) }
    }

    /// What it does now.
    #[must_use]
    pub fn status(&self) -> FocusStatus {
        self.status.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The focus error of the moment, for whoever writes down frames.
    #[must_use]
    pub fn error(&self) -> FocusError {
        self.error.clone()
    }
}

impl Drop for FocusLoop {
    fn drop(&mut self) {
        self.commands = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the focus lock failed; the drive stays where it is");
        }
    }
}

struct Owner {
    sensor: Box<dyn FocusSensor>,
    drive: Box<dyn FocusDrive>,
    calibration: Option<Calibration>,
    servo: ServoSettings,
    now: Now,
    lock: FocusLock,
    z: Nanometers,
    reading: Option<FocusReading>,
    fault: Option<String>,
    status: Arc<Mutex<FocusStatus>>,
    error: FocusError,
}

/// Nothing holds any more, however the thread ends; frames must not get the last error for ever.
impl Drop for Owner {
    fn drop(&mut self) {
        self.error.set(None);
    }
}

impl Owner {
    fn live(&mut self, commands: &Receiver<FocusCommand>) {
        self.read_place();
        loop {
            match commands.try_recv() {
                Ok(command) => self.obey(command),
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => return,
            }
            let reading = self.read();
            self.step(reading);
            self.tell();
        }
    }

    fn obey(&mut self, command: FocusCommand) {
        self.fault = None;
        match command {
            FocusCommand::Lock if self.calibration.is_none() => {
                self.fault = Some("the focus lock is not calibrated; calibrate it first".to_owned());
            }
            FocusCommand::Lock => {
                self.read_place();
                self.lock = FocusLock::begin(self.z, (self.now)());
            }
            FocusCommand::Release => self.lock = FocusLock::default(),
            FocusCommand::MoveTo(_) if !matches!(self.lock, FocusLock::Off(_)) => {
                self.fault = Some("the drive is in the hand of the focus lock; release it first".to_owned());
            }
            FocusCommand::MoveTo(z) => self.move_to(z),
            FocusCommand::Calibrate(half_range) => {
                self.lock = FocusLock::default();
                if let Err(reason) = self.calibrate(half_range) {
                    self.fault = Some(reason);
                }
            }
        }
    }

    /// The next reading; `None` when there was none to believe or none at all.
    fn read(&mut self) -> Option<FocusReading> {
        match self.sensor.read(READING) {
            Ok(reading) => {
                self.reading = Some(reading);
                Some(reading)
            }
            Err(error) => {
                if error.kind() != ErrorKind::Timeout {
                    self.fault = Some(error.to_string());
                }
                None
            }
        }
    }

    fn step(&mut self, reading: Option<FocusReading>) {
        let Some(calibration) = self.calibration else { return };
        let settings = LockSettings { calibration, servo: self.servo, range: self.drive.range() };
        let (lock, correction) = self.lock.step(reading.as_ref(), self.z, (self.now)(), &settings);
        self.lock = lock;
        if let Correction::MoveTo(z) = correction
            && z != self.z
        {
            self.move_to(z);
        }
    }

    fn move_to(&mut self, z: Nanometers) {
        match self.drive.move_to(z) {
            Ok(()) => self.z = z,
            Err(error) => {
                self.lock = FocusLock::Off(Some(LockEnd::NoResponse));
                self.fault = Some(error.to_string());
            }
        }
    }

    fn read_place(&mut self) {
        match self.drive.position() {
            Ok(z) => self.z = z,
            Err(error) => self.fault = Some(error.to_string()),
        }
    }

    /// Sweeps around the present place, comes back and takes the calibration found.
    fn calibrate(&mut self, half_range: Nanometers) -> Result<(), String> {
        self.read_place();
        let (center, range) = (self.z, self.drive.range());
        let mut sweep = Vec::new();
        for place in -SWEEP_PLACES..=SWEEP_PLACES {
            let z = center.value() + half_range.value() * f64::from(place) / f64::from(SWEEP_PLACES);
            let z = Nanometers::new(z).map_err(|error| error.to_string())?;
            if !range.contains(&z) {
                continue;
            }
            self.drive.move_to(z).map_err(|error| error.to_string())?;
            self.wait_settled();
            sweep.extend(self.average().map(|reading| SweepPoint { z, reading }));
        }
        self.move_to(center);
        self.wait_settled();
        let found = Calibration::from_sweep(&sweep, 3.0).map_err(|error| error.to_string())?;
        tracing::info!(?found, "focus sensor calibrated");
        self.calibration = Some(found);
        Ok(())
    }

    /// Reads until the drive has followed.
    fn wait_settled(&mut self) {
        let begun = (self.now)();
        while (self.now)().since(begun) < SETTLE && self.read().is_some() {}
    }

    fn average(&mut self) -> Option<FocusReading> {
        let readings: Vec<FocusReading> = (0..SWEEP_READINGS).filter_map(|_| self.read()).collect();
        let number = readings.len() as f64;
        let mean = |part: fn(&FocusReading) -> f64| readings.iter().map(part).sum::<f64>() / number;
        let last = readings.last()?;
        Some(FocusReading {
            signal: mean(|reading| reading.signal),
            light: mean(|reading| reading.light),
            saturated: mean(|reading| reading.saturated),
            shape: mean(|reading| reading.shape),
            ..*last
        })
    }

    fn tell(&self) {
        self.error.set(self.lock.error_nm());
        let (state, reason, quality) = match &self.lock {
            FocusLock::Off(end) => ("off", end.map(|end| end.to_string()), 0.0),
            FocusLock::Searching(_) => ("searching", None, 0.0),
            FocusLock::Probing(_) => ("probing", None, 0.0),
            FocusLock::Locked(hold) => ("locked", None, hold.quality()),
            FocusLock::Lost { end, .. } => ("lost", Some(end.to_string()), 0.0),
        };
        *self.status.lock().unwrap_or_else(PoisonError::into_inner) = FocusStatus {
            state: state.to_owned(),
            reason,
            error_nm: self.lock.error_nm(),
            quality,
            z_nm: self.z.value(),
            reading: self.reading,
            calibration: self.calibration,
            fault: self.fault.clone(),
        };
    }
}
