//! Runs a model through all its schedules.
//!
//! In: a model. Out: how many schedules there were. Never: lets a model pass that has only one.
//! Fails: by the panic of the schedule in which something goes wrong; a thread that waits in vain is a panic too.

use crate::sync::times_out;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Runs every schedule with at most `preemptions` threads stopped between two steps, and says how many there were.
///
/// A model joins all threads that wait.
///
/// # Panics
/// When a schedule does, or when there is only one, as then nothing was proved.
pub fn explore(name: &str, preemptions: Option<usize>, model: impl Fn() + Send + Sync + 'static) -> usize {
    let schedules = Arc::new(AtomicUsize::new(0));
    let counter = Arc::clone(&schedules);
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = preemptions;
    builder.check(move || {
        counter.fetch_add(1, Ordering::Relaxed);
        let _ = times_out();
        model();
        assert_eq!(times_out(), 0, "a ring was lost");
    });
    let schedules = schedules.load(Ordering::Relaxed);
    println!("{name}: {schedules} schedules");
    assert!(schedules > 1, "{name}: one schedule proves nothing");
    schedules
}
