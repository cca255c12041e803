//! A slot is never written while somebody reads it, and comes back with its last reader.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use loom::sync::Arc;
use loom::sync::atomic::{AtomicUsize, Ordering};
use loom::thread;
use sofiscope_handoffs::explore::explore;
use sofiscope_handoffs::sync::Watched;
use sofiscope_handoffs::{Bell, Received, Slots, WhenFull, bounded};
use std::time::Duration;

type Frame = Watched<u64>;

/// Reads twice, as a consumer that takes its time.
fn assert_shows(frame: &Arc<Frame>, exposure: u64) {
    assert_eq!(frame.read(), exposure);
    thread::yield_now();
    assert_eq!(frame.read(), exposure);
}

/// Writes a frame if there is memory for it.
fn write(slots: &mut Slots<Frame>, exposure: u64) -> Option<Arc<Frame>> {
    let mut loan = slots.take()?;
    loan.get_mut().write(exposure);
    Some(loan.share())
}

#[test]
fn two_readers_see_what_was_written_and_the_last_one_gives_it_back() {
    explore("two readers of one slot", Some(3), || {
        let writing = thread::spawn(|| {
            let mut slots = Slots::new(vec![Frame::new(0)]);
            let frame = write(&mut slots, 1).unwrap();
            let readers = [frame.clone(), frame].map(|frame| thread::spawn(move || assert_shows(&frame, 1)));
            if let Some(again) = write(&mut slots, 2) {
                assert_shows(&again, 2);
            }
            readers.into_iter().for_each(|reader| reader.join().unwrap());
            assert_eq!(slots.lent(), 0);
            assert!(write(&mut slots, 3).is_some(), "nobody reads, so there is memory");
        });
        writing.join().unwrap();
    });
}

#[test]
fn a_reader_that_passes_its_frame_on_keeps_it() {
    explore("a frame passed on", Some(3), || {
        let writing = thread::spawn(|| {
            let mut slots = Slots::new(vec![Frame::new(0)]);
            let frame = write(&mut slots, 1).unwrap();
            let reader = thread::spawn(move || {
                let other = frame.clone();
                drop(frame);
                assert_shows(&other, 1);
            });
            let again = write(&mut slots, 2);
            drop(again);
            reader.join().unwrap();
            assert!(slots.take().is_some());
        });
        writing.join().unwrap();
    });
}

#[test]
fn frames_go_through_a_queue_and_their_memory_comes_home() {
    explore("three frames, two slots, a queue", Some(2), || {
        let (mut sender, mut receiver) = bounded("test", 1, WhenFull::Refuse, &Bell::default());
        thread::spawn(move || {
            let mut slots = Slots::new(vec![Frame::new(0), Frame::new(0)]);
            for exposure in 1..=3 {
                if let Some(frame) = write(&mut slots, exposure) {
                    drop(sender.send((exposure, frame)));
                }
            }
        });
        let reading = thread::spawn(move || {
            let mut last = 0;
            while let Received::Value((exposure, frame)) = receiver.receive(Duration::from_secs(3600)) {
                assert_eq!(frame.read(), exposure);
                assert!(exposure > last);
                last = exposure;
            }
            assert!(last > 0);
        });
        reading.join().unwrap();
    });
}

/// A slot that counts its readers; `looking` is the order in which the writer looks at the count.
fn counted_readers(looking: Ordering) {
    let slot = Arc::new((AtomicUsize::new(1), Frame::new(1)));
    let lent = Arc::clone(&slot);
    let reading = thread::spawn(move || {
        assert_eq!(lent.1.read(), 1);
        lent.0.fetch_sub(1, Ordering::Release);
    });
    let writing = thread::spawn(move || {
        if slot.0.load(looking) == 0 {
            slot.1.write(2);
        }
    });
    reading.join().unwrap();
    writing.join().unwrap();
}

#[test]
fn a_count_that_is_looked_at_in_order_is_a_proof() {
    explore("readers counted", None, || counted_readers(Ordering::Acquire));
}

#[test]
#[should_panic(expected = "Causality violation")]
fn a_count_of_references_alone_is_no_proof() {
    explore("readers counted without order", None, || counted_readers(Ordering::Relaxed));
}

#[test]
#[should_panic(expected = "Causality violation")]
fn a_pool_that_goes_round_without_looking_is_caught() {
    explore("going round", None, || {
        let writing = thread::spawn(|| {
            let slots = [Arc::new(Frame::new(0))];
            for exposure in 1..=2 {
                let slot = &slots[0];
                slot.write(exposure);
                let frame = Arc::clone(slot);
                thread::spawn(move || assert_shows(&frame, exposure));
            }
        });
        writing.join().unwrap();
    });
}
