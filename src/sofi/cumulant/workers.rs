//! Parallelism handed in from outside: the mathematics never starts a thread itself.

/// Something that can work on the items of a slice, one after another or side by side.
///
/// Results do not depend on which: every item is worked on by itself.
pub trait Workers: Sync {
    /// Calls `work` with the index of and exclusive access to every item, and returns when all are done.
    fn for_each<T: Send, F: Fn(usize, &mut T) + Sync>(&self, items: &mut [T], work: F);
}

/// Works on the calling thread.
#[derive(Debug, Clone, Copy, Default)]
pub struct Serial;

impl Workers for Serial {
    fn for_each<T: Send, F: Fn(usize, &mut T) + Sync>(&self, items: &mut [T], work: F) {
        items.iter_mut().enumerate().for_each(|(index, item)| work(index, item));
    }
}
