//! Light that somebody holds stays on.

use crate::bench::{Bench, BusyCores, THOROUGH, num_trials, wait};
use crate::instrument::Instrument;
use sofiscope_virtual::monotonic;
use std::time::Duration;

/// Exposures that follow each other without a pause, as in the paper.
const EXPOSURE: Duration = Duration::from_millis(20);
const PARALLEL: usize = 3;

#[test]
fn held_light_does_not_trip_while_all_cores_are_busy() {
    let _busy = BusyCores::new();
    let hold = Duration::from_secs(if num_trials() >= THOROUGH { 60 } else { 10 });
    std::thread::scope(|scope| {
        for _ in 0..PARALLEL {
            scope.spawn(|| assert_held(hold));
        }
    });
    println!("{PARALLEL} instruments held their light for {} s each: no trip", hold.as_secs());
}

fn assert_held(hold: Duration) {
    let bench = Bench::new(EXPOSURE);
    let mut instrument = Instrument::start(&bench, EXPOSURE).unwrap();
    instrument.ask("arm", "armed").unwrap();
    instrument.ask("shine", "lit").unwrap();
    let lit = bench.await_light(Duration::from_secs(5));
    assert!(lit.is_ok(), "tripped by {:?}: {lit:?}", instrument.tripped());
    let begun = monotonic();
    wait(hold);
    let (held, end) = (monotonic() - begun, monotonic());
    assert_eq!(instrument.tripped(), None);
    let opened: Vec<Duration> = bench
        .gates()
        .iter()
        .filter(|note| note.value != 0.0 && note.at >= begun)
        .map(|note| note.at)
        .collect();
    let expected = held.as_secs_f64() / EXPOSURE.as_secs_f64();
    assert!(opened.len() as f64 > 0.98 * expected, "{} exposures of {expected:.0} had light", opened.len());
    assert!(end.saturating_sub(*opened.last().unwrap()) < 10 * EXPOSURE, "the light was on until the end");
}
