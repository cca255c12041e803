//! The window: draws what the instrument shows and sends what a person asks for.
//!
//! In: [`BenchStatus`] and [`Pictures`], newest only. Out: [`BenchCommand`]s.
//! Never: talks to a device, waits for the instrument, owns state that matters beyond what is drawn.
//! Fails: not at all; what the instrument refuses is shown where it was asked.

pub mod bench;

pub use bench::{Bench, BenchCommand, BenchStatus, Pictures};
