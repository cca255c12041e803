//! The optical table that all virtual devices stand on: what one does, the others see.
//!
//! A file that every process maps, with one cell per quantity. Each cell has one writer; readers take the newest
//! value. Lasers write what leaves their heads, the trigger controller which gates are open, the stage and the
//! piezo where they are; the cameras read all of it to know how bright and how sharp the sample is.

mod cells;

use std::io;
use std::path::Path;
use std::time::Duration;

use cells::Cells;

/// Laser lines that a table has room for.
pub const LINES: usize = 8;

/// A quantity on the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Stage, micrometers.
    StageX,
    /// Stage, micrometers.
    StageY,
    /// 1 while the stage moves.
    StageMoving,
    /// Piezo, nanometers, where it really is.
    PiezoZ,
    /// Drift of the sample along the optical axis, nanometers per second.
    DriftSpeed,
    /// Height of the sample without drift, nanometers: focused when the piezo is there.
    SampleZ,
    /// Wavelength of a laser line, nanometers; 0 for a line that is not there.
    Wavelength(usize),
    /// Power that leaves the head of a line, milliwatts, if its gate is open or it has none.
    Power(usize),
    /// Level of an analog output of the trigger controller, volts.
    Level(usize),
    /// Open gates of the trigger controller, bit 0 for line 0.
    Gates,
    /// Pulses that the trigger controller has sent since its power-up.
    Pulses,
    /// Time of the newest pulse, seconds on [`monotonic`](crate::monotonic).
    LastPulse,
    /// 1 while the interlock is open.
    InterlockOpen,
    /// 1 while somebody blocks the focus-lock beam.
    FocusBeamBlocked,
    /// How often somebody has pressed the reset button of the trigger controller.
    ControllerResets,
}

impl Quantity {
    fn cell(self) -> usize {
        match self {
            Self::StageX => 1,
            Self::StageY => 2,
            Self::StageMoving => 3,
            Self::PiezoZ => 4,
            Self::DriftSpeed => 5,
            Self::SampleZ => 6,
            Self::Gates => 7,
            Self::Pulses => 8,
            Self::LastPulse => 9,
            Self::InterlockOpen => 10,
            Self::FocusBeamBlocked => 11,
            Self::ControllerResets => 12,
            Self::Wavelength(line) => 16 + line.min(LINES - 1),
            Self::Power(line) => 16 + LINES + line.min(LINES - 1),
            Self::Level(line) => 16 + 2 * LINES + line.min(LINES - 1),
        }
    }
}

/// Cell of the time, in seconds, at which the table was set up; drift counts from there.
const BEGUN: usize = 0;
const NUM_CELLS: usize = 16 + 3 * LINES;

/// What all virtual devices share.
#[derive(Debug, Clone)]
pub struct OpticalTable(Cells);

impl OpticalTable {
    /// Sets up a table in a new file; everything on it is zero.
    ///
    /// # Errors
    /// When the file is there already or cannot be made.
    pub fn set_up(path: &Path) -> io::Result<Self> {
        let table = Self(Cells::create(path, NUM_CELLS)?);
        table.0.set(BEGUN, crate::monotonic().as_secs_f64());
        Ok(table)
    }

    /// Joins a table that somebody has set up.
    ///
    /// # Errors
    /// When there is none.
    pub fn join(path: &Path) -> io::Result<Self> {
        Ok(Self(Cells::open(path, NUM_CELLS)?))
    }

    /// A table for one process and its tests, in no file.
    ///
    /// # Errors
    /// When the system gives no memory.
    pub fn private() -> io::Result<Self> {
        let table = Self(Cells::private(NUM_CELLS)?);
        table.0.set(BEGUN, crate::monotonic().as_secs_f64());
        Ok(table)
    }

    /// The newest value.
    #[must_use]
    pub fn get(&self, quantity: Quantity) -> f64 {
        self.0.get(quantity.cell())
    }

    /// A new value; only the one device that owns the quantity says it.
    pub fn set(&self, quantity: Quantity, value: f64) {
        self.0.set(quantity.cell(), value);
    }

    /// Focus error at `at`, nanometers: piezo above sample.
    #[must_use]
    pub fn focus_error_nm(&self, at: Duration) -> f64 {
        let drift = self.get(Quantity::DriftSpeed) * (at.as_secs_f64() - self.0.get(BEGUN));
        self.get(Quantity::PiezoZ) - self.get(Quantity::SampleZ) - drift
    }

    /// Power of a line on the sample, milliwatts: what leaves its head while its gate is open.
    #[must_use]
    pub fn light_mw(&self, line: usize) -> f64 {
        let gates = self.get(Quantity::Gates);
        let open = gates >= 0.0 && (gates as u64 >> line.min(LINES - 1)) & 1 == 1;
        if open { self.get(Quantity::Power(line)) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_joins_sees_what_the_others_do() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table");
        assert!(OpticalTable::join(&path).is_err(), "nobody has set it up");
        let ours = OpticalTable::set_up(&path).unwrap();
        let theirs = OpticalTable::join(&path).unwrap();
        assert!(OpticalTable::set_up(&path).is_err(), "it is there already");
        ours.set(Quantity::Power(2), 12.5);
        assert_eq!(theirs.light_mw(2), 0.0, "the gate is closed");
        theirs.set(Quantity::Gates, 4.0);
        assert_eq!((ours.light_mw(2), ours.light_mw(1)), (12.5, 0.0));
    }

    #[test]
    fn drift_takes_the_sample_away_from_the_piezo() {
        let table = OpticalTable::private().unwrap();
        table.set(Quantity::DriftSpeed, 5.0);
        table.set(Quantity::PiezoZ, 1000.0);
        table.set(Quantity::SampleZ, 1000.0);
        let now = crate::monotonic();
        let change = table.focus_error_nm(now + Duration::from_secs(2)) - table.focus_error_nm(now);
        assert!((change + 10.0).abs() < 1e-6, "{change}");
    }

    #[test]
    fn no_two_quantities_share_a_cell() {
        let mut all = vec![BEGUN];
        all.extend((0..LINES).flat_map(|line| {
            [Quantity::Wavelength(line), Quantity::Power(line), Quantity::Level(line)].map(Quantity::cell)
        }));
        all.extend(
            [
                Quantity::StageX,
                Quantity::StageY,
                Quantity::StageMoving,
                Quantity::PiezoZ,
                Quantity::DriftSpeed,
                Quantity::SampleZ,
                Quantity::Gates,
                Quantity::Pulses,
                Quantity::LastPulse,
                Quantity::InterlockOpen,
                Quantity::FocusBeamBlocked,
                Quantity::ControllerResets,
            ]
            .map(Quantity::cell),
        );
        let number = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), number);
        assert!(all.iter().all(|cell| *cell < NUM_CELLS));
    }
}
