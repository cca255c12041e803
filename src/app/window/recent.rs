//! Recordings and results of earlier sessions, remembered beside the settings of the user.
//!
//! In: directories that were written. Out: the newest of them that are still there.
//! Never: fails a run because it cannot be remembered. Fails: not at all; a list that cannot be read is empty.

use std::path::{Path, PathBuf};

/// Directories that are remembered.
const MOST: usize = 20;

/// The remembered directories, newest first.
pub(super) fn remembered() -> Vec<PathBuf> {
    let text = file().and_then(|file| std::fs::read_to_string(file).ok()).unwrap_or_default();
    text.lines().map(PathBuf::from).filter(|path| path.is_dir()).take(MOST).collect()
}

/// The list with one more directory, which is also written down.
pub(super) fn remember(before: &[PathBuf], directory: &Path) -> Vec<PathBuf> {
    let older = before.iter().filter(|path| *path != directory).cloned();
    let list: Vec<PathBuf> = std::iter::once(directory.to_owned()).chain(older).take(MOST).collect();
    let text: String = list.iter().map(|path| format!("{}\n", path.display())).collect();
    if let Some(file) = file() {
        let written =
            file.parent().map_or(Ok(()), std::fs::create_dir_all).and_then(|()| std::fs::write(&file, text));
        if let Err(error) = written {
            tracing::warn!("{}: {error}; recent recordings are not remembered", file.display());
        }
    }
    list
}

fn file() -> Option<PathBuf> {
    let home = || std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".local/share"));
    let data = std::env::var_os("XDG_DATA_HOME").map(PathBuf::from).or_else(home)?;
    Some(data.join("sofiscope/recent"))
}
