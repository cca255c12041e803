//! An output directory that appears whole or not at all.
//!
//! In: the path that the results shall have. Out: a hidden sibling directory to write into, renamed at the end.
//! Never: touches what exists already, but for what a killed program left of the same output; leaves a partial result
//! that looks whole.
//! Fails: [`FileError`] when the path is taken, its parent is missing or the disk refuses.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::FileError;
use rustix::process::{Pid, test_kill_process};

/// How many partial directories of one name and process may exist at a time.
const MAX_PARTIAL: u32 = 100;

/// Results under way; dropped without [`commit`](OutputDirectory::commit), they are removed.
#[derive(Debug)]
pub struct OutputDirectory {
    target: PathBuf,
    parent: PathBuf,
    partial: Option<PathBuf>,
}

impl OutputDirectory {
    /// Starts an output that will be named `target`; an empty directory of that name may exist.
    ///
    /// # Errors
    /// [`FileError::OutputExists`] when `target` is taken, [`FileError::OutputRefused`] when its parent is missing
    /// or the disk is read-only, [`FileError::Denied`], [`FileError::DiskFull`].
    pub fn create(target: &Path) -> Result<OutputDirectory, FileError> {
        let absolute =
            std::path::absolute(target).map_err(|source| FileError::from_io(target, "look up", source))?;
        let (Some(parent), Some(name)) = (absolute.parent(), absolute.file_name()) else {
            return Err(refused(target, "it has no name of its own"));
        };
        ensure_vacant(target)?;
        if !parent.is_dir() {
            let reason = format!("the directory {} does not exist", parent.display());
            return Err(refused(target, &reason));
        }
        remove_abandoned(parent, &name.to_string_lossy());
        let stem = format!(".{}.partial-{}", name.to_string_lossy(), std::process::id());
        let partial = create_partial(target, parent, &stem)?;
        Ok(OutputDirectory { target: absolute.clone(), parent: parent.to_path_buf(), partial: Some(partial) })
    }

    /// The path that the results will have after [`commit`](OutputDirectory::commit).
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// The directory to write into meanwhile.
    pub fn directory(&self) -> &Path {
        self.partial.as_deref().unwrap_or(&self.target)
    }

    /// Where to write the result file `name` meanwhile.
    pub fn file(&self, name: &str) -> PathBuf {
        self.directory().join(name)
    }

    /// Writes everything through to the disk and gives the directory its final name, which is returned.
    ///
    /// # Errors
    /// As [`create`](OutputDirectory::create); the partial results are removed then.
    pub fn commit(mut self) -> Result<PathBuf, FileError> {
        let partial = self.directory().to_path_buf();
        sync_tree(&partial)?;
        fs::rename(&partial, &self.target).map_err(|source| match source.kind() {
            io::ErrorKind::DirectoryNotEmpty
            | io::ErrorKind::AlreadyExists
            | io::ErrorKind::NotADirectory => FileError::OutputExists { path: self.target.clone() },
            _ => FileError::from_io(&self.target, "create", source),
        })?;
        self.partial = None;
        sync(&self.parent)?;
        Ok(self.target.clone())
    }
}

impl Drop for OutputDirectory {
    fn drop(&mut self) {
        let Some(partial) = &self.partial else {
            return;
        };
        if let Err(error) = fs::remove_dir_all(partial) {
            tracing::warn!(path = %partial.display(), %error, "partial output could not be removed");
        }
    }
}

fn refused(path: &Path, reason: &str) -> FileError {
    FileError::OutputRefused { path: path.to_path_buf(), reason: reason.to_owned() }
}

/// Nothing or an empty directory may be at `target`; a link is something.
fn ensure_vacant(target: &Path) -> Result<(), FileError> {
    let taken = || FileError::OutputExists { path: target.to_path_buf() };
    match fs::symlink_metadata(target) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::NotADirectory => {
            Err(refused(target, "a part of its path is a file"))
        }
        Err(error) => Err(FileError::from_io(target, "look up", error)),
        Ok(metadata) if !metadata.is_dir() => Err(taken()),
        Ok(_) => {
            let mut entries =
                fs::read_dir(target).map_err(|source| FileError::from_io(target, "read", source))?;
            entries.next().map_or(Ok(()), |_| Err(taken()))
        }
    }
}

/// Removes what programs that were killed left of this output; what cannot be removed stays.
fn remove_abandoned(parent: &Path, name: &str) {
    let prefix = format!(".{name}.partial-");
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let found = entry.file_name();
        let owner = found.to_str().and_then(|found| found.strip_prefix(&prefix)).and_then(owner_of);
        let is_directory = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_directory && owner.is_some_and(is_gone) {
            let path = entry.path();
            match fs::remove_dir_all(&path) {
                Ok(()) => tracing::info!(path = %path.display(), "removed what a killed program left"),
                Err(error) => {
                    tracing::warn!(path = %path.display(), %error, "an abandoned output could not be removed");
                }
            }
        }
    }
}

/// The process that writes `PID` or `PID-ATTEMPT`.
fn owner_of(rest: &str) -> Option<Pid> {
    let (number, attempt) = rest.split_once('-').unwrap_or((rest, "0"));
    attempt.parse::<u32>().ok()?;
    Pid::from_raw(number.parse().ok().filter(|&number| number > 0)?)
}

fn is_gone(process: Pid) -> bool {
    test_kill_process(process) == Err(rustix::io::Errno::SRCH)
}

fn create_partial(target: &Path, parent: &Path, stem: &str) -> Result<PathBuf, FileError> {
    for attempt in 0..MAX_PARTIAL {
        let partial = match attempt {
            0 => parent.join(stem),
            _ => parent.join(format!("{stem}-{attempt}")),
        };
        match fs::create_dir(&partial) {
            Ok(()) => return Ok(partial),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
                return Err(FileError::Denied { path: parent.to_path_buf(), action: "write into" });
            }
            Err(error) => return Err(FileError::from_io(target, "create", error)),
        }
    }
    let reason = format!("{MAX_PARTIAL} unfinished outputs {stem} are beside it; remove them");
    Err(refused(target, &reason))
}

fn sync_tree(directory: &Path) -> Result<(), FileError> {
    let entries = fs::read_dir(directory).map_err(|source| FileError::from_io(directory, "read", source))?;
    for entry in entries {
        let path = entry.map_err(|source| FileError::from_io(directory, "read", source))?.path();
        match fs::symlink_metadata(&path) {
            Ok(metadata) if metadata.is_dir() => sync_tree(&path)?,
            Ok(metadata) if metadata.is_file() => sync(&path)?,
            Ok(_) => {}
            Err(source) => return Err(FileError::from_io(&path, "look up", source)),
        }
    }
    sync(directory)
}

fn sync(path: &Path) -> Result<(), FileError> {
    File::open(path)
        .and_then(|file| file.sync_all())
        .map_err(|source| FileError::from_io(path, "write", source))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_killed_program_left_is_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let mut child = std::process::Command::new("true").spawn().unwrap();
        let (dead, alive) = (child.id(), std::process::id());
        child.wait().unwrap();
        let abandoned = [format!(".result.partial-{dead}"), format!(".result.partial-{dead}-3")];
        let kept = [
            format!(".result.partial-{alive}-7"),
            format!(".result2.partial-{dead}"),
            ".result.partial-notes".to_owned(),
            format!(".result.partial-{dead}.txt"),
        ];
        for name in abandoned.iter().chain(&kept) {
            fs::create_dir(folder.path().join(name)).unwrap();
            fs::write(folder.path().join(name).join("unmixed.ome.tif"), "half").unwrap();
        }
        OutputDirectory::create(&folder.path().join("result")).unwrap().commit().unwrap();
        assert!(abandoned.iter().all(|name| !folder.path().join(name).exists()));
        assert!(kept.iter().all(|name| folder.path().join(name).exists()));
    }
}
