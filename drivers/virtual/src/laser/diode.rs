//! A virtual laser without a data link: what comes out follows a level and a gate.
//!
//! In: level and gates of the table. Out: light. Never: emits with an open interlock, or when it closes before
//! level and gate have been low once. Fails: never.
//!
//! Typical values of the CNI-built MLL-III and SD families, to be replaced by those of the delivered test sheets.

use std::time::Duration;

use super::LOOKS_EVERY;
use super::head::{Head, Place};

/// What moves its light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Input {
    /// Only the gate: full power whenever it is open.
    Gate,
    /// The level of an analog output, 0–5 V; the gate is a quantity of its own.
    Level {
        /// Which output.
        output: usize,
        /// Level below which it stays dark, volts.
        threshold_v: f64,
    },
}

/// The laser.
#[derive(Debug)]
pub struct Diode {
    head: Head,
    input: Input,
    full_mw: f64,
    /// After an open interlock: dark until its input has been low.
    latched: bool,
}

impl Diode {
    /// A laser of this full power.
    #[must_use]
    pub fn new(place: Place, input: Input, full_mw: f64) -> Self {
        Self { head: Head::new(place), input, full_mw, latched: false }
    }

    /// Looks at its inputs at `now`, and tells when it wants to look again.
    pub fn step(&mut self, now: Duration) -> Duration {
        let asked_mw = self.asked_mw();
        if self.head.interlock_open() {
            self.latched = true;
        } else if asked_mw == 0.0 {
            self.latched = false;
        }
        self.head.emit(if self.latched { 0.0 } else { asked_mw }, now);
        now + LOOKS_EVERY
    }

    fn asked_mw(&self) -> f64 {
        match self.input {
            Input::Gate if self.head.gate_open() => self.full_mw,
            Input::Gate => 0.0,
            Input::Level { output, threshold_v } => {
                let above = self.head.level(output).clamp(0.0, 5.0) - threshold_v;
                if above > 0.0 { self.full_mw * above / (5.0 - threshold_v) } else { 0.0 }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::EmissionLog;
    use crate::table::{OpticalTable, Quantity};

    fn diode(input: Input) -> (OpticalTable, Diode) {
        let table = OpticalTable::private().unwrap();
        let place = Place {
            table: table.clone(),
            line: 0,
            wavelength_nm: 405,
            log: EmissionLog::none(),
            began: Duration::ZERO,
        };
        (table, Diode::new(place, input, 200.0))
    }

    #[test]
    fn light_follows_the_level_above_its_threshold() {
        let (table, mut diode) = diode(Input::Level { output: 1, threshold_v: 0.5 });
        for (volts, power_mw) in [(0.0, 0.0), (0.5, 0.0), (2.75, 100.0), (5.0, 200.0), (9.0, 200.0)] {
            table.set(Quantity::Level(1), volts);
            diode.step(Duration::ZERO);
            assert_eq!(table.get(Quantity::Power(0)), power_mw, "{volts} V");
        }
    }

    #[test]
    fn after_an_open_interlock_its_input_must_go_low_once() {
        let (table, mut diode) = diode(Input::Gate);
        let mut light = |gates, interlock| {
            table.set(Quantity::Gates, gates);
            table.set(Quantity::InterlockOpen, interlock);
            diode.step(Duration::ZERO);
            table.get(Quantity::Power(0))
        };
        let seen = [(1.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0), (1.0, 0.0)]
            .map(|(gate, open)| light(gate, open));
        assert_eq!(seen, [200.0, 0.0, 0.0, 0.0, 200.0]);
    }
}
