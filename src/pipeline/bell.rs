//! Wakes the one thread that waits for work from several sides.
//!
//! In: rings from any thread. Out: the waiting thread looks again.
//! Never: loses a ring between looking and sleeping: a ring before the sleep makes the sleep return at once.
//! Fails: not at all; a ring without anybody waiting does nothing.
//!
//! `tests/handoffs` runs this file through all interleavings of its threads.

use super::sync::{Arc, Instant, OnceLock, Thread, fence, thread};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// A bell that one thread listens to and many may ring.
#[derive(Debug, Clone, Default)]
pub struct Bell {
    listener: Arc<OnceLock<Thread>>,
}

impl Bell {
    /// Wakes the listener, or keeps it from falling asleep.
    pub fn ring(&self) {
        // What was made ready is seen before the listener is looked for; else, both sides could see the past:
        // the listener nothing ready, and this thread nobody listening.
        fence(Ordering::SeqCst);
        if let Some(listener) = self.listener.get() {
            listener.unpark();
        }
    }

    /// Makes the calling thread the listener and waits until `ready` or until the time is over; says whether ready.
    ///
    /// # Panics
    /// When another thread is the listener already.
    pub fn wait_until(&self, timeout: Duration, mut ready: impl FnMut() -> bool) -> bool {
        // First listen, then look: who makes something ready after the look finds a listener to ring for.
        let me = thread::current();
        assert_eq!(self.listener.get_or_init(|| me.clone()).id(), me.id(), "a bell has one listener");
        fence(Ordering::SeqCst);
        let begun = Instant::now();
        loop {
            if ready() {
                return true;
            }
            let Some(left) = timeout.checked_sub(begun.elapsed()).filter(|left| !left.is_zero()) else {
                return false;
            };
            thread::park_timeout(left);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU64;

    #[test]
    fn no_ring_is_lost() {
        const ROUNDS: u64 = 20_000;
        let (there, back) = (Bell::default(), Bell::default());
        let count = AtomicU64::new(0);
        let long = Duration::from_secs(60);
        thread::scope(|scope| {
            scope.spawn(|| {
                for round in 0..ROUNDS {
                    assert!(there.wait_until(long, || count.load(Ordering::Acquire) == 2 * round + 1));
                    count.fetch_add(1, Ordering::Release);
                    back.ring();
                }
            });
            for round in 0..ROUNDS {
                count.fetch_add(1, Ordering::Release);
                there.ring();
                assert!(back.wait_until(long, || count.load(Ordering::Acquire) == 2 * round + 2));
            }
        });
    }

    #[test]
    fn nothing_ready_is_said_when_the_time_is_over() {
        assert!(!Bell::default().wait_until(Duration::ZERO, || false));
        assert!(Bell::default().wait_until(Duration::ZERO, || true));
    }
}
