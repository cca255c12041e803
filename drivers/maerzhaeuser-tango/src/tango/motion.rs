//! Moves and homing: begun here, watched here, never waited for.

use sofiscope_hal::{DeviceError, ErrorKind, Motion, StagePoint};

use super::Tango;
use crate::grid::GridPoint;
use crate::properties::AXES;
use crate::reply::Letter;
use crate::watch::{Activity, HOMING_LEG, Leg, Watch, allowed};
use crate::{codes, reply};

/// What the letters of both axes say together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Look {
    Moving,
    ByHand,
    Ready,
    Fault(char, Letter),
}

impl Tango {
    pub(super) fn begin_move(&mut self, target: StagePoint) -> Result<(), DeviceError> {
        let stops = self.brake.stops();
        let Some(on_grid) = GridPoint::inside(&self.envelope, target) else {
            let (x, y) = (&self.envelope.x, &self.envelope.y);
            let message = format!(
                "({}, {}) is outside of x {} to {}, y {} to {}; choose a place inside",
                target.x,
                target.y,
                x.start(),
                x.end(),
                y.start(),
                y.end(),
            );
            return Err(self.error(ErrorKind::OutOfRange, message));
        };
        self.activity.allows_move(self.dialog.device())?;
        let here = self.read_position()?;
        // Only `go` may follow a move that is under way.
        let verb = if self.activity.is_motion() { "go" } else { "!moa" };
        let paces = self.axes.map(|axis| axis.pace);
        let watch = Watch::new(self.now(), allowed(here, target, paces));
        self.begin(&format!("{verb} {on_grid}"), Activity::Moving { target: on_grid, watch }, stops)
    }

    pub(super) fn home(&mut self) -> Result<(), DeviceError> {
        if self.activity.is_motion() {
            return Err(
                self.error(ErrorKind::Busy, "the stage moves; wait for its end, or stop it, then home it")
            );
        }
        let stops = self.brake.stops();
        self.begin_leg(Leg::Calibration, stops)?;
        self.envelope = self.settings.envelope.clone();
        Ok(())
    }

    fn begin_leg(&mut self, leg: Leg, stops: u64) -> Result<(), DeviceError> {
        for axis in AXES {
            let watch = Watch::new(self.now(), HOMING_LEG);
            let begun =
                self.begin(&format!("!{} {axis}", leg.verb()), Activity::Homing { leg, watch }, stops);
            // Once an axis searches, the place is not known any more, whatever becomes of the other.
            if begun.is_err() && self.activity.is_motion() {
                self.give_up();
            }
            begun?;
        }
        Ok(())
    }

    /// Sends a command that moves, unless STOP came after `stops` were counted.
    fn begin(&mut self, command: &str, activity: Activity, stops: u64) -> Result<(), DeviceError> {
        self.dialog.clear_errors(command)?;
        if self.brake.stops() != stops {
            return Err(self.stopped());
        }
        let before = std::mem::replace(&mut self.activity, activity);
        let stops_before = std::mem::replace(&mut self.stops_before, stops);
        self.dialog.send(command)?;
        if self.brake.stops() != stops {
            // STOP may have overtaken the command on the line: it is sent again, behind it.
            if self.brake.stop().is_err() {
                return Err(self.error(ErrorKind::Lost, "STOP could not be sent again; switch the stage off"));
            }
            return Err(self.stopped());
        }
        let accepted = self.dialog.accepted(command);
        if let Err(error) = &accepted
            && !matches!(error.kind(), ErrorKind::Lost | ErrorKind::Timeout | ErrorKind::Protocol)
        {
            (self.activity, self.stops_before) = (before, stops_before);
        }
        accepted
    }

    fn stopped(&self) -> DeviceError {
        self.error(ErrorKind::Busy, "STOP came before the move; move again if that is wanted")
    }

    pub(super) fn look(&mut self) -> Result<Motion, DeviceError> {
        let look = self.look_at_axes()?;
        match (self.activity, look) {
            (Activity::Unknown, Look::Moving) => Ok(Motion::Moving),
            (Activity::Unknown, _) => Ok(Motion::Unknown),
            (_, Look::Fault(axis, letter)) => Err(self.fault_of(axis, letter)?),
            (Activity::Still, Look::Ready) => Ok(Motion::Still),
            // Nothing was begun here: somebody else moves it.
            (Activity::Still, Look::Moving | Look::ByHand) => Ok(Motion::ByHand),
            (Activity::Moving { watch, .. } | Activity::Homing { watch, .. }, Look::Moving) => {
                self.still_moving(watch)
            }
            (Activity::Moving { .. }, Look::ByHand) => {
                self.activity = Activity::Still;
                Ok(Motion::ByHand)
            }
            (Activity::Moving { target, watch }, Look::Ready) => self.end_of_move(target, watch),
            (Activity::Homing { leg, watch }, Look::Ready | Look::ByHand) => self.end_of_leg(leg, watch),
        }
    }

    fn still_moving(&mut self, watch: Watch) -> Result<Motion, DeviceError> {
        let now = self.now();
        if now <= watch.until {
            return Ok(Motion::Moving);
        }
        let taken = now.saturating_sub(watch.begun).as_secs_f64();
        let most = watch.until.saturating_sub(watch.begun).as_secs_f64();
        self.give_up();
        let message = format!(
            "the motion goes on after {taken:.1} s and needs {most:.1} s at most; STOP was sent; \
             look at the stage, then home it",
        );
        Err(self.error(ErrorKind::Fault, message))
    }

    fn end_of_move(&mut self, target: GridPoint, watch: Watch) -> Result<Motion, DeviceError> {
        if self.was_stopped() {
            self.activity = Activity::Still;
            return Ok(Motion::Still);
        }
        let place = self.read_position()?;
        let tolerance = self.settings.tolerance;
        let is_there = target.micrometers().is_some_and(|target| {
            place.x.distance(target.x) <= tolerance && place.y.distance(target.y) <= tolerance
        });
        if is_there {
            self.activity = Activity::Still;
            return Ok(Motion::Still);
        }
        if !watch.shows(self.now()) {
            return Ok(Motion::Moving);
        }
        self.give_up();
        let message = format!(
            "the move to ({target}) mm ended at ({}, {}); look at the stage, then home it",
            place.x, place.y,
        );
        Err(self.error(ErrorKind::Fault, message))
    }

    fn end_of_leg(&mut self, leg: Leg, watch: Watch) -> Result<Motion, DeviceError> {
        if self.was_stopped() {
            self.activity = Activity::Unknown;
            return Ok(Motion::Unknown);
        }
        if !watch.shows(self.now()) {
            return Ok(Motion::Moving);
        }
        if !self.calibration(leg.bit())? {
            self.give_up();
            let message = format!("'{}' ended without finding the end switches; home again", leg.verb());
            return Err(self.error(ErrorKind::Fault, message));
        }
        match leg {
            Leg::Calibration => {
                self.begin_leg(Leg::RangeMeasure, self.stops_before)?;
                Ok(Motion::Moving)
            }
            Leg::RangeMeasure => {
                let envelope = self.measured_envelope().inspect_err(|_| self.activity = Activity::Unknown)?;
                (self.envelope, self.activity, self.needs_homing) = (envelope, Activity::Still, false);
                Ok(Motion::Still)
            }
        }
    }

    /// The fault that a letter tells; STOP is sent and the place is no longer known.
    fn fault_of(&mut self, axis: char, letter: Letter) -> Result<DeviceError, DeviceError> {
        self.give_up();
        let code = self.dialog.error_code()?;
        self.dialog.send("!err")?;
        let what = match letter {
            Letter::Limit => "stands in an end switch",
            Letter::Timeout => "needed too long",
            Letter::Absent => "is absent or switched off",
            _ => "failed or was aborted",
        };
        let message = format!(
            "axis {axis} {what} (error {code}: {}); STOP was sent; look at the stage, then home it",
            codes::meaning(code),
        );
        Ok(self.error(ErrorKind::Fault, message))
    }

    fn look_at_axes(&mut self) -> Result<Look, DeviceError> {
        let mut look = Look::Ready;
        for axis in AXES {
            // One axis at a time: the answer of one letter cannot be mistaken for a line of autostatus.
            match self.dialog.ask(&format!("?statusaxis {axis}"), "a letter", reply::letter)? {
                // An axis keeps this letter after STOP until its next move.
                Letter::Error if self.was_stopped() => {}
                Letter::Ready => {}
                Letter::Moving => return Ok(Look::Moving),
                Letter::Joystick => look = Look::ByHand,
                letter => return Ok(Look::Fault(axis, letter)),
            }
        }
        Ok(look)
    }

    /// Whether STOP was sent since the newest motion was begun.
    fn was_stopped(&self) -> bool {
        self.brake.stops() != self.stops_before
    }
}
