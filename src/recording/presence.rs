//! Whether a recording under way is still where it was created.
//!
//! In: the paths of its directory and files. Out: nothing while they are the same.
//! Never: opens or changes a file. Fails: [`RecordingError::Gone`] with the first that was deleted, renamed or unmounted.

use super::RecordingError;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The paths and what they named when the recording began.
#[derive(Debug)]
pub(super) struct Presence(Vec<(PathBuf, Identity)>);

/// Device and number of the file on it.
type Identity = (u64, u64);

impl Presence {
    pub(super) fn of(paths: impl IntoIterator<Item = PathBuf>) -> Result<Self, RecordingError> {
        let known = |path: PathBuf| match identity(&path) {
            Ok(found) => Ok((path, found)),
            Err(source) => Err(RecordingError::storage(&path, "find", source)),
        };
        paths.into_iter().map(known).collect::<Result<_, _>>().map(Self)
    }

    pub(super) fn ensure(&self) -> Result<(), RecordingError> {
        let is_gone = |path: &Path, then: &Identity| match identity(path) {
            Ok(now) => now != *then,
            Err(error) => {
                matches!(error.kind(), std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory)
            }
        };
        match self.0.iter().find(|(path, then)| is_gone(path, then)) {
            Some((path, _)) => Err(RecordingError::Gone { path: path.clone() }),
            None => Ok(()),
        }
    }
}

fn identity(path: &Path) -> std::io::Result<Identity> {
    std::fs::metadata(path).map(|metadata| (metadata.dev(), metadata.ino()))
}
