//! Start-up: who is there, what it can do, and whether it knows where it is.

use sofiscope_hal::{DeviceError, ErrorKind, StageEnvelope};

use super::{DIM, Tango, point};
use crate::properties::{self, AXES};
use crate::watch::Activity;
use crate::{grid, reply};

/// `?calst` of an axis that is calibrated and whose range is measured.
const HOMED: u32 = 3;

impl Tango {
    /// The start-up sequence that Micro-Manager uses, with the identity checked before anything is changed.
    pub(super) fn connect(&mut self) -> Result<(), DeviceError> {
        self.needs_homing |= self.activity.is_motion();
        // Until everything is read, nothing is known, and nothing moves.
        self.activity = Activity::Unknown;
        self.identify()?;
        if self.needs_homing {
            self.give_up();
        }
        // Power-up switches autostatus on; first of all it must be off.
        self.dialog.send("!autostatus 0")?;
        self.dialog.clear_errors("!autostatus 0")?;
        self.count_axes()?;
        self.dialog.tell(&format!("!dim {DIM} {DIM}"))?;
        for (settings, axis) in self.axes.iter_mut().zip(AXES) {
            *settings = properties::read(&mut self.dialog, axis, self.settings.fastest.value())?;
        }
        self.envelope = self.settings.envelope.clone();
        if !self.needs_homing && self.calibration(HOMED)? {
            self.envelope = self.measured_envelope()?;
            self.activity = Activity::Still;
        }
        // An axis may still have the letter of an abort that was before our time.
        self.stops_before = self.brake.stops().wrapping_sub(1);
        Ok(())
    }

    fn identify(&mut self) -> Result<(), DeviceError> {
        let version = self.dialog.greet()?;
        if !version.contains("TANGO") {
            let message = format!("expected a TANGO controller, found '{version}'; check the port");
            return Err(self.error(ErrorKind::Identity, message));
        }
        let found = self.dialog.ask("?readsn", "a serial number", reply::text)?;
        let wanted = &self.settings.serial;
        if found.trim() != wanted {
            let message = format!(
                "expected serial number {wanted}, found {found}; check the port, or the serial number in the configuration",
            );
            return Err(self.error(ErrorKind::Identity, message));
        }
        self.identity.simulated = version.to_ascii_uppercase().contains("SIMULATED");
        (self.identity.serial, self.identity.firmware) = (found, version);
        Ok(())
    }

    /// `?det`: bits 0 to 2 encoders, bits 4 to 7 number of axes.
    fn count_axes(&mut self) -> Result<(), DeviceError> {
        let detected = self.dialog.ask("?det", "a number", reply::whole)?;
        self.num_axes = (detected >> 4 & 0xF) as usize;
        if self.num_axes < 2 {
            let message = format!("two axes are needed, it has {} (?det {detected})", self.num_axes);
            return Err(self.error(ErrorKind::Fault, message));
        }
        if detected & 7 == 0 { Ok(()) } else { self.dialog.tell("!encpos 1 1") }
    }

    /// Whether all axes have these bits of `?calst`.
    pub(super) fn calibration(&mut self, bits: u32) -> Result<bool, DeviceError> {
        let states = self.dialog.ask("?calst", "calibration states", |answer| {
            reply::wholes(answer).or_else(|| Some(vec![reply::whole(answer)?]))
        })?;
        Ok(states.iter().take(2).all(|state| state & bits == bits))
    }

    /// The configured envelope within the measured travel.
    pub(super) fn measured_envelope(&mut self) -> Result<StageEnvelope, DeviceError> {
        self.check_units()?;
        let mut limits = [[0.0; 2]; 2];
        for (limits, axis) in limits.iter_mut().zip(AXES) {
            let read = |answer: &[u8]| <[f64; 2]>::try_from(reply::numbers(answer, 2)?).ok();
            *limits = self.dialog.ask(&format!("?lim {axis}"), "two limits", read)?;
        }
        let corners = [0, 1].map(|end: usize| point(&[limits[0][end], limits[1][end]]));
        let measured = match corners {
            [Some(lower), Some(upper)] => Some(StageEnvelope { x: lower.x..=upper.x, y: lower.y..=upper.y }),
            _ => None,
        };
        measured.and_then(|measured| grid::common(&self.settings.envelope, &measured)).ok_or_else(|| {
            let message = format!(
                "the configured envelope {:?} has no place in the measured travel {limits:?} mm; correct the configuration",
                self.settings.envelope,
            );
            self.error(ErrorKind::Fault, message)
        })
    }
}
