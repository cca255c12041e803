//! How the window is arranged: what is stored between sessions, and nothing that matters to the instrument.
//!
//! In: nothing. Out: [`WindowSettings`]. Never: holds a power, a limit or a place. Fails: not at all.

use serde::{Deserialize, Serialize};

/// The panel on the right.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Side {
    /// Live view: exposure, order, dyes, presets.
    Live,
    /// Plans.
    Plan,
    /// Lasers, stage, focus, properties.
    Devices,
    /// Registration of the cameras.
    Align,
    /// Replay and recent recordings.
    Replay,
}

impl Side {
    /// All of them with their names, and what they are for.
    pub const ALL: [(Self, &'static str, &'static str); 5] = [
        (Self::Live, "Live view", "Exposure, region, order, dyes, presets; nothing is recorded"),
        (Self::Plan, "Plan", "What to acquire and record: edit, check, run (Ctrl+Enter)"),
        (Self::Devices, "Instrument", "Lasers, stage, focus lock, and every property of every device"),
        (Self::Align, "Align", "How the cameras see each other, and the colors of the dyes"),
        (Self::Replay, "Replay", "Play a recording as if the microscope were there"),
    ];
}

/// The panel at the bottom.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Below {
    /// SNR, resolution, bleaching against exposures.
    Curves,
    /// Histogram of raw counts.
    Histogram,
    /// The line profile.
    Profile,
    /// What happened.
    Events,
}

impl Below {
    /// All of them with their names, and what they are for.
    pub const ALL: [(Self, &'static str, &'static str); 4] = [
        (Self::Curves, "Curves", "Signal-to-noise, resolution and bleaching against exposures"),
        (Self::Histogram, "Histogram", "Raw counts of both cameras, with handles for black and white"),
        (Self::Profile, "Profile", "Values along a line: drag with Shift in an image"),
        (Self::Events, "Events", "What happened, and what to do about it"),
    ];
}

/// What is stored between sessions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct WindowSettings {
    /// Dark or light.
    pub is_dark: bool,
    /// Panel on the right.
    pub side: Side,
    /// Panel at the bottom.
    pub below: Below,
    /// Whether cameras stand beside the result.
    pub shows_cameras: bool,
    /// Path of the instrument file that was typed last.
    pub instrument: String,
    /// Larger or smaller writing.
    pub scale: f32,
}

impl Default for WindowSettings {
    fn default() -> Self {
        Self {
            is_dark: true,
            side: Side::Live,
            below: Below::Curves,
            shows_cameras: true,
            instrument: "config/virtual.toml".to_owned(),
            scale: 1.0,
        }
    }
}
