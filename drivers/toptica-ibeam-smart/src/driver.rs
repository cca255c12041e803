//! The laser behind the contract.
//!
//! Channel 1 is the bias and stays at zero; channel 2 is the operating level. With external modulation the power is
//! fixed over the line and the trigger controller gates it: what is measured is then an average.

use sofiscope_hal::{
    DeviceError, DeviceIdentity, Emission, ErrorKind, Interlock, Laser, LaserState, Milliwatts,
};
use sofiscope_serial_line::Line;

use crate::link::{Haste, Link, Shape};
use crate::reply;

/// Part by which the measured power may be off.
const POWER_TOLERANCE: f64 = 0.1;
/// Part by which a photodiode that is right may read above the cap.
const READING_TOLERANCE: f64 = 0.02;
/// Levels are set in microwatts and read back in the same.
const LEVEL_STEP_MW: f64 = 0.0011;
/// Below this nothing is compared: the offset of the photodiode, milliwatts.
const LEAST_COMPARED_MW: f64 = 0.1;
/// Confirmations of darkness that are asked for.
const ATTEMPTS_TO_OFF: usize = 2;

/// Whether the trigger controller gates the laser through its modulation input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Modulation {
    /// It does: dark while the input is low.
    External,
    /// It does not: the power is constant, and something else must gate it.
    None,
}

/// What the configuration says; nothing of it has a default.
#[derive(Debug, Clone, PartialEq)]
pub struct IbeamSettings {
    /// Wavelength, nanometers.
    pub wavelength_nm: u32,
    /// Serial number as `serial` answers it, without `SN:`.
    pub serial: String,
    /// The most that may be asked of it.
    pub cap: Milliwatts,
    /// Who gates it.
    pub modulation: Modulation,
}

/// An iBEAM smart; dark when opened, and when dropped.
pub struct IbeamSmart {
    pub(crate) link: Link,
    identity: DeviceIdentity,
    settings: IbeamSettings,
    cap: Milliwatts,
    power_set: Milliwatts,
    /// Whether it was told to emit and has not been found dark.
    commanded: bool,
    /// Why it went dark by itself; stays until it is switched on or off.
    fault: Option<String>,
}

impl IbeamSmart {
    /// Meets the laser at the other end of `line`, and makes it dark before anything else is asked of it.
    ///
    /// # Errors
    /// [`Identity`](ErrorKind::Identity) for another laser, which is left alone;
    /// [`OutOfRange`](ErrorKind::OutOfRange) for a cap that is no power; what the line and the laser say.
    pub fn open(line: Line, settings: IbeamSettings) -> Result<Self, DeviceError> {
        if settings.cap <= Milliwatts::ZERO || settings.wavelength_nm == 0 {
            let told = "cap and wavelength must be above zero; correct the configuration";
            return Err(DeviceError::new(ErrorKind::OutOfRange, line.device(), told));
        }
        let mut link = Link::new(line, settings.serial.clone());
        let found = link.first_contact()?;
        if found != settings.serial {
            let told = format!(
                "expected serial number {}, found {found}; check which laser hangs on this port",
                settings.serial
            );
            return Err(link.fault(ErrorKind::Identity, told));
        }
        let identity = DeviceIdentity {
            vendor: "Toptica".into(),
            model: String::new(),
            serial: found,
            firmware: String::new(),
            simulated: false,
        };
        // From here on it is dark again whatever fails: it is dropped.
        let mut laser = Self {
            link,
            identity,
            cap: settings.cap,
            settings,
            power_set: Milliwatts::ZERO,
            commanded: false,
            fault: None,
        };
        laser.initialize()?;
        Ok(laser)
    }

    /// Reboots it, which makes it dark: the cure for a clipped laser or answers that lag.
    ///
    /// # Errors
    /// What the line and the laser say.
    pub fn reboot(&mut self) -> Result<(), DeviceError> {
        self.commanded = false;
        self.link.restart()?;
        self.initialize()
    }

    fn initialize(&mut self) -> Result<(), DeviceError> {
        self.confirm_off(Haste::Thorough)?;
        let text = |texts: &[String]| reply::only(texts).map(str::to_owned);
        self.identity.model = self.link.ask("id", Shape::Text, Haste::Usual, text)?;
        self.identity.firmware = self.link.ask("version", Shape::Text, Haste::Usual, text)?;
        self.identity.simulated = self.identity.firmware.contains("virtual");
        let most = self.link.ask("sh sat", Shape::Limits, Haste::Usual, reply::most_power)?;
        if most < self.cap {
            self.cap = most;
        }
        // FINE acts on the bias, which is not used.
        for command in ["fine off", "ch 1 pow 0", "ch 2 pow 0"] {
            self.link.set(command, Haste::Usual)?;
        }
        self.power_set = Milliwatts::ZERO;
        let external = self.settings.modulation == Modulation::External;
        self.link.set(if external { "en ext" } else { "di ext" }, Haste::Usual)?;
        let found = self.link.ask("sta ext", Shape::Switch, Haste::Usual, reply::switch)?;
        if found != external {
            let told =
                format!("external modulation was set to {external} and reads {found}; check its firmware");
            return Err(self.darken(ErrorKind::Fault, &told));
        }
        self.levels_are_right(Haste::Usual)
    }

    /// Makes it dark and gives the error that says so.
    fn darken(&mut self, kind: ErrorKind, told: &str) -> DeviceError {
        self.commanded = false;
        let dark = match self.link.make_dark() {
            Ok(()) => "it was told to be dark",
            Err(_) => "it cannot be told to be dark: use key or interlock",
        };
        self.fault = Some(told.to_owned());
        self.link.fault(kind, format!("{told}; {dark}"))
    }

    /// Makes it dark after something else has failed, and gives the graver of the two errors.
    fn darken_after(&mut self, error: DeviceError) -> DeviceError {
        self.commanded = false;
        self.fault = Some(error.to_string());
        self.link.dark().err().unwrap_or(error)
    }

    /// Reads back that bias and operating level are what they should be.
    fn levels_are_right(&mut self, haste: Haste) -> Result<(), DeviceError> {
        let levels = self.link.ask("sh level pow", Shape::Levels, haste, reply::levels)?;
        let (bias, level) = (levels[0], levels[1]);
        let right = level.distance(self.power_set).value() < LEVEL_STEP_MW && bias == Milliwatts::ZERO;
        if right && level.value() <= self.cap.value() + LEVEL_STEP_MW {
            return Ok(());
        }
        let told = format!("power was set to {}, but reads {level} above a bias of {bias}", self.power_set);
        Err(self.darken(ErrorKind::Fault, &told))
    }

    /// `true` for on.
    fn status(&mut self, of: &str, haste: Haste) -> Result<bool, DeviceError> {
        self.link.ask(&format!("sta {of}"), Shape::Switch, haste, reply::switch)
    }

    fn confirm_off(&mut self, haste: Haste) -> Result<(), DeviceError> {
        self.link.set("la off", haste)?;
        self.link.set("di 0", haste)?;
        if self.status("la", haste)? {
            let told =
                "OFF was acknowledged, but it still says ON; take it as emitting, use key or interlock";
            return Err(self.darken(ErrorKind::Fault, told));
        }
        Ok(())
    }

    fn try_on(&mut self) -> Result<(), DeviceError> {
        self.levels_are_right(Haste::Thorough)?;
        for command in ["en 1", "en 2"] {
            self.link.set(command, Haste::Usual)?;
        }
        if !self.status("ch 2", Haste::Usual)? {
            let told = "channel 2 stays disabled, so that it would stay dark; check its channels with TOPAS";
            return Err(self.darken(ErrorKind::Fault, told));
        }
        self.link.set("la on", Haste::Usual)?;
        if !self.status("la", Haste::Usual)? {
            let told = "took ON and stays OFF; check interlock and key, then switch on again";
            return Err(self.darken(ErrorKind::Fault, told));
        }
        Ok(())
    }

    /// Whether the measured power is what it may be.
    fn judge(&mut self, measured: Milliwatts) -> Result<(), DeviceError> {
        let (set, read) = (self.power_set.value(), measured.value());
        let gated = self.settings.modulation == Modulation::External;
        let above = read > set * (1.0 + POWER_TOLERANCE) + LEAST_COMPARED_MW;
        let below = !gated && read < set * (1.0 - POWER_TOLERANCE) - LEAST_COMPARED_MW;
        let over_cap = read > self.cap.value() * (1.0 + READING_TOLERANCE) + LEAST_COMPARED_MW;
        if !(above || below || over_cap) {
            return Ok(());
        }
        let told =
            format!("{measured} measured where {} are set under a cap of {}", self.power_set, self.cap);
        Err(self.darken(ErrorKind::Fault, &told))
    }
}

impl Laser for IbeamSmart {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn wavelength_nm(&self) -> u32 {
        self.settings.wavelength_nm
    }

    fn power_cap(&self) -> Milliwatts {
        self.cap
    }

    fn set_power(&mut self, power: Milliwatts) -> Result<(), DeviceError> {
        if power < Milliwatts::ZERO || power > self.cap {
            let told = format!("{power} is not within 0 and the cap of {}; nothing was sent", self.cap);
            return Err(self.link.fault(ErrorKind::OutOfRange, told));
        }
        // Rounded down, so that it never comes to lie above what was asked.
        let microwatts = (power.value() * 1000.0 + 1e-6).floor();
        self.power_set = Milliwatts::new(microwatts / 1000.0).unwrap_or(Milliwatts::ZERO);
        let haste = if self.commanded { Haste::Usual } else { Haste::Thorough };
        let done = self.link.set(&format!("ch 2 pow {microwatts} mic"), haste);
        match done.and_then(|()| self.levels_are_right(haste)) {
            Ok(()) => Ok(()),
            // Nobody knows at which power it would go on.
            Err(error) => Err(self.darken_after(error)),
        }
    }

    fn switch_on(&mut self) -> Result<(), DeviceError> {
        self.fault = None;
        match self.try_on() {
            Ok(()) => {
                self.commanded = true;
                Ok(())
            }
            Err(error) if self.fault.is_some() => Err(error),
            Err(error) => Err(self.darken_after(error)),
        }
    }

    fn switch_off(&mut self) -> Result<(), DeviceError> {
        (self.commanded, self.fault) = (false, None);
        let mut result = self.confirm_off(Haste::Urgent);
        for _again in 1..ATTEMPTS_TO_OFF {
            if result.as_ref().is_err_and(|error| error.kind() != ErrorKind::Lost) {
                result = self.confirm_off(Haste::Urgent);
            }
        }
        if let Err(error) = &result {
            self.fault = Some(error.to_string());
        }
        result
    }

    fn state(&mut self) -> Result<LaserState, DeviceError> {
        let on = self.status("la", Haste::Usual)?;
        let measured = self.link.ask("sh pow", Shape::Power, Haste::Usual, reply::measured_power)?;
        self.levels_are_right(Haste::Usual)?;
        match (on, self.commanded) {
            (true, true) => self.judge(measured)?,
            (true, false) => {
                let told = "it emits, and nobody has switched it on";
                return Err(self.darken(ErrorKind::Fault, told));
            }
            (false, true) => {
                // Closing an interlock must not bring the light back, whatever this firmware makes of it.
                let told = "went dark by itself; check interlock and key, then switch on again";
                self.darken(ErrorKind::Fault, told);
            }
            (false, false) => {}
        }
        Ok(LaserState {
            emission: if on { Emission::On } else { Emission::Off },
            power_set: self.power_set,
            power_measured: Some(measured),
            // No public query tells interlock and key apart from a laser that is off.
            interlock: Interlock::NotReported,
            fault: self.fault.clone(),
        })
    }

    fn make_dark(&mut self) -> Result<(), DeviceError> {
        self.commanded = false;
        self.link.dark()
    }
}

impl Drop for IbeamSmart {
    fn drop(&mut self) {
        // Nobody is left who could be told; the line is then as dead as the laser can be made.
        let _told = self.link.make_dark();
        self.link.take_leave();
    }
}
