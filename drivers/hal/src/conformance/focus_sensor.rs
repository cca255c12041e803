//! What every sensor of the focus error promises.
//!
//! In: a [`FocusSensorRig`], which has a healthy sensor and moves its focus and its beam. Out: nothing.
//! Never: sleeps, reads a clock, knows which device it tests. Fails: panics with the first promise that is broken.

#[cfg(test)]
mod tests;

use std::time::Duration;

use super::{MOST_TIMEOUTS, must, refused};
use crate::{ErrorKind, FocusReading, FocusSensor, HostTime, Nanometers};

/// Readings that are taken where several are needed.
const SEVERAL: usize = 20;
/// New readings after which a change of focus or beam is seen.
const SETTLING: usize = 4;
/// What the focus lock believes: most saturated share and least shape.
const BELIEVED: (f64, f64) = (0.05, 0.5);
/// Light of a blocked beam, as a share of that in focus.
const BLOCKED_LIGHT: f64 = 0.05;

/// A sensor on the bench, in focus and with its beam on, on which nothing goes wrong.
pub trait FocusSensorRig {
    /// The sensor; always the same one.
    fn sensor(&mut self) -> &mut dyn FocusSensor;

    /// Time on the clock that stamps readings.
    fn now(&self) -> HostTime;

    /// Sets the focus error; readings soon see it.
    fn defocus(&mut self, error: Nanometers);

    /// Blocks the beam.
    fn block(&mut self);

    /// Lets the beam through again.
    fn unblock(&mut self);

    /// Lets the sensor take no readings; false when it cannot be without one, as a detector that is read at once.
    fn silence(&mut self) -> bool;

    /// Ends the silence.
    fn resume(&mut self);

    /// A focus error that the sensor tells with the right sign in both directions.
    fn reach(&self) -> Nanometers;

    /// A time within which a new reading certainly comes.
    fn patience(&self) -> Duration;

    /// How much later than its timeout an answer may come.
    fn slack(&self) -> Duration;
}

/// Everything that a sensor promises; leaves it in focus.
///
/// # Panics
/// With the first promise that is broken.
pub fn focus_sensor(rig: &mut impl FocusSensorRig) {
    identity_is_told(rig);
    readings_are_new_or_the_same(rig);
    the_signal_follows_the_focus(rig);
    a_blocked_beam_is_dark(rig);
    timeouts_are_kept(rig);
    identity_is_told(rig);
}

fn identity_is_told(rig: &mut impl FocusSensorRig) {
    let identity = rig.sensor().identity().clone();
    for (name, text) in [("vendor", &identity.vendor), ("model", &identity.model)] {
        assert!(!text.trim().is_empty(), "the identity has a {name}: {identity:?}");
    }
    assert_eq!(*rig.sensor().identity(), identity, "the identity stays the same");
}

/// One reading with sound numbers, taken by now.
fn reading(rig: &mut impl FocusSensorRig) -> FocusReading {
    let patience = rig.patience();
    let reading = must(rig.sensor().read(patience), "a reading");
    assert_sound(&reading);
    assert!(reading.at <= rig.now(), "a reading is not from the future: {reading:?} at {:?}", rig.now());
    reading
}

fn assert_sound(reading: &FocusReading) {
    let FocusReading { signal, light, saturated, shape, .. } = *reading;
    assert!(signal.is_finite(), "the signal is a number, also without light: {reading:?}");
    assert!(light.is_finite() && light >= 0.0, "light is a number and never negative: {reading:?}");
    assert!((0.0..=1.0).contains(&saturated), "the saturated share is from 0 to 1: {reading:?}");
    assert!((0.0..=1.0).contains(&shape), "the shape is from 0 to 1: {reading:?}");
}

/// Readings with different numbers.
fn new_readings(rig: &mut impl FocusSensorRig, number: usize) -> Vec<FocusReading> {
    let mut found: Vec<FocusReading> = Vec::new();
    for _ in 0..number * MOST_TIMEOUTS {
        let next = reading(rig);
        match found.last() {
            Some(last) if next.number == last.number => {
                assert_eq!(next, *last, "the same number is the same reading");
            }
            Some(last) => {
                assert!(next.number > last.number, "numbers rise: {last:?}, then {next:?}");
                assert!(next.at >= last.at, "times rise with numbers: {last:?}, then {next:?}");
                found.push(next);
            }
            None => found.push(next),
        }
        if found.len() == number {
            return found;
        }
    }
    panic!("a sensor takes new readings, but only {} of {number} came", found.len());
}

fn readings_are_new_or_the_same(rig: &mut impl FocusSensorRig) {
    for reading in new_readings(rig, SEVERAL) {
        assert!(is_believed(&reading), "a healthy sensor in focus is believed: {reading:?}");
    }
}

fn is_believed(reading: &FocusReading) -> bool {
    let (most_saturated, least_shape) = BELIEVED;
    reading.light > 0.0 && reading.saturated <= most_saturated && reading.shape >= least_shape
}

/// Readings after what was changed has settled.
fn settled(rig: &mut impl FocusSensorRig) -> Vec<FocusReading> {
    new_readings(rig, SETTLING + SEVERAL).split_off(SETTLING)
}

/// Mean and deviation of the signal.
fn signal(readings: &[FocusReading]) -> (f64, f64) {
    let number = readings.len() as f64;
    let mean = readings.iter().map(|reading| reading.signal).sum::<f64>() / number;
    let square = readings.iter().map(|reading| (reading.signal - mean).powi(2)).sum::<f64>() / number;
    (mean, square.sqrt())
}

fn the_signal_follows_the_focus(rig: &mut impl FocusSensorRig) {
    let reach = rig.reach().value();
    let mut places = Vec::new();
    for share in [-1.0, -0.5, 0.0, 0.5, 1.0] {
        let error = Nanometers::new(share * reach).unwrap_or_default();
        rig.defocus(error);
        let readings = settled(rig);
        assert!(readings.iter().all(is_believed), "within its reach, at {error}, a sensor is believed");
        places.push((error, signal(&readings)));
    }
    rig.defocus(Nanometers::ZERO);
    let way = places[4].1.0 - places[0].1.0;
    for pair in places.windows(2) {
        let ((_, (before, noise)), (_, (after, noise_after))) = (pair[0], pair[1]);
        let step = (after - before) * way.signum();
        assert!(
            step > 3.0 * noise.max(noise_after),
            "the signal rises or falls all the way, by more than its noise, but: {places:?}",
        );
    }
}

fn a_blocked_beam_is_dark(rig: &mut impl FocusSensorRig) {
    let light = |readings: &[FocusReading]| {
        readings.iter().map(|reading| reading.light).sum::<f64>() / readings.len() as f64
    };
    let full = light(&settled(rig));
    rig.block();
    let blocked = settled(rig);
    for reading in &blocked {
        assert!(
            reading.light <= BLOCKED_LIGHT * full,
            "a blocked beam has almost none of the light {full}: {reading:?}"
        );
        assert!(!is_believed(reading), "a blocked beam has no shape: {reading:?}");
    }
    rig.unblock();
    let again = light(&settled(rig));
    assert!((again / full - 1.0).abs() < 0.2, "the light comes back: {full} before, {again} after the block");
}

fn timeouts_are_kept(rig: &mut impl FocusSensorRig) {
    let last = new_readings(rig, 1)[0];
    if !rig.silence() {
        return;
    }
    let (patience, slack) = (rig.patience(), rig.slack());
    // What was taken before the silence may still come.
    for _ in 0..MOST_TIMEOUTS {
        if rig.sensor().read(patience).is_err() {
            break;
        }
    }
    for timeout in [Duration::ZERO, patience / 4, patience] {
        let begun = rig.now();
        let answer = rig.sensor().read(timeout);
        let took = rig.now().since(begun);
        refused(answer, ErrorKind::Timeout, "a reading from a silent sensor");
        assert!(took <= timeout + slack, "an answer within {timeout:?} came only after {took:?}");
    }
    rig.resume();
    let next = new_readings(rig, SETTLING);
    assert!(
        next[SETTLING - 1].number > last.number,
        "readings go on after a silence: {last:?}, then {next:?}"
    );
}
