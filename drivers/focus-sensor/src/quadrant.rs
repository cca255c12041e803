//! A quadrant or split detector on two analog inputs, as a sensor of the focus error.
//!
//! In: volts of two channels. Out: readings whose signal is (x₊ − x₋)/(x₊ + x₋), between −1 and 1.
//! Never: waits: it reads at once, so the caller's period is its rate. Fails: as the input does;
//! [`Protocol`](ErrorKind::Protocol) for volts that are no number.

use std::time::Duration;

use sofiscope_hal::{DeviceError, DeviceIdentity, ErrorKind, FocusReading, FocusSensor, HostTime, Volts};

use crate::Now;

/// Analog inputs, told apart by channel.
pub trait AnalogInput: Send {
    /// Volts on a channel now.
    ///
    /// # Errors
    /// [`OutOfRange`](ErrorKind::OutOfRange) for a channel that is not there; else whatever the device says.
    fn read(&mut self, channel: u8) -> Result<f64, DeviceError>;
}

/// How the detector is wired.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuadrantSettings {
    /// Channel of the side where light makes the signal larger.
    pub plus: u8,
    /// Channel of the other side.
    pub minus: u8,
    /// Volts on each channel without light.
    pub dark: Volts,
    /// Volts at which a channel is saturated.
    pub full_scale: Volts,
    /// Sum above the dark volts below which there is no light.
    pub least_light: Volts,
    /// Samples that are averaged for one reading, at least 1.
    pub samples: u16,
}

/// A quadrant or split detector.
///
/// It cannot see whether its light is a spot; the shape of its readings tells instead how far the spot is from
/// the ends of the range: 1 − signal², which is half where the signal is ± 0.7 and hardly changes any more.
pub struct QuadrantSensor {
    input: Box<dyn AnalogInput>,
    identity: DeviceIdentity,
    settings: QuadrantSettings,
    now: Now,
    next_number: u64,
}

impl QuadrantSensor {
    /// A detector behind an input. `now` is the clock of the readings.
    ///
    /// # Errors
    /// [`OutOfRange`](ErrorKind::OutOfRange) for settings that contradict themselves.
    pub fn new(
        input: Box<dyn AnalogInput>,
        identity: DeviceIdentity,
        settings: QuadrantSettings,
        now: Now,
    ) -> Result<Self, DeviceError> {
        let QuadrantSettings { plus, minus, dark, full_scale, least_light, samples } = settings;
        let fault = if plus == minus {
            Some(format!("both sides are on channel {plus}; give each its own"))
        } else if full_scale <= dark {
            Some(format!("full scale of {full_scale} must be above the {dark} without light"))
        } else if least_light <= Volts::ZERO {
            Some(format!("the least light must be above zero, but is {least_light}"))
        } else if samples == 0 {
            Some("a reading needs at least one sample".to_owned())
        } else {
            None
        };
        match fault {
            Some(message) => Err(DeviceError::new(ErrorKind::OutOfRange, identity.to_string(), message)),
            None => Ok(Self { input, identity, settings, now, next_number: 0 }),
        }
    }

    fn volts(&mut self, channel: u8) -> Result<f64, DeviceError> {
        let volts = self.input.read(channel)?;
        if volts.is_finite() {
            return Ok(volts);
        }
        let message =
            format!("channel {channel} reads {volts} V, which is no voltage; check the analog input");
        Err(DeviceError::new(ErrorKind::Protocol, self.identity.to_string(), message))
    }
}

impl FocusSensor for QuadrantSensor {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn read(&mut self, _timeout: Duration) -> Result<FocusReading, DeviceError> {
        let QuadrantSettings { plus, minus, dark, full_scale, samples, .. } = self.settings;
        let (mut sum_plus, mut sum_minus, mut saturated) = (0.0, 0.0, 0_u16);
        for _ in 0..samples {
            let (on_plus, on_minus) = (self.volts(plus)?, self.volts(minus)?);
            saturated += u16::from(on_plus.max(on_minus) >= full_scale.value());
            sum_plus += on_plus - dark.value();
            sum_minus += on_minus - dark.value();
        }
        let number = self.next_number;
        self.next_number += 1;
        let samples = f64::from(samples);
        let (on_plus, on_minus) = (sum_plus / samples, sum_minus / samples);
        Ok(self.reading(number, (on_plus, on_minus), f64::from(saturated) / samples, (self.now)()))
    }
}

impl QuadrantSensor {
    fn reading(
        &self,
        number: u64,
        (on_plus, on_minus): (f64, f64),
        saturated: f64,
        at: HostTime,
    ) -> FocusReading {
        let light = (on_plus + on_minus).max(0.0);
        let (signal, shape) = if light >= self.settings.least_light.value() {
            let signal = ((on_plus - on_minus) / light).clamp(-1.0, 1.0);
            (signal, 1.0 - signal * signal)
        } else {
            (0.0, 0.0)
        };
        FocusReading { number, at, signal, light, saturated, shape }
    }
}
