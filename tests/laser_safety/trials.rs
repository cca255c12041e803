//! Trials of the twelve causes.

use crate::bench::{Bench, BusyCores, dark_since, is_on, milliseconds, num_trials, wait};
use crate::causes::{Aftermath, CAUSES, Cause};
use crate::instrument::Instrument;
use crate::on_time;
use rustix::process::Signal;
use sofiscope_virtual::table::Quantity;
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// What is promised.
const CLOSED_WITHIN: Duration = Duration::from_millis(300);
/// How long the gates are watched afterwards.
const WATCH: Duration = Duration::from_millis(1200);
/// Trials at the same time.
const PARALLEL: usize = 7;
/// Row of the catalogue that is tried in a second way: the longest on-time of the board.
const ON_TIME_ROW: u8 = 49;

/// How long it took.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Closed {
    pub(crate) gates: Duration,
    /// `None` for a laser that stays on behind its closed gate, or that is gone.
    pub(crate) laser: Option<Duration>,
}

fn try_out(cause: &Cause, number: u32) -> Result<Closed, String> {
    let mut bench = Bench::new(cause.exposure);
    let mut instrument = Instrument::start(&bench, cause.exposure)?;
    instrument.ask("arm", "armed")?;
    instrument.ask("shine", "lit")?;
    bench
        .await_light(Duration::from_secs(5))
        .map_err(|dark| format!("tripped by {:?}: {dark}", instrument.tripped()))?;
    // Spread over the phases of proofs, heartbeats and questions.
    wait(Duration::from_micros(u64::from(number * 67_717 + u32::from(cause.row) * 13_331) % 300_000));
    if let Some(trip) = instrument.tripped() {
        return Err(format!("a false trip before anything happened: {trip}"));
    }
    bench.await_light(Duration::from_secs(1))?;
    let caused = (cause.happen)(&mut bench, &mut instrument, number)?;
    wait(WATCH);
    let (gates, laser) = (bench.gates(), bench.laser());
    let Some(closed) = dark_since(&gates) else { return Err(format!("gates stay open: {gates:?}")) };
    let closed = closed.saturating_sub(caused);
    if closed > CLOSED_WITHIN {
        return Err(format!("gates closed after {:.1} ms", milliseconds(closed)));
    }
    live_on(cause, &mut bench, &mut instrument, gates.len())?;
    Ok(Closed { gates: closed, laser: dark_since(&laser).map(|dark| dark.saturating_sub(caused)) })
}

/// Nothing opens a gate again but a person who arms.
fn live_on(
    cause: &Cause,
    bench: &mut Bench,
    instrument: &mut Instrument,
    num_notes: usize,
) -> Result<(), String> {
    match cause.aftermath {
        Aftermath::Nobody | Aftermath::Ended => {}
        Aftermath::GoesOn => {
            instrument.signal(Signal::CONT);
            instrument.await_word("tripped", Duration::from_secs(10))?;
        }
        Aftermath::Refused | Aftermath::ArmedAgain => {
            // Row 51 hears nothing any more: it cannot even be refused.
            if cause.row != 51 {
                instrument.await_word("tripped", Duration::from_secs(10))?;
                bench.table.set(Quantity::InterlockOpen, 0.0);
                if instrument.ask("shine", "lit").is_ok() {
                    return Err("light without arming again".to_owned());
                }
            }
        }
    }
    wait(Duration::from_millis(200));
    let gates = bench.gates();
    if gates.len() != num_notes || is_on(&gates) {
        return Err(format!("gates opened again: {gates:?}"));
    }
    if cause.aftermath == Aftermath::ArmedAgain {
        instrument.ask("arm", "armed")?;
        instrument.ask("shine", "lit")?;
        bench.await_light(Duration::from_secs(5))?;
    }
    Ok(())
}

fn attempt(cause: &Cause, number: u32) -> Result<Closed, String> {
    if cause.row == ON_TIME_ROW && number % 2 == 1 { on_time::try_out() } else { try_out(cause, number) }
}

type Outcomes = BTreeMap<u8, Vec<Result<Closed, String>>>;

#[test]
fn gates_close_within_300_ms_whatever_happens() {
    let _busy = BusyCores::new();
    let rows: Option<Vec<u8>> = std::env::var("SOFISCOPE_TEST_SAFETY_ROWS")
        .ok()
        .map(|rows| rows.split(',').map(|row| row.parse().unwrap()).collect());
    let causes = CAUSES.iter().filter(|cause| rows.as_ref().is_none_or(|rows| rows.contains(&cause.row)));
    let jobs: Vec<(&Cause, u32)> =
        (0..num_trials()).flat_map(|number| causes.clone().map(move |cause| (cause, number))).collect();
    let (next, outcomes) = (AtomicUsize::new(0), Mutex::new(Outcomes::new()));
    std::thread::scope(|scope| {
        for _ in 0..PARALLEL {
            scope.spawn(|| {
                while let Some((cause, number)) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let outcome = attempt(cause, *number);
                    outcomes.lock().unwrap().entry(cause.row).or_default().push(outcome);
                }
            });
        }
    });
    let misses = report(&outcomes.into_inner().unwrap());
    assert!(misses.is_empty(), "{} of {} trials: {misses:#?}", misses.len(), jobs.len());
}

/// Prints what was measured; returns what went wrong.
fn report(outcomes: &Outcomes) -> Vec<String> {
    println!("milliseconds until all gates were closed, by the controller's own clock, all cores busy");
    println!("row  cause                              trials  misses    p50    p99    max  laser dark, max");
    let mut misses = Vec::new();
    for cause in CAUSES.iter().filter(|cause| outcomes.contains_key(&cause.row)) {
        let outcomes = &outcomes[&cause.row];
        let missed = outcomes.iter().filter_map(|outcome| outcome.as_ref().err());
        misses.extend(missed.clone().map(|miss| format!("{} {}: {miss}", cause.row, cause.name)));
        let closed: Vec<&Closed> = outcomes.iter().flatten().collect();
        let mut gates: Vec<f64> = closed.iter().map(|closed| milliseconds(closed.gates)).collect();
        gates.sort_by(f64::total_cmp);
        let lasers = closed.iter().filter_map(|closed| closed.laser).max();
        let laser = lasers.map_or("-".to_owned(), |dark| format!("{:.1}", milliseconds(dark)));
        let num_missed = missed.count();
        let (p50, p99, max) = (quantile(&gates, 0.5), quantile(&gates, 0.99), quantile(&gates, 1.0));
        println!(
            "{:3}  {:33}  {:6}  {num_missed:6}  {p50:5.1}  {p99:5.1}  {max:5.1}  {laser}",
            cause.row,
            cause.name,
            outcomes.len(),
        );
    }
    misses
}

/// The smallest value that this share of all is not above.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let at = (sorted.len() as f64 * share).ceil() as usize;
    sorted.get(at.max(1) - 1).copied().unwrap_or(f64::NAN)
}
