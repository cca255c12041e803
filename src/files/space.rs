//! Room on the disk, asked before anything long is written.
//!
//! In: a path that need not exist yet. Out: bytes free for this user on its disk.
//! Never: writes. Fails: [`FileError`] when the disk cannot be asked or has too little room.

use std::path::Path;

use super::{FileError, Space};

/// Bytes that this user may still write on the disk that holds `path` or its nearest existing parent.
///
/// # Errors
/// [`FileError::Io`] and its kin when the file system does not answer.
pub fn free_bytes(path: &Path) -> Result<u64, FileError> {
    let absolute = std::path::absolute(path).map_err(|source| FileError::from_io(path, "look up", source))?;
    let existing = absolute.ancestors().find(|ancestor| ancestor.exists()).unwrap_or(Path::new("/"));
    let disk = rustix::fs::statvfs(existing)
        .map_err(|errno| FileError::from_io(path, "ask the free space of", errno.into()))?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// Refuses when fewer than `needed_bytes` are free where `path` is to be written.
///
/// # Errors
/// [`FileError::DiskFull`] with the bytes needed and free; else as [`free_bytes`].
pub fn ensure_free(path: &Path, needed_bytes: u64) -> Result<(), FileError> {
    let free = free_bytes(path)?;
    if free >= needed_bytes {
        return Ok(());
    }
    Err(FileError::DiskFull {
        path: path.to_path_buf(),
        space: Space { needed_bytes: Some(needed_bytes), free_bytes: Some(free) },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_that_does_not_exist_yet_has_the_space_of_its_parent() {
        let folder = tempfile::tempdir().unwrap();
        let free = free_bytes(&folder.path().join("not/yet/there")).unwrap();
        assert!(free > 0);
    }

    #[test]
    fn too_little_space_is_said_with_both_numbers() {
        let folder = tempfile::tempdir().unwrap();
        ensure_free(folder.path(), 0).unwrap();
        let said = ensure_free(folder.path(), u64::MAX).unwrap_err().to_string();
        assert!(said.contains("needed") && said.contains("free"), "{said}");
    }
}
