//! What the disk can take: a short trial before a run.
//!
//! In: where the recording will be. Out: bytes per second of large direct writes.
//! Never: leaves the trial behind. Fails: [`RecordingError`] in the words of the disk.

use super::RecordingError;
use super::direct::{Aligned, DirectFile};
use super::gate::Gate;
use std::fs;
use std::path::Path;
use std::time::Instant;

/// Bytes of one write, as large as a group of frames.
const WRITE_BYTES: usize = 8 << 20;

/// Writes `bytes` beside where `directory` is to be, as a recording would, and says how fast that went.
///
/// # Errors
/// [`RecordingError::Storage`] when the disk refuses.
pub fn disk_rate(directory: &Path, bytes: u64) -> Result<f64, RecordingError> {
    let absolute = std::path::absolute(directory)
        .map_err(|source| RecordingError::storage(directory, "look up", source))?;
    let existing = absolute.ancestors().find(|ancestor| ancestor.is_dir()).unwrap_or(Path::new("/"));
    let path = existing.join(format!(".sofiscope-trial-{}", std::process::id()));
    let rate = trial(&path, bytes.max(WRITE_BYTES as u64));
    let removed = fs::remove_file(&path);
    let rate = rate?;
    removed.map_err(|source| RecordingError::storage(&path, "remove", source))?;
    Ok(rate)
}

fn trial(path: &Path, bytes: u64) -> Result<f64, RecordingError> {
    let buffer = Aligned::zeroed(WRITE_BYTES);
    let mut file = DirectFile::create(path, Gate::default())?;
    file.reserve(bytes, bytes);
    let begun = Instant::now();
    let mut offset = 0;
    while offset < bytes {
        file.write(&[buffer.bytes()], offset)?;
        offset += WRITE_BYTES as u64;
    }
    Ok(offset as f64 / begun.elapsed().as_secs_f64().max(1e-9))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_trial_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let rate = disk_rate(&folder.path().join("not/yet"), 16 << 20).unwrap();
        assert!(rate > 0.0);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
