//! The twelve causes, as they are numbered in the catalogue of faults.

use crate::bench::{Bench, LASER};
use crate::instrument::{Instrument, send};
use rustix::process::Signal;
use sofiscope_virtual::monotonic;
use sofiscope_virtual::table::Quantity;
use std::time::Duration;

/// One long exposure: nothing but the safety chain closes the gate meanwhile.
const LONG: Duration = Duration::from_secs(20);
/// Exposures that follow each other without a pause.
const SHORT: Duration = Duration::from_millis(100);

/// What is left of the instrument afterwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Aftermath {
    /// Nobody who could ask for light.
    Nobody,
    /// It is stopped, and goes on later.
    GoesOn,
    /// It lives, and must be told of a trip; light is refused.
    Refused,
    /// The same; a person can arm again.
    ArmedAgain,
    /// It lives, and nothing was wrong: the light just ended.
    Ended,
}

/// One of the causes.
pub(crate) struct Cause {
    pub(crate) row: u8,
    pub(crate) name: &'static str,
    pub(crate) exposure: Duration,
    pub(crate) aftermath: Aftermath,
    /// Lets it happen; the number of the trial chooses among the ways. Returns when, or just before.
    pub(crate) happen: fn(&mut Bench, &mut Instrument, u32) -> Result<Duration, String>,
}

/// The instrument does it to itself and says when.
fn ordered(instrument: &mut Instrument, ways: &[&str], number: u32) -> Result<Duration, String> {
    instrument.ask(ways[number as usize % ways.len()], "cause").map(|said| said.at)
}

/// The test does it, at a time that is taken just before.
fn done(deed: impl FnOnce()) -> Result<Duration, String> {
    let now = monotonic();
    deed();
    Ok(now)
}

const fn cause(
    row: u8,
    name: &'static str,
    aftermath: Aftermath,
    happen: fn(&mut Bench, &mut Instrument, u32) -> Result<Duration, String>,
) -> Cause {
    Cause { row, name, exposure: LONG, aftermath, happen }
}

pub(crate) const CAUSES: [Cause; 12] = [
    cause(21, "supervising thread panics", Aftermath::Nobody, |_, instrument, number| {
        ordered(instrument, &["panic-of-a-thread"], number)
    }),
    cause(23, "control loop hangs", Aftermath::Nobody, |_, instrument, number| {
        ordered(instrument, &["lock", "spin"], number)
    }),
    cause(39, "instrument killed", Aftermath::Nobody, |_, instrument, _| {
        done(|| instrument.signal(Signal::KILL))
    }),
    cause(40, "instrument stopped", Aftermath::GoesOn, |_, instrument, _| {
        done(|| instrument.signal(Signal::STOP))
    }),
    cause(41, "panic, abort, overflow, segfault", Aftermath::Nobody, |_, instrument, number| {
        ordered(instrument, &["panic", "abort", "stack-overflow", "segmentation-fault"], number)
    }),
    cause(42, "guard killed", Aftermath::Refused, |_, instrument, _| {
        done(|| send(instrument.guard, Signal::KILL))
    }),
    cause(43, "laser line unplugged", Aftermath::Refused, |bench, _, _| done(|| bench.kill(LASER))),
    cause(47, "interlock opens", Aftermath::ArmedAgain, |bench, _, _| {
        done(|| bench.table.set(Quantity::InterlockOpen, 1.0))
    }),
    cause(48, "controller resets", Aftermath::ArmedAgain, |bench, _, _| done(|| bench.reset_controller())),
    Cause {
        row: 49,
        name: "pulses for the cameras stop",
        exposure: SHORT,
        aftermath: Aftermath::Ended,
        happen: |_, instrument, number| ordered(instrument, &["stop-train"], number),
    },
    cause(50, "SIGHUP, SIGTERM", Aftermath::Nobody, |_, instrument, number| {
        let signal = if number % 2 == 0 { Signal::HUP } else { Signal::TERM };
        done(|| instrument.signal(signal))
    }),
    cause(51, "socket blackholed", Aftermath::Refused, |_, instrument, number| {
        ordered(instrument, &["silence"], number)
    }),
];
