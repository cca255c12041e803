//! What `src/pipeline/sync.rs` takes from the standard library, on loom's foundations.
//!
//! - `OnceLock`, which loom has not: set once under a mutex, published by a release store, looked for by an acquire
//!   load, which is what the standard library promises.
//! - Parking: a token that unparking swaps in with release and parking swaps out with acquire, as the standard
//!   library promises; loom's own parking hands over memory before the thread parks.
//! - Time stands still as long as any thread can do anything. A parked thread lets all others run as far as they can;
//!   when the token is not there then, it never will be: its time is over, which [`times_out`] counts.
//!   So no timeout hides a ring that was lost.

use loom::cell::UnsafeCell;
use loom::sync::Mutex;
use loom::sync::atomic::{AtomicBool, Ordering};
use std::cell::Cell;
use std::fmt::{self, Debug, Formatter};
use std::sync::OnceLock as Storage;
use std::time::Duration;

pub use loom::sync::Arc;

std::thread_local! {
    /// All threads of a model run on the thread of its test.
    static FENCED: Cell<bool> = const { Cell::new(true) };
    static TIMES_OUT: Cell<u32> = const { Cell::new(0) };
}

/// Time that passes when somebody waits in vain: more than any timeout.
const AGE: Duration = Duration::from_secs(1_000_000);

/// How often a thread has waited in vain since the last call.
#[must_use]
pub fn times_out() -> u32 {
    TIMES_OUT.take()
}

/// Takes the fences away from all models that this thread runs from here on, to see that they are needed.
pub fn remove_fences() {
    FENCED.set(false);
}

/// A fence, unless they were removed.
pub fn fence(order: Ordering) {
    if FENCED.get() {
        loom::sync::atomic::fence(order);
    }
}

/// A value that is set once.
pub struct OnceLock<T> {
    is_set: AtomicBool,
    setting: Mutex<()>,
    /// loom does not see it, and need not: it is looked at only after `is_set` was seen.
    value: Storage<T>,
}

impl<T> Default for OnceLock<T> {
    fn default() -> Self {
        Self { is_set: AtomicBool::new(false), setting: Mutex::new(()), value: Storage::new() }
    }
}

impl<T> Debug for OnceLock<T> {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("OnceLock").finish_non_exhaustive()
    }
}

impl<T> OnceLock<T> {
    /// The value, if this thread can see that it was set.
    pub fn get(&self) -> Option<&T> {
        if self.is_set.load(Ordering::Acquire) { self.value.get() } else { None }
    }

    /// The value, set now if it was not.
    pub fn get_or_init(&self, make: impl FnOnce() -> T) -> &T {
        if let Some(value) = self.get() {
            return value;
        }
        let setting = self.setting.lock().expect("no model goes on after a panic");
        let value = self.value.get_or_init(make);
        self.is_set.store(true, Ordering::Release);
        drop(setting);
        value
    }
}

/// A thread that can be woken.
#[derive(Debug, Clone)]
pub struct Thread {
    id: thread::ThreadId,
    token: Arc<AtomicBool>,
}

impl Thread {
    /// Which thread it is.
    #[must_use]
    pub fn id(&self) -> thread::ThreadId {
        self.id
    }

    /// Lets its park return, the one under way or the next.
    pub fn unpark(&self) {
        self.token.swap(true, Ordering::Release);
    }
}

/// The calling thread.
pub mod thread {
    use super::{Arc, AtomicBool, Duration, Ordering, TIMES_OUT, Thread};

    pub use loom::thread::ThreadId;

    /// How often a parked thread looks, after all others have run as far as they can.
    const LOOKS: usize = 10;

    loom::thread_local! {
        static THIS: Thread = Thread {
            id: loom::thread::current().id(),
            token: Arc::new(AtomicBool::new(false)),
        };
    }

    /// The calling thread.
    #[must_use]
    pub fn current() -> Thread {
        THIS.with(Clone::clone)
    }

    /// Waits for the token and takes it, or until nobody is left who could bring it.
    pub fn park_timeout(_: Duration) {
        let token = current().token;
        for _ in 0..LOOKS {
            if token.swap(false, Ordering::Acquire) {
                return;
            }
            loom::thread::yield_now();
        }
        TIMES_OUT.set(TIMES_OUT.get() + 1);
    }
}

/// A moment, in ages.
#[derive(Debug, Clone, Copy)]
pub struct Instant(u32);

impl Instant {
    /// This age.
    #[must_use]
    pub fn now() -> Self {
        Self(TIMES_OUT.get())
    }

    /// The ages since.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        AGE * (TIMES_OUT.get() - self.0)
    }
}

/// Memory whose users loom watches: a write beside another use is a panic.
#[derive(Debug, Default)]
pub struct Watched<T> {
    uses: UnsafeCell<()>,
    value: std::sync::Mutex<T>,
}

impl<T: Copy> Watched<T> {
    /// Memory with a value.
    pub fn new(value: T) -> Self {
        Self { uses: UnsafeCell::new(()), value: std::sync::Mutex::new(value) }
    }

    /// Reads.
    pub fn read(&self) -> T {
        self.uses.with(|_| *self.value.lock().expect("no model goes on after a panic"))
    }

    /// Writes, where no borrow proves that nobody reads.
    pub fn write(&self, value: T) {
        self.uses.with_mut(|_| *self.value.lock().expect("no model goes on after a panic") = value);
    }
}
