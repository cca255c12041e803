//! What comes before the first frame: room on the disk, and files that never change again.
//!
//! In: a plan, texts. Out: durable files. Never: overwrites. Fails: [`RecordingError`] with path and free bytes.

use super::RecordingError;
use super::gate::{Change, Gate, Operation};
use super::metadata::{RecordingPlan, stride};
use crate::files::free_bytes;
use std::fs;
use std::io::Write;
use std::path::Path;

/// Refuses a plan that does not fit with 5 % to spare.
pub(super) fn ensure_planned_space(plan: &RecordingPlan) -> Result<(), RecordingError> {
    let Some(planned) = plan.planned_exposures else { return Ok(()) };
    let per_exposure: u64 = plan.cameras.iter().map(stride).sum();
    let needed_bytes = planned.saturating_mul(per_exposure).saturating_mul(105) / 100;
    let free_bytes = free_bytes(&plan.directory)?;
    if free_bytes >= needed_bytes {
        return Ok(());
    }
    Err(RecordingError::Space { path: plan.directory.clone(), needed_bytes, free_bytes })
}

/// A durable file that did not exist.
pub(super) fn write_new(path: &Path, text: &str, gate: &Gate) -> Result<(), RecordingError> {
    gate.pass(Operation::Write, path)
        .and_then(|()| fs::OpenOptions::new().write(true).create_new(true).open(path))
        .and_then(|mut file| file.write_all(text.as_bytes()).and_then(|()| file.sync_all()))
        .map_err(|source| RecordingError::storage(path, "write", source))?;
    gate.note(Change::Created, path);
    gate.note(Change::Bytes(0, text.as_bytes()), path);
    gate.note(Change::Synced, path);
    Ok(())
}
