//! Frame pairs and provenance to disk, lossless or loudly not; and back.
//!
//! ```text
//! ExposureRecord ─► Recording ─┬─► reflection, transmission: OME-TIFF or OME-Zarr, committed as they come, or in groups
//!                              ├─► ledger.csv: one row per exposure of each camera
//!                              └─► events.jsonl, recording.json, provenance
//! directory ─► open ─► RecordedRun ─► frames and rows      recover: after a crash      export: to the other format
//! ```
//!
//! In: every exposure once, in order. Out: a directory that opens in stock readers at any moment, and its reader.
//! Never: promises a frame that is not there, overwrites anything, starts a thread but the one that syncs, for the time of one group one per camera, and one for the end.
//! Fails: [`RecordingError`] with path, free bytes and remedy; what was committed stays readable,
//! and what could not be written is in the ledger as lost.
//!
//! A commit writes pixels, then the pointer that makes readers see them, then the rows of the ledger.

mod appended;
mod begin;
mod direct;
mod ending;
mod error;
mod events;
mod export;
mod facts;
mod finish;
mod gate;
mod group;
mod ledger_file;
mod lock;
mod merge;
mod metadata;
mod presence;
mod reader;
mod recorder;
mod recover;
mod summary;
mod sync;
mod tiff;
mod tiff_pages;
mod trial;
mod writer;
mod zarr;
mod zarr_pages;

#[cfg(test)]
mod fault_tests;
#[cfg(test)]
mod power_loss_tests;

pub use error::RecordingError;
pub use events::{Event, StopRecord, StopStatus};
pub use export::export;
pub use metadata::{CameraDescription, Format, Metadata, RecordingPlan};
pub use reader::{LedgerRows, RecordedRun, open};
pub use recorder::{Recording, SpaceLeft};
pub use recover::{Outcome, RecoverReport, recover};
pub use summary::RecordingSummary;
pub use trial::disk_rate;
