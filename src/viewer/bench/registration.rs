//! The registration of the cameras, as the window sees it and asks for it.
//!
//! In: nothing. Out: [`RegistrationAsk`], [`RegistrationStatus`]. Never: holds frames. Fails: not at all.

use crate::display::RgbImage;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// What shows where camera R sees what camera T sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum RegisterBy {
    /// Beads that both cameras see.
    #[default]
    Beads,
    /// What blinks together in any sample.
    Blinking,
}

/// What can be asked of the registration.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum RegistrationAsk {
    /// Take frames of the live view and find the registration from them.
    Begin {
        /// From what.
        by: RegisterBy,
        /// Frames of both cameras, at least 2.
        frames: usize,
    },
    /// Take what was found for the next live view and run, and write it into a file that must not exist yet.
    Use(PathBuf),
    /// Leave everything as it was before.
    Discard,
    /// The next live view and run go by the instrument's file again.
    Forget,
}

/// How the registration stands.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct RegistrationStatus {
    /// What is under way, or what was found and neither used nor discarded.
    pub step: RegistrationStep,
    /// What the next live view and run go by, for people; none for cameras that are taken as aligned.
    pub in_use: Option<String>,
    /// Whether that is of this session, not of the instrument's file.
    pub is_of_session: bool,
}

/// A step of the procedure.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub enum RegistrationStep {
    /// Nothing is under way.
    #[default]
    Idle,
    /// Frames are taken.
    Gathering {
        /// So many so far.
        taken: usize,
        /// Of so many.
        wanted: usize,
    },
    /// The registration is worked out.
    Working,
    /// It could not be found: why, and what to do.
    Failed(String),
    /// It was found.
    Found(Arc<FoundRegistration>),
}

/// A registration that was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FoundRegistration {
    /// From what.
    pub by: RegisterBy,
    /// "none", "horizontal", "vertical", "both".
    pub mirror: String,
    /// Shift of the middle of the field, `[y, x]`, camera pixels.
    pub shift_px: [f64; 2],
    /// Degrees.
    pub rotation_deg: f64,
    /// Of T onto R.
    pub scale: f64,
    /// Root mean square of the distances between partners, nanometers.
    pub residual_nm: f64,
    /// Beads or patches that it was made of.
    pub points: usize,
    /// Those that did not fit.
    pub points_left_out: usize,
    /// What people must know before they use it.
    pub warnings: Vec<String>,
    /// Mean of camera R with a stroke for the residual of every point.
    pub residual_map: Arc<RgbImage>,
}
