//! Two cameras that begin together: which is armed first, and what the master tells the slave.
//!
//! In: two configured cameras. Out: their streams, in the order given. Never: leaves one armed when the other
//! failed. Fails: [`DeviceError`] of the camera that did not arm.
//!
//! With a common trigger both are armed before the first pulse, in any order. With a cable from an output of the
//! master to the trigger input of the slave, the slave is armed first, or it misses the master's first frame
//! (Hamamatsu, "Synchronization and Triggering with the ORCA-Flash4.0").

use std::time::{Duration, Instant};

use sofiscope_hal::{Camera, DeviceError, ErrorKind, FrameStream};

use crate::camera::DcamCamera;
use crate::ffi::Failure;
use crate::ffi::ids::{Id, event, mode};

/// Time from arming to the first pulse in which a camera becomes ready for triggers (Hamamatsu).
pub const READY_AFTER: Duration = Duration::from_millis(50);

/// Length of the pulse that the master gives at the beginning of each frame, seconds.
const OUTPUT_PULSE_S: f64 = 100e-6;

const STATUS_BUSY: i32 = 1;

/// Arms two cameras that hear the same trigger; the first pulse may come when this returns.
///
/// # Errors
/// Whatever the camera says that could not be armed; both are then stopped.
pub fn arm_both(cameras: [&mut DcamCamera; 2]) -> Result<[Box<dyn FrameStream>; 2], DeviceError> {
    let [first, second] = cameras;
    let first_stream = first.arm()?;
    let armed = second.arm().and_then(|stream| {
        await_ready(first)?;
        await_ready(second)?;
        Ok(stream)
    });
    match armed {
        Ok(second_stream) => Ok([first_stream, second_stream]),
        Err(error) => {
            stop_after_failure(first);
            stop_after_failure(second);
            Err(error)
        }
    }
}

/// Lets `master` give a pulse at the beginning of each frame on output `connector` (0 is the first).
///
/// # Errors
/// Whatever the camera says, for example [`OutOfRange`](ErrorKind::OutOfRange) when it has no such output.
pub fn give_frame_pulses(master: &DcamCamera, connector: u32) -> Result<(), DeviceError> {
    if master.is_armed() {
        return Err(master.error(ErrorKind::Busy, "is armed; stop it before changing its outputs"));
    }
    let device = &master.device;
    device.set(Id::OUTPUT_KIND.element(connector), mode::OUTPUT_PROGRAMMABLE)?;
    device.set(Id::OUTPUT_SOURCE.element(connector), mode::OUTPUT_VSYNC)?;
    device.set(Id::OUTPUT_POLARITY.element(connector), mode::POSITIVE)?;
    device.set(Id::OUTPUT_PERIOD.element(connector), OUTPUT_PULSE_S)
}

/// Arms the slave, waits until it is ready, and then arms the master, which runs free; streams in that order:
/// master, slave.
///
/// # Errors
/// Whatever the camera says that could not be armed; both are then stopped.
pub fn arm_slave_then_master(
    master: &mut DcamCamera,
    slave: &mut DcamCamera,
) -> Result<[Box<dyn FrameStream>; 2], DeviceError> {
    let slave_stream = slave.arm()?;
    match await_ready(slave).and_then(|()| master.arm()) {
        Ok(master_stream) => Ok([master_stream, slave_stream]),
        Err(error) => {
            stop_after_failure(slave);
            Err(error)
        }
    }
}

/// Watches an armed camera for [`READY_AFTER`]: it must capture and must not stop.
fn await_ready(camera: &DcamCamera) -> Result<(), DeviceError> {
    let begun = Instant::now();
    let stopped = || camera.error(ErrorKind::Fault, "stopped before the first pulse; arm it again");
    let Some(capture) = camera.capture() else { return Err(stopped()) };
    while let Some(left) = READY_AFTER.checked_sub(begun.elapsed()).filter(|left| !left.is_zero()) {
        let milliseconds = i32::try_from(left.as_micros().div_ceil(1000)).unwrap_or(1);
        match capture.wait(event::STOPPED, milliseconds) {
            Ok(_) => return Err(stopped()),
            Err(Failure::TIMEOUT) => {}
            Err(failure) => return Err(camera.device.error("cannot be waited for", failure)),
        }
    }
    let status = camera.device.functions().status(camera.device.handle());
    match status.map_err(|failure| camera.device.error("does not tell its status", failure))? {
        STATUS_BUSY => Ok(()),
        _ => Err(stopped()),
    }
}

fn stop_after_failure(camera: &mut DcamCamera) {
    if let Err(error) = camera.stop() {
        tracing::warn!("{error}");
    }
}
