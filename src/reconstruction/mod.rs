//! Exposures to images: runs the mathematics of [`sofi`](crate::sofi) on all cores.
//!
//! In: blocks of exposures from a file, a simulator or cameras. Out: every stage from cumulants to linearized images.
//! Never: opens a file, draws a picture, holds more than two blocks of frames.
//! Fails: [`ReconstructionError`], which names the stage and what to change.

mod chain;
mod feed;
mod live;
mod look;
mod preview;
mod quality;
mod workers;

pub use chain::{
    ChainSettings, FlatteningKind, ReconstructionError, Stages, finish_species, reconstruct, unmix,
};
pub use feed::{BLOCK, Feed, FeedError, feed};
pub use live::{LiveAnalysis, LiveReport};
pub use look::{CameraLook, HISTOGRAM_BINS, OneCamera, PixelMap, SofiLook, SofiStage, StageImage};
pub use preview::{Preview, PreviewLink, PreviewReport, PreviewSettings, Shown, Snapshot, preview};
pub use quality::{
    BleachingState, CENTRAL_SIDE, CameraDrift, LagCheck, MOST_DRIFT_PX, Quality, QualityError,
    QualityMonitor, QualitySettings, Resolution,
};
pub use workers::AllCores;
