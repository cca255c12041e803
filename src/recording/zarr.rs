//! OME-Zarr 0.5 under way: an array t, y, x in shards of 64 frames, each frame a chunk.
//!
//! ```text
//! zarr.json           a group with OME metadata
//! 0/zarr.json         the array; its shape names the published frames and no more, in eight bytes written at once
//! 0/c/K/0/0           shard K: index, checksum and facts in the first 4 KiB, then the frames, each on whole pages
//! ```
//!
//! In: groups of frames with their facts. Out: shards, then their indices, then the shape, in place.
//! Never: names a frame in the shape before it is in its shard. Fails: [`RecordingError`]; the shape is then as before.

use super::RecordingError;
use super::direct::{Aligned, DirectFile, PAGE};
use super::facts::{FACTS_BYTES, FIRST_FACTS_BYTES, FactsBytes};
use super::gate::{Change, Gate, Operation};
use super::metadata::{CameraDescription, stride};
use super::sync::SyncFile;
use super::writer::{Bounce, sync_file, write_frames};
use serde_json::{Value, json};
use std::fs;
use std::io::Write;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Frames of a shard: index and facts of all of them fit one page.
pub(super) const SHARD_FRAMES: u64 = 64;
/// Bytes of the index without its checksum.
pub(super) const INDEX_BYTES: usize = 16 * SHARD_FRAMES as usize;
/// Where the facts begin in the first page.
const FACTS_AT: usize = INDEX_BYTES + 8;
/// Where what recordings of before do not have begins, for all frames behind the other facts of all frames.
const MORE_FACTS_AT: usize = FACTS_AT + SHARD_FRAMES as usize * FIRST_FACTS_BYTES;

/// Where the number of frames stands in the metadata of the array.
const SHAPE_AT: usize = 16;
/// And how long it is; more frames are not recorded.
const SHAPE_DIGITS: usize = 8;

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
    /// Full shards and new directories: to be synced once more.
    changed: Vec<SyncFile>,
    /// The metadata of the array, of which the shape changes.
    shape: SyncFile,
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
        let inner = directory.join("0");
        for path in [directory, &inner] {
            gate.pass(Operation::Write, path)
                .and_then(|()| fs::create_dir(path))
                .map_err(|source| RecordingError::storage(path, "create", source))?;
            gate.note(Change::Directory, path);
        }
        write_text(
            &directory.join("zarr.json"),
            &format!("{:#}\n", group_metadata(directory, camera)),
            &gate,
        )?;
        let path = inner.join("zarr.json");
        write_text(&path, &array_text(camera, 0), &gate)?;
        let shape = fs::OpenOptions::new()
            .write(true)
            .open(&path)
            .map_err(|source| RecordingError::storage(&path, "open", source))?;
        super::direct::sync_directory(&inner, &gate)?;
        super::direct::sync_directory(directory, &gate)?;
        Ok(Self {
            directory: directory.to_path_buf(),
            camera: camera.clone(),
            bounce: Bounce::for_frames(camera.frame_bytes()),
            pages: 0,
            staged: 0,
            shards: Vec::new(),
            changed: Vec::new(),
            shape: Arc::new((path, shape)),
            gate,
        })
    }

    /// Writes the pixels of a group; readers do not see it yet.
    pub(super) fn stage(&mut self, group: &[&[u8]]) -> Result<(), RecordingError> {
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

    fn stage_in_shard(&mut self, page: u64, group: &[&[u8]]) -> Result<(), RecordingError> {
        let number = page / SHARD_FRAMES;
        if self.shards.last().is_none_or(|shard| shard.number != number) {
            self.create_directories(number)?;
            self.shards.push(Shard::create(&self.directory, number, self.gate.clone())?);
        }
        let stride = stride(&self.camera);
        let Some(shard) = self.shards.last_mut() else { return Ok(()) };
        let slot = page % SHARD_FRAMES;
        let offset = PAGE as u64 + slot * stride;
        let whole = PAGE as u64 + SHARD_FRAMES * stride;
        shard.file.reserve(offset + group.len() as u64 * stride, whole);
        write_frames(&mut shard.file, group, offset, &mut self.bounce)
    }

    /// Creates the directories of a shard, which become durable with it.
    fn create_directories(&mut self, number: u64) -> Result<(), RecordingError> {
        let chunks = self.directory.join("0/c");
        let of_shard = chunks.join(number.to_string());
        let mut parent = self.directory.join("0");
        for path in [chunks, of_shard.clone(), of_shard.join("0")] {
            let created =
                self.gate.pass(Operation::Write, &path).and_then(|()| match fs::create_dir(&path) {
                    Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => Ok(()),
                    outcome => outcome.inspect(|()| self.gate.note(Change::Directory, &path)),
                });
            created.map_err(|source| RecordingError::storage(&path, "create", source))?;
            self.changed.push(sync_file(&parent)?);
            parent = path;
        }
        self.changed.push(sync_file(&parent)?);
        Ok(())
    }

    /// Writes the indices with the facts of each staged frame, then the shape.
    pub(super) fn publish(&mut self, facts: &[FactsBytes]) -> Result<(), RecordingError> {
        if self.staged == self.pages {
            return Ok(());
        }
        for (page, facts) in (self.pages..self.staged).zip(facts) {
            if let Some(shard) = self.shards.iter_mut().find(|shard| shard.number == page / SHARD_FRAMES) {
                shard.enter((page % SHARD_FRAMES) as usize, &self.camera, facts);
            }
        }
        for shard in &mut self.shards {
            let bytes = shard.first_page.bytes_mut();
            let checksum = crc32c::crc32c(&bytes[..INDEX_BYTES]);
            bytes[INDEX_BYTES..INDEX_BYTES + 4].copy_from_slice(&checksum.to_le_bytes());
            shard.file.write(&[shard.first_page.bytes()], 0)?;
        }
        self.write_shape(self.staged)?;
        self.pages = self.staged;
        for shard in &mut self.shards {
            shard.is_published = true;
        }
        let open = self.pages / SHARD_FRAMES;
        let finished: Vec<Shard> = self.shards.extract_if(.., |shard| shard.number < open).collect();
        self.changed.extend(finished.into_iter().map(|shard| shard.sync));
        Ok(())
    }

    /// Declares `pages` frames: eight digits, within one sector and one word, so that no reader sees half of them.
    fn write_shape(&self, pages: u64) -> Result<(), RecordingError> {
        let (path, file) = &*self.shape;
        let digits = format!("{pages:>SHAPE_DIGITS$}");
        let written = if digits.len() > SHAPE_DIGITS {
            Err(std::io::ErrorKind::FileTooLarge.into())
        } else {
            let write = || file.write_all_at(digits.as_bytes(), SHAPE_AT as u64);
            self.gate.pass(Operation::Write, path).and_then(|()| write())
        };
        written.map_err(|source| RecordingError::storage(path, "write", source))?;
        self.gate.note(Change::Bytes(SHAPE_AT as u64, digits.as_bytes()), path);
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
                let removed = fs::remove_file(path).inspect(|()| self.gate.note(Change::Removed, path));
                removed.map_err(|source| RecordingError::storage(path, "remove", source))
            };
            if shard.is_published {
                self.changed.push(shard.sync);
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
        self.changed.iter().chain(open).chain([&self.shape]).map(Arc::clone).collect()
    }

    pub(super) fn sync_requested(&mut self) {
        self.changed.clear();
    }

    /// Where the frames of the open shard end.
    fn shard_end(&self) -> u64 {
        PAGE as u64 + self.pages % SHARD_FRAMES * stride(&self.camera)
    }
}

impl Shard {
    fn create(directory: &Path, number: u64, gate: Gate) -> Result<Self, RecordingError> {
        let path = shard_path(directory, number);
        let file = DirectFile::create(&path, gate)?;
        let mut first_page = Aligned::zeroed(PAGE);
        first_page.bytes_mut()[..INDEX_BYTES].fill(u8::MAX);
        Ok(Self { number, file, sync: sync_file(&path)?, first_page, is_published: false })
    }

    /// Enters a frame that is written into index and facts.
    fn enter(&mut self, slot: usize, camera: &CameraDescription, facts: &FactsBytes) {
        let at = PAGE as u64 + slot as u64 * stride(camera);
        let bytes = self.first_page.bytes_mut();
        bytes[16 * slot..16 * slot + 8].copy_from_slice(&at.to_le_bytes());
        bytes[16 * slot + 8..16 * slot + 16].copy_from_slice(&(camera.frame_bytes() as u64).to_le_bytes());
        for (part, place) in parts_of_facts(slot) {
            bytes[place].copy_from_slice(&facts[part]);
        }
    }
}

/// Where the parts of the facts of a frame lie in the first page.
fn parts_of_facts(slot: usize) -> [(Range<usize>, Range<usize>); 2] {
    const MORE: usize = FACTS_BYTES - FIRST_FACTS_BYTES;
    let (first, more) = (FACTS_AT + slot * FIRST_FACTS_BYTES, MORE_FACTS_AT + slot * MORE);
    [
        (0..FIRST_FACTS_BYTES, first..first + FIRST_FACTS_BYTES),
        (FIRST_FACTS_BYTES..FACTS_BYTES, more..more + MORE),
    ]
}

/// The facts of a frame from the first page of its shard.
pub(super) fn facts_in(first_page: &[u8], slot: usize) -> FactsBytes {
    let mut facts = [0; FACTS_BYTES];
    for (part, place) in parts_of_facts(slot) {
        facts[part].copy_from_slice(&first_page[place]);
    }
    facts
}

pub(super) fn shard_path(directory: &Path, number: u64) -> PathBuf {
    directory.join(format!("0/c/{number}/0/0"))
}

/// Writes the metadata of a whole array with `pages` frames again.
pub(super) fn rewrite_shape(
    directory: &Path,
    camera: &CameraDescription,
    pages: u64,
) -> Result<(), RecordingError> {
    write_text(&directory.join("0/zarr.json"), &array_text(camera, pages), &Gate::default())
}

/// Makes metadata durable after the last frame.
pub(super) fn sync_metadata(directory: &Path, gate: &Gate) -> Result<(), RecordingError> {
    for name in ["zarr.json", "0/zarr.json"] {
        let path = directory.join(name);
        gate.pass(Operation::Sync, &path)
            .and_then(|()| fs::File::open(&path)?.sync_all())
            .map_err(|source| RecordingError::storage(&path, "sync", source))?;
        gate.note(Change::Synced, &path);
    }
    super::direct::sync_directory(&directory.join("0"), gate)?;
    super::direct::sync_directory(directory, gate)
}

/// A durable file that is there whole or not at all.
fn write_text(path: &Path, text: &str, gate: &Gate) -> Result<(), RecordingError> {
    let new = path.with_extension("json.new");
    let write = || {
        let mut file = fs::File::create(&new)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()
    };
    gate.pass(Operation::Write, path).and_then(|()| write()).and_then(|()| fs::rename(&new, path)).map_err(
        |source| {
            let _ = fs::remove_file(&new);
            RecordingError::storage(path, "write", source)
        },
    )?;
    gate.note(Change::Created, path);
    gate.note(Change::Bytes(0, text.as_bytes()), path);
    gate.note(Change::Synced, path);
    Ok(())
}

/// The metadata of an array with the first number of its shape in a fixed place.
fn array_text(camera: &CameraDescription, pages: u64) -> String {
    let mut others = array_metadata(camera, pages);
    if let Some(others) = others.as_object_mut() {
        others.remove("shape");
    }
    let (begin, width) = ("{\"shape\":[", SHAPE_AT + SHAPE_DIGITS - "{\"shape\":[".len());
    let others = format!("{others:#}\n");
    format!("{begin}{pages:>width$},{},{}],{}", camera.height(), camera.width(), &others[1..])
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
