//! A stage that keeps its contract passes; each broken promise is caught.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};

use super::*;
use crate::{DeviceError, DeviceIdentity, Properties, Property, PropertyValue, StopMotion};

/// What the stage does wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bug {
    None,
    Nameless,
    MovesUnhomed,
    TrustsStoppedHoming,
    ForgetsHoming,
    Clips,
    RefusesLate,
    Rounds,
    StaysAway,
    KeepsFirstTarget,
    IgnoresStop,
    GoesOnAfterStop,
    FaultsAfterStop,
    StaysStopped,
    NeverArrives,
    TakesAnyProperty,
}

/// A stage of 100 by 50 µm that goes 1 µm per millisecond along each axis.
struct Fake {
    bug: Bug,
    identity: DeviceIdentity,
    envelope: StageEnvelope,
    place: [f64; 2],
    target: [f64; 2],
    is_homed: bool,
    is_homing: bool,
    stop: Arc<AtomicBool>,
    was_stopped: bool,
    motions: usize,
}

struct FakeStop(Arc<AtomicBool>);

impl StopMotion for FakeStop {
    fn stop_motion(&self) -> Result<(), DeviceError> {
        self.0.store(true, SeqCst);
        Ok(())
    }
}

fn point(at: [f64; 2]) -> StagePoint {
    StagePoint { x: micrometers(at[0]), y: micrometers(at[1]) }
}

fn error(kind: ErrorKind) -> DeviceError {
    DeviceError::new(kind, "fake", "no")
}

impl Fake {
    fn new(bug: Bug) -> Self {
        let name = if bug == Bug::Nameless { "" } else { "fake" };
        let identity = DeviceIdentity {
            vendor: name.to_owned(),
            model: "stage".to_owned(),
            serial: String::new(),
            firmware: String::new(),
            simulated: true,
        };
        let range = |end| micrometers(0.0)..=micrometers(end);
        Self {
            bug,
            identity,
            envelope: StageEnvelope { x: range(100.0), y: range(50.0) },
            place: [30.0, 20.0],
            target: [30.0, 20.0],
            is_homed: false,
            is_homing: false,
            stop: Arc::default(),
            was_stopped: false,
            motions: 0,
        }
    }

    /// What STOP has asked for, before anything else happens.
    fn obey(&mut self) {
        if !self.stop.swap(false, SeqCst) || self.bug == Bug::IgnoresStop {
            return;
        }
        self.was_stopped = true;
        if self.is_homing {
            self.is_homing = false;
            self.is_homed = self.bug == Bug::TrustsStoppedHoming;
        }
        if self.bug != Bug::GoesOnAfterStop {
            self.target = self.place;
        }
    }
}

impl Properties for Fake {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        Ok(vec![Property::reading("travel", PropertyValue::Number(100.0), "µm")])
    }

    fn set_property(&mut self, _name: &str, _value: &PropertyValue) -> Result<(), DeviceError> {
        if self.bug == Bug::TakesAnyProperty { Ok(()) } else { Err(error(ErrorKind::OutOfRange)) }
    }
}

impl Stage for Fake {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn envelope(&self) -> &StageEnvelope {
        &self.envelope
    }

    fn position(&mut self) -> Result<StagePoint, DeviceError> {
        Ok(point(self.place))
    }

    fn move_to(&mut self, target: StagePoint) -> Result<(), DeviceError> {
        self.obey();
        if self.bug == Bug::RefusesLate {
            self.motions += 1;
        }
        if self.is_homing || (!self.is_homed && self.bug != Bug::MovesUnhomed) {
            return Err(error(ErrorKind::Busy));
        }
        let mut target = [target.x.value(), target.y.value()];
        if !self.envelope.contains(point(target)) {
            let is_near = target.iter().all(|at| (-0.1..=100.1).contains(at));
            match self.bug {
                Bug::Clips => target = [target[0].clamp(0.0, 100.0), target[1].clamp(0.0, 50.0)],
                Bug::Rounds if is_near => target = target.map(f64::round),
                _ => return Err(error(ErrorKind::OutOfRange)),
            }
        }
        self.motions += 1;
        let is_moving = self.place != self.target;
        if !(is_moving && self.bug == Bug::KeepsFirstTarget
            || self.was_stopped && self.bug == Bug::StaysStopped)
        {
            self.target = target;
        }
        if self.bug == Bug::StaysAway {
            self.target[0] += 3.0;
        }
        Ok(())
    }

    fn motion(&mut self) -> Result<Motion, DeviceError> {
        self.obey();
        if self.was_stopped && self.bug == Bug::FaultsAfterStop && self.is_homed {
            return Err(error(ErrorKind::Fault));
        }
        if self.place != self.target || self.bug == Bug::NeverArrives && self.is_homed {
            return Ok(Motion::Moving);
        }
        if self.is_homing {
            self.is_homing = false;
            self.is_homed = self.bug != Bug::ForgetsHoming;
        }
        Ok(if self.is_homed { Motion::Still } else { Motion::Unknown })
    }

    fn stopper(&self) -> Box<dyn StopMotion> {
        Box::new(FakeStop(self.stop.clone()))
    }

    fn begin_homing(&mut self) -> Result<(), DeviceError> {
        self.motions += 1;
        (self.is_homing, self.is_homed, self.target) = (true, false, [0.0, 0.0]);
        Ok(())
    }
}

struct Rig(Fake);

impl StageRig for Rig {
    fn stage(&mut self) -> &mut dyn Stage {
        &mut self.0
    }

    fn pass(&mut self, time: Duration) {
        self.0.obey();
        let way = 1e3 * time.as_secs_f64();
        for (place, target) in self.0.place.iter_mut().zip(self.0.target) {
            *place += (target - *place).clamp(-way, way);
        }
    }

    fn num_motions(&mut self) -> usize {
        self.0.motions
    }

    fn patience(&self) -> Duration {
        Duration::from_secs(2)
    }

    fn tolerance(&self) -> Micrometers {
        micrometers(0.01)
    }
}

#[test]
fn a_stage_that_keeps_its_contract_passes() {
    stage(&mut Rig(Fake::new(Bug::None)));
}

#[test]
fn every_broken_promise_is_caught() {
    let bugs = [
        (Bug::Nameless, "has a vendor"),
        (Bug::MovesUnhomed, "a move before homing must be refused"),
        (Bug::TrustsStoppedHoming, "after homing was stopped"),
        (Bug::ForgetsHoming, "after homing, the place is known"),
        (Bug::Clips, "must be refused as OutOfRange"),
        (Bug::Rounds, "outside by 0.05 µm, must be refused"),
        (Bug::RefusesLate, "a refused move sends nothing"),
        (Bug::StaysAway, "the stage is at"),
        (Bug::KeepsFirstTarget, "the stage is at"),
        (Bug::IgnoresStop, "after homing was stopped"),
        (Bug::GoesOnAfterStop, "does not come to its target"),
        (Bug::FaultsAfterStop, "asking for the motion must succeed"),
        (Bug::StaysStopped, "the stage is at"),
        (Bug::NeverArrives, "every motion ends"),
        (Bug::TakesAnyProperty, "a property that is not there"),
    ];
    for (bug, expected) in bugs {
        let caught = catch_unwind(AssertUnwindSafe(|| stage(&mut Rig(Fake::new(bug)))));
        let panic = caught.expect_err(&format!("{bug:?} is not caught"));
        let text = panic.downcast_ref::<String>().map_or("", String::as_str);
        assert!(text.contains(expected), "{bug:?}: {text}");
    }
}
