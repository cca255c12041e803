//! The only way from a model to light on the optical table.
//!
//! In: the power that a model lets out. Out: `Wavelength` and `Power` of one line of the table, and a note for
//! every change. Never: asks the gate, whose bit is a quantity of its own. Fails: as [`EmissionLog::note`].

use std::time::Duration;

use crate::log::EmissionLog;
use crate::table::{OpticalTable, Quantity};

/// Quantity of the notes: what leaves the head while its gate is open or it has none, milliwatts.
pub const EMISSION: &str = "emission_mw";

/// Changes smaller than this part are not noted, so that a ramp is a hundred lines and not ten thousand.
const NOTED_CHANGE: f64 = 0.01;

/// Where a laser stands.
#[derive(Debug)]
pub struct Place {
    /// The table.
    pub table: OpticalTable,
    /// Its line on the table; its gate is the bit of the same number.
    pub line: usize,
    /// Wavelength, nanometers.
    pub wavelength_nm: u32,
    /// Who judges its light.
    pub log: EmissionLog,
    /// Power-up of the model, on the clock of [`monotonic`](crate::monotonic): times of notes count from there.
    pub began: Duration,
}

/// Head of a laser, dark at first.
#[derive(Debug)]
pub struct Head {
    place: Place,
    power_mw: f64,
    noted_mw: f64,
}

impl Head {
    /// Puts the head on its table.
    #[must_use]
    pub fn new(mut place: Place) -> Self {
        place.table.set(Quantity::Wavelength(place.line), f64::from(place.wavelength_nm));
        place.table.set(Quantity::Power(place.line), 0.0);
        place.log.note(place.began, EMISSION, 0.0);
        Self { place, power_mw: 0.0, noted_mw: 0.0 }
    }

    /// Lets this power out from `now` on.
    pub fn emit(&mut self, power_mw: f64, now: Duration) {
        if power_mw == self.power_mw {
            return;
        }
        self.power_mw = power_mw;
        self.place.table.set(Quantity::Power(self.place.line), power_mw);
        let turned = (power_mw == 0.0) != (self.noted_mw == 0.0);
        if turned || (power_mw - self.noted_mw).abs() > NOTED_CHANGE * self.noted_mw {
            self.noted_mw = power_mw;
            self.place.log.note(self.place.began + now, EMISSION, power_mw);
        }
    }

    /// What it lets out, milliwatts.
    #[must_use]
    pub fn power_mw(&self) -> f64 {
        self.power_mw
    }

    /// Whether the interlock is open; anything but a clear "closed" is open.
    #[must_use]
    pub fn interlock_open(&self) -> bool {
        self.place.table.get(Quantity::InterlockOpen) != 0.0
    }

    /// Whether the gate of its line is open.
    #[must_use]
    pub fn gate_open(&self) -> bool {
        let gates = self.place.table.get(Quantity::Gates);
        gates >= 0.0 && (gates as u64 >> self.place.line.min(63)) & 1 == 1
    }

    /// An analog level on the table, volts.
    #[must_use]
    pub fn level(&self, output: usize) -> f64 {
        self.place.table.get(Quantity::Level(output))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_change_of_light_is_on_the_table_and_in_the_log() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let table = OpticalTable::private().unwrap();
        let log = EmissionLog::append(&path, "laser").unwrap();
        let began = Duration::from_secs(100);
        let mut head = Head::new(Place { table: table.clone(), line: 1, wavelength_nm: 488, log, began });
        for (at, power_mw) in [(1, 10.0), (2, 10.05), (3, 11.0), (4, 0.0)] {
            head.emit(power_mw, Duration::from_secs(at));
            assert_eq!(table.get(Quantity::Power(1)), power_mw);
        }
        assert_eq!(table.get(Quantity::Wavelength(1)), 488.0);
        let notes: Vec<_> =
            crate::log::read(&path).unwrap().iter().map(|note| (note.at.as_secs(), note.value)).collect();
        assert_eq!(notes, [(100, 0.0), (101, 10.0), (103, 11.0), (104, 0.0)]);
    }

    #[test]
    fn gate_and_interlock_are_those_of_the_table() {
        let table = OpticalTable::private().unwrap();
        let (log, began) = (EmissionLog::none(), Duration::ZERO);
        let head = Head::new(Place { table: table.clone(), line: 2, wavelength_nm: 488, log, began });
        assert!(!head.gate_open() && !head.interlock_open());
        table.set(Quantity::Gates, 4.0);
        table.set(Quantity::InterlockOpen, f64::NAN);
        assert!(head.gate_open() && head.interlock_open());
    }
}
