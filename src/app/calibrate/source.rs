//! The frames of one camera for a calibration, from a recording, a simulated measurement or a stack.
//!
//! In: a path and the side of the camera. Out: [`CameraFrames`] with what the files know of the camera.
//! Never: reads a frame. Fails: [`AppError`] that names the file.

use super::open;
use crate::app::AppError;
use crate::files::{ImageStack, SampleType};
use crate::recording;
use sofiscope_hal::{Channel, Region};
use std::path::Path;

/// The frames of one camera, and what is known of it.
pub(super) struct CameraFrames {
    pub(super) stack: ImageStack,
    pub(super) serial: Option<String>,
    pub(super) region: Option<Region>,
}

impl CameraFrames {
    /// Height and width of a frame, pixels.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.stack.info().height, self.stack.info().width]
    }

    /// The most counts that the file can hold.
    pub(super) fn largest_count(&self) -> u16 {
        match self.stack.info().sample {
            SampleType::Uint8 => u16::from(u8::MAX),
            _ => u16::MAX,
        }
    }
}

/// The frames of one camera; a stack of a single camera is taken as that camera's.
pub(super) fn camera_frames(path: &Path, channel: Channel) -> Result<CameraFrames, AppError> {
    let mut stacks = open(path, None)?;
    let index = channel.index().min(stacks.len() - 1);
    let stack = stacks.swap_remove(index);
    if stack.info().sample == SampleType::Float32 {
        return Err(AppError::Data(format!(
            "{}: pixels are float32; give the counts as the camera gave them",
            stack.path().display()
        )));
    }
    let (mut serial, mut region) = (None, None);
    if path.join("recording.json").is_file() {
        let run = recording::open(path).map_err(AppError::data)?;
        let camera = &run.metadata().cameras[channel.index()];
        serial = Some(camera.identity.serial.clone()).filter(|serial| !serial.is_empty());
        region = Some(camera.settings.region);
    }
    Ok(CameraFrames { stack, serial, region })
}
