//! Small text files: settings, scenes, truths.
//!
//! In: a path. Out: its text. Never: more memory than the limit. Fails: [`AppError`] that names the file.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::AppError;
use crate::files::FileError;

/// Reads a text of at most `max_bytes`.
///
/// # Errors
/// A usage error for a path that cannot be read, that is longer, or whose bytes are no UTF-8.
pub(super) fn read_text(path: &Path, max_bytes: u64) -> Result<String, AppError> {
    let mut bytes = Vec::new();
    open_file(path)?
        .take(max_bytes + 1)
        .read_to_end(&mut bytes)
        .map_err(|source| FileError::from_io(path, "read", source))?;
    if bytes.len() as u64 > max_bytes {
        let limit = max_bytes >> 10;
        return Err(AppError::usage(format!(
            "{} is longer than {limit} KiB, so it is not the file that was meant. Check the path.",
            path.display()
        )));
    }
    String::from_utf8(bytes).map_err(|error| {
        let line =
            1 + error.as_bytes()[..error.utf8_error().valid_up_to()].iter().filter(|b| **b == b'\n').count();
        AppError::usage(format!(
            "{}, line {line}: not UTF-8 text. Save the file as UTF-8 or check the path.",
            path.display()
        ))
    })
}

/// Opens regular files only, as reading a pipe or a device might never end.
fn open_file(path: &Path) -> Result<File, AppError> {
    let metadata = std::fs::metadata(path).map_err(|source| FileError::from_io(path, "look up", source))?;
    if !metadata.is_file() {
        let found = if metadata.is_dir() { "a directory" } else { "a pipe or device" };
        return Err(AppError::usage(format!("{} is {found}, not a file. Name a text file.", path.display())));
    }
    Ok(File::open(path).map_err(|source| FileError::from_io(path, "read", source))?)
}
