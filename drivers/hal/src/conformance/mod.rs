//! What every camera driver must pass, whatever stands behind it; lasers have [a suite of their own](laser()).
//! What every driver of a camera or a focus drive must pass, whatever stands behind it.
//!
//! In: a [`CameraRig`], which has a camera and knows how to let it expose; a [`FocusDriveRig`]. Out: nothing.
//! Never: sleeps, reads a clock, knows which device it tests; it waits only in `next_frame`.
//! Fails: panics with what was expected and what was found.
//!
//! The rig must be one on which nothing goes wrong: no frame may be lost, doubled, late or incomplete.
//!
//! ```ignore
//! #[test]
//! fn the_camera_keeps_its_contract() {
//!     sofiscope_hal::conformance::camera(&mut MyRig::open());
//! }
//! ```

mod focus_drive;
mod focus_sensor;
mod frames;
#[cfg(test)]
mod gate_tests;
mod gates;
mod laser;
mod stage;
mod states;
#[cfg(test)]
mod tests;

pub use focus_sensor::{FocusSensorRig, focus_sensor};
pub use gates::{GateRig, gates};
pub use laser::{LaserRig, laser};
pub use stage::{StageRig, stage};

use std::time::Duration;

pub use focus_drive::{FocusDriveRig, focus_drive};

use crate::{
    Camera, CameraSettings, DeviceError, ErrorKind, FrameInfo, FrameStatus, FrameStream, TriggerSource,
};

/// Frames that are taken where some are needed.
const SEVERAL: usize = 12;
/// Frames after which a stopped camera must have ended.
const MOST_FINISHED: usize = 10_000;
/// Answers "not yet" after which a frame should have come.
const MOST_TIMEOUTS: usize = 100;

/// A camera on the bench, with all that it needs to expose.
pub trait CameraRig {
    /// The camera; never configured before the suite begins, and always the same one.
    fn camera(&mut self) -> &mut dyn Camera;

    /// What gives the pulses, where [`Self::settings`] asks for [`External`](crate::TriggerMode::External).
    fn trigger(&mut self) -> Option<&mut dyn TriggerSource>;

    /// Settings that the camera can do exactly.
    fn settings(&self) -> CameraSettings;

    /// A time within which a frame certainly comes, for example ten periods.
    fn patience(&self) -> Duration;
}

/// Everything that a camera promises; leaves it stopped.
///
/// # Panics
/// With the first promise that is broken.
pub fn camera(rig: &mut impl CameraRig) {
    states::identity_is_told(rig);
    states::arming_needs_settings(rig);
    states::settings_are_read_back(rig);
    states::settings_out_of_range_change_nothing(rig);
    states::armed_cameras_are_busy(rig);
    frames::exposures_count_from_arming(rig);
    frames::every_pixel_is_written(rig);
    frames::a_smaller_region_gives_smaller_frames(rig);
    frames::memory_of_the_wrong_size_is_refused(rig);
    frames::timeouts_lose_nothing(rig);
    frames::stopped_streams_end(rig);
    frames::streams_move_to_other_threads(rig);
    frames::streams_may_be_dropped_while_armed(rig);
    states::identity_is_told(rig);
}

/// Everything that a trigger source promises by itself; leaves it stopped.
///
/// # Panics
/// With the first promise that is broken.
pub fn trigger(source: &mut dyn TriggerSource, period: Duration) {
    must(source.stop(), "stopping a trigger that does not run");
    must(source.start(period, None), "starting a trigger");
    refused(source.start(period, Some(1)), ErrorKind::Busy, "starting a trigger that runs");
    must(source.stop(), "stopping a trigger");
    must(source.stop(), "stopping a trigger twice");
    must(source.start(period, None), "starting a trigger again");
    must(source.stop(), "stopping a trigger again");
    refused(source.start(Duration::ZERO, None), ErrorKind::OutOfRange, "a trigger period of zero");
    must(source.stop(), "stopping a trigger that was not started");
}

/// The value, or a panic that says what did not succeed.
fn must<T>(result: Result<T, DeviceError>, what: &str) -> T {
    match result {
        Ok(value) => value,
        Err(error) => panic!("{what} must succeed, but: {error} ({:?})", error.kind()),
    }
}

/// Asserts that something was refused in the right way.
fn refused<T>(result: Result<T, DeviceError>, kind: ErrorKind, what: &str) {
    match result {
        Ok(_) => panic!("{what} must be refused as {kind:?}, but it succeeded"),
        Err(error) => {
            assert_eq!(error.kind(), kind, "{what} must be refused as {kind:?}, but: {error}");
            assert!(!error.device().is_empty(), "{what}: an error names its device");
        }
    }
}

/// A camera that is armed and exposes.
struct Run {
    stream: Box<dyn FrameStream>,
    settings: CameraSettings,
    patience: Duration,
}

impl Run {
    /// Configures, arms and lets the camera expose.
    fn begin(rig: &mut impl CameraRig) -> Self {
        let want = rig.settings();
        Self::begin_with(rig, &want)
    }

    fn begin_with(rig: &mut impl CameraRig, want: &CameraSettings) -> Self {
        let settings = must(rig.camera().configure(want), "configuring");
        let run = Self::arm(rig, settings);
        Self::expose(rig, settings);
        run
    }

    /// Arms a camera that does `settings`.
    fn arm(rig: &mut impl CameraRig, settings: CameraSettings) -> Self {
        let stream = must(rig.camera().arm(), "arming a camera that is configured and stopped");
        Self { stream, settings, patience: rig.patience() }
    }

    /// Lets the pulses begin, if any are needed.
    fn expose(rig: &mut impl CameraRig, settings: CameraSettings) {
        if let Some(trigger) = rig.trigger() {
            must(trigger.start(settings.period, None), "starting the trigger");
        }
    }

    /// Memory for one frame.
    fn memory(&self) -> Vec<u16> {
        vec![0; self.settings.region.num_pixels()]
    }

    /// The next frame within the rig's patience.
    fn next(&mut self, counts: &mut [u16]) -> FrameInfo {
        let info = must(self.stream.next_frame(counts, self.patience), "the next frame");
        assert_eq!(info.status, FrameStatus::Complete, "frames on a healthy rig are complete: {info:?}");
        info
    }

    /// Some frames.
    fn several(&mut self) -> Vec<FrameInfo> {
        let mut counts = self.memory();
        (0..SEVERAL).map(|_| self.next(&mut counts)).collect()
    }

    /// Stops everything and reads to the end; gives the frames that were finished.
    fn end(mut self, rig: &mut impl CameraRig) -> Vec<FrameInfo> {
        halt(rig);
        let mut counts = self.memory();
        let mut frames = Vec::new();
        let mut timeouts = 0;
        while frames.len() <= MOST_FINISHED {
            match self.stream.next_frame(&mut counts, self.patience) {
                Ok(info) => frames.push(info),
                Err(error) if error.kind() == ErrorKind::Ended => {
                    refused(
                        self.stream.next_frame(&mut counts, self.patience),
                        ErrorKind::Ended,
                        "a frame after the end",
                    );
                    return frames;
                }
                Err(error) if error.kind() == ErrorKind::Timeout && timeouts < MOST_TIMEOUTS => timeouts += 1,
                Err(error) => {
                    panic!("a stopped stream must come to Ended, but: {error} ({:?})", error.kind())
                }
            }
        }
        panic!("a stopped stream must come to Ended, but it went on for {MOST_FINISHED} frames")
    }
}

/// Stops the pulses and the camera.
fn halt(rig: &mut impl CameraRig) {
    if let Some(trigger) = rig.trigger() {
        must(trigger.stop(), "stopping the trigger");
    }
    must(rig.camera().stop(), "stopping the camera");
}
