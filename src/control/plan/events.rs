//! The steps of a plan and how long they take.

use std::collections::BTreeMap;
use std::time::Duration;

use super::{CameraWish, FocusWish, OnRecordDrop, Plan, RecordingFormat, StagePosition};
use crate::control::stop_rule::StopRule;
use sofiscope_hal::Nanometers;

/// One step of a plan: one series of exposures at one place.
#[derive(Debug, Clone, PartialEq)]
pub struct AcquisitionEvent {
    /// Which series of the plan, from 0.
    pub series: usize,
    /// Where; `None` for where the stage is.
    pub position: Option<StagePosition>,
    /// What the cameras are asked to do.
    pub cameras: CameraWish,
    /// Exposures; `None` until the stop rule ends the series.
    pub exposures: Option<u64>,
    /// Ends beside the number of exposures.
    pub stop: StopRule,
    /// Power of each laser line, milliwatts by nanometers.
    pub laser_power_mw: BTreeMap<u32, f64>,
    /// What is to be kept of the series, and what must hold.
    pub duties: Duties,
}

/// What is to be kept of a series, and what must hold during it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Duties {
    /// In which format frames are recorded.
    pub recording: RecordingFormat,
    /// What happens when the recording loses a frame.
    pub on_record_drop: OnRecordDrop,
    /// Whether the focus lock holds.
    pub focus: FocusWish,
    /// Pairs with a larger focus error, and those without a lock, are not analyzed.
    pub focus_gate: Option<Nanometers>,
}

impl Plan {
    /// The steps in order.
    pub fn events(&self) -> impl Iterator<Item = AcquisitionEvent> + '_ {
        let here = self.positions.is_empty().then_some(None);
        let places = self.positions.iter().map(|position| Some(position.clone()));
        here.into_iter().chain(places).enumerate().map(|(series, position)| AcquisitionEvent {
            series,
            position,
            cameras: self.cameras.clone(),
            exposures: self.loops,
            stop: self.stop.clone(),
            laser_power_mw: self.laser_power_mw.clone(),
            duties: Duties {
                recording: self.recording,
                on_record_drop: self.on_record_drop,
                focus: self.focus,
                focus_gate: self.focus_gate,
            },
        })
    }

    /// Most exposures of one series; `None` when only signal-to-noise, resolution or dose end it.
    #[must_use]
    pub fn exposures_per_series(&self) -> Option<u64> {
        let period = self.cameras.period.as_secs_f64();
        let by_time = self.stop.time.map(|time| (time.as_secs_f64() / period).ceil() as u64);
        [self.loops, self.stop.frames, by_time].into_iter().flatten().min()
    }

    /// Longest time of all exposures, without moves and setting up; `None` when the end is not certain.
    #[must_use]
    pub fn duration(&self) -> Option<Duration> {
        let series = self.positions.len().max(1) as f64;
        let seconds = self.exposures_per_series()? as f64 * self.cameras.period.as_secs_f64() * series;
        Duration::try_from_secs_f64(seconds).ok()
    }

    /// Laser energy of one series to its certain end, millijoules of all lines together.
    #[must_use]
    pub fn dose_per_series_mj(&self) -> Option<f64> {
        let seconds = self.exposures_per_series()? as f64 * self.cameras.period.as_secs_f64();
        Some(self.laser_power_mw.values().sum::<f64>() * seconds)
    }
}
