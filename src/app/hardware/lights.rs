//! Opens lasers and gates; runs in the guard's process only.

use sofiscope_gated_laser::{
    Calibration, CalibrationPoint, Drive, GatedLaser, GatedLaserSettings, Output, OutputState, Permission,
    Polarity,
};
use sofiscope_gatekeeper::{Gatekeeper, GatekeeperSettings, Step};
use sofiscope_hal::{
    DeviceError, DeviceIdentity, ErrorKind, GateCapabilities, GateController, GatePattern, GateState, Laser,
    Milliwatts, TriggerSource, Volts,
};
use sofiscope_laserquantum_smd12::{Smd12, Smd12Settings};
use sofiscope_micromanager_arduino::{ExposureLevel, MicroManagerArduino};
use sofiscope_serial_line::Line;
use sofiscope_toptica_ibeam_smart::{IbeamSettings, IbeamSmart, Modulation};
use std::time::{Duration, Instant};

use crate::config::{GatesKind, Hardware, Instrument, LaserEntry, LaserLink};
use crate::guard::lights::{Controller, Gates, LaserStation};
use crate::guard::process::Builder;

/// Width of the pulses that start exposures.
const PULSE_WIDTH: Duration = Duration::from_millis(1);
/// A gate stays open for one exposure and this much longer at most.
const ON_TIME_MARGIN: Duration = Duration::from_millis(50);
/// The gate closes this much before the exposure ends, and never for more than a twentieth of it: exposures that
/// follow each other without a pause would otherwise be one long on-time to the board, which cuts it.
const CLOSED_BETWEEN: Duration = Duration::from_micros(500);
/// Full scale of the analog outputs of every controller here, volts.
const FULL_SCALE_V: f64 = 5.0;

/// Opens what an instrument file names.
#[derive(Debug, Default)]
pub(super) struct Lights {
    instrument: Option<Instrument>,
}

impl Lights {
    fn hardware(&self) -> Result<&Hardware, DeviceError> {
        let instrument = self.instrument.as_ref();
        instrument.map(Instrument::hardware).ok_or_else(|| refused("the gates come before the lasers"))
    }
}

fn refused(message: impl Into<String>) -> DeviceError {
    DeviceError::new(ErrorKind::OutOfRange, "laser guard", message)
}

impl Builder for Lights {
    fn controller(&mut self, instrument: &str) -> Result<Box<dyn Controller>, DeviceError> {
        let instrument = Instrument::from_toml(instrument).map_err(|faults| refused(faults.to_string()))?;
        let longest = instrument.cameras().iter().map(|camera| camera.exposure).max().unwrap_or_default();
        let instrument = self.instrument.insert(instrument);
        let entry = instrument.hardware().gates.as_ref();
        let entry = entry.ok_or_else(|| refused("the instrument file has no `[gates]`"))?;
        let is_virtual = instrument.hardware().virtual_devices.is_some();
        match entry.kind {
            GatesKind::Gatekeeper => {
                let line = Line::open(&entry.port.path, Gatekeeper::line_settings(), "gatekeeper")?;
                let serial = entry.port.serial.as_ref().and_then(|serial| serial.parse().ok());
                let settings = GatekeeperSettings {
                    serial,
                    longest_on_time: vec![longest + ON_TIME_MARGIN; 4],
                    full_scale: Volts::new(FULL_SCALE_V).unwrap_or_default(),
                    pulse_width: PULSE_WIDTH,
                    step: Step::OwnClock {
                        delay: Duration::ZERO,
                        open: longest - CLOSED_BETWEEN.min(longest / 20),
                    },
                };
                Ok(Box::new(Gatekeeper::connect(line, settings)?))
            }
            GatesKind::MicromanagerArduino => {
                let line = Line::open(
                    &entry.port.path,
                    MicroManagerArduino::line_settings(),
                    "Arduino trigger box",
                )?;
                let arduino = MicroManagerArduino::connect(line, ExposureLevel::High)?;
                Ok(Box::new(WithoutClock(if is_virtual { arduino.simulated() } else { arduino })))
            }
        }
    }

    fn lasers(&mut self, gates: &Gates) -> Result<Vec<LaserStation>, DeviceError> {
        let lasers = &self.hardware()?.lasers;
        let is_virtual = self.hardware()?.virtual_devices.is_some();
        lasers
            .iter()
            .map(|entry| Ok(LaserStation { gate: entry.gate, laser: laser(entry, gates, is_virtual)? }))
            .collect()
    }
}

fn laser(entry: &LaserEntry, gates: &Gates, is_virtual: bool) -> Result<Box<dyn Laser>, DeviceError> {
    let name = format!("laser {} nm", entry.wavelength_nm);
    match &entry.link {
        LaserLink::TopticaIbeamSmart(port) => {
            let line = Line::open(&port.path, sofiscope_toptica_ibeam_smart::line_settings(), name.clone())?;
            let settings = IbeamSettings {
                wavelength_nm: entry.wavelength_nm,
                serial: named(port.serial.as_ref(), &name)?,
                cap: entry.cap,
                modulation: Modulation::External,
            };
            Ok(Box::new(IbeamSmart::open(line, settings)?))
        }
        LaserLink::LaserquantumSmd12(port) => {
            let line = Line::open(&port.path, sofiscope_laserquantum_smd12::line_settings(), name.clone())?;
            let settings = Smd12Settings {
                wavelength_nm: entry.wavelength_nm,
                version: named(port.serial.as_ref(), &name)?,
                cap: entry.cap,
            };
            let begun = Instant::now();
            Ok(Box::new(Smd12::open(line, settings, Box::new(move || begun.elapsed()))?))
        }
        LaserLink::Gated { level, calibration } => {
            let output = GatedOutput { gates: gates.clone(), level: *level, set: None };
            let settings = GatedLaserSettings {
                name: name.clone(),
                identity: DeviceIdentity {
                    vendor: "Roithner".to_owned(),
                    model: format!("{} nm, gate {}", entry.wavelength_nm, entry.gate),
                    serial: String::new(),
                    firmware: String::new(),
                    simulated: is_virtual,
                },
                wavelength_nm: entry.wavelength_nm,
                cap: entry.cap,
                drive: drive_of(*level, calibration, &name)?,
            };
            Ok(Box::new(GatedLaser::new(output, settings)?))
        }
    }
}

/// Lasers are known by what they say of themselves, never by the port they are found on.
fn named(serial: Option<&String>, name: &str) -> Result<String, DeviceError> {
    serial.cloned().ok_or_else(|| {
        refused(format!(
            "{name} has no `serial` in the instrument file; write what `devices list` shows for its port"
        ))
    })
}

fn drive_of(
    level: Option<u8>,
    calibration: &[(Volts, Milliwatts)],
    name: &str,
) -> Result<Drive, DeviceError> {
    if level.is_none() {
        let power = calibration.last().map_or(Milliwatts::ZERO, |(_, power)| *power);
        return Ok(Drive::Ttl { power, polarity: Polarity::HighIsLight });
    }
    let points = calibration.iter().map(|&(level, power)| CalibrationPoint { level, power }).collect();
    let calibration = Calibration::new(points, Volts::ZERO)
        .map_err(|error| refused(format!("{name}: calibration: {error}")))?;
    Ok(Drive::Both { calibration, polarity: Polarity::HighIsLight })
}

/// The way of a laser without data link to the controller, through the thread that owns it.
struct GatedOutput {
    gates: Gates,
    level: Option<u8>,
    /// The level that was granted; `None` while withheld.
    set: Option<Volts>,
}

impl Output for GatedOutput {
    fn grant(&mut self, level: Volts) -> Result<(), DeviceError> {
        if let Some(output) = self.level {
            self.gates.set_level(output, level)?;
        }
        self.set = Some(level);
        Ok(())
    }

    fn set_level(&mut self, level: Volts) -> Result<(), DeviceError> {
        if self.set.is_none() {
            return Err(DeviceError::new(ErrorKind::Busy, "gated laser", "is dark; switch it on first"));
        }
        self.grant(level)
    }

    /// The guard closes all gates before it makes any laser dark, so that the level is left to do.
    fn withhold(&mut self) -> Result<(), DeviceError> {
        self.set = None;
        self.level.map_or(Ok(()), |output| self.gates.set_level(output, Volts::ZERO))
    }

    fn state(&mut self) -> Result<OutputState, DeviceError> {
        let gate = self.gates.state().ok_or_else(|| {
            DeviceError::new(ErrorKind::Lost, "trigger controller", "does not answer; its gates are unknown")
        })?;
        let permission = if self.set.is_some() { Permission::Granted } else { Permission::Withheld };
        Ok(OutputState { permission, level: self.set.unwrap_or(Volts::ZERO), gate })
    }
}

/// A controller whose cameras have another clock.
struct WithoutClock<C>(C);

impl<C: GateController> TriggerSource for WithoutClock<C> {
    fn start(&mut self, _period: Duration, _pulses: Option<u64>) -> Result<(), DeviceError> {
        Err(refused("this controller makes no pulses for cameras; name another trigger"))
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

impl<C: GateController> GateController for WithoutClock<C> {
    fn identity(&self) -> &DeviceIdentity {
        self.0.identity()
    }

    fn capabilities(&self) -> &GateCapabilities {
        self.0.capabilities()
    }

    fn arm(&mut self) -> Result<(), DeviceError> {
        self.0.arm()
    }

    fn disarm(&mut self) -> Result<(), DeviceError> {
        self.0.disarm()
    }

    fn set_gates(&mut self, open: GatePattern) -> Result<(), DeviceError> {
        self.0.set_gates(open)
    }

    fn set_level(&mut self, output: u8, level: Volts) -> Result<(), DeviceError> {
        self.0.set_level(output, level)
    }

    fn begin_sequence(&mut self, patterns: &[GatePattern]) -> Result<(), DeviceError> {
        self.0.begin_sequence(patterns)
    }

    fn end_sequence(&mut self) -> Result<(), DeviceError> {
        self.0.end_sequence()
    }

    fn heartbeat(&mut self) -> Result<(), DeviceError> {
        self.0.heartbeat()
    }

    fn state(&mut self) -> Result<GateState, DeviceError> {
        self.0.state()
    }
}
