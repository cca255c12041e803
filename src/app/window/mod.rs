//! `live`: the window, and the session with the instrument behind it.
//!
//! ```text
//! window ─ commands ─► LocalBench ─► session thread ─► sequencer ─► devices
//!    ▲                     └─ STOP, past every queue ─► stage, lasers, sequencer
//!    └─ newest values ◄─ Shared ◄─ Board ◄─ data path: look, preview, numbers
//! ```
//!
//! In: arguments. Out: a window until it is closed. Never: lets drawing hold up the instrument.
//! Fails: [`AppError`](super::AppError) where there is no display.

mod bench;
pub(super) mod board;
mod card;
mod numbers;
mod recent;
mod save;
mod session;
mod shared;
#[cfg(test)]
mod tests;
