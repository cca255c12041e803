//! Who goes without when there is not enough time: preview first, then analysis, recording last.
//!
//! In: how full the queues are, 0 to 1. Out: a [`Pressure`]. Never: reads a clock. Fails: not at all.
//!
//! Consumers are let in again only when the queues are much emptier than when they were shut out,
//! so that the pressure does not flicker.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

/// Who must go without.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Pressure {
    /// Nobody.
    #[default]
    None,
    /// The preview.
    NoPreview,
    /// Preview and analysis.
    NoAnalysis,
}

/// The state of shedding.
#[derive(Debug, Clone, Copy, Default)]
pub struct Shedding {
    pressure: Pressure,
}

/// Queues so full shut the preview out.
const PREVIEW_OFF: [f64; 2] = [0.25, 0.5];
/// Queues so empty let it in.
const PREVIEW_ON: [f64; 2] = [0.1, 0.25];
/// A recorder's queue so full shuts the analysis out.
const ANALYSIS_OFF: f64 = 0.5;

impl Shedding {
    /// The pressure now that the queues to recording and analysis are so full.
    pub fn step(&mut self, recording: f64, analysis: f64) -> Pressure {
        let fills = [recording, analysis];
        let any_above = |limits: [f64; 2]| fills.iter().zip(limits).any(|(&fill, limit)| fill > limit);
        self.pressure = if recording > ANALYSIS_OFF {
            Pressure::NoAnalysis
        } else if any_above(PREVIEW_OFF) {
            self.pressure.max(Pressure::NoPreview)
        } else if any_above(PREVIEW_ON) {
            // Analysis may not come back before the recorder is well ahead again.
            self.pressure
        } else {
            Pressure::None
        };
        self.pressure
    }
}

/// The pressure as other threads see it.
#[derive(Debug, Clone, Default)]
pub struct PressureGauge(Arc<AtomicU8>);

impl PressureGauge {
    /// Shows a pressure.
    pub fn set(&self, pressure: Pressure) {
        self.0.store(pressure as u8, Ordering::Relaxed);
    }

    /// Whether the preview must not work now.
    #[must_use]
    pub fn preview_is_off(&self) -> bool {
        self.0.load(Ordering::Relaxed) >= Pressure::NoPreview as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn preview_goes_before_analysis_and_comes_back_last() {
        let mut shedding = Shedding::default();
        let mut at = |recording, analysis| shedding.step(recording, analysis);
        assert_eq!(at(0.0, 0.4), Pressure::None);
        assert_eq!(at(0.0, 0.6), Pressure::NoPreview);
        assert_eq!(at(0.0, 0.3), Pressure::NoPreview);
        assert_eq!(at(0.6, 1.0), Pressure::NoAnalysis);
        assert_eq!(at(0.3, 0.0), Pressure::NoAnalysis);
        assert_eq!(at(0.05, 0.0), Pressure::None);
    }

    #[test]
    fn a_full_analysis_never_costs_the_recording() {
        let mut shedding = Shedding::default();
        for step in 0..=10 {
            assert!(shedding.step(0.0, f64::from(step) / 10.0) < Pressure::NoAnalysis);
        }
    }
}
