//! The hand-offs of `src/pipeline`, the very files, on the foundations of loom.
//!
//! loom runs a piece of code once for every order in which its threads can take their steps,
//! and lets every load see every value that the memory model allows.
//! Nothing here is a copy: `bell.rs`, `queue.rs` and `slots.rs` are compiled as they stand, with another `sync`.
//! A package of its own, as the program and the hundred packages below it are not needed for this.
//!
//! What is modeled instead of run: `OnceLock`, parking and time in `sync.rs`; in `ring.rs` the ring of rtrb,
//! which is tested where it is made.
//! Every model of `tests/` stands beside a wrong twin, which must be caught.

// The files bring unit tests for the standard library's threads, which cannot run here.
#![cfg(not(test))]

// The queue's file asks for a package of this name.
extern crate self as rtrb;

#[path = "../../../src/pipeline/bell.rs"]
mod bell;
pub mod explore;
#[path = "../../../src/pipeline/queue.rs"]
mod queue;
mod ring;
#[path = "../../../src/pipeline/slots.rs"]
mod slots;
pub mod sync;

pub use bell::Bell;
pub use queue::{Received, Receiver, Refused, Sender, WhenFull, bounded};
pub use ring::{Consumer, Producer, PushError, RingBuffer};
pub use slots::{Loan, Slots};
