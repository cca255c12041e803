//! A sensor that keeps its promises passes; each broken promise is caught.

use super::*;
use crate::{DeviceError, DeviceIdentity};

/// What the sensor does wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bug {
    None,
    NoModel,
    OldNumberNewSignal,
    NumbersGoBack,
    NeverNew,
    FromTheFuture,
    TimesGoBack,
    NoNumberInTheDark,
    NegativeLight,
    ShapeAboveOne,
    Saturated,
    Flat,
    Folded,
    BrightWhenBlocked,
    ShapelyWhenBlocked,
    StaysDark,
    WaitsTooLong,
    LostWhenSilent,
    RepeatsWhenSilent,
}

const PERIOD_NS: u64 = 5_000_000;

struct Fake {
    bug: Bug,
    identity: DeviceIdentity,
    now_ns: u64,
    reads: u64,
    error_nm: f64,
    blocked: bool,
    was_blocked: bool,
    silent: bool,
}

impl Fake {
    fn new(bug: Bug) -> Self {
        let model = if bug == Bug::NoModel { "" } else { "fake" };
        let identity = DeviceIdentity {
            vendor: "nobody".into(),
            model: model.into(),
            serial: String::new(),
            firmware: "1".into(),
            simulated: true,
        };
        Self {
            bug,
            identity,
            now_ns: 0,
            reads: 0,
            error_nm: 0.0,
            blocked: false,
            was_blocked: false,
            silent: false,
        }
    }

    fn has(&self, bug: Bug) -> bool {
        self.bug == bug
    }

    fn number(&self) -> u64 {
        // Every reading is told twice.
        match self.bug {
            Bug::NeverNew => 0,
            Bug::NumbersGoBack if self.reads == 12 => 1,
            _ => self.reads / 2,
        }
    }

    fn signal(&self, number: u64) -> f64 {
        let slope = match self.bug {
            Bug::Flat => 0.0,
            Bug::Folded if self.error_nm < 0.0 => -0.01,
            _ => 0.065,
        };
        let noise = if number.is_multiple_of(2) { 0.02 } else { -0.02 };
        let late = if self.has(Bug::OldNumberNewSignal) { self.reads as f64 * 1e-6 } else { 0.0 };
        300.0 + slope * self.error_nm + noise + late
    }
}

impl FocusSensor for Fake {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn read(&mut self, timeout: Duration) -> Result<FocusReading, DeviceError> {
        if self.silent && !self.has(Bug::RepeatsWhenSilent) {
            let waits = if self.has(Bug::WaitsTooLong) { 3 * timeout } else { timeout };
            self.now_ns += waits.as_nanos() as u64;
            let kind = if self.has(Bug::LostWhenSilent) { ErrorKind::Lost } else { ErrorKind::Timeout };
            return Err(DeviceError::new(kind, "fake", "nothing came"));
        }
        self.now_ns += PERIOD_NS / 2;
        self.reads += 1;
        let number = self.number();
        let at = HostTime(match self.bug {
            Bug::FromTheFuture => self.now_ns + 1,
            Bug::TimesGoBack => 1_000_000_000 - number,
            Bug::NeverNew => 0,
            _ => number * PERIOD_NS,
        });
        if self.has(Bug::TimesGoBack) {
            self.now_ns = self.now_ns.max(1_000_000_000);
        }
        let dark = self.blocked || self.has(Bug::StaysDark) && self.was_blocked;
        let reading =
            FocusReading { number, at, signal: self.signal(number), light: 1e5, saturated: 0.0, shape: 0.95 };
        Ok(match self.bug {
            Bug::BrightWhenBlocked if dark => FocusReading { shape: 0.0, ..reading },
            Bug::ShapelyWhenBlocked if dark => FocusReading { light: 50.0, ..reading },
            Bug::NoNumberInTheDark if dark => {
                FocusReading { signal: f64::NAN, light: 0.0, shape: 0.0, ..reading }
            }
            Bug::NegativeLight if dark => FocusReading { light: -3.0, shape: 0.0, ..reading },
            _ if dark => FocusReading { signal: 0.0, light: 10.0, shape: 0.0, ..reading },
            Bug::ShapeAboveOne => FocusReading { shape: 1.01, ..reading },
            Bug::Saturated => FocusReading { saturated: 0.2, ..reading },
            _ => reading,
        })
    }
}

impl FocusSensorRig for Fake {
    fn sensor(&mut self) -> &mut dyn FocusSensor {
        self
    }

    fn now(&self) -> HostTime {
        HostTime(self.now_ns)
    }

    fn defocus(&mut self, error: Nanometers) {
        self.error_nm = error.value();
    }

    fn block(&mut self) {
        (self.blocked, self.was_blocked) = (true, true);
    }

    fn unblock(&mut self) {
        self.blocked = false;
    }

    fn silence(&mut self) -> bool {
        self.silent = true;
        true
    }

    fn resume(&mut self) {
        self.silent = false;
    }

    fn reach(&self) -> Nanometers {
        Nanometers::new(1000.0).unwrap()
    }

    fn patience(&self) -> Duration {
        Duration::from_millis(100)
    }

    fn slack(&self) -> Duration {
        Duration::ZERO
    }
}

#[test]
fn a_sensor_that_keeps_its_promises_passes() {
    focus_sensor(&mut Fake::new(Bug::None));
}

macro_rules! caught {
    ($($name:ident: $bug:ident, $says:literal;)*) => {
        $(
            #[test]
            #[should_panic(expected = $says)]
            fn $name() {
                focus_sensor(&mut Fake::new(Bug::$bug));
            }
        )*
    };
}

caught! {
    a_missing_model_is_caught: NoModel, "has a model";
    new_signals_with_old_numbers_are_caught: OldNumberNewSignal, "same number is the same reading";
    numbers_that_go_back_are_caught: NumbersGoBack, "numbers rise";
    sensors_that_stand_are_caught: NeverNew, "takes new readings";
    readings_from_the_future_are_caught: FromTheFuture, "not from the future";
    times_that_go_back_are_caught: TimesGoBack, "times rise with numbers";
    signals_that_are_no_number_are_caught: NoNumberInTheDark, "the signal is a number";
    negative_light_is_caught: NegativeLight, "never negative";
    shapes_above_one_are_caught: ShapeAboveOne, "the shape is from 0 to 1";
    saturation_in_focus_is_caught: Saturated, "in focus is believed";
    flat_signals_are_caught: Flat, "rises or falls all the way";
    folded_signals_are_caught: Folded, "rises or falls all the way";
    light_of_blocked_beams_is_caught: BrightWhenBlocked, "a blocked beam has almost none";
    shapes_of_blocked_beams_are_caught: ShapelyWhenBlocked, "a blocked beam has no shape";
    beams_that_stay_dark_are_caught: StaysDark, "the light comes back";
    long_waits_are_caught: WaitsTooLong, "came only after";
    silence_taken_for_loss_is_caught: LostWhenSilent, "refused as Timeout";
    readings_in_silence_are_caught: RepeatsWhenSilent, "a reading from a silent sensor";
}
