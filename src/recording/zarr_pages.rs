//! The frames of a recorded Zarr array: as many as its shape names.
//!
//! In: a directory of ours, whole or under way. Out: pixels and facts of each frame.
//! Never: reads a shard whole. Fails: [`RecordingError`] with file and field.

use super::RecordingError;
use super::facts::{self, FACTS_BYTES, FactsBytes};
use super::metadata::{CameraDescription, read_text, stride};
use super::reader::checksum;
use super::tiff_pages::MAX_PAGES;
use super::zarr::{INDEX_BYTES, SHARD_FRAMES, array_metadata, facts_in, rewrite_shape, shard_path};
use sofiscope_hal::Channel;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

const MAX_METADATA_BYTES: u64 = 1 << 20;
const PAGE: usize = 4096;

/// An open array.
#[derive(Debug)]
pub(super) struct ZarrPages {
    directory: PathBuf,
    frame_bytes: u64,
    pages: u64,
    shard: Option<OpenShard>,
}

/// The shard read last, with its index.
#[derive(Debug)]
struct OpenShard {
    number: u64,
    path: PathBuf,
    file: File,
    first_page: Vec<u8>,
    len: u64,
}

impl ZarrPages {
    pub(super) fn open(directory: &Path, camera: &CameraDescription) -> Result<Self, RecordingError> {
        let path = directory.join("0/zarr.json");
        let text = read_text(&path, MAX_METADATA_BYTES)?;
        let found: serde_json::Value = serde_json::from_str(&text)
            .map_err(|error| RecordingError::damaged(&path, "JSON", error.to_string()))?;
        let pages = found["shape"][0].as_u64().filter(|pages| *pages <= MAX_PAGES);
        let Some(pages) = pages else {
            return Err(RecordingError::damaged(&path, "shape", found["shape"].to_string()));
        };
        let expected = array_metadata(camera, pages);
        for key in
            ["zarr_format", "node_type", "shape", "data_type", "chunk_grid", "chunk_key_encoding", "codecs"]
        {
            if found[key] != expected[key] {
                let detail = format!("{} where {} was recorded", found[key], expected[key]);
                return Err(RecordingError::damaged(&path, key, detail));
            }
        }
        let frame_bytes = camera.frame_bytes() as u64;
        Ok(Self { directory: directory.to_path_buf(), frame_bytes, pages, shard: None })
    }

    /// Leaves the frames from `pages` on out of the shape, in memory and in the file.
    pub(super) fn keep(&mut self, pages: u64, camera: &CameraDescription) -> Result<(), RecordingError> {
        self.pages = pages;
        rewrite_shape(&self.directory, camera, pages)
    }

    /// Writes the index of each shard again whose checksum is wrong, from the frames that are there.
    pub(super) fn mend(&self, camera: &CameraDescription, channel: Channel) -> Result<(), RecordingError> {
        for number in 0..self.pages.div_ceil(SHARD_FRAMES) {
            if let Err(RecordingError::Damaged { .. }) = OpenShard::open(&self.directory, number) {
                let path = shard_path(&self.directory, number);
                mend_index(&path, camera, channel)
                    .map_err(|source| RecordingError::storage(&path, "write the index of", source))?;
            }
        }
        Ok(())
    }

    pub(super) fn len(&self) -> u64 {
        self.pages
    }

    pub(super) fn path(&self) -> &Path {
        &self.directory
    }

    /// Reads the pixels of a frame that exists, as bytes.
    pub(super) fn read(&mut self, page: u64, bytes: &mut [u8]) -> Result<(), RecordingError> {
        let frame_bytes = self.frame_bytes;
        let shard = self.shard(page)?;
        let slot = (page % SHARD_FRAMES) as usize;
        let entry = |at: usize| u64::from_le_bytes(std::array::from_fn(|byte| shard.first_page[at + byte]));
        let (offset, len) = (entry(16 * slot), entry(16 * slot + 8));
        let is_inside = offset.checked_add(len).is_some_and(|end| end <= shard.len);
        if len != frame_bytes || !is_inside {
            let detail = format!("{len} bytes at {offset} in a file of {}", shard.len);
            return Err(RecordingError::damaged(&shard.path, format!("index, slot {slot}"), detail));
        }
        shard
            .file
            .read_exact_at(bytes, offset)
            .map_err(|source| RecordingError::storage(&shard.path, "read", source))
    }

    /// The facts of a frame that exists.
    pub(super) fn facts(&mut self, page: u64) -> Result<FactsBytes, RecordingError> {
        let shard = self.shard(page)?;
        Ok(facts_in(&shard.first_page, (page % SHARD_FRAMES) as usize))
    }

    fn shard(&mut self, page: u64) -> Result<&OpenShard, RecordingError> {
        let number = page / SHARD_FRAMES;
        let shard = match self.shard.take() {
            Some(shard) if shard.number == number => shard,
            _ => OpenShard::open(&self.directory, number)?,
        };
        Ok(self.shard.insert(shard))
    }
}

impl OpenShard {
    fn open(directory: &Path, number: u64) -> Result<Self, RecordingError> {
        let path = shard_path(directory, number);
        let failed = |source| RecordingError::storage(&path, "read", source);
        let file = File::open(&path).map_err(failed)?;
        let len = file.metadata().map_err(failed)?.len();
        let mut first_page = vec![0; PAGE];
        if len < PAGE as u64 {
            return Err(RecordingError::damaged(&path, "index", format!("the file has {len} bytes")));
        }
        file.read_exact_at(&mut first_page, 0).map_err(failed)?;
        let found = crc32c::crc32c(&first_page[..INDEX_BYTES]);
        let stored = u32::from_le_bytes(std::array::from_fn(|byte| first_page[INDEX_BYTES + byte]));
        if found != stored {
            let detail = format!("{stored:08x} where the index has {found:08x}");
            return Err(RecordingError::damaged(&path, "checksum of the index", detail));
        }
        Ok(Self { number, path, file, first_page, len })
    }
}

/// Writes an index of those frames whose pixels have the checksum in their facts.
fn mend_index(path: &Path, camera: &CameraDescription, channel: Channel) -> std::io::Result<()> {
    let file = File::options().read(true).write(true).open(path)?;
    if file.metadata()?.len() < PAGE as u64 {
        file.set_len(PAGE as u64)?;
    }
    let mut page = [0; PAGE];
    file.read_exact_at(&mut page, 0)?;
    page[..INDEX_BYTES].fill(u8::MAX);
    let mut pixels = vec![0; camera.frame_bytes()];
    for slot in 0..SHARD_FRAMES as usize {
        let bytes = facts_in(&page, slot);
        let offset = PAGE as u64 + slot as u64 * stride(camera);
        let expected = facts::decode(&bytes, channel, 0).as_ref().and_then(checksum);
        let is_read = file.read_exact_at(&mut pixels, offset).is_ok();
        if bytes != [0; FACTS_BYTES] && is_read && expected == Some(crc32c::crc32c(&pixels)) {
            page[16 * slot..16 * slot + 8].copy_from_slice(&offset.to_le_bytes());
            page[16 * slot + 8..16 * slot + 16].copy_from_slice(&(pixels.len() as u64).to_le_bytes());
        }
    }
    let of_index = crc32c::crc32c(&page[..INDEX_BYTES]);
    page[INDEX_BYTES..INDEX_BYTES + 4].copy_from_slice(&of_index.to_le_bytes());
    file.write_all_at(&page, 0)?;
    file.sync_all()
}
