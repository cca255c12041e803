//! One window is served: what it asks is answered, what it wants is passed on, until it is gone.
//!
//! In: a bench, the two lines of a window. Out: why the window left.
//! Never: sends anything unasked, lets STOP wait behind pixels, keeps light on for a window that does not look.
//! Fails: not at all; a window that cannot be reached is lost.

use super::bench::LocalBench;
use super::wire::{FromWindow, Known, receive, send};
use crate::pipeline::spawn;
use crate::viewer::bench::{Activity, Bench, BenchCommand, BenchStatus, Gravity, LaserStatus};
use std::io::{BufReader, Read};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

/// A window that has not looked for so long holds no light on.
const SILENT: Duration = Duration::from_secs(3);
/// Time between two judgments of that.
const WATCH_EVERY: Duration = Duration::from_millis(100);

/// Why a window left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Left {
    /// The person has closed it.
    Closed,
    /// It could not be shown: why.
    Failed(String),
    /// It is gone without a word; whether it had looked before.
    Lost {
        /// Whether it had looked at least once.
        has_looked: bool,
    },
}

/// Serves a window until it is gone.
pub(super) fn serve(bench: &LocalBench, wire: &UnixStream, stop: UnixStream) -> Left {
    let looks = Arc::new(Looks::default());
    let (stopped, watched, seen) = (bench.another(), bench.another(), Arc::clone(&looks));
    let lines = [
        spawn("window-stop", move || hear_stop(&stopped, stop)).err(),
        spawn("window-watch", move || {
            seen.watch(|| is_lit_by_hand(&watched.status()), || end_dark(&watched));
        })
        .err(),
    ];
    if let Some(error) = lines.into_iter().flatten().next() {
        return Left::Failed(format!("no thread for STOP and for what holds light on: {error}"));
    }
    let left = answer(bench, wire, &looks);
    looks.is_over.store(true, Ordering::SeqCst);
    left
}

fn hear_stop(bench: &LocalBench, mut line: UnixStream) {
    let mut pressed = [0];
    while line.read_exact(&mut pressed).is_ok() {
        bench.stop();
    }
}

fn answer(bench: &LocalBench, wire: &UnixStream, looks: &Looks) -> Left {
    let (mut from, mut to, mut known) = (BufReader::new(wire), wire, Known::default());
    loop {
        let Ok(message) = receive(&mut from) else { return looks.lost() };
        let answered = match message {
            FromWindow::Look => {
                looks.take();
                known.send(&mut to, (bench.status(), bench.shows_simulated()), bench.pictures())
            }
            FromWindow::Judge(text) => send(&mut to, &bench.judge_plan(&text)),
            FromWindow::Ask(command) => {
                if let Err(refused) = bench.ask(command) {
                    bench.tell(Gravity::Warning, &refused.to_string());
                }
                Ok(())
            }
            FromWindow::Tell(gravity, text) => {
                bench.tell(gravity, &text);
                Ok(())
            }
            FromWindow::Closed => return Left::Closed,
            FromWindow::Failed(why) => return Left::Failed(why),
        };
        if answered.is_err() {
            return looks.lost();
        }
    }
}

/// When the window looked.
#[derive(Debug)]
struct Looks {
    last: RwLock<Instant>,
    number: AtomicU64,
    is_over: AtomicBool,
}

impl Default for Looks {
    fn default() -> Self {
        Self { last: RwLock::new(Instant::now()), number: AtomicU64::new(0), is_over: AtomicBool::new(false) }
    }
}

impl Looks {
    fn take(&self) {
        *self.last.write().unwrap_or_else(PoisonError::into_inner) = Instant::now();
        self.number.fetch_add(1, Ordering::SeqCst);
    }

    fn lost(&self) -> Left {
        Left::Lost { has_looked: self.number.load(Ordering::SeqCst) > 0 }
    }

    /// Calls `darken` when light shines by hand and the window does not look.
    fn watch(&self, is_lit: impl Fn() -> bool, mut darken: impl FnMut()) {
        while !self.is_over.load(Ordering::SeqCst) {
            let silent = self.last.read().unwrap_or_else(PoisonError::into_inner).elapsed();
            if silent > SILENT && is_lit() {
                darken();
            }
            // Nothing will ever come: this is a pause between two judgments.
            let _ = crossbeam_channel::after(WATCH_EVERY).recv();
        }
    }
}

/// Whether lasers shine because somebody looks, not because a run needs them.
fn is_lit_by_hand(status: &BenchStatus) -> bool {
    let shines = |laser: &LaserStatus| laser.power_mw > 0.0 || laser.is_emitting == Some(true);
    status.activity == Activity::Live && status.lasers.iter().any(shines)
}

fn end_dark(bench: &LocalBench) {
    let text = "the window has not looked for 3 s: the live view ends, lasers go off";
    bench.tell(Gravity::Warning, text);
    // A run that is busy with an end already needs no other.
    let _ = bench.ask(BenchCommand::Finish);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_by_hand_is_that_of_the_live_view() {
        let laser = |power_mw: f64, is_emitting| LaserStatus {
            wavelength_nm: 488,
            cap_mw: 50.0,
            identity: String::new(),
            power_mw,
            is_emitting,
            interlock_closed: None,
        };
        let status =
            |activity, laser| BenchStatus { activity, lasers: vec![laser], ..BenchStatus::default() };
        assert!(is_lit_by_hand(&status(Activity::Live, laser(5.0, None))));
        assert!(is_lit_by_hand(&status(Activity::Live, laser(0.0, Some(true)))));
        assert!(!is_lit_by_hand(&status(Activity::Live, laser(0.0, Some(false)))));
        assert!(!is_lit_by_hand(&status(Activity::Run, laser(5.0, Some(true)))));
        assert!(!is_lit_by_hand(&BenchStatus { activity: Activity::Live, ..BenchStatus::default() }));
    }

    #[test]
    fn light_goes_off_when_nobody_looks_for_so_long_and_not_before() {
        let looks = Looks::default();
        let begun = Instant::now();
        let mut dark_after = None;
        looks.watch(
            || true,
            || {
                dark_after = Some(begun.elapsed());
                looks.is_over.store(true, Ordering::SeqCst);
            },
        );
        assert!(dark_after.is_some_and(|after| after > SILENT), "{dark_after:?}");
    }
}
