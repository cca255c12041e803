//! A bounded queue with a name and a loss policy: one sender, one receiver, wait-free.
//!
//! In: values. Out: the same values in order. Never: locks, allocates after creation.
//! Fails: [`Refused`] with the value when full (or, with [`WhenFull::Wait`], only when the receiver is gone).

use super::Bell;
use rtrb::{Consumer, Producer, PushError, RingBuffer};
use std::time::Duration;

/// How long a waiting side sleeps at most before it looks whether the other side is still there.
const LOOK_AGAIN: Duration = Duration::from_millis(100);

/// What a sender does when the queue is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhenFull {
    /// Gives the value back at once: for everything that a camera feeds.
    Refuse,
    /// Waits for room: only where the source is a file or a patient simulator.
    Wait,
}

/// A value that found no place.
#[derive(Debug, PartialEq, Eq)]
pub enum Refused<T> {
    /// The queue is full.
    Full(T),
    /// The receiver is gone.
    Closed(T),
}

impl<T> Refused<T> {
    /// The value.
    pub fn into_inner(self) -> T {
        match self {
            Self::Full(value) | Self::Closed(value) => value,
        }
    }
}

/// What a receiver finds.
#[derive(Debug, PartialEq, Eq)]
pub enum Received<T> {
    /// The oldest value.
    Value(T),
    /// Nothing at this moment.
    Empty,
    /// Nothing, and nothing will come.
    Closed,
}

/// The sending end.
#[derive(Debug)]
pub struct Sender<T> {
    ring: Producer<T>,
    name: &'static str,
    when_full: WhenFull,
    filled: RungAtTheEnd,
    emptied: Bell,
}

/// The receiving end.
#[derive(Debug)]
pub struct Receiver<T> {
    ring: Consumer<T>,
    name: &'static str,
    filled: Bell,
    emptied: RungAtTheEnd,
}

/// Rings when it is dropped; stands behind the ring, so that the other side wakes up when this end is gone.
#[derive(Debug)]
struct RungAtTheEnd(Bell);

impl Drop for RungAtTheEnd {
    fn drop(&mut self) {
        self.0.ring();
    }
}

/// A queue for `capacity` values; `filled` rings at every value, so that one thread can listen to several queues.
///
/// # Panics
/// When the capacity is zero.
#[must_use]
pub fn bounded<T>(
    name: &'static str,
    capacity: usize,
    when_full: WhenFull,
    filled: &Bell,
) -> (Sender<T>, Receiver<T>) {
    assert!(capacity > 0, "queue {name} needs room for at least one value");
    let (producer, consumer) = RingBuffer::new(capacity);
    let emptied = Bell::default();
    let at_end = |bell: &Bell| RungAtTheEnd(bell.clone());
    let sender = Sender { ring: producer, name, when_full, filled: at_end(filled), emptied: emptied.clone() };
    (sender, Receiver { ring: consumer, name, filled: filled.clone(), emptied: at_end(&emptied) })
}

impl<T> Sender<T> {
    /// Sends a value by the queue's policy.
    ///
    /// # Errors
    /// [`Refused`] with the value.
    pub fn send(&mut self, value: T) -> Result<(), Refused<T>> {
        let mut value = value;
        loop {
            match self.ring.push(value) {
                Ok(()) => {
                    self.filled.0.ring();
                    return Ok(());
                }
                Err(PushError::Full(back)) if self.ring.is_abandoned() => return Err(Refused::Closed(back)),
                Err(PushError::Full(back)) if self.when_full == WhenFull::Refuse => {
                    return Err(Refused::Full(back));
                }
                Err(PushError::Full(back)) => value = back,
            }
            let ring = &self.ring;
            self.emptied.wait_until(LOOK_AGAIN, || !ring.is_full() || ring.is_abandoned());
        }
    }

    /// Values waiting, as a share of the capacity, 0 to 1.
    #[must_use]
    pub fn fill(&self) -> f64 {
        let capacity = self.ring.buffer().capacity();
        1.0 - self.ring.slots() as f64 / capacity as f64
    }

    /// Whether the receiver is gone.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.ring.is_abandoned()
    }

    /// The name of the queue.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.name
    }
}

impl<T> Receiver<T> {
    /// The oldest value, without waiting.
    pub fn try_receive(&mut self) -> Received<T> {
        // Asked before the last look: what was sent before the sender left is still found.
        let sender_gone = self.ring.is_abandoned();
        match self.ring.pop() {
            Ok(value) => {
                self.emptied.0.ring();
                Received::Value(value)
            }
            Err(_) if sender_gone => Received::Closed,
            Err(_) => Received::Empty,
        }
    }

    /// The oldest value, waiting for it until the time is over.
    pub fn receive(&mut self, timeout: Duration) -> Received<T> {
        let ring = &self.ring;
        self.filled.wait_until(timeout, || !ring.is_empty() || ring.is_abandoned());
        self.try_receive()
    }

    /// Values waiting.
    #[must_use]
    pub fn len(&self) -> usize {
        self.ring.slots()
    }

    /// Whether no value is waiting.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.ring.is_empty()
    }

    /// Whether the sender is gone; values may still be waiting.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.ring.is_abandoned()
    }

    /// The name of the queue.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.name
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    #[test]
    fn a_full_queue_gives_the_value_back() {
        let (mut sender, mut receiver) = bounded("test", 2, WhenFull::Refuse, &Bell::default());
        assert_eq!((sender.send(1), sender.send(2)), (Ok(()), Ok(())));
        assert_eq!(sender.send(3), Err(Refused::Full(3)));
        assert!((sender.fill() - 1.0).abs() < 1e-12);
        assert_eq!(receiver.try_receive(), Received::Value(1));
        assert_eq!(sender.send(3), Ok(()));
        drop(receiver);
        while sender.send(4).is_ok() {}
        assert_eq!(sender.send(5), Err(Refused::Closed(5)));
    }

    #[test]
    fn values_sent_before_the_sender_left_are_found() {
        let (mut sender, mut receiver) = bounded("test", 2, WhenFull::Refuse, &Bell::default());
        sender.send(1).unwrap();
        drop(sender);
        assert_eq!(receiver.receive(Duration::from_secs(60)), Received::Value(1));
        assert_eq!(receiver.receive(Duration::from_secs(60)), Received::Closed);
    }

    #[test]
    fn a_patient_queue_carries_everything_in_order() {
        let (mut sender, mut receiver) = bounded("test", 3, WhenFull::Wait, &Bell::default());
        thread::scope(|scope| {
            scope.spawn(move || (0..50_000_u32).for_each(|value| sender.send(value).unwrap()));
            let mut expected = 0;
            loop {
                match receiver.receive(Duration::from_secs(60)) {
                    Received::Value(value) => assert_eq!(value, expected),
                    Received::Empty => panic!("nothing for a minute"),
                    Received::Closed => break,
                }
                expected += 1;
            }
            assert_eq!(expected, 50_000);
        });
    }

    #[test]
    fn who_waits_for_room_learns_that_the_receiver_left() {
        let (mut sender, receiver) = bounded("test", 1, WhenFull::Wait, &Bell::default());
        sender.send(1).unwrap();
        thread::scope(|scope| {
            let waiting = scope.spawn(move || sender.send(2));
            drop(receiver);
            assert_eq!(waiting.join().unwrap(), Err(Refused::Closed(2)));
        });
    }
}
