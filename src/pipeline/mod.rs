//! Plumbing between threads: bounded queues with names, the latest value, named threads. Knows no physics.
//!
//! ```text
//! sender ─► queue (wait-free ring, one sender, one receiver) ─► receiver, woken by its Bell
//! writer ─► Slots (memory on loan) ─► readers; the last one gives it back
//! publisher ─► Latest (wait-free, newest value wins) ─► viewer
//! ```
//!
//! In: values to hand over. Out: the same values, in order, once; or the newest one.
//! Never: locks, allocates after creation, drops a value unsaid.
//! Fails: a full queue gives the value back; a queue whose other end is gone says so.

mod bell;
mod latest;
mod queue;
mod slots;
mod stage;
mod sync;

pub use bell::Bell;
pub use latest::{Publisher, Viewer, latest};
pub use queue::{Received, Receiver, Refused, Sender, WhenFull, bounded};
pub use slots::{Loan, Slots};
pub use stage::{Stage, StagePanicked, spawn};
