//! The laser behind the contract.
//!
//! It is always in power control: probing the option of current control would write to the laser. The supply has no
//! query for the set power, so what is reported is what it has taken; the measured power tells whether it meant it.

use std::time::Duration;

use sofiscope_hal::{
    DeviceError, DeviceIdentity, Emission, ErrorKind, Interlock, Laser, LaserState, Milliwatts,
};
use sofiscope_serial_line::Line;

use crate::link::{Haste, Link, Shape};
use crate::ramp::{Aim, Ramp};
use crate::reply;

/// Confirmations of darkness that are asked for.
const ATTEMPTS_TO_OFF: usize = 2;

/// Time that passes for the ramp: any beginning, never backwards.
pub type Clock = Box<dyn FnMut() -> Duration + Send>;

/// What the configuration says; nothing of it has a default.
#[derive(Debug, Clone, PartialEq)]
pub struct Smd12Settings {
    /// Wavelength, nanometers.
    pub wavelength_nm: u32,
    /// The whole answer to `VERSION?`, by which the laser is known: the supply tells no serial number.
    pub version: String,
    /// The most that may be asked of it: the head does not tell its own limit.
    pub cap: Milliwatts,
}

/// A gem laser on an SMD12; dark when opened, and when dropped.
pub struct Smd12 {
    pub(crate) link: Link,
    identity: DeviceIdentity,
    settings: Smd12Settings,
    clock: Clock,
    power_set: Milliwatts,
    measured: Milliwatts,
    ramp: Ramp,
    /// Why it went dark by itself; stays until it is switched on or off.
    fault: Option<String>,
}

impl Smd12 {
    /// Meets the laser at the other end of `line`, and makes it dark before anything else is asked of it.
    ///
    /// # Errors
    /// [`Identity`](ErrorKind::Identity) for another laser, which is left alone;
    /// [`OutOfRange`](ErrorKind::OutOfRange) for a cap that is no power; what the line and the laser say.
    pub fn open(line: Line, settings: Smd12Settings, clock: Clock) -> Result<Self, DeviceError> {
        if settings.cap <= Milliwatts::ZERO || settings.wavelength_nm == 0 {
            let told = "cap and wavelength must be above zero; correct the configuration";
            return Err(DeviceError::new(ErrorKind::OutOfRange, line.device(), told));
        }
        let mut link = Link::new(line);
        let found = link.first_contact()?;
        if found != settings.version {
            let wanted = &settings.version;
            let told = format!("expected '{wanted}', found '{found}'; check which laser hangs on this port");
            return Err(link.fault(ErrorKind::Identity, told));
        }
        let identity = DeviceIdentity {
            vendor: "Laser Quantum".into(),
            model: "gem, SMD12".into(),
            serial: String::new(),
            simulated: found.contains("virtual"),
            firmware: found,
        };
        let (power_set, measured) = (Milliwatts::ZERO, Milliwatts::ZERO);
        // From here on it is dark again whatever fails: it is dropped.
        let mut laser =
            Self { link, identity, settings, clock, power_set, measured, ramp: Ramp::Dark, fault: None };
        laser.initialize()?;
        Ok(laser)
    }

    /// How far the power has come, as of the last state.
    #[must_use]
    pub fn ramp(&self) -> Ramp {
        self.ramp
    }

    fn initialize(&mut self) -> Result<(), DeviceError> {
        self.confirm_off(Haste::Usual)?;
        // It must not emit by itself at its next power-up.
        self.link.set("STEN=NO", Haste::Usual)?;
        self.link.set("CONTROL=POWER", Haste::Usual)?;
        let control = self.link.ask("CONTROL?", Shape::Text, Haste::Usual, reply::something)?;
        if control != "POWER" {
            let told = format!("stays in {control} control, where no power can be set; check its supply");
            return Err(self.darken(&told));
        }
        self.link.set("POWER=0", Haste::Usual)
    }

    /// Makes it dark and gives the fault that says so.
    fn darken(&mut self, told: &str) -> DeviceError {
        self.ramp = Ramp::Dark;
        self.fault = Some(told.to_owned());
        let dark = match self.link.make_dark() {
            Ok(()) => "it was told to be dark",
            Err(_) => "it cannot be told to be dark: use key or interlock",
        };
        self.link.fault(ErrorKind::Fault, format!("{told}; {dark}"))
    }

    /// Makes it dark after something else has failed, and gives the graver of the two errors.
    fn darken_after(&mut self, error: DeviceError) -> DeviceError {
        self.ramp = Ramp::Dark;
        self.fault = Some(error.to_string());
        self.link.make_dark().err().unwrap_or(error)
    }

    fn status(&mut self, haste: Haste) -> Result<bool, DeviceError> {
        self.link.ask("STATUS?", Shape::Status, haste, reply::enabled)
    }

    fn confirm_off(&mut self, haste: Haste) -> Result<(), DeviceError> {
        self.link.set("OFF", haste)?;
        self.is_off(haste)
    }

    fn is_off(&mut self, haste: Haste) -> Result<(), DeviceError> {
        if self.status(haste)? {
            let told =
                "OFF was acknowledged, but it is still ENABLED; take it as emitting, use key or interlock";
            return Err(self.darken(told));
        }
        Ok(())
    }

    fn try_on(&mut self) -> Result<(), DeviceError> {
        // Once more, as the supply may have lost its power since.
        let power = self.power_set;
        self.link.set(&power_command(power), Haste::Usual)?;
        self.link.set("ON", Haste::Usual)?;
        if self.status(Haste::Usual)? {
            return Ok(());
        }
        Err(self.darken("took ON and stays DISABLED; check interlock and key, then switch on again"))
    }

    fn begin_ramp(&mut self, from: Milliwatts) {
        self.ramp = Ramp::Rising { since: (self.clock)(), from };
    }
}

fn power_command(power: Milliwatts) -> String {
    format!("POWER={}", power.value())
}

impl Laser for Smd12 {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn wavelength_nm(&self) -> u32 {
        self.settings.wavelength_nm
    }

    fn power_cap(&self) -> Milliwatts {
        self.settings.cap
    }

    /// Sets the power in tenths of a milliwatt, rounded down; the supply has no query that would read it back.
    fn set_power(&mut self, power: Milliwatts) -> Result<(), DeviceError> {
        if power < Milliwatts::ZERO || power > self.settings.cap {
            let told =
                format!("{power} is not within 0 and the cap of {}; nothing was sent", self.settings.cap);
            return Err(self.link.fault(ErrorKind::OutOfRange, told));
        }
        let tenths = (power.value() * 10.0 + 1e-6).floor();
        let wanted = Milliwatts::new(tenths / 10.0).unwrap_or(Milliwatts::ZERO);
        match self.link.set(&power_command(wanted), Haste::Usual) {
            Ok(()) => {
                let highest = if self.measured > self.power_set { self.measured } else { self.power_set };
                self.power_set = wanted;
                if self.ramp != Ramp::Dark {
                    self.begin_ramp(highest);
                }
                Ok(())
            }
            // Nobody knows at which power it would go on.
            Err(error) => Err(self.darken_after(error)),
        }
    }

    /// Lets it emit; it does not wait for the ramp, which [`state`](Self::state) follows.
    fn switch_on(&mut self) -> Result<(), DeviceError> {
        self.fault = None;
        match self.try_on() {
            Ok(()) => {
                if self.ramp == Ramp::Dark {
                    self.begin_ramp(Milliwatts::ZERO);
                }
                Ok(())
            }
            Err(error) if self.fault.is_some() => Err(error),
            Err(error) => Err(self.darken_after(error)),
        }
    }

    fn switch_off(&mut self) -> Result<(), DeviceError> {
        (self.ramp, self.fault) = (Ramp::Dark, None);
        let mut result = self.link.off_at_once().and_then(|()| self.is_off(Haste::Urgent));
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
        let on = self.status(Haste::Usual)?;
        self.measured = self.link.ask("POWER?", Shape::Power, Haste::Usual, reply::power)?;
        match (on, self.ramp) {
            (true, Ramp::Dark) => return Err(self.darken("it emits, and nobody has switched it on")),
            (true, ramp) => {
                let aim = Aim { set: self.power_set, cap: self.settings.cap };
                let now = (self.clock)();
                match ramp.step(aim, self.measured, now) {
                    Ok(ramp) => self.ramp = ramp,
                    Err(deviation) => {
                        let told = format!("{deviation}: {} measured, {} set", self.measured, self.power_set);
                        return Err(self.darken(&told));
                    }
                }
            }
            (false, Ramp::Dark) => {}
            (false, _) => {
                // Closing an interlock must not bring the light back, whatever this supply makes of it.
                self.darken("went dark by itself; check interlock and key, then switch on again");
            }
        }
        Ok(LaserState {
            emission: if on { Emission::On } else { Emission::Off },
            power_set: self.power_set,
            power_measured: Some(self.measured),
            // No public query tells interlock and key apart from a laser that is off.
            interlock: Interlock::NotReported,
            fault: self.fault.clone(),
        })
    }

    fn make_dark(&mut self) -> Result<(), DeviceError> {
        self.ramp = Ramp::Dark;
        self.link.make_dark()
    }
}

impl Drop for Smd12 {
    fn drop(&mut self) {
        // Nobody is left who could be told.
        let _told = self.link.make_dark();
    }
}
