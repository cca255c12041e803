//! The one place that every change of a file passes, so that tests can make it fail or write it down.
//!
//! In: what is about to be done, and what has been done. Out: leave to do it.
//! Never: changes anything itself; without a test it costs one look at an option. Fails: as the test says.

use std::io;
use std::path::Path;
use std::sync::Arc;

/// What is about to be done to a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Operation {
    /// Writing bytes, creating or renaming a file.
    Write,
    /// Making it durable.
    Sync,
}

/// What has been done to a file or directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change<'a> {
    /// A new file without bytes.
    Created,
    /// A new directory without entries.
    Directory,
    /// Bytes from an offset on.
    Bytes(u64, &'a [u8]),
    /// Another length.
    Length(u64),
    /// Removed.
    Removed,
    /// Everything done before the sync began is durable.
    Synced,
}

/// Sees every change before it is made, and may refuse it, and afterwards.
pub(super) trait Watch: Send + Sync {
    fn before(&self, operation: Operation, path: &Path) -> io::Result<()>;

    fn after(&self, _change: Change<'_>, _path: &Path) {}
}

impl<F: Fn(Operation, &Path) -> io::Result<()> + Send + Sync> Watch for F {
    fn before(&self, operation: Operation, path: &Path) -> io::Result<()> {
        self(operation, path)
    }
}

/// The gate; open to everything unless somebody watches.
#[derive(Clone, Default)]
pub(super) struct Gate(Option<Arc<dyn Watch>>);

impl Gate {
    #[cfg(test)]
    pub(super) fn new(watch: impl Watch + 'static) -> Self {
        Self(Some(Arc::new(watch)))
    }

    #[cfg(test)]
    pub(super) fn shared(watch: Arc<dyn Watch>) -> Self {
        Self(Some(watch))
    }

    pub(super) fn pass(&self, operation: Operation, path: &Path) -> io::Result<()> {
        self.0.as_ref().map_or(Ok(()), |watch| watch.before(operation, path))
    }

    pub(super) fn note(&self, change: Change<'_>, path: &Path) {
        if let Some(watch) = &self.0 {
            watch.after(change, path);
        }
    }
}

impl std::fmt::Debug for Gate {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("Gate")
    }
}
