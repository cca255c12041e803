//! What every laser driver must pass.
//!
//! In: a [`LaserRig`], which has a laser and sees its light with its own eyes. Out: nothing. Never: believes what
//! the laser says of its light. Fails: panics with what was expected and what was found.
//!
//! ```ignore
//! #[test]
//! fn the_laser_keeps_its_contract() {
//!     sofiscope_hal::conformance::laser(&mut MyRig::open());
//! }
//! ```

#[cfg(test)]
mod tests;

use super::{must, refused};
use crate::{Emission, ErrorKind, Interlock, Laser, LaserState, Milliwatts};

/// Powers further apart than this are not the same, milliwatts.
const SAME_POWER_MW: f64 = 0.01;

/// A laser on the bench, with a power meter, a counter on its line and a door with an interlock.
pub trait LaserRig {
    /// The laser, just opened; always the same one.
    fn laser(&mut self) -> &mut dyn Laser;

    /// A power that the laser can do exactly, above zero and not above half of its cap.
    fn power(&self) -> Milliwatts;

    /// Lets pass the time that the light needs to settle, and measures what leaves the head through an open gate.
    fn emitted(&mut self) -> Milliwatts;

    /// Bytes or calls that have reached the device since it was opened.
    fn num_sent(&mut self) -> u64;

    /// Opens the door.
    fn open_interlock(&mut self);

    /// Closes the door, and does all that a person must do until lasers may be switched on again.
    fn close_interlock(&mut self);
}

/// Everything that a laser promises; leaves it dark.
///
/// # Panics
/// With the first promise that is broken.
pub fn laser(rig: &mut impl LaserRig) {
    it_says_what_it_is(rig);
    it_is_dark_at_start(rig);
    powers_out_of_range_reach_no_device(rig);
    power_is_read_back_in_the_dark(rig);
    on_and_off_are_verified(rig);
    the_short_way_is_dark(rig);
    an_open_interlock_keeps_it_dark(rig);
    an_interlock_that_opens_makes_it_dark(rig);
    it_says_what_it_is(rig);
}

fn it_says_what_it_is(rig: &mut impl LaserRig) {
    let identity = rig.laser().identity().clone();
    for (name, text) in [("vendor", &identity.vendor), ("model", &identity.model)] {
        assert!(!text.trim().is_empty(), "the identity has a {name}: {identity:?}");
    }
    assert!(rig.laser().wavelength_nm() > 0, "the laser has a wavelength");
    let (cap, power) = (rig.laser().power_cap().value(), rig.power().value());
    assert!(power > 0.0 && power <= cap / 2.0, "a rig's power is within (0, {cap}/2] mW, but is {power} mW");
    let properties = must(rig.laser().properties(), "reading the properties");
    assert!(properties.iter().all(|property| !property.name.is_empty()), "properties have names");
}

fn it_is_dark_at_start(rig: &mut impl LaserRig) {
    assert_dark(rig, "a laser that was just opened");
    assert_says(rig, Emission::Off, "a laser that was just opened");
}

fn powers_out_of_range_reach_no_device(rig: &mut impl LaserRig) {
    let cap = rig.laser().power_cap().value();
    let before = rig.num_sent();
    for power_mw in [cap * 1.0001 + 0.01, cap * 10.0, f64::MAX, -0.01, -cap] {
        let power = Milliwatts::new(power_mw).unwrap_or(Milliwatts::ZERO);
        let done = rig.laser().set_power(power);
        refused(done, ErrorKind::OutOfRange, &format!("{power_mw} mW under a cap of {cap} mW"));
    }
    assert_eq!(rig.num_sent(), before, "powers that are refused reach no device");
}

fn power_is_read_back_in_the_dark(rig: &mut impl LaserRig) {
    for power_mw in [rig.power().value() / 2.0, rig.power().value()] {
        let power = Milliwatts::new(power_mw).unwrap_or(Milliwatts::ZERO);
        must(rig.laser().set_power(power), "setting a power below the cap");
        let read = state(rig).power_set;
        assert!(
            read.distance(power).value() <= SAME_POWER_MW,
            "the set power reads back: set {power}, read {read}"
        );
        assert_dark(rig, "a laser whose power was set in the dark");
    }
}

fn on_and_off_are_verified(rig: &mut impl LaserRig) {
    for round in 1..=2 {
        must(rig.laser().switch_on(), "switching on");
        assert_bright(rig, &format!("a laser that was switched on for the {round}. time"));
        assert_says(rig, Emission::On, "a laser that was switched on");
        must(rig.laser().switch_on(), "switching on twice");
        must(rig.laser().switch_off(), "switching off");
        assert_dark(rig, "a laser that was switched off");
        assert_says(rig, Emission::Off, "a laser that was switched off");
        must(rig.laser().switch_off(), "switching off twice");
        assert_dark(rig, "a laser that was switched off twice");
    }
}

fn the_short_way_is_dark(rig: &mut impl LaserRig) {
    must(rig.laser().switch_on(), "switching on");
    must(rig.laser().make_dark(), "making dark");
    assert_dark(rig, "a laser that was made dark");
    assert_says(rig, Emission::Off, "a laser that was made dark");
    must(rig.laser().make_dark(), "making dark twice");
    must(rig.laser().switch_off(), "switching off a laser that was made dark");
    must(rig.laser().switch_on(), "switching on a laser that was made dark");
    assert_bright(rig, "a laser that was switched on after it was made dark");
    must(rig.laser().switch_off(), "switching off");
}

fn an_open_interlock_keeps_it_dark(rig: &mut impl LaserRig) {
    rig.open_interlock();
    refused(rig.laser().switch_on(), ErrorKind::Fault, "switching on with an open interlock");
    assert_dark(rig, "a laser with an open interlock");
    rig.close_interlock();
    assert_dark(rig, "a laser whose interlock was closed after it was refused");
    must(rig.laser().switch_on(), "switching on with a closed interlock");
    assert_bright(rig, "a laser that was switched on with a closed interlock");
    must(rig.laser().switch_off(), "switching off");
}

fn an_interlock_that_opens_makes_it_dark(rig: &mut impl LaserRig) {
    must(rig.laser().switch_on(), "switching on");
    rig.open_interlock();
    assert_dark(rig, "a laser whose interlock has opened");
    let told = state(rig);
    assert_ne!(told.emission, Emission::On, "with its interlock open a laser is not on: {told:?}");
    let named = told.interlock == Interlock::Open || told.fault.is_some();
    assert!(named, "a laser that went dark by itself says so: {told:?}");
    rig.close_interlock();
    assert_dark(rig, "a laser whose interlock has opened and closed again");
    must(rig.laser().switch_off(), "switching off");
    assert_dark(rig, "a laser at the end");
}

fn state(rig: &mut impl LaserRig) -> LaserState {
    must(rig.laser().state(), "reading the state")
}

fn assert_dark(rig: &mut impl LaserRig, what: &str) {
    let emitted = rig.emitted();
    assert_eq!(emitted, Milliwatts::ZERO, "{what} is dark, but {emitted} leave its head");
}

/// Emits what was set, within a tenth.
fn assert_bright(rig: &mut impl LaserRig, what: &str) {
    let (emitted, power) = (rig.emitted(), rig.power());
    let near = emitted.distance(power).value() <= 0.1 * power.value();
    assert!(near, "{what} emits {power}, but {emitted} leave its head");
}

fn assert_says(rig: &mut impl LaserRig, emission: Emission, what: &str) {
    let told = state(rig);
    assert_eq!(told.emission, emission, "{what} says that it is {emission:?}: {told:?}");
}
