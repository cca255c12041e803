//! When enough is enough: the ends of a series that a plan names.
//!
//! In: [`Progress`]. Out: [`Verdict`]. Never: reads a clock, forgets the dose for the sake of a better image.
//! Fails: not at all; numbers that are not there yet, or are not finite, end nothing.

use std::fmt;
use std::time::Duration;

use serde::Serialize;

/// The ends that a plan names; the first that is reached ends the series.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct StopRule {
    /// Exposures.
    pub frames: Option<u64>,
    /// Time of acquisition, pauses not counted.
    pub time: Option<Duration>,
    /// Signal-to-noise that every species must reach.
    pub snr: Option<f64>,
    /// Resolution that must be reached, nanometers.
    pub resolution_nm: Option<f64>,
    /// Laser energy that must not be passed, millijoules of all lines together.
    pub dose_mj: Option<f64>,
}

/// How far a series has come.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Progress {
    /// Exposures that are settled: received, or known to be lost.
    pub frames: u64,
    /// Time of acquisition, pauses not counted.
    pub acquired: Duration,
    /// Signal-to-noise of each species; empty as long as there is none.
    pub snr: Vec<f64>,
    /// Resolution, nanometers.
    pub resolution_nm: Option<f64>,
    /// Laser energy so far, millijoules.
    pub dose_mj: f64,
}

/// Which end was reached.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum StopReason {
    /// The dose that bleaching allows, in millijoules.
    Dose {
        /// Energy so far.
        mj: f64,
    },
    /// Exposures.
    Frames {
        /// Exposures so far.
        frames: u64,
    },
    /// Time.
    Time {
        /// Seconds so far.
        seconds: f64,
    },
    /// Every species is bright enough above its noise.
    Snr {
        /// Of the worst species.
        worst: f64,
    },
    /// The images are sharp enough.
    Resolution {
        /// Nanometers.
        nm: f64,
    },
}

impl fmt::Display for StopReason {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Dose { mj } => write!(formatter, "the dose limit was reached with {mj:.1} mJ"),
            Self::Frames { frames } => write!(formatter, "{frames} frames were taken"),
            Self::Time { seconds } => write!(formatter, "{seconds:.1} s of acquisition are over"),
            Self::Snr { worst } => {
                write!(formatter, "every species has a signal-to-noise of {worst:.1} or more")
            }
            Self::Resolution { nm } => write!(formatter, "the resolution is {nm:.0} nm"),
        }
    }
}

/// Whether a series goes on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    /// No end is reached.
    Continue,
    /// This end is reached.
    Stop(StopReason),
}

impl StopRule {
    /// Whether there is any end.
    #[must_use]
    pub fn has_end(&self) -> bool {
        *self != Self::default()
    }

    /// Whether an end comes by itself, whatever the sample shows.
    #[must_use]
    pub fn has_certain_end(&self) -> bool {
        self.frames.is_some() || self.time.is_some()
    }

    /// Judges how far a series has come; the dose first, as it protects the sample.
    #[must_use]
    pub fn judge(&self, progress: &Progress) -> Verdict {
        let reason = self
            .dose(progress)
            .or_else(|| self.frames(progress))
            .or_else(|| self.time(progress))
            .or_else(|| self.snr(progress))
            .or_else(|| self.resolution(progress));
        reason.map_or(Verdict::Continue, Verdict::Stop)
    }

    fn dose(&self, progress: &Progress) -> Option<StopReason> {
        let mj = progress.dose_mj;
        (mj >= self.dose_mj?).then_some(StopReason::Dose { mj })
    }

    fn frames(&self, progress: &Progress) -> Option<StopReason> {
        let frames = progress.frames;
        (frames >= self.frames?).then_some(StopReason::Frames { frames })
    }

    fn time(&self, progress: &Progress) -> Option<StopReason> {
        let seconds = progress.acquired.as_secs_f64();
        (progress.acquired >= self.time?).then_some(StopReason::Time { seconds })
    }

    fn snr(&self, progress: &Progress) -> Option<StopReason> {
        let wanted = self.snr?;
        let reached = |snr: &f64| snr.is_finite() && *snr >= wanted;
        if progress.snr.is_empty() || !progress.snr.iter().all(reached) {
            return None;
        }
        Some(StopReason::Snr { worst: progress.snr.iter().copied().fold(f64::INFINITY, f64::min) })
    }

    fn resolution(&self, progress: &Progress) -> Option<StopReason> {
        let nm = progress.resolution_nm.filter(|nm| nm.is_finite() && *nm > 0.0)?;
        (nm <= self.resolution_nm?).then_some(StopReason::Resolution { nm })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rule() -> StopRule {
        StopRule {
            frames: Some(4000),
            time: Some(Duration::from_secs(80)),
            snr: Some(5.0),
            resolution_nm: Some(120.0),
            dose_mj: Some(1000.0),
        }
    }

    fn stopped(progress: &Progress) -> Option<StopReason> {
        match rule().judge(progress) {
            Verdict::Continue => None,
            Verdict::Stop(reason) => Some(reason),
        }
    }

    #[test]
    fn each_end_alone_ends_the_series() {
        let none = Progress::default();
        assert_eq!(stopped(&none), None);
        let frames = Progress { frames: 4000, ..none.clone() };
        assert_eq!(stopped(&frames), Some(StopReason::Frames { frames: 4000 }));
        let time = Progress { acquired: Duration::from_secs(80), ..none.clone() };
        assert_eq!(stopped(&time), Some(StopReason::Time { seconds: 80.0 }));
        let snr = Progress { snr: vec![9.0, 5.0, 7.0], ..none.clone() };
        assert_eq!(stopped(&snr), Some(StopReason::Snr { worst: 5.0 }));
        let sharp = Progress { resolution_nm: Some(119.0), ..none.clone() };
        assert_eq!(stopped(&sharp), Some(StopReason::Resolution { nm: 119.0 }));
        let dose = Progress { dose_mj: 1000.0, ..frames };
        assert_eq!(stopped(&dose), Some(StopReason::Dose { mj: 1000.0 }));
    }

    #[test]
    fn numbers_that_are_not_there_end_nothing() {
        for snr in [vec![], vec![9.0, 4.9], vec![9.0, f64::NAN], vec![f64::INFINITY]] {
            let progress = Progress { snr, resolution_nm: Some(f64::NAN), ..Progress::default() };
            assert_eq!(stopped(&progress), None, "{progress:?}");
        }
        let progress = Progress { resolution_nm: Some(0.0), ..Progress::default() };
        assert_eq!(stopped(&progress), None);
    }

    #[test]
    fn ends_are_known() {
        assert!(!StopRule::default().has_end());
        let hoped = StopRule { snr: Some(5.0), ..StopRule::default() };
        assert!(hoped.has_end() && !hoped.has_certain_end());
    }
}
