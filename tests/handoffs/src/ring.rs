//! A ring for one sender and one receiver with the orders of rtrb's: what it publishes and when, not how it is fast.

use crate::sync::Arc;
use loom::cell::UnsafeCell;
use loom::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::Mutex;

/// What both ends share.
#[derive(Debug)]
pub struct RingBuffer<T> {
    places: Vec<Place<T>>,
    head: AtomicUsize,
    tail: AtomicUsize,
    is_abandoned: AtomicBool,
}

/// A place whose users loom watches; the mutex is one that loom does not see, and orders nothing.
#[derive(Debug)]
struct Place<T> {
    uses: UnsafeCell<()>,
    value: Mutex<Option<T>>,
}

/// The sending end.
#[derive(Debug)]
pub struct Producer<T> {
    ring: Arc<RingBuffer<T>>,
    tail: usize,
}

/// The receiving end.
#[derive(Debug)]
pub struct Consumer<T> {
    ring: Arc<RingBuffer<T>>,
    head: usize,
}

/// Why a value was not taken.
#[derive(Debug, PartialEq, Eq)]
pub enum PushError<T> {
    /// There is no room.
    Full(T),
}

impl<T> RingBuffer<T> {
    /// Both ends.
    #[expect(clippy::new_ret_no_self, reason = "the ring that this stands for has it so")]
    #[must_use]
    pub fn new(capacity: usize) -> (Producer<T>, Consumer<T>) {
        let place = |_| Place { uses: UnsafeCell::new(()), value: Mutex::new(None) };
        let ring = Arc::new(Self {
            places: (0..capacity).map(place).collect(),
            head: AtomicUsize::new(0),
            tail: AtomicUsize::new(0),
            is_abandoned: AtomicBool::new(false),
        });
        (Producer { ring: Arc::clone(&ring), tail: 0 }, Consumer { ring, head: 0 })
    }

    /// Places.
    #[must_use]
    pub fn capacity(&self) -> usize {
        self.places.len()
    }

    fn exchange(&self, at: usize, value: Option<T>) -> Option<T> {
        let place = &self.places[at % self.places.len()];
        place.uses.with_mut(|_| {
            let mut kept = place.value.lock().expect("no model goes on after a panic");
            std::mem::replace(&mut *kept, value)
        })
    }
}

impl<T> Producer<T> {
    /// Puts a value in.
    ///
    /// # Errors
    /// The value, when there is no room.
    pub fn push(&mut self, value: T) -> Result<(), PushError<T>> {
        if self.is_full() {
            return Err(PushError::Full(value));
        }
        self.ring.exchange(self.tail, Some(value));
        self.tail += 1;
        self.ring.tail.store(self.tail, Ordering::Release);
        Ok(())
    }

    /// Room.
    #[must_use]
    pub fn slots(&self) -> usize {
        self.ring.capacity() - (self.tail - self.ring.head.load(Ordering::Acquire))
    }

    /// Whether there is no room.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.slots() == 0
    }

    /// Whether the receiving end is gone.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.ring.is_abandoned.load(Ordering::Acquire)
    }

    /// What both ends share.
    #[must_use]
    pub fn buffer(&self) -> &RingBuffer<T> {
        &self.ring
    }
}

impl<T> Consumer<T> {
    /// Takes a value out.
    ///
    /// # Errors
    /// When there is none.
    pub fn pop(&mut self) -> Result<T, PushError<()>> {
        if self.is_empty() {
            return Err(PushError::Full(()));
        }
        let value = self.ring.exchange(self.head, None);
        self.head += 1;
        self.ring.head.store(self.head, Ordering::Release);
        Ok(value.expect("between head and tail there are values"))
    }

    /// Values there.
    #[must_use]
    pub fn slots(&self) -> usize {
        self.ring.tail.load(Ordering::Acquire) - self.head
    }

    /// Whether there is no value.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.slots() == 0
    }

    /// Whether the sending end is gone.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.ring.is_abandoned.load(Ordering::Acquire)
    }
}

impl<T> Drop for Producer<T> {
    fn drop(&mut self) {
        self.ring.is_abandoned.store(true, Ordering::Release);
    }
}

impl<T> Drop for Consumer<T> {
    fn drop(&mut self) {
        self.ring.is_abandoned.store(true, Ordering::Release);
    }
}
