//! How the dyes divide between the cameras, as the window sees it and asks for it.
//!
//! In: nothing. Out: [`ColorsAsk`], [`ColorsStatus`]. Never: holds frames. Fails: not at all.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// Where a dye is and where nothing is, in pixels of the sensor of camera R: left, top, width, height.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct MarkedRegions {
    /// Only the one dye is there.
    pub dye: Vec<[u32; 4]>,
    /// No dye is there; none for what surrounds the dye within its regions.
    pub background: Option<[u32; 4]>,
}

/// What can be asked of the colors.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum ColorsAsk {
    /// Take frames of the live view and find the share of a dye's light that reaches camera T.
    Begin {
        /// The dye, by its name.
        dye: String,
        /// Where it is.
        marked: MarkedRegions,
        /// Frames of both cameras, at least 4.
        frames: usize,
    },
    /// Take what was found for the next live view and run, and write it into a file that must not exist yet.
    Use(PathBuf),
    /// Leave everything as it was before.
    Discard,
    /// The next live view and run go by the instrument's own coefficients again.
    Forget,
}

/// How the colors stand.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ColorsStatus {
    /// What is under way, or what was found and neither used nor discarded.
    pub step: ColorsStep,
    /// What the next live view and run take for each dye of which a share is known.
    pub in_use: Arc<Vec<DyeInUse>>,
    /// Whether shares of this session are among them.
    pub is_of_session: bool,
}

/// The share of a dye's light that is in use.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DyeInUse {
    /// Its name.
    pub dye: String,
    /// Share that reaches camera T, 0 to 1.
    pub transmission: f64,
    /// Where that comes from, for people.
    pub from: String,
}

/// A step of the procedure.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub enum ColorsStep {
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
    /// The share is worked out.
    Working,
    /// It could not be found: why, and what to do.
    Failed(String),
    /// It was found.
    Found(Arc<FoundShare>),
}

/// A share that was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FoundShare {
    /// Of which dye.
    pub dye: String,
    /// Share of its light that reaches camera T, 0 to 1.
    pub transmission: f64,
    /// Half of the interval that holds the truth in 95 of 100 measurements.
    pub uncertainty: f64,
    /// What the live view that the frames are of goes by, if a share of this dye is known.
    pub in_use: Option<DyeInUse>,
    /// Frames of both cameras that it was made of.
    pub frames: usize,
    /// What people must know before they use it.
    pub warnings: Vec<String>,
}

impl FoundShare {
    /// Whether what is in use lies within the uncertainty; none where nothing is in use.
    #[must_use]
    pub fn agrees(&self) -> Option<bool> {
        let in_use = self.in_use.as_ref()?;
        Some((self.transmission - in_use.transmission).abs() <= self.uncertainty)
    }
}
