//! Replay cameras keep the contract of cameras.

use crate::common::{FORMATS, PERIOD, replay, whole_recording};
use sofiscope::replay::{Repeat, Replay, ReplayCamera, ReplayOptions, ReplaySpeed};
use sofiscope_hal::{Camera, CameraSettings, ManualClock, TriggerSource, conformance};
use std::sync::Arc;
use std::time::Duration;

struct Rig(ReplayCamera);

impl conformance::CameraRig for Rig {
    fn camera(&mut self) -> &mut dyn Camera {
        &mut self.0
    }

    fn trigger(&mut self) -> Option<&mut dyn TriggerSource> {
        None
    }

    fn settings(&self) -> CameraSettings {
        self.0.recorded_settings()
    }

    fn patience(&self) -> Duration {
        10 * PERIOD
    }
}

#[test]
fn the_cameras_keep_the_contract() {
    for format in FORMATS {
        for speed in [ReplaySpeed::Max, ReplaySpeed::Times(1.0), ReplaySpeed::Times(7.0)] {
            for repeat in [Repeat::Once, Repeat::Forever] {
                let folder = tempfile::tempdir().unwrap();
                let path = folder.path().join("run");
                whole_recording(&path, format, 40);
                let clock = Arc::new(ManualClock::default());
                let options = ReplayOptions { speed, repeat, clock, ..ReplayOptions::default() };
                let Replay { cameras, .. } = replay(&[path], options);
                for camera in cameras {
                    conformance::camera(&mut Rig(camera));
                }
            }
        }
    }
}
