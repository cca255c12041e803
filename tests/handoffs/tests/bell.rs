//! No ring is lost, whoever comes first.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use loom::sync::Arc;
use loom::sync::atomic::{AtomicUsize, Ordering};
use loom::thread;
use sofiscope_handoffs::Bell;
use sofiscope_handoffs::explore::explore;
use sofiscope_handoffs::sync;
use std::time::Duration;

const LONG: Duration = Duration::from_secs(3600);

/// One waits for all of `ringers`, who make one thing ready each and ring.
fn ringers_and_one_who_waits(ringers: usize) {
    let (bell, ready) = (Bell::default(), Arc::new(AtomicUsize::new(0)));
    for _ in 0..ringers {
        let (bell, ready) = (bell.clone(), Arc::clone(&ready));
        thread::spawn(move || {
            ready.fetch_add(1, Ordering::Release);
            bell.ring();
        });
    }
    let waiting = thread::spawn(move || bell.wait_until(LONG, || ready.load(Ordering::Acquire) == ringers));
    waiting.join().unwrap();
}

#[test]
fn a_ring_is_heard_before_and_after_the_first_listening() {
    explore("one ringer", None, || ringers_and_one_who_waits(1));
}

#[test]
fn two_may_ring_at_once() {
    explore("two ringers", Some(3), || ringers_and_one_who_waits(2));
}

#[test]
fn one_may_wait_again_and_again() {
    explore("two rounds there and back", Some(3), || {
        let (there, back, count) = (Bell::default(), Bell::default(), Arc::new(AtomicUsize::new(0)));
        let (here, answer, counted) = (there.clone(), back.clone(), Arc::clone(&count));
        thread::spawn(move || {
            for round in 0..2 {
                assert!(here.wait_until(LONG, || counted.load(Ordering::Acquire) == 2 * round + 1));
                counted.fetch_add(1, Ordering::Release);
                answer.ring();
            }
        });
        let asking = thread::spawn(move || {
            for round in 0..2 {
                count.fetch_add(1, Ordering::Release);
                there.ring();
                assert!(back.wait_until(LONG, || count.load(Ordering::Acquire) == 2 * round + 2));
            }
        });
        asking.join().unwrap();
    });
}

#[test]
#[should_panic(expected = "a ring was lost")]
fn without_fences_both_sides_can_see_the_past() {
    sync::remove_fences();
    explore("one ringer, no fences", None, || ringers_and_one_who_waits(1));
}

/// A bell that looks first and then listens.
#[derive(Clone, Default)]
struct LookingFirst(Arc<sync::OnceLock<sync::Thread>>);

impl LookingFirst {
    fn ring(&self) {
        sync::fence(Ordering::SeqCst);
        if let Some(listener) = self.0.get() {
            listener.unpark();
        }
    }

    fn wait_until(&self, ready: impl Fn() -> bool) {
        while !ready() {
            self.0.get_or_init(sync::thread::current);
            sync::fence(Ordering::SeqCst);
            sync::thread::park_timeout(LONG);
        }
    }
}

#[test]
#[should_panic(expected = "a ring was lost")]
fn looking_before_listening_is_caught() {
    explore("looking first", None, || {
        let (bell, ready) = (LookingFirst::default(), Arc::new(AtomicUsize::new(0)));
        let (ringing, readied) = (bell.clone(), Arc::clone(&ready));
        thread::spawn(move || {
            readied.store(1, Ordering::Release);
            ringing.ring();
        });
        let waiting = thread::spawn(move || bell.wait_until(|| ready.load(Ordering::Acquire) == 1));
        waiting.join().unwrap();
    });
}
