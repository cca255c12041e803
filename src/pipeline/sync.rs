//! What the hand-offs are built on, in one place, so that `tests/handoffs` can run the same code on other foundations.
//!
//! In and out: the standard library's own. Never: holds logic. Fails: not at all.

pub(super) use std::sync::atomic::fence;
pub(super) use std::sync::{Arc, OnceLock};
pub(super) use std::thread::{self, Thread};
pub(super) use std::time::Instant;
