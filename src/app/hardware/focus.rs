//! The focus lock of an instrument: piezo, camera and the loop between them, in the hand of the sequencer.

use sofiscope_focus_sensor::{SpotMethod, SpotSensor, SpotSettings};
use sofiscope_hal::{DeviceError, ErrorKind, FocusDrive, HostTime, Nanometers, Region};
use sofiscope_madlib::{Madlib, NanoDrive, NanoDriveOptions};
use sofiscope_virtual::table::{OpticalTable, Quantity};
use std::path::Path;
use std::time::{Duration, Instant};

use super::super::AppError;
use super::cameras;
use crate::config::{FocusEntry, VirtualEntry};
use crate::control::contracts::FocusHold;
use crate::control::focus_lock::{FocusCommand, FocusError, FocusLoop, FocusRemote, ServoSettings};

/// Rate of the sensor: 100 readings per second.
const PERIOD: Duration = Duration::from_millis(10);
const EXPOSURE: Duration = Duration::from_millis(5);
/// Expected width of the reflected spot, pixels.
const SPOT_SIGMA_PX: f64 = 4.0;
/// Half of the calibration sweep, nanometers.
pub(in crate::app) const FOCUS_SWEEP_NM: f64 = 2000.0;
/// A calibration of 41 places takes ten seconds, a search three.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time between two looks at the loop.
const LOOK: Duration = Duration::from_millis(50);

/// The focus lock with what is known of the series so far.
pub(super) struct Focus {
    focus: FocusLoop,
    squares: f64,
    looks: u64,
}

/// Opens piezo and sensor and starts the loop; nothing moves.
///
/// # Errors
/// [`AppError::Device`] with what was looked for and what was found.
pub(super) fn open(entry: &FocusEntry, virtual_devices: Option<&VirtualEntry>) -> Result<Focus, AppError> {
    if let (Some(library), Some(shared)) = (&entry.library, virtual_devices) {
        put_on_table(library, &shared.directory)?;
    }
    let library = Madlib::open(entry.library.as_deref())?;
    let serial = entry.serial.as_ref().and_then(|serial| serial.parse().ok());
    let options = NanoDriveOptions { serial, ..NanoDriveOptions::within(entry.range.0..=entry.range.1) };
    let drive = NanoDrive::open(&library, options)?;
    let camera = cameras::genicam("focus camera", &entry.sensor_serial, Some(&entry.sensor_address))?;
    let (width, height) = (camera.capabilities().sensor_width, camera.capabilities().sensor_height);
    let settings = SpotSettings {
        method: SpotMethod::Centroid,
        region: Region { left: 0, top: 0, width, height },
        exposure: EXPOSURE,
        period: PERIOD,
        sigma_px: SPOT_SIGMA_PX,
    };
    let begun = Instant::now();
    let now = move || HostTime(u64::try_from(begun.elapsed().as_nanos()).unwrap_or(u64::MAX));
    let sensor = SpotSensor::open(camera, &settings, Box::new(now))?;
    let drive: Box<dyn FocusDrive> = Box::new(drive);
    let focus = FocusLoop::spawn(Box::new(sensor), drive, None, ServoSettings::default(), Box::new(now))
        .map_err(|error| AppError::Device(format!("focus lock: {error}")))?;
    Ok(Focus { focus, squares: 0.0, looks: 0 })
}

/// A virtual piezo stands on the table of the other virtual devices.
fn put_on_table(library: &Path, directory: &Path) -> Result<(), AppError> {
    let failed = |error: String| AppError::Device(format!("{}: {error}", library.display()));
    let table = directory.join("table");
    let remote = sofiscope_madlib_stand_in::Remote::open(library).map_err(failed)?;
    let sample_nm = OpticalTable::join(&table)
        .map_err(|error| {
            AppError::Device(format!("{}: {error}; start the virtual devices", table.display()))
        })?
        .get(Quantity::SampleZ);
    // A person has focused by hand before.
    remote.say(&format!("at {}", sample_nm / 1000.0)).map_err(failed)?;
    remote.say(&format!("table {}", table.display())).map_err(failed)?;
    Ok(())
}

impl Focus {
    /// The focus error of the moment, for every frame.
    pub(super) fn error(&self) -> FocusError {
        self.focus.error()
    }

    /// For whoever asks and looks beside the sequencer.
    pub(super) fn remote(&self) -> FocusRemote {
        self.focus.remote()
    }

    /// Asks for something and waits until `is_done` with the answer, or with the reason why not.
    fn wait(
        &self,
        command: FocusCommand,
        is_done: impl Fn(&crate::control::focus_lock::FocusStatus) -> Option<Result<(), String>>,
    ) -> Result<(), DeviceError> {
        let failed = |kind, message: String| Err(DeviceError::new(kind, "focus lock", message));
        self.focus.ask(command)?;
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            // Nothing will ever come: this is a pause between two looks.
            let _ = crossbeam_channel::after(LOOK).recv();
            let status = self.focus.status();
            if let Some(fault) = status.fault {
                return failed(ErrorKind::Fault, fault);
            }
            match is_done(&status) {
                Some(Ok(())) => return Ok(()),
                Some(Err(reason)) => return failed(ErrorKind::Fault, reason),
                None => {}
            }
        }
        failed(ErrorKind::Timeout, format!("it did not answer within {} s", PATIENCE.as_secs()))
    }
}

impl FocusHold for Focus {
    fn lock(&mut self) -> Result<(), DeviceError> {
        if self.focus.status().state == "locked" {
            return Ok(());
        }
        if self.focus.status().calibration.is_none() {
            let half = Nanometers::new(FOCUS_SWEEP_NM).unwrap_or_default();
            self.wait(FocusCommand::Calibrate(half), |status| status.calibration.map(|_| Ok(())))?;
        }
        self.wait(FocusCommand::Lock, |status| match status.state.as_str() {
            "locked" if status.quality > 0.5 => Some(Ok(())),
            "off" => status.reason.clone().map(Err),
            _ => None,
        })
    }

    fn look(&mut self) -> Result<(), DeviceError> {
        let status = self.focus.status();
        match status.error_nm {
            Some(error) => {
                self.squares += error * error;
                self.looks += 1;
                Ok(())
            }
            None => {
                let reason = status.reason.or(status.fault).unwrap_or_else(|| status.state.clone());
                Err(DeviceError::new(ErrorKind::Fault, "focus lock", format!("does not hold: {reason}")))
            }
        }
    }
}

impl Drop for Focus {
    fn drop(&mut self) {
        if self.looks > 0 {
            let rms = (self.squares / self.looks as f64).sqrt();
            eprintln!("focus error while it held: {rms:.1} nm root mean square in {} looks", self.looks);
        }
    }
}
