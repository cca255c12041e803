//! The stage in the hand of the sequencer: moves are waited for here, and can be stopped from anywhere.

use sofiscope_hal::{DeviceError, ErrorKind, Micrometers, Motion, Stage, StagePoint};
use std::time::{Duration, Instant};

use crate::control::contracts::StageDrive;
use crate::control::plan::StagePosition;

/// Time between two looks at a moving stage.
const LOOK: Duration = Duration::from_millis(50);
/// The whole travel takes a quarter of this.
const PATIENCE: Duration = Duration::from_secs(60);

/// A stage whose moves are waited for.
pub(super) struct AwaitedStage(pub(super) Box<dyn Stage>);

impl AwaitedStage {
    /// Lets the stage find its end switches and waits until it has.
    ///
    /// # Errors
    /// When it does not; it is stopped then.
    pub(super) fn home(&mut self) -> Result<(), DeviceError> {
        self.0.begin_homing()?;
        self.wait_still()
    }

    fn wait_still(&mut self) -> Result<(), DeviceError> {
        let begun = Instant::now();
        loop {
            match self.0.motion()? {
                Motion::Still => return Ok(()),
                Motion::Moving if begun.elapsed() < PATIENCE => {
                    // Nothing will ever come: this is a pause between two questions.
                    let _ = crossbeam_channel::after(LOOK).recv();
                }
                other => {
                    self.0.stopper().stop_motion()?;
                    let name = self.0.identity().to_string();
                    let message =
                        format!("the move did not end ({other:?}); it was stopped, home the stage again");
                    return Err(DeviceError::new(ErrorKind::Fault, name, message));
                }
            }
        }
    }
}

impl StageDrive for AwaitedStage {
    fn move_to(&mut self, position: &StagePosition) -> Result<(), DeviceError> {
        let name = self.0.identity().to_string();
        let point = |value: f64| {
            Micrometers::new(value)
                .map_err(|error| DeviceError::new(ErrorKind::OutOfRange, &name, error.to_string()))
        };
        if position.z_um.is_some() {
            let message =
                "it moves in x and y only; remove z from the position and focus by hand or by the lock";
            return Err(DeviceError::new(ErrorKind::OutOfRange, name, message));
        }
        let here = self.0.position()?;
        let x = position.x_um.map_or(Ok(here.x), point)?;
        let y = position.y_um.map_or(Ok(here.y), point)?;
        self.0.move_to(StagePoint { x, y })?;
        self.wait_still()
    }
}
