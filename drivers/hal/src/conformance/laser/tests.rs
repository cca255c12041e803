//! A laser that keeps its contract passes; each broken promise is caught.

use super::*;
use crate::{DeviceError, DeviceIdentity, Properties, Property};

/// What the laser does wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bug {
    None,
    NoVendor,
    NoWavelength,
    BrightAtStart,
    ClipsPower,
    TakesNegativePower,
    SendsWhatItRefuses,
    RefusesAsBusy,
    ForgetsPower,
    PowerSwitchesOn,
    OnIsOnlySaid,
    OnAtDoublePower,
    OnIsNotSaid,
    StaysLit,
    OffIsNotSaid,
    OffOnlyOnce,
    ShortWayIsLong,
    ShortWayForGood,
    OnWithOpenInterlock,
    TimesOutAtInterlock,
    BrightBehindInterlock,
    RemembersInterlock,
    ReenablesItself,
    KeepsItselfToItself,
}

struct Fake {
    bug: Bug,
    identity: DeviceIdentity,
    power: Milliwatts,
    on: bool,
    lit: bool,
    open: bool,
    fault: Option<String>,
    num_sent: u64,
    num_off: u32,
}

impl Fake {
    fn error(kind: ErrorKind) -> DeviceError {
        DeviceError::new(kind, "fake", "no")
    }
}

fn mw(power: f64) -> Milliwatts {
    Milliwatts::new(power).unwrap()
}

impl Properties for Fake {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        Ok(Vec::new())
    }
}

impl Laser for Fake {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn wavelength_nm(&self) -> u32 {
        if self.bug == Bug::NoWavelength { 0 } else { 488 }
    }

    fn power_cap(&self) -> Milliwatts {
        mw(100.0)
    }

    fn set_power(&mut self, power: Milliwatts) -> Result<(), DeviceError> {
        self.num_sent += u64::from(self.bug == Bug::SendsWhatItRefuses);
        let high = power > self.power_cap() && self.bug != Bug::ClipsPower;
        let low = power < Milliwatts::ZERO && self.bug != Bug::TakesNegativePower;
        if high || low {
            let busy = self.bug == Bug::RefusesAsBusy;
            return Err(Self::error(if busy { ErrorKind::Busy } else { ErrorKind::OutOfRange }));
        }
        self.num_sent += 1;
        self.power = power;
        self.lit |= self.bug == Bug::PowerSwitchesOn;
        Ok(())
    }

    fn switch_on(&mut self) -> Result<(), DeviceError> {
        self.fault = None;
        if self.open {
            self.on = self.bug == Bug::RemembersInterlock;
            self.lit = self.bug == Bug::BrightBehindInterlock;
            let late = self.bug == Bug::TimesOutAtInterlock;
            let kind = if late { ErrorKind::Timeout } else { ErrorKind::Fault };
            return if self.bug == Bug::OnWithOpenInterlock { Ok(()) } else { Err(Self::error(kind)) };
        }
        (self.on, self.lit) = (true, self.bug != Bug::OnIsOnlySaid);
        Ok(())
    }

    fn switch_off(&mut self) -> Result<(), DeviceError> {
        self.num_off += 1;
        if !self.on && self.bug == Bug::OffOnlyOnce && self.num_off > 1 {
            return Err(Self::error(ErrorKind::Fault));
        }
        (self.on, self.lit) = (false, self.bug == Bug::StaysLit);
        Ok(())
    }

    fn state(&mut self) -> Result<LaserState, DeviceError> {
        let said = match self.bug {
            Bug::OnIsNotSaid => false,
            Bug::OffIsNotSaid => self.on || self.num_off > 0,
            _ => self.on,
        };
        let silent = self.bug == Bug::KeepsItselfToItself;
        Ok(LaserState {
            emission: if said { Emission::On } else { Emission::Off },
            power_set: if self.bug == Bug::ForgetsPower { Milliwatts::ZERO } else { self.power },
            power_measured: None,
            interlock: Interlock::NotReported,
            fault: self.fault.clone().filter(|_| !silent),
        })
    }

    fn make_dark(&mut self) -> Result<(), DeviceError> {
        if self.bug == Bug::ShortWayForGood {
            self.open = true;
        }
        self.on = false;
        self.lit &= self.bug == Bug::ShortWayIsLong;
        Ok(())
    }
}

impl LaserRig for Fake {
    fn laser(&mut self) -> &mut dyn Laser {
        self
    }

    fn power(&self) -> Milliwatts {
        mw(40.0)
    }

    fn emitted(&mut self) -> Milliwatts {
        let factor = if self.bug == Bug::OnAtDoublePower { 2.0 } else { 1.0 };
        if self.lit { mw(self.power.value().max(1.0) * factor) } else { Milliwatts::ZERO }
    }

    fn num_sent(&mut self) -> u64 {
        self.num_sent
    }

    fn open_interlock(&mut self) {
        self.open = true;
        self.fault = self.on.then(|| "went dark by itself".to_owned());
        let was_on = std::mem::take(&mut self.on);
        self.lit = false;
        self.on = was_on && self.bug == Bug::ReenablesItself;
    }

    fn close_interlock(&mut self) {
        self.open = false;
        self.lit = self.on;
    }
}

fn fake(bug: Bug) -> Fake {
    let identity = DeviceIdentity {
        vendor: if bug == Bug::NoVendor { "" } else { "nobody" }.into(),
        model: "fake".into(),
        serial: String::new(),
        firmware: String::new(),
        simulated: true,
    };
    Fake {
        bug,
        identity,
        power: Milliwatts::ZERO,
        on: false,
        lit: bug == Bug::BrightAtStart,
        open: false,
        fault: None,
        num_sent: 0,
        num_off: 0,
    }
}

#[test]
fn a_laser_that_keeps_its_contract_passes() {
    laser(&mut fake(Bug::None));
}

macro_rules! caught {
    ($($name:ident: $bug:ident, $says:literal;)*) => {
        $(
            #[test]
            #[should_panic(expected = $says)]
            fn $name() {
                laser(&mut fake(Bug::$bug));
            }
        )*
    };
}

caught! {
    a_missing_vendor_is_caught: NoVendor, "has a vendor";
    a_missing_wavelength_is_caught: NoWavelength, "has a wavelength";
    light_at_start_is_caught: BrightAtStart, "just opened is dark";
    clipped_powers_are_caught: ClipsPower, "under a cap of 100 mW must be refused";
    negative_powers_are_caught: TakesNegativePower, "-0.01 mW under a cap of 100 mW must be refused";
    refused_powers_on_the_line_are_caught: SendsWhatItRefuses, "reach no device";
    refusals_of_another_kind_are_caught: RefusesAsBusy, "must be refused as OutOfRange";
    forgotten_powers_are_caught: ForgetsPower, "the set power reads back";
    powers_that_switch_on_are_caught: PowerSwitchesOn, "set in the dark is dark";
    light_that_is_only_said_is_caught: OnIsOnlySaid, "0 mW leave its head";
    light_of_another_power_is_caught: OnAtDoublePower, "emits 40 mW, but 80 mW";
    light_that_is_not_said_is_caught: OnIsNotSaid, "says that it is On";
    light_that_stays_is_caught: StaysLit, "switched off is dark";
    darkness_that_is_not_said_is_caught: OffIsNotSaid, "says that it is Off";
    an_off_that_fails_the_second_time_is_caught: OffOnlyOnce, "switching off twice";
    a_short_way_without_darkness_is_caught: ShortWayIsLong, "made dark is dark";
    a_short_way_for_good_is_caught: ShortWayForGood, "switching on a laser that was made dark";
    on_with_an_open_interlock_is_caught: OnWithOpenInterlock, "must be refused as Fault, but it succeeded";
    another_word_for_the_interlock_is_caught: TimesOutAtInterlock, "must be refused as Fault";
    light_behind_an_open_interlock_is_caught: BrightBehindInterlock, "with an open interlock is dark";
    a_refusal_that_is_remembered_is_caught: RemembersInterlock, "closed after it was refused is dark";
    light_that_comes_back_is_caught: ReenablesItself, "not on";
    going_dark_without_a_word_is_caught: KeepsItselfToItself, "says so";
}
