//! What all tests of the files room share.

use std::path::PathBuf;

use sofiscope::files::{FileError, FrameBuffer, ImageStack};
use tempfile::TempDir;

/// A folder with one file of the given bytes.
pub(crate) fn file_of(bytes: &[u8]) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stack.tif");
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

/// Opens a file and reads every frame of every channel.
pub(crate) fn read_all(path: &std::path::Path) -> Result<Vec<FrameBuffer>, FileError> {
    let mut stack = ImageStack::open(path)?;
    let mut frames = Vec::new();
    for channel in 0..stack.info().channels {
        stack.select_channel(channel)?;
        stack.seek(0)?;
        let mut frame = stack.info().buffer();
        while stack.read(&mut frame)? {
            frames.push(frame.clone());
        }
    }
    Ok(frames)
}

/// The bits of each sample of a frame, as the builder takes them.
pub(crate) fn bits(frame: &FrameBuffer) -> Vec<u32> {
    match frame {
        FrameBuffer::Counts(counts) => counts.iter().map(|count| u32::from(*count)).collect(),
        FrameBuffer::Values(values) => values.iter().map(|value| value.to_bits()).collect(),
    }
}
