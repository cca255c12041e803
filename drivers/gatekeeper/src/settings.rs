//! What a board is told when it is connected, and again after every reset.

use std::time::Duration;

use sofiscope_hal::Volts;

use crate::frame::crc;

/// Gates that the config CRC covers, whether the board has them or not.
const GATES: usize = 8;
/// Longest on-time after reset, and the longest that the firmware takes.
const LIMIT_AT_RESET_US: u32 = 1_000_000;
const LIMIT_MAX_US: u32 = 1_800_000_000;

/// What makes a sequence go on to its next pattern.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The camera's exposure output: gates are open while it is high.
    CameraExposure,
    /// The board's own pulses: gates are open from `delay` after a pulse, for `open`.
    OwnClock {
        /// From the pulse to the opening of the gates.
        delay: Duration,
        /// How long the gates are open.
        open: Duration,
    },
}

/// Settings of a gatekeeper; nothing that can hurt has a default.
#[derive(Debug, Clone, PartialEq)]
pub struct GatekeeperSettings {
    /// The board that is wanted, by its number; `None` takes any.
    pub serial: Option<u32>,
    /// How long each gate may stay open, from gate 0; gates without one have a second.
    pub longest_on_time: Vec<Duration>,
    /// Level of the analog outputs at full scale.
    pub full_scale: Volts,
    /// Width of the pulses that start exposures; half a period at most.
    pub pulse_width: Duration,
    /// What makes a sequence go on.
    pub step: Step,
}

impl GatekeeperSettings {
    /// What is wrong with them for a board with so many gates.
    pub(crate) fn check(&self, gates: u8) -> Result<(), String> {
        if self.longest_on_time.len() > usize::from(gates) {
            return Err(format!(
                "{} longest on-times, but the board has {gates} gates",
                self.longest_on_time.len()
            ));
        }
        for (gate, time) in self.longest_on_time.iter().enumerate() {
            if !(1..=u128::from(LIMIT_MAX_US)).contains(&time.as_micros()) {
                return Err(format!("gate {gate} may stay open for {time:?}: from 1 µs to 30 min"));
            }
        }
        if self.full_scale.value() <= 0.0 {
            return Err(format!(
                "full scale of the analog outputs is {}: must be above 0 V",
                self.full_scale
            ));
        }
        let (delay, open) = self.window();
        if [self.pulse_width, delay, open].iter().any(|time| time.as_micros() > u128::from(u32::MAX)) {
            return Err("pulse width and opening of gates must be below an hour".to_owned());
        }
        if self.pulse_width.as_micros() == 0 {
            return Err("pulse width must be at least 1 µs".to_owned());
        }
        Ok(())
    }

    /// Longest on-time of a gate in microseconds.
    pub(crate) fn limit_us(&self, gate: u8) -> u32 {
        self.longest_on_time.get(usize::from(gate)).map_or(LIMIT_AT_RESET_US, |time| time.as_micros() as u32)
    }

    fn window(&self) -> (Duration, Duration) {
        match self.step {
            Step::CameraExposure => (Duration::ZERO, Duration::ZERO),
            Step::OwnClock { delay, open } => (delay, open),
        }
    }

    pub(crate) fn window_us(&self) -> (u32, u32) {
        let (delay, open) = self.window();
        (delay.as_micros() as u32, open.as_micros() as u32)
    }

    pub(crate) fn width_us(&self, period_us: u32) -> u32 {
        (self.pulse_width.as_micros() as u32).min(period_us / 2)
    }

    /// The config CRC that a board with so many gates must have.
    pub(crate) fn config_crc(&self, gates: u8) -> u16 {
        let mut bytes = vec![gates];
        for gate in 0..GATES as u8 {
            let limit = if gate < gates { self.limit_us(gate) } else { LIMIT_AT_RESET_US };
            bytes.extend(limit.to_be_bytes());
        }
        crc(&bytes)
    }
}
