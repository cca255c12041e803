//! Who waits at a queue learns of every value, of room, and that the other side is gone.

use loom::thread;
use sofiscope_handoffs::explore::explore;
use sofiscope_handoffs::{Bell, Producer, Received, Refused, RingBuffer, WhenFull, bounded};
use std::time::Duration;

const LONG: Duration = Duration::from_secs(3600);

#[test]
fn everything_sent_before_the_sender_leaves_is_received_in_order() {
    explore("two values and the end", Some(3), || {
        let (mut sender, mut receiver) = bounded("test", 2, WhenFull::Refuse, &Bell::default());
        thread::spawn(move || {
            sender.send(1).unwrap();
            sender.send(2).unwrap();
        });
        let receiving = thread::spawn(move || {
            let all = [receiver.receive(LONG), receiver.receive(LONG), receiver.receive(LONG)];
            assert_eq!(all, [Received::Value(1), Received::Value(2), Received::Closed]);
        });
        receiving.join().unwrap();
    });
}

#[test]
fn who_waits_for_a_value_learns_that_the_sender_left() {
    explore("the sender leaves", None, || {
        let (sender, mut receiver) = bounded::<u8>("test", 1, WhenFull::Refuse, &Bell::default());
        thread::spawn(move || drop(sender));
        let receiving = thread::spawn(move || assert_eq!(receiver.receive(LONG), Received::Closed));
        receiving.join().unwrap();
    });
}

#[test]
fn who_waits_for_room_gets_it() {
    explore("room for one", Some(3), || {
        let (mut sender, mut receiver) = bounded("test", 1, WhenFull::Wait, &Bell::default());
        thread::spawn(move || (1..=2).for_each(|value| sender.send(value).unwrap()));
        let receiving = thread::spawn(move || {
            assert_eq!([receiver.receive(LONG), receiver.receive(LONG)], [1, 2].map(Received::Value));
        });
        receiving.join().unwrap();
    });
}

#[test]
fn who_waits_for_room_learns_that_the_receiver_left() {
    explore("the receiver leaves", None, || {
        let (mut sender, receiver) = bounded("test", 1, WhenFull::Wait, &Bell::default());
        sender.send(1).unwrap();
        thread::spawn(move || drop(receiver));
        let sending = thread::spawn(move || assert_eq!(sender.send(2), Err(Refused::Closed(2))));
        sending.join().unwrap();
    });
}

#[test]
fn one_bell_serves_two_queues() {
    explore("two queues, one bell", Some(2), || {
        let bell = Bell::default();
        let (mut first, from_first) = bounded("first", 1, WhenFull::Refuse, &bell);
        let (mut second, from_second) = bounded("second", 1, WhenFull::Refuse, &bell);
        thread::spawn(move || first.send(1).unwrap());
        thread::spawn(move || second.send(2).unwrap());
        let receiving = thread::spawn(move || {
            let mut queues = [from_first, from_second];
            let mut values = 0;
            while values < 2 {
                assert!(bell.wait_until(LONG, || queues.iter().any(|queue| !queue.is_empty())));
                for queue in &mut queues {
                    values += usize::from(matches!(queue.try_receive(), Received::Value(_)));
                }
            }
        });
        receiving.join().unwrap();
    });
}

/// A sender that rings at its end while its ring is still there.
struct RingingTooEarly {
    ring: Producer<u8>,
    filled: Bell,
}

impl Drop for RingingTooEarly {
    fn drop(&mut self) {
        assert!(!self.ring.is_full());
        self.filled.ring();
    }
}

#[test]
#[should_panic(expected = "a ring was lost")]
fn a_ring_before_the_end_is_caught() {
    explore("ringing too early", None, || {
        let bell = Bell::default();
        let (ring, from_ring) = RingBuffer::new(1);
        let sender = RingingTooEarly { ring, filled: bell.clone() };
        thread::spawn(move || drop(sender));
        let receiving = thread::spawn(move || {
            bell.wait_until(LONG, || !from_ring.is_empty() || from_ring.is_abandoned());
        });
        receiving.join().unwrap();
    });
}

#[test]
#[should_panic(expected = "the last value was lost")]
fn asking_for_the_sender_after_the_last_look_is_caught() {
    explore("asking too late", None, || {
        let (mut ring, mut from_ring) = RingBuffer::new(1);
        thread::spawn(move || ring.push(1).unwrap());
        let receiving = thread::spawn(move || {
            let nothing_there = from_ring.pop().is_err();
            let closed = nothing_there && from_ring.is_abandoned();
            assert!(!closed, "the last value was lost");
        });
        receiving.join().unwrap();
    });
}
