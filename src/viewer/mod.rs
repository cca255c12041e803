//! The window: draws what the instrument shows and sends what a person asks for.
//!
//! ```text
//! BenchStatus, Pictures ─► Window ─┬─ panels ─► BenchCommand
//!                                  └─ Canvas ─► Renderer (a thread) ─► texture
//! ```
//!
//! In: [`BenchStatus`] and [`Pictures`], newest only. Out: [`BenchCommand`]s.
//! Never: talks to a device, waits for the instrument, owns state that matters beyond what is drawn.
//! Fails: not at all; what the instrument refuses is shown where it was asked.

pub mod as_seen;
pub mod bench;
mod canvas;
mod panels;
pub mod plane;
mod presets;
pub mod renderer;
mod settings;
pub mod view;
mod window;

pub use as_seen::AsSeen;
pub use bench::{Bench, BenchCommand, BenchStatus, Pictures};
pub use canvas::{Canvas, Done};
pub use presets::{Preset, Presets};
pub use settings::{Below, Side, WindowSettings};
pub use window::{SHORTCUTS, Window};
