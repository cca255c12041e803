//! What a camera does, compared with what it was asked.
//!
//! In: settings wanted and read back. Out: the differences, in words with numbers.
//! Never: takes rounding to the camera's own step for a difference. Fails: not at all.

use std::fmt;
use std::time::Duration;

use sofiscope_hal::{CameraSettings, Region, TriggerMode};

/// One setting that a camera does not follow.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mismatch {
    /// The setting.
    pub setting: &'static str,
    /// What was asked, with its unit.
    pub wanted: String,
    /// What the camera does, with its unit.
    pub actual: String,
}

impl fmt::Display for Mismatch {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} {} was asked, the camera does {}", self.setting, self.wanted, self.actual)
    }
}

/// Times below this are equal for every purpose.
const FINEST: Duration = Duration::from_micros(1);

/// All differences beyond the step to which the camera rounds its times.
pub(super) fn mismatches(wanted: &CameraSettings, actual: &CameraSettings, step: Duration) -> Vec<Mismatch> {
    let mut found = Vec::new();
    let mut compare = |setting, is_same: bool, wanted: String, actual: String| {
        if !is_same {
            found.push(Mismatch { setting, wanted, actual });
        }
    };
    let step = step.max(FINEST);
    let alike = |a: Duration, b: Duration| a.abs_diff(b) <= step;
    compare("exposure", alike(wanted.exposure, actual.exposure), ms(wanted.exposure), ms(actual.exposure));
    compare("period", alike(wanted.period, actual.period), ms(wanted.period), ms(actual.period));
    let (want, have) = (wanted.region, actual.region);
    compare("region", want == have, place(want), place(have));
    compare("trigger", wanted.trigger == actual.trigger, mode(wanted.trigger), mode(actual.trigger));
    found
}

fn ms(time: Duration) -> String {
    format!("{} ms", time.as_nanos() as f64 / 1e6)
}

fn place(region: Region) -> String {
    format!("{} x {} pixels at ({}, {})", region.width, region.height, region.left, region.top)
}

fn mode(trigger: TriggerMode) -> String {
    let name = match trigger {
        TriggerMode::FreeRunning => "free-running",
        TriggerMode::External => "external",
    };
    name.to_owned()
}
