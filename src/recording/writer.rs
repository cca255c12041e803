//! The images of one camera under way, whatever their format.
//!
//! In: groups of frames. Out: files, staged first and published when the pixels of both cameras are there.
//! Never: decides what a failure means. Fails: [`RecordingError`]; what was published stays.

use super::RecordingError;
use super::direct::{Aligned, DirectFile, PAGE};
use super::facts::FactsBytes;
use super::gate::Gate;
use super::metadata::{Format, Metadata};
use super::sync::SyncFile;
use super::tiff::TiffFile;
use super::zarr::ZarrArray;
use sofiscope_hal::Channel;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Frames that are no whole pages are copied in portions of about this size.
const BOUNCE_BYTES: usize = 1 << 20;

/// The images of one camera.
#[derive(Debug)]
pub(super) enum ImageWriter {
    Tiff { file: TiffFile, sync: SyncFile },
    Zarr(ZarrArray),
}

impl ImageWriter {
    pub(super) fn create(
        directory: &Path,
        metadata: &Metadata,
        channel: Channel,
        gate: Gate,
    ) -> Result<Self, RecordingError> {
        let path = directory.join(metadata.image_name(channel));
        let camera = &metadata.cameras[channel.index()];
        match metadata.format {
            Format::OmeTiff => {
                let file = TiffFile::create(&path, camera, metadata.planned_exposures, gate)?;
                Ok(Self::Tiff { file, sync: sync_file(&path)? })
            }
            Format::OmeZarr => ZarrArray::create(&path, camera, gate).map(Self::Zarr),
        }
    }

    /// Writes the pixels of a group; readers do not see them yet.
    pub(super) fn stage(&mut self, group: &[&[u8]]) -> Result<(), RecordingError> {
        match self {
            Self::Tiff { file, .. } => file.stage(group),
            Self::Zarr(array) => array.stage(group),
        }
    }

    /// Makes readers see the staged group, with the facts of each frame.
    pub(super) fn publish(&mut self, facts: &[FactsBytes]) -> Result<(), RecordingError> {
        match self {
            Self::Tiff { file, .. } => file.publish(facts),
            Self::Zarr(array) => array.publish(facts),
        }
    }

    pub(super) fn cut(&mut self) -> Result<(), RecordingError> {
        match self {
            Self::Tiff { file, .. } => file.cut(),
            Self::Zarr(array) => array.cut(),
        }
    }

    pub(super) fn pages(&self) -> u64 {
        match self {
            Self::Tiff { file, .. } => file.pages(),
            Self::Zarr(array) => array.pages(),
        }
    }

    pub(super) fn bytes(&self) -> u64 {
        match self {
            Self::Tiff { file, .. } => file.bytes(),
            Self::Zarr(array) => array.bytes(),
        }
    }

    /// Bytes reserved on the disk and not written yet.
    pub(super) fn reserve(&self) -> u64 {
        match self {
            Self::Tiff { file, .. } => file.reserve(),
            Self::Zarr(array) => array.reserve(),
        }
    }

    pub(super) fn path(&self) -> PathBuf {
        match self {
            Self::Tiff { file, .. } => file.path().to_path_buf(),
            Self::Zarr(array) => array.path().to_path_buf(),
        }
    }

    /// Files with data that is not known to be durable.
    pub(super) fn sync_files(&self) -> Vec<SyncFile> {
        match self {
            Self::Tiff { sync, .. } => vec![Arc::clone(sync)],
            Self::Zarr(array) => array.sync_files(),
        }
    }

    /// Says that all of them have been handed over for syncing.
    pub(super) fn sync_requested(&mut self) {
        if let Self::Zarr(array) = self {
            array.sync_requested();
        }
    }
}

/// A descriptor of its own, so that it hears of every failure since now.
pub(super) fn sync_file(path: &Path) -> Result<SyncFile, RecordingError> {
    let file = File::open(path).map_err(|source| RecordingError::storage(path, "open", source))?;
    Ok(Arc::new((path.to_path_buf(), file)))
}

/// Memory for frames that are no whole pages; empty for those that are.
#[derive(Debug)]
pub(super) struct Bounce {
    memory: Aligned,
    stride: usize,
}

impl Bounce {
    pub(super) fn for_frames(frame_bytes: usize) -> Self {
        let stride = frame_bytes.next_multiple_of(PAGE);
        let len = if stride == frame_bytes { 0 } else { (BOUNCE_BYTES / stride).max(1) * stride };
        Self { memory: Aligned::zeroed(len), stride }
    }
}

/// Writes frames, each at the begin of a page.
pub(super) fn write_frames(
    file: &mut DirectFile,
    frames: &[&[u8]],
    offset: u64,
    bounce: &mut Bounce,
) -> Result<(), RecordingError> {
    if bounce.memory.bytes().is_empty() {
        return file.write(frames, offset);
    }
    let mut at = offset;
    for portion in frames.chunks(bounce.memory.bytes().len() / bounce.stride) {
        let len = portion.len() * bounce.stride;
        let places = bounce.memory.bytes_mut().chunks_exact_mut(bounce.stride);
        for (place, frame) in places.zip(portion) {
            place[..frame.len()].copy_from_slice(frame);
        }
        file.write(&[&bounce.memory.bytes()[..len]], at)?;
        at += len as u64;
    }
    Ok(())
}
