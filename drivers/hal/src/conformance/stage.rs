//! What every stage promises.
//!
//! In: a [`StageRig`], which has a healthy stage and lets its time pass. Out: nothing.
//! Never: sleeps, reads a clock, knows which device it tests. Fails: panics with the first promise that is broken.

#[cfg(test)]
mod tests;

use std::time::Duration;

use super::{must, refused};
use crate::{ErrorKind, Micrometers, Motion, Stage, StageEnvelope, StagePoint};

/// A stage on the bench, standing and never homed, on which nothing goes wrong.
pub trait StageRig {
    /// The stage; always the same one.
    fn stage(&mut self) -> &mut dyn Stage;

    /// Lets time pass for the device.
    fn pass(&mut self, time: Duration);

    /// Commands to move or to home that have reached the device so far, as the device counts them.
    fn num_motions(&mut self) -> usize;

    /// A time within which every move and the search for the end switches certainly end.
    fn patience(&self) -> Duration;

    /// How far from its target a move may end.
    fn tolerance(&self) -> Micrometers;
}

/// Looks at a motion that may be taken before its end.
const LOOKS: u32 = 1000;

/// Everything that a stage promises; leaves it homed and standing.
///
/// # Panics
/// With the first promise that is broken.
pub fn stage(rig: &mut impl StageRig) {
    identity_is_told(rig);
    nothing_moves_before_homing(rig);
    stopped_homing_is_no_homing(rig);
    homing_makes_the_place_known(rig);
    moves_end_at_their_target(rig);
    places_outside_are_refused(rig);
    the_last_of_several_moves_counts(rig);
    stop_ends_motion(rig);
    stop_is_never_too_much(rig);
    moves_go_on_after_a_stop(rig);
    unknown_properties_are_refused(rig);
    identity_is_told(rig);
}

fn identity_is_told(rig: &mut impl StageRig) {
    let identity = rig.stage().identity().clone();
    for (name, text) in [("vendor", &identity.vendor), ("model", &identity.model)] {
        assert!(!text.trim().is_empty(), "the identity has a {name}: {identity:?}");
    }
    assert_eq!(*rig.stage().identity(), identity, "the identity stays the same");
    let StageEnvelope { x, y } = rig.stage().envelope().clone();
    assert!(x.start() < x.end() && y.start() < y.end(), "the envelope has room: {x:?}, {y:?}");
}

fn nothing_moves_before_homing(rig: &mut impl StageRig) {
    let motion = must(rig.stage().motion(), "asking a stage that was never homed");
    assert_eq!(motion, Motion::Unknown, "the place of a stage that was never homed is not known");
    let target = inside(rig, 0.5, 0.5);
    let before = rig.num_motions();
    refused(rig.stage().move_to(target), ErrorKind::Busy, "a move before homing");
    assert_eq!(rig.num_motions(), before, "a refused move sends nothing");
}

fn stopped_homing_is_no_homing(rig: &mut impl StageRig) {
    must(rig.stage().begin_homing(), "homing");
    assert_eq!(must(rig.stage().motion(), "asking while homing"), Motion::Moving, "homing is motion");
    let target = inside(rig, 0.5, 0.5);
    refused(rig.stage().move_to(target), ErrorKind::Busy, "a move while homing");
    must(rig.stage().stopper().stop_motion(), "stopping the homing");
    assert_eq!(ended(rig), Motion::Unknown, "after homing was stopped, the place is not known");
}

fn homing_makes_the_place_known(rig: &mut impl StageRig) {
    must(rig.stage().begin_homing(), "homing");
    assert_eq!(ended(rig), Motion::Still, "after homing, the place is known");
}

fn moves_end_at_their_target(rig: &mut impl StageRig) {
    for (x, y) in [(0.5, 0.5), (0.25, 0.5), (0.25, 0.5), (0.75, 0.25), (0.0, 0.0), (1.0, 1.0), (0.5, 0.5)] {
        let target = inside(rig, x, y);
        let before = rig.num_motions();
        must(rig.stage().move_to(target), "a move inside the envelope");
        assert!(rig.num_motions() > before, "a move to {target:?} reaches the device");
        assert_eq!(ended(rig), Motion::Still, "a move to {target:?} ends");
        assert_at(rig, target);
    }
}

fn places_outside_are_refused(rig: &mut impl StageRig) {
    let StageEnvelope { x, y } = rig.stage().envelope().clone();
    let here = must(rig.stage().position(), "reading the position");
    let before = rig.num_motions();
    for beyond in [0.05, 1.0, 1e3, 1e9, f64::MAX / 2.0] {
        let outside = [
            StagePoint { x: micrometers(x.end().value() + beyond), ..here },
            StagePoint { x: micrometers(x.start().value() - beyond), ..here },
            StagePoint { y: micrometers(y.end().value() + beyond), ..here },
            StagePoint { y: micrometers(y.start().value() - beyond), ..here },
        ];
        for target in outside {
            let what = format!("a move to {target:?}, outside by {beyond} µm,");
            refused(rig.stage().move_to(target), ErrorKind::OutOfRange, &what);
        }
    }
    assert_eq!(rig.num_motions(), before, "a refused move sends nothing");
    assert_eq!(ended(rig), Motion::Still, "a refused move does not move");
    assert_at(rig, here);
}

fn the_last_of_several_moves_counts(rig: &mut impl StageRig) {
    let [first, last] = [inside(rig, 0.9, 0.9), inside(rig, 0.3, 0.2)];
    must(rig.stage().move_to(first), "a move");
    let some = rig.patience() / 100;
    rig.pass(some);
    must(rig.stage().move_to(last), "a move that replaces another");
    assert_eq!(ended(rig), Motion::Still, "a move that replaced another ends");
    assert_at(rig, last);
}

fn stop_ends_motion(rig: &mut impl StageRig) {
    let begin = must(rig.stage().position(), "reading the position");
    let target = inside(rig, 0.9, 0.9);
    must(rig.stage().move_to(target), "a move");
    let some = rig.patience() / 500;
    rig.pass(some);
    let stopper = rig.stage().stopper();
    let stopped = std::thread::scope(|scope| scope.spawn(|| stopper.stop_motion()).join());
    match stopped {
        Ok(stopped) => must(stopped, "stopping from another thread"),
        Err(panic) => std::panic::resume_unwind(panic),
    }
    assert_eq!(ended(rig), Motion::Still, "a stopped move is no fault, and the place stays known");
    let there = must(rig.stage().position(), "reading the position");
    let way = |from: StagePoint| from.x.distance(target.x).value().max(from.y.distance(target.y).value());
    assert!(
        way(there) > 0.1 * way(begin),
        "a stopped move does not come to its target: from {begin:?} to {there:?} with target {target:?}",
    );
    let time = rig.patience();
    rig.pass(time);
    assert_at(rig, there);
}

fn stop_is_never_too_much(rig: &mut impl StageRig) {
    let stopper = rig.stage().stopper();
    for time in ["first", "second", "third"] {
        must(stopper.stop_motion(), &format!("stopping a stage that stands, for the {time} time"));
    }
    drop(stopper);
    assert_eq!(ended(rig), Motion::Still, "a stage that stands is not harmed by STOP");
}

fn moves_go_on_after_a_stop(rig: &mut impl StageRig) {
    let target = inside(rig, 0.5, 0.5);
    must(rig.stage().move_to(target), "a move after a stop");
    assert_eq!(ended(rig), Motion::Still, "a move after a stop ends");
    assert_at(rig, target);
}

fn unknown_properties_are_refused(rig: &mut impl StageRig) {
    let properties = must(rig.stage().properties(), "reading the properties");
    let what = "a property that is not there";
    let value = crate::PropertyValue::Flag(true);
    refused(rig.stage().set_property("no such property", &value), ErrorKind::OutOfRange, what);
    for property in properties.iter().filter(|property| !property.writable) {
        let what = format!("changing '{}', which is only looked at,", property.name);
        refused(rig.stage().set_property(&property.name, &property.value), ErrorKind::OutOfRange, &what);
    }
}

/// Waits for the end of a motion, and for what it ended as.
fn ended(rig: &mut impl StageRig) -> Motion {
    let step = rig.patience() / LOOKS;
    for _ in 0..LOOKS {
        match must(rig.stage().motion(), "asking for the motion") {
            Motion::Moving => rig.pass(step),
            motion => return motion,
        }
    }
    panic!("every motion ends within {:?}, but this one did not", rig.patience())
}

fn assert_at(rig: &mut impl StageRig, target: StagePoint) {
    let place = must(rig.stage().position(), "reading the position");
    let off = place.x.distance(target.x).value().max(place.y.distance(target.y).value());
    assert!(off <= rig.tolerance().value(), "the stage is at {target:?}, but it is at {place:?}");
}

/// A place in the envelope, given in shares of its sides.
fn inside(rig: &mut impl StageRig, x: f64, y: f64) -> StagePoint {
    let envelope = rig.stage().envelope();
    let share = |range: &std::ops::RangeInclusive<Micrometers>, share: f64| {
        let (start, end) = (range.start().value(), range.end().value());
        micrometers((start + share * (end - start)).clamp(start, end))
    };
    StagePoint { x: share(&envelope.x, x), y: share(&envelope.y, y) }
}

fn micrometers(value: f64) -> Micrometers {
    match Micrometers::new(value) {
        Ok(length) => length,
        Err(error) => panic!("the envelope is far too large: {error}"),
    }
}
