//! Where the data path leaves what a window shows: newest values, swapped in whole.
//!
//! In: looks and numbers from the threads of the data path. Out: the newest of each, to any number of lookers.
//! Never: waits, holds memory of the frame pool. Fails: not at all.

use crate::acquisition::Progress;
use crate::reconstruction::{CameraLook, Quality, SofiLook};
use arc_swap::{ArcSwap, ArcSwapOption};
use std::sync::Arc;
use std::time::Duration;

/// The newest of everything.
#[derive(Debug, Default)]
pub(in crate::app) struct Board {
    /// Both cameras.
    pub(in crate::app) cameras: ArcSwapOption<CameraLook>,
    /// The running result.
    pub(in crate::app) sofi: ArcSwapOption<SofiLook>,
    /// Numbers of the series under way.
    pub(in crate::app) numbers: ArcSwap<PathNumbers>,
}

impl Board {
    /// Nothing of an earlier series is left.
    pub(super) fn clear(&self) {
        self.cameras.store(None);
        self.sofi.store(None);
        self.numbers.store(Arc::default());
    }
}

/// Numbers of the series under way, as the data path knows them.
#[derive(Debug, Clone, Default)]
pub(in crate::app) struct PathNumbers {
    /// The books so far.
    pub(in crate::app) progress: Progress,
    /// Frames of each camera, usable or not.
    pub(in crate::app) frames: [u64; 2],
    /// From the last frame of the newest picture to the picture.
    pub(in crate::app) latency: Duration,
    /// How good the result is after the newest subsequence.
    pub(in crate::app) quality: Option<Arc<Quality>>,
}

/// What looks at a data path: the board, and what the cameras' pixels mean.
#[derive(Debug, Clone)]
pub(in crate::app) struct Onlooker {
    /// Where everything goes.
    pub(in crate::app) board: Arc<Board>,
    /// Shortest time between two looks at the cameras.
    pub(in crate::app) every: Duration,
    /// Counts from which on pixels are saturated, R and T.
    pub(in crate::app) saturation_counts: [u16; 2],
}
