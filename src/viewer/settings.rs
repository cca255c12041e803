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
    /// All of them with their names.
    pub const ALL: [(Self, &'static str); 5] = [
        (Self::Live, "Live view"),
        (Self::Plan, "Plan"),
        (Self::Devices, "Instrument"),
        (Self::Align, "Align"),
        (Self::Replay, "Replay"),
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
    /// All of them with their names.
    pub const ALL: [(Self, &'static str); 4] = [
        (Self::Curves, "Curves"),
        (Self::Histogram, "Histogram"),
        (Self::Profile, "Profile"),
        (Self::Events, "Events"),
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
