//! Command and response over a serial line, for every driver that speaks to one.
//!
//! | module | what |
//! |---|---|
//! | [`port`] | [`Port`]: bytes out, bytes in within a time, a second handle for STOP; [`open`] for real ports |
//! | [`mod@line`] | [`Line`]: commands, answers up to a terminator or of a length, quiet, resynchronization |
//! | [`model`] | [`LineModel`], a device at the other end as a pure state machine; [`ModelPort`] to talk to it |
//! | [`wire`] | [`Wire`], which makes a model as slow and as faulty as a real line |
//! | [`scripted`] | [`ScriptedPort`], which wants exactly these bytes and answers exactly those |
//!
//! In: commands as bytes. Out: answers as bytes. Never: knows what they mean; takes a late answer for the next one.
//! Fails: [`LineError`], which a driver turns into a `DeviceError` with [`Line::error`].

pub mod line;
pub mod model;
pub mod port;
pub mod scripted;
pub mod wire;

pub use line::{Line, LineError};
pub use model::{LineModel, ModelPort};
pub use port::{LineSettings, Port, open};
pub use scripted::ScriptedPort;
pub use wire::{Wire, WireFaults};
