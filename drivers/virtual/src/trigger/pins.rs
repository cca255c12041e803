//! Pins on the optical table.

use std::time::Duration;

use crate::EmissionLog;
use crate::table::{OpticalTable, Quantity};

/// Where a virtual controller stands: the table its pins are wired to, the log, and what its time is on the clock
/// of the computer.
#[derive(Debug)]
pub struct Bench {
    /// What all virtual devices share.
    pub table: OpticalTable,
    /// The judge.
    pub log: EmissionLog,
    /// Time of [`monotonic`](crate::monotonic) at which the time of the model is zero.
    pub base: Duration,
}

impl Bench {
    /// A bench whose log nobody reads.
    #[must_use]
    pub fn quiet(table: OpticalTable, base: Duration) -> Self {
        Self { table, log: EmissionLog::none(), base }
    }
}

/// The exposure output of a camera that is started by the newest pulse on the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ExposureLine {
    /// From the pulse to the exposure.
    pub delay: Duration,
    /// How long the camera exposes; zero for a camera that is not wired.
    pub length: Duration,
    /// A level that the line keeps whatever the camera does.
    pub stuck: Option<bool>,
}

impl ExposureLine {
    fn edges(self, table: &OpticalTable) -> Option<(Duration, Duration)> {
        let pulse = Duration::try_from_secs_f64(table.get(Quantity::LastPulse)).ok()?;
        let begin = pulse.checked_add(self.delay)?;
        (!pulse.is_zero()).then_some((begin, begin + self.length))
    }

    /// Whether the line is high at `at`, a time of [`monotonic`](crate::monotonic).
    #[must_use]
    pub fn level(self, table: &OpticalTable, at: Duration) -> bool {
        self.stuck.unwrap_or_else(|| self.edges(table).is_some_and(|(begin, end)| begin <= at && at < end))
    }

    /// The next edge after `at`, if one is known already.
    #[must_use]
    pub fn next_edge(self, table: &OpticalTable, at: Duration) -> Option<Duration> {
        let (begin, end) = self.edges(table).filter(|_| self.stuck.is_none())?;
        [begin, end].into_iter().find(|edge| *edge > at)
    }
}

/// The outputs of a controller as they were last, and the bench that they are wired to.
#[derive(Debug)]
pub(super) struct Pins {
    pub(super) bench: Bench,
    gates: u8,
    levels: Vec<u16>,
    pulses: u64,
}

impl Pins {
    /// Pins that are low, and say so on the table.
    pub(super) fn low(bench: Bench, num_levels: usize) -> Self {
        bench.table.set(Quantity::Gates, 0.0);
        for level in 0..num_levels {
            bench.table.set(Quantity::Level(level), 0.0);
        }
        Self { bench, gates: 0, levels: vec![0; num_levels], pulses: 0 }
    }

    pub(super) fn monotonic(&self, now: Duration) -> Duration {
        self.bench.base + now
    }

    pub(super) fn gates(&self) -> u8 {
        self.gates
    }

    pub(super) fn drive(&mut self, gates: u8, now: Duration) {
        if self.gates != gates {
            self.gates = gates;
            self.bench.table.set(Quantity::Gates, f64::from(gates));
            let at = self.monotonic(now);
            self.bench.log.note(at, "gates", f64::from(gates));
        }
    }

    /// An analog output of 12 bits and 5 V.
    pub(super) fn set_level(&mut self, output: usize, level: u16) {
        if let Some(before) = self.levels.get_mut(output)
            && *before != level
        {
            *before = level;
            self.bench.table.set(Quantity::Level(output), f64::from(level) * 5.0 / 4095.0);
        }
    }

    pub(super) fn pulse(&mut self, now: Duration) {
        self.pulses += 1;
        // The time first: whoever sees the new number finds the time that belongs to it.
        self.bench.table.set(Quantity::LastPulse, self.monotonic(now).as_secs_f64());
        self.bench.table.set(Quantity::Pulses, self.pulses as f64);
    }
}
