//! Memory that is lent: one writer fills a slot, any number of readers look, the last one gives it back.
//!
//! In: the slots, once. Out: [`Loan`]s to write, shared slots to read.
//! Never: allocates after [`Slots::new`], locks, waits, lends a slot that somebody reads.
//! Fails: `None` when every slot is out on loan.
//!
//! One reference to each slot stays here. A slot whose only reference is this one can be written again,
//! so a slot needs no way back: the last reader that drops it has returned it.
//! [`Arc::get_mut`] is the proof: it succeeds only when nobody else holds the slot, and what the last reader did
//! happened before. A count of references alone would not say that.

use super::sync::Arc;

/// A fixed number of slots.
#[derive(Debug)]
pub struct Slots<S> {
    slots: Vec<Arc<S>>,
    next: usize,
}

/// A slot that nobody else holds.
#[derive(Debug)]
pub struct Loan<'a, S>(&'a mut Arc<S>);

impl<S> Slots<S> {
    /// Slots to lend.
    #[must_use]
    pub fn new(slots: Vec<S>) -> Self {
        Self { slots: slots.into_iter().map(Arc::new).collect(), next: 0 }
    }

    /// How many slots there are, lent or not.
    #[must_use]
    pub fn capacity(&self) -> usize {
        self.slots.len()
    }

    /// A slot that nobody holds; `None` when all are out.
    pub fn take(&mut self) -> Option<Loan<'_, S>> {
        let slots = self.slots.len();
        let free = (0..slots)
            .map(|step| (self.next + step) % slots)
            .find(|&slot| Arc::get_mut(&mut self.slots[slot]).is_some())?;
        self.next = (free + 1) % slots;
        Some(Loan(&mut self.slots[free]))
    }

    /// Slots out on loan at this moment.
    #[must_use]
    pub fn lent(&self) -> usize {
        self.slots.iter().filter(|slot| Arc::strong_count(slot) > 1).count()
    }
}

impl<S> Loan<'_, S> {
    /// The slot, to be written.
    pub fn get_mut(&mut self) -> &mut S {
        Arc::get_mut(self.0).expect("a slot is lent only while nobody else holds it")
    }

    /// Makes what was written readable.
    #[must_use]
    pub fn share(self) -> Arc<S> {
        Arc::clone(self.0)
    }
}
