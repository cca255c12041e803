//! The search for the end switches, waited for.

use sofiscope_hal::{DeviceError, ErrorKind, Motion, Stage};
use std::time::{Duration, Instant};

/// Time between two looks at a moving stage.
const LOOK: Duration = Duration::from_millis(50);
/// The whole travel takes a quarter of this.
const PATIENCE: Duration = Duration::from_secs(60);

/// A stage whose homing is waited for.
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
                        format!("the search did not end ({other:?}); it was stopped, home the stage again");
                    return Err(DeviceError::new(ErrorKind::Fault, name, message));
                }
            }
        }
    }
}
