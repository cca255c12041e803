//! The laser behind the contract.

use sofiscope_hal::{
    DeviceError, DeviceIdentity, Emission, ErrorKind, GateTrip, Interlock, Laser, LaserState, Milliwatts,
    Properties, Property, PropertyValue, Volts,
};

use crate::calibration::Calibration;
use crate::output::{Output, OutputState, Permission};

/// Which level of the digital input means light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Polarity {
    /// High is light: a controller that resets and a cable that is pulled are dark, with a pull-down at the input.
    HighIsLight,
    /// Low is light: refused, since every reset and every pulled cable would be light.
    LowIsLight,
}

/// Which inputs of the laser are wired.
#[derive(Debug, Clone, PartialEq)]
pub enum Drive {
    /// The digital input alone: one power, set at the supply by hand and measured there.
    Ttl {
        /// That power.
        power: Milliwatts,
        /// Of the digital input.
        polarity: Polarity,
    },
    /// The analog input alone: no gate closes it, so the controller must take its levels back by itself.
    Analog {
        /// Of the analog input.
        calibration: Calibration,
    },
    /// Both: the level sets the power, the gate lets it through.
    Both {
        /// Of the analog input.
        calibration: Calibration,
        /// Of the digital input.
        polarity: Polarity,
    },
}

/// What the configuration says; nothing of it has a default.
#[derive(Debug, Clone, PartialEq)]
pub struct GatedLaserSettings {
    /// The laser as the person knows it, for example `laser 405`.
    pub name: String,
    /// What its label says; it cannot be asked.
    pub identity: DeviceIdentity,
    /// Wavelength, nanometers.
    pub wavelength_nm: u32,
    /// The most that may be asked of it.
    pub cap: Milliwatts,
    /// How it is wired.
    pub drive: Drive,
}

/// A laser without a data link; withheld when made, and when dropped.
pub struct GatedLaser<O: Output> {
    output: O,
    settings: GatedLaserSettings,
    cap: Milliwatts,
    power_set: Milliwatts,
    /// Whether it was switched on and has not been found withheld.
    commanded: bool,
    fault: Option<String>,
}

impl<O: Output> GatedLaser<O> {
    /// Takes over an output, and makes it dark.
    ///
    /// # Errors
    /// [`OutOfRange`](ErrorKind::OutOfRange) for a cap that is no power, a fixed power above it, or an inverted
    /// input; what the controller says.
    pub fn new(output: O, settings: GatedLaserSettings) -> Result<Self, DeviceError> {
        let refuse = |told: &str| Err(DeviceError::new(ErrorKind::OutOfRange, &settings.name, told));
        let (most, polarity) = match &settings.drive {
            Drive::Ttl { power, polarity } => (*power, *polarity),
            Drive::Analog { calibration } => (calibration.greatest(), Polarity::HighIsLight),
            Drive::Both { calibration, polarity } => (calibration.greatest(), *polarity),
        };
        if settings.cap <= Milliwatts::ZERO || most <= Milliwatts::ZERO || settings.wavelength_nm == 0 {
            return refuse("cap, power and wavelength must be above zero; correct the configuration");
        }
        if polarity == Polarity::LowIsLight {
            return refuse(
                "its digital input is inverted: a reset of the controller, or a pulled cable, would be light; \
                 put an inverter with a pull-down before the laser",
            );
        }
        let fixed = matches!(settings.drive, Drive::Ttl { .. });
        if fixed && most > settings.cap {
            return refuse(
                "the power that is set at its supply lies above the cap; turn it down and measure again",
            );
        }
        let cap = if most < settings.cap { most } else { settings.cap };
        let power_set = if fixed { most } else { Milliwatts::ZERO };
        let mut laser = Self { output, settings, cap, power_set, commanded: false, fault: None };
        laser.output.withhold()?;
        Ok(laser)
    }

    fn error(&self, kind: ErrorKind, told: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.settings.name, told)
    }

    /// The level for a power.
    fn level_for(&self, power: Milliwatts) -> Result<Volts, DeviceError> {
        match &self.settings.drive {
            Drive::Ttl { power: fixed, .. } if power == *fixed => Ok(Volts::ZERO),
            Drive::Ttl { power: fixed, .. } => {
                let told = format!("{power} cannot be set: its supply is set to {fixed} by hand");
                Err(self.error(ErrorKind::OutOfRange, told))
            }
            Drive::Analog { calibration } | Drive::Both { calibration, .. } => {
                let level = calibration.level_for(power);
                level.map_err(|outside| self.error(ErrorKind::OutOfRange, outside.to_string()))
            }
        }
    }

    /// Takes the light back and gives the error that says so.
    fn darken(&mut self, told: &str) -> DeviceError {
        self.commanded = false;
        self.fault = Some(told.to_owned());
        match self.output.withhold() {
            Ok(()) => self.error(ErrorKind::Fault, told),
            Err(error) => error,
        }
    }

    /// Whether the controller holds what this laser wants.
    fn is_held(state: &OutputState, level: Volts) -> bool {
        state.permission == Permission::Granted && state.level == level && state.gate.trip.is_none()
    }
}

impl<O: Output> Laser for GatedLaser<O> {
    fn identity(&self) -> &DeviceIdentity {
        &self.settings.identity
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
            return Err(self.error(ErrorKind::OutOfRange, told));
        }
        let level = self.level_for(power)?;
        // In the dark the level stays zero; it is applied when the laser is switched on.
        if self.commanded {
            match self.output.set_level(level) {
                Ok(()) => {}
                Err(error) if error.kind() == ErrorKind::Busy => {
                    self.darken("went dark by itself; look at the controller, then switch on again");
                }
                Err(error) => {
                    self.commanded = false;
                    self.fault = Some(error.to_string());
                    return Err(self.output.withhold().err().unwrap_or(error));
                }
            }
        }
        self.power_set = power;
        Ok(())
    }

    fn switch_on(&mut self) -> Result<(), DeviceError> {
        (self.commanded, self.fault) = (false, None);
        let level = self.level_for(self.power_set)?;
        let granted = self.output.grant(level).and_then(|()| self.output.state());
        match granted {
            Ok(state) if Self::is_held(&state, level) => {
                self.commanded = true;
                Ok(())
            }
            Ok(_) => {
                Err(self.darken("the controller took the level and does not hold it; look at its state"))
            }
            Err(error) => {
                self.fault = Some(error.to_string());
                Err(self.output.withhold().err().unwrap_or(error))
            }
        }
    }

    fn switch_off(&mut self) -> Result<(), DeviceError> {
        (self.commanded, self.fault) = (false, None);
        self.output.withhold()?;
        let state = self.output.state()?;
        if state.permission == Permission::Withheld && state.level == Volts::ZERO {
            return Ok(());
        }
        Err(self.darken("withheld, but its level is still there; take it as emitting, use key or interlock"))
    }

    fn state(&mut self) -> Result<LaserState, DeviceError> {
        let state = self.output.state()?;
        let on = state.permission == Permission::Granted || state.level != Volts::ZERO;
        if self.commanded && (!on || state.gate.trip.is_some()) {
            let why =
                state.gate.trip.map_or("the controller was reset, armed or disarmed".to_owned(), |trip| {
                    format!("the controller has tripped ({trip:?})")
                });
            self.darken(&format!("went dark by itself: {why}; arm the controller, then switch on again"));
        } else if on && !self.commanded {
            return Err(self.darken("its output is held, and nobody has switched it on"));
        }
        Ok(LaserState {
            emission: if on && self.commanded { Emission::On } else { Emission::Off },
            power_set: self.power_set,
            power_measured: None,
            interlock: match state.gate.trip {
                Some(GateTrip::Interlock) => Interlock::Open,
                _ => Interlock::NotReported,
            },
            fault: self.fault.clone(),
        })
    }

    fn make_dark(&mut self) -> Result<(), DeviceError> {
        self.commanded = false;
        self.output.withhold()
    }
}

impl<O: Output> Properties for GatedLaser<O> {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        let state = self.output.state()?;
        let permitted = PropertyValue::Flag(state.permission == Permission::Granted);
        let mut properties = vec![
            Property::reading("gate permitted", permitted, ""),
            Property::reading("level", PropertyValue::Number(state.level.value()), "V"),
            Property::reading("power cap", PropertyValue::Number(self.cap.value()), "mW"),
        ];
        if let Drive::Analog { calibration } | Drive::Both { calibration, .. } = &self.settings.drive {
            let threshold = PropertyValue::Number(calibration.threshold().value());
            properties.push(Property::reading("threshold", threshold, "V"));
        }
        Ok(properties)
    }
}

impl<O: Output> Drop for GatedLaser<O> {
    fn drop(&mut self) {
        // Nobody is left who could be told; the controller's watchdog is the next to act.
        let _told = self.output.withhold();
    }
}
