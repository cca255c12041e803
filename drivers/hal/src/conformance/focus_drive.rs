//! What every focus drive must pass, whatever stands behind it.
//!
//! In: a [`FocusDriveRig`], which has a drive and can let it come to rest. Out: nothing.
//! Never: sleeps, reads a clock, knows which device it tests. Fails: panics with what was expected and found.

use super::{must, refused};
use crate::{ErrorKind, FocusDrive, Nanometers, PropertyValue};

/// A focus drive on the bench.
pub trait FocusDriveRig {
    /// The drive, always the same one.
    fn drive(&mut self) -> &mut dyn FocusDrive;

    /// Returns when any motion is certainly over.
    fn settle(&mut self);

    /// Distance between a target and where the drive comes to rest, noise of its sensor included.
    fn tolerance(&self) -> Nanometers;
}

/// Everything that a focus drive promises, twice; leaves it in the middle of its range.
///
/// # Panics
/// With the first promise that is broken.
pub fn focus_drive(rig: &mut impl FocusDriveRig) {
    for _ in 0..2 {
        identity_and_range_are_told(rig);
        targets_are_reached(rig);
        targets_outside_are_refused_and_nothing_moves(rig);
        holding_keeps_it_where_it_is(rig);
        properties_can_be_browsed(rig);
        let range = rig.drive().range();
        go(rig, between(&range, 0.5));
    }
}

fn identity_and_range_are_told(rig: &mut impl FocusDriveRig) {
    let identity = rig.drive().identity().clone();
    assert!(
        !identity.vendor.trim().is_empty() && !identity.model.trim().is_empty(),
        "it is named: {identity:?}"
    );
    assert_eq!(*rig.drive().identity(), identity, "the identity stays the same");
    let range = rig.drive().range();
    let length = range.end().distance(*range.start());
    assert!(range.start() < range.end(), "there is a range: {range:?}");
    assert!(length > rig.tolerance(), "the range {range:?} is longer than the tolerance {}", rig.tolerance());
}

/// A place within a range, 0 for its start and 1 for its end.
fn between(range: &std::ops::RangeInclusive<Nanometers>, share: f64) -> Nanometers {
    let (start, end) = (range.start().value(), range.end().value());
    nanometers((start + share * (end - start)).clamp(start, end))
}

fn nanometers(value: f64) -> Nanometers {
    Nanometers::new(value).expect("ranges and steps are finite")
}

/// Goes to a target and asserts that it is reached.
fn go(rig: &mut impl FocusDriveRig, target: Nanometers) {
    must(rig.drive().move_to(target), "moving within the range");
    rig.settle();
    assert_at(rig, target, "a target within the range is reached");
}

fn assert_at(rig: &mut impl FocusDriveRig, expected: Nanometers, what: &str) {
    let found = must(rig.drive().position(), "reading the position");
    let tolerance = rig.tolerance();
    assert!(found.distance(expected) <= tolerance, "{what}: {expected} ± {tolerance}, but it is at {found}");
}

fn targets_are_reached(rig: &mut impl FocusDriveRig) {
    let range = rig.drive().range();
    for share in [0.5, 0.25, 0.75, 0.0, 1.0, 0.501, 0.5] {
        go(rig, between(&range, share));
    }
}

fn targets_outside_are_refused_and_nothing_moves(rig: &mut impl FocusDriveRig) {
    let range = rig.drive().range();
    let middle = between(&range, 0.5);
    go(rig, middle);
    let length = range.end().value() - range.start().value();
    for beyond in [1.0, length, 1e9] {
        for target in [range.start().value() - beyond, range.end().value() + beyond] {
            let target = nanometers(target);
            refused(
                rig.drive().move_to(target),
                ErrorKind::OutOfRange,
                &format!("{target}, outside {range:?},"),
            );
            rig.settle();
            assert_at(rig, middle, "a refused target moves nothing");
        }
    }
    assert_eq!(rig.drive().range(), range, "the range stays the same");
}

fn holding_keeps_it_where_it_is(rig: &mut impl FocusDriveRig) {
    let range = rig.drive().range();
    let there = between(&range, 0.3);
    go(rig, there);
    for _ in 0..2 {
        must(rig.drive().hold(), "holding");
        rig.settle();
        assert_at(rig, there, "a drive at rest is held where it is");
    }
    must(rig.drive().move_to(between(&range, 0.6)), "moving within the range");
    must(rig.drive().hold(), "holding a drive that moves");
    rig.settle();
    let held = must(rig.drive().position(), "reading the position");
    rig.settle();
    assert_at(rig, held, "a drive that was held stays");
    go(rig, between(&range, 0.4));
}

fn properties_can_be_browsed(rig: &mut impl FocusDriveRig) {
    let properties = must(rig.drive().properties(), "listing the properties");
    for (number, property) in properties.iter().enumerate() {
        let is_new = properties[..number].iter().all(|other| other.name != property.name);
        assert!(is_new, "a property is listed once: {property:?}");
        if !property.writable {
            let same = rig.drive().set_property(&property.name, &property.value);
            refused(same, ErrorKind::OutOfRange, "changing a property that is only looked at");
        }
    }
    let unknown = rig.drive().set_property("no such property", &PropertyValue::Flag(true));
    refused(unknown, ErrorKind::OutOfRange, "changing a property that is not there");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DeviceError, DeviceIdentity, Properties, Property};
    use std::ops::RangeInclusive;

    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    enum Bug {
        None,
        Clips,
        MovesWhenRefused,
        StopsShort,
        HoldsAtZero,
        HoldsOnce,
        DriftsWhenHeld,
        SetsAnything,
    }

    struct Fake {
        bug: Bug,
        identity: DeviceIdentity,
        here: f64,
        target: f64,
        holds: u32,
        drift: f64,
    }

    fn no(kind: ErrorKind) -> DeviceError {
        DeviceError::new(kind, "fake", "no")
    }

    impl Properties for Fake {
        fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
            Ok(vec![Property::reading("range", PropertyValue::Number(300.0), "µm")])
        }

        fn set_property(&mut self, _: &str, _: &PropertyValue) -> Result<(), DeviceError> {
            if self.bug == Bug::SetsAnything { Ok(()) } else { Err(no(ErrorKind::OutOfRange)) }
        }
    }

    impl FocusDrive for Fake {
        fn identity(&self) -> &DeviceIdentity {
            &self.identity
        }

        fn range(&self) -> RangeInclusive<Nanometers> {
            nanometers(1_000.0)..=nanometers(300_000.0)
        }

        fn position(&mut self) -> Result<Nanometers, DeviceError> {
            Ok(nanometers(self.here))
        }

        fn move_to(&mut self, target: Nanometers) -> Result<(), DeviceError> {
            let range = self.range();
            if !range.contains(&target) && self.bug != Bug::Clips {
                self.target += f64::from(self.bug == Bug::MovesWhenRefused) * 500.0;
                return Err(no(ErrorKind::OutOfRange));
            }
            self.drift = 0.0;
            let short = if self.bug == Bug::StopsShort { 50.0 } else { 0.0 };
            self.target = target.value().clamp(range.start().value(), range.end().value()) - short;
            Ok(())
        }

        fn hold(&mut self) -> Result<(), DeviceError> {
            self.holds += 1;
            match self.bug {
                Bug::HoldsAtZero => self.target = 1_000.0,
                Bug::HoldsOnce if self.holds > 1 => return Err(no(ErrorKind::Busy)),
                Bug::DriftsWhenHeld if self.here != self.target => self.drift = 40.0,
                _ => self.target = self.here,
            }
            Ok(())
        }
    }

    struct Rig(Fake);

    impl FocusDriveRig for Rig {
        fn drive(&mut self) -> &mut dyn FocusDrive {
            &mut self.0
        }

        fn settle(&mut self) {
            self.0.target += self.0.drift;
            self.0.here = self.0.target;
        }

        fn tolerance(&self) -> Nanometers {
            nanometers(10.0)
        }
    }

    fn suite(bug: Bug) {
        let identity = DeviceIdentity {
            vendor: "nobody".into(),
            model: "fake".into(),
            serial: String::new(),
            firmware: "1".into(),
            simulated: true,
        };
        focus_drive(&mut Rig(Fake { bug, identity, here: 5_000.0, target: 5_000.0, holds: 0, drift: 0.0 }));
    }

    #[test]
    fn a_drive_that_keeps_its_contract_passes() {
        suite(Bug::None);
    }

    macro_rules! caught {
        ($($name:ident: $bug:ident, $says:literal;)*) => {
            $(
                #[test]
                #[should_panic(expected = $says)]
                fn $name() {
                    suite(Bug::$bug);
                }
            )*
        };
    }

    caught! {
        clipping_is_caught: Clips, "must be refused as OutOfRange";
        moving_when_refused_is_caught: MovesWhenRefused, "a refused target moves nothing";
        stopping_short_is_caught: StopsShort, "a target within the range is reached";
        holding_elsewhere_is_caught: HoldsAtZero, "is held where it is";
        holding_once_only_is_caught: HoldsOnce, "holding must succeed";
        drifting_when_held_is_caught: DriftsWhenHeld, "a drive that was held stays";
        setting_anything_is_caught: SetsAnything, "only looked at";
    }
}
