//! What an engine must know before the first exposure.

use crate::sofi::camera::CameraMaps;
use crate::sofi::grid::{Combinations, GridError, VirtualPixelGrid};
use crate::sofi::registration::{RegistrationSettings, TransformError};
use std::sync::Arc;

/// Most channels that one engine takes.
const MOST_CHANNELS: usize = 4;

/// Settings of a cumulant engine.
#[derive(Debug, Clone, PartialEq)]
pub struct CumulantSettings {
    /// Cumulant order, 2 to 6.
    pub order: usize,
    /// Number of physical channels, 1 to 4.
    pub channels: usize,
    /// Exposures per subsequence, at least 2.
    pub subsequence: u64,
    /// The rule that chooses pixel sets.
    pub combinations: Combinations,
    /// Exposures by which the j-th pixel of every set, in row-major order, is delayed; empty for none.
    pub lags: Vec<u64>,
    /// Exposure at which the stream begins; exposures before it belong to somebody else's state.
    pub first_exposure: u64,
    /// How the second of two channels is brought onto the first; `None` where they come aligned.
    pub registration: Option<RegistrationSettings>,
    /// What is known of the pixels of each channel's camera, as it gives them: broken ones are left out of everything,
    /// and noise that a registration shares among neighbors is that of each pixel. Empty where nothing is known.
    pub cameras: Vec<Option<Arc<CameraMaps>>>,
}

/// Why settings cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// The grid refuses order or combinations.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// Too few or too many channels.
    #[error("{0} channels cannot be analyzed together; take 1 to 4")]
    Channels(usize),
    /// Registration is between two cameras.
    #[error("a registration needs two cameras, and {0} are analyzed; leave it out")]
    RegisteredChannels(usize),
    /// The registration cannot be used.
    #[error(transparent)]
    Registration(#[from] TransformError),
    /// A subsequence has no variance with fewer than two exposures.
    #[error("a subsequence of {0} exposures is too short; take at least 2, in practice 100 to 500")]
    Subsequence(u64),
    /// The number of lags is not the order.
    #[error("{lags} time lags were given for order {order}; give one per pixel of the tuple, or none")]
    Lags {
        /// Number of lags given.
        lags: usize,
        /// The cumulant order.
        order: usize,
    },
    /// A lag spans a whole subsequence.
    #[error("time lags that span {span} exposures do not fit into subsequences of {subsequence}")]
    LagSpan {
        /// Largest difference between lags, in exposures.
        span: u64,
        /// Exposures per subsequence.
        subsequence: u64,
    },
    /// Camera maps for another number of cameras.
    #[error("maps of {0} cameras were given for {1} channels; give one per camera")]
    Cameras(usize, usize),
    /// Camera maps of another size.
    #[error(
        "the maps of a camera are of {} x {} pixels and its frames of {} x {}; use the region of the calibration \
         or calibrate again",
        made_for[1], made_for[0], frames[1], frames[0]
    )]
    MapSize {
        /// Height and width of the maps.
        made_for: [usize; 2],
        /// Height and width of the frames.
        frames: [usize; 2],
    },
    /// The images have no inner pixel.
    #[error("images of {width} x {height} pixels are too small; order {order} needs at least 4 x 4")]
    Size {
        /// Height in pixels.
        height: usize,
        /// Width in pixels.
        width: usize,
        /// The cumulant order.
        order: usize,
    },
}

impl CumulantSettings {
    /// Settings without lags, with all closest combinations, beginning at exposure 0.
    #[must_use]
    pub fn new(order: usize, channels: usize, subsequence: u64) -> Self {
        let combinations = Combinations::default();
        Self {
            order,
            channels,
            subsequence,
            combinations,
            lags: Vec::new(),
            first_exposure: 0,
            registration: None,
            cameras: Vec::new(),
        }
    }

    /// The virtual-pixel grid of these settings.
    ///
    /// # Errors
    /// [`SettingsError`] for the first setting that cannot be used.
    pub fn checked_grid(&self) -> Result<VirtualPixelGrid, SettingsError> {
        let grid = VirtualPixelGrid::new(self.order, self.combinations)?;
        if !(1..=MOST_CHANNELS).contains(&self.channels) {
            return Err(SettingsError::Channels(self.channels));
        }
        if self.registration.is_some() && self.channels != 2 {
            return Err(SettingsError::RegisteredChannels(self.channels));
        }
        if !self.cameras.is_empty() && self.cameras.len() != self.channels {
            return Err(SettingsError::Cameras(self.cameras.len(), self.channels));
        }
        if self.subsequence < 2 {
            return Err(SettingsError::Subsequence(self.subsequence));
        }
        if !self.lags.is_empty() && self.lags.len() != self.order {
            return Err(SettingsError::Lags { lags: self.lags.len(), order: self.order });
        }
        let span = self.lag_span();
        if span + 1 >= self.subsequence {
            return Err(SettingsError::LagSpan { span, subsequence: self.subsequence });
        }
        Ok(grid)
    }

    /// What is known of the pixels of a channel's camera.
    #[must_use]
    pub fn camera(&self, channel: usize) -> Option<&Arc<CameraMaps>> {
        self.cameras.get(channel)?.as_ref()
    }

    /// Largest difference between lags, in exposures.
    pub(super) fn lag_span(&self) -> u64 {
        let shortest = self.lags.iter().min().copied().unwrap_or_default();
        self.lags.iter().max().map_or(0, |longest| longest - shortest)
    }

    /// The lags with the shortest at zero.
    pub(super) fn relative_lags(&self) -> Vec<u64> {
        let shortest = self.lags.iter().min().copied().unwrap_or_default();
        self.lags.iter().map(|lag| lag - shortest).collect()
    }
}
