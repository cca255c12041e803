//! OME-Zarr 0.5 under way: an array t, y, x in shards of 64 frames, each frame a chunk.
//!
//! ```text
//! zarr.json           a group with OME metadata
//! 0/zarr.json         the array; its shape names the published frames and no more
//! 0/c/K/0/0           shard K: index, checksum and facts in the first 4 KiB, then the frames, each on whole pages
//! ```
//!
//! In: groups of frames with their facts. Out: shards, then their indices, then the shape, renamed into place.
//! Never: names a frame in the shape before it is in its shard. Fails: [`RecordingError`]; the shape is then as before.

use super::RecordingError;
use super::direct::{Aligned, DirectFile, Gate, Operation, PAGE};
use super::facts::FACTS_BYTES;
use super::metadata::{CameraDescription, stride};
use super::sync::SyncFile;
use super::writer::{Bounce, Staged, sync_file, write_frames};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Frames of a shard: index and facts of all of them fit one page.
pub(super) const SHARD_FRAMES: u64 = 64;
/// Bytes of the index without its checksum.
pub(super) const INDEX_BYTES: usize = 16 * SHARD_FRAMES as usize;
/// Where the facts begin in the first page.
pub(super) const FACTS_AT: usize = INDEX_BYTES + 8;

/// An array under way.
#[derive(Debug)]
pub(super) struct ZarrArray {
    directory: PathBuf,
    camera: CameraDescription,
    gate: Gate,
    bounce: Bounce,
    pages: u64,
    staged: u64,
    /// Shards written to since the last publication and the one that has room, in order.
    shards: Vec<Shard>,
    finished: Vec<SyncFile>,
}

#[derive(Debug)]
struct Shard {
    number: u64,
    file: DirectFile,
    sync: SyncFile,
    first_page: Aligned,
    is_published: bool,
}

impl ZarrArray {
    pub(super) fn create(
        directory: &Path,
        camera: &CameraDescription,
        gate: Gate,
    ) -> Result<Self, RecordingError> {
        let make = |path: &Path| {
            gate.pass(Operation::Write, path)
                .and_then(|()| fs::create_dir(path))
                .map_err(|source| RecordingError::storage(path, "create", source))
        };
        make(directory)?;
        make(&directory.join("0"))?;
        let array = Self {
            directory: directory.to_path_buf(),
            camera: camera.clone(),
            bounce: Bounce::for_frames(camera.frame_bytes()),
            pages: 0,
            staged: 0,
            shards: Vec::new(),
            finished: Vec::new(),
            gate,
        };
        write_json(&directory.join("zarr.json"), &group_metadata(directory, camera), &array.gate)?;
        write_shape(directory, camera, 0, &array.gate)?;
        Ok(array)
    }

    /// Writes a group; readers do not see it yet.
    pub(super) fn stage(&mut self, group: &[Staged<'_>]) -> Result<(), RecordingError> {
        let mut page = self.pages;
        let mut left = group;
        while !left.is_empty() {
            let room = (SHARD_FRAMES - page % SHARD_FRAMES) as usize;
            let (now, later) = left.split_at(room.min(left.len()));
            self.stage_in_shard(page, now)?;
            page += now.len() as u64;
            left = later;
        }
        self.staged = page;
        Ok(())
    }

    fn stage_in_shard(&mut self, page: u64, group: &[Staged<'_>]) -> Result<(), RecordingError> {
        let number = page / SHARD_FRAMES;
        if self.shards.last().is_none_or(|shard| shard.number != number) {
            self.shards.push(Shard::create(&self.directory, number, self.gate.clone())?);
        }
        let frame_bytes = self.camera.frame_bytes() as u64;
        let stride = stride(&self.camera);
        let Some(shard) = self.shards.last_mut() else { return Ok(()) };
        let slot = page % SHARD_FRAMES;
        let offset = PAGE as u64 + slot * stride;
        let whole = PAGE as u64 + SHARD_FRAMES * stride;
        shard.file.reserve(offset + group.len() as u64 * stride, whole);
        let frames: Vec<&[u8]> = group.iter().map(|staged| staged.pixels).collect();
        write_frames(&mut shard.file, &[], &frames, offset, &mut self.bounce)?;
        for (index, staged) in group.iter().enumerate() {
            let slot = slot as usize + index;
            let at = PAGE as u64 + slot as u64 * stride;
            let bytes = shard.first_page.bytes_mut();
            bytes[16 * slot..16 * slot + 8].copy_from_slice(&at.to_le_bytes());
            bytes[16 * slot + 8..16 * slot + 16].copy_from_slice(&frame_bytes.to_le_bytes());
            bytes[FACTS_AT + slot * FACTS_BYTES..][..FACTS_BYTES].copy_from_slice(staged.facts);
        }
        Ok(())
    }

    /// Writes the indices, then the shape.
    pub(super) fn publish(&mut self) -> Result<(), RecordingError> {
        if self.staged == self.pages {
            return Ok(());
        }
        for shard in &mut self.shards {
            let bytes = shard.first_page.bytes_mut();
            let checksum = crc32c::crc32c(&bytes[..INDEX_BYTES]);
            bytes[INDEX_BYTES..INDEX_BYTES + 4].copy_from_slice(&checksum.to_le_bytes());
            shard.file.write(&[shard.first_page.bytes()], 0)?;
        }
        write_shape(&self.directory, &self.camera, self.staged, &self.gate)?;
        self.pages = self.staged;
        for shard in &mut self.shards {
            shard.is_published = true;
        }
        let open = self.pages / SHARD_FRAMES;
        let finished: Vec<Shard> = self.shards.extract_if(.., |shard| shard.number < open).collect();
        self.finished.extend(finished.into_iter().map(|shard| shard.sync));
        Ok(())
    }

    /// Gives back all room behind the published frames.
    pub(super) fn cut(&mut self) -> Result<(), RecordingError> {
        self.staged = self.pages;
        let end = self.shard_end();
        let mut outcome = Ok(());
        for mut shard in std::mem::take(&mut self.shards) {
            let cut = if shard.is_published {
                shard.file.cut(end)
            } else {
                let path = shard.file.path();
                fs::remove_file(path).map_err(|source| RecordingError::storage(path, "remove", source))
            };
            if shard.is_published {
                self.finished.push(shard.sync);
            }
            outcome = outcome.and(cut);
        }
        outcome
    }

    pub(super) fn pages(&self) -> u64 {
        self.pages
    }

    pub(super) fn bytes(&self) -> u64 {
        self.pages * stride(&self.camera) + self.pages.div_ceil(SHARD_FRAMES) * PAGE as u64
    }

    pub(super) fn reserve(&self) -> u64 {
        let end = self.shard_end();
        self.shards.iter().map(|shard| shard.file.reserve_beyond(end)).sum()
    }

    pub(super) fn path(&self) -> &Path {
        &self.directory
    }

    pub(super) fn sync_files(&self) -> Vec<SyncFile> {
        let open = self.shards.iter().map(|shard| &shard.sync);
        self.finished.iter().chain(open).map(Arc::clone).collect()
    }

    pub(super) fn sync_requested(&mut self) {
        self.finished.clear();
    }

    /// Where the frames of the open shard end.
    fn shard_end(&self) -> u64 {
        PAGE as u64 + self.pages % SHARD_FRAMES * stride(&self.camera)
    }
}

impl Shard {
    fn create(directory: &Path, number: u64, gate: Gate) -> Result<Self, RecordingError> {
        let path = shard_path(directory, number);
        if let Some(parent) = path.parent() {
            gate.pass(Operation::Write, parent)
                .and_then(|()| fs::create_dir_all(parent))
                .map_err(|source| RecordingError::storage(parent, "create", source))?;
        }
        let file = DirectFile::create(&path, gate)?;
        let mut first_page = Aligned::zeroed(PAGE);
        first_page.bytes_mut()[..INDEX_BYTES].fill(u8::MAX);
        Ok(Self { number, file, sync: sync_file(&path)?, first_page, is_published: false })
    }
}

pub(super) fn shard_path(directory: &Path, number: u64) -> PathBuf {
    directory.join(format!("0/c/{number}/0/0"))
}

/// Declares `pages` frames, all at once or not at all.
pub(super) fn write_shape(
    directory: &Path,
    camera: &CameraDescription,
    pages: u64,
    gate: &Gate,
) -> Result<(), RecordingError> {
    write_json(&directory.join("0/zarr.json"), &array_metadata(camera, pages), gate)
}

/// Makes metadata durable after the last frame.
pub(super) fn sync_metadata(directory: &Path, gate: &Gate) -> Result<(), RecordingError> {
    for name in ["zarr.json", "0/zarr.json"] {
        let path = directory.join(name);
        gate.pass(Operation::Sync, &path)
            .and_then(|()| fs::File::open(&path)?.sync_all())
            .map_err(|source| RecordingError::storage(&path, "sync", source))?;
    }
    super::direct::sync_directory(&directory.join("0"), gate)?;
    super::direct::sync_directory(directory, gate)
}

fn write_json(path: &Path, value: &Value, gate: &Gate) -> Result<(), RecordingError> {
    let new = path.with_extension("json.new");
    gate.pass(Operation::Write, path)
        .and_then(|()| fs::write(&new, format!("{value:#}\n")))
        .and_then(|()| fs::rename(&new, path))
        .map_err(|source| {
            let _ = fs::remove_file(&new);
            RecordingError::storage(path, "write", source)
        })
}

/// The array of one camera, as Zarr 3 describes it.
pub(super) fn array_metadata(camera: &CameraDescription, pages: u64) -> Value {
    let (height, width) = (camera.height(), camera.width());
    let little = json!({"name": "bytes", "configuration": {"endian": "little"}});
    json!({
        "zarr_format": 3,
        "node_type": "array",
        "shape": [pages, height, width],
        "data_type": "uint16",
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [SHARD_FRAMES, height, width]}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0,
        "codecs": [{"name": "sharding_indexed", "configuration": {
            "chunk_shape": [1, height, width],
            "codecs": [little],
            "index_codecs": [little, {"name": "crc32c"}],
            "index_location": "start",
        }}],
        "attributes": {},
        "dimension_names": ["t", "y", "x"],
    })
}

fn group_metadata(directory: &Path, camera: &CameraDescription) -> Value {
    let name = directory.file_name().map(|name| name.to_string_lossy().into_owned());
    let period = camera.settings.period.as_secs_f64();
    let pixel = camera.pixel_size_nm.map_or(1.0, |size| size / 1e3);
    let mut axes = vec![json!({"name": "t", "type": "time", "unit": "second"})];
    for axis in ["y", "x"] {
        axes.push(match camera.pixel_size_nm {
            Some(_) => json!({"name": axis, "type": "space", "unit": "micrometer"}),
            None => json!({"name": axis, "type": "space"}),
        });
    }
    let scale = json!({"type": "scale", "scale": [if period > 0.0 { period } else { 1.0 }, pixel, pixel]});
    json!({
        "zarr_format": 3,
        "node_type": "group",
        "attributes": {"ome": {"version": "0.5", "multiscales": [{
            "name": name,
            "axes": axes,
            "datasets": [{"path": "0", "coordinateTransformations": [scale]}],
        }]}},
    })
}
