//! What `zarr.json` says of an array: axes, chunks, codecs.
//!
//! In: JSON. Out: [`ArrayLayout`], of a kind that is read. Never: follows a path out of the array.
//! Fails: [`ReplayError`] with file and field.

use super::super::ReplayError;
use super::super::source::{SourceFile, check_frames, check_size};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Name of the file that describes a group or an array.
pub(crate) const METADATA: &str = "zarr.json";
const MAX_METADATA_BYTES: u64 = 1 << 20;
const MAX_AXES: usize = 6;
/// Bytes of one chunk that is decoded at once.
pub(super) const MAX_CHUNK_BYTES: u64 = 32 << 20;
/// Chunks of one frame.
const MAX_PIECES: u64 = 4096;
/// Chunks of one shard; their index takes 16 bytes each.
const MAX_SHARD_CHUNKS: u64 = 1 << 18;

const REMEDY: &str = "Export it as uint16 with axes t, y, x, codecs bytes, gzip or zstd, or as TIFF";

/// Where the frames of an array are.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ArrayLayout {
    /// Directory of the array.
    pub(super) root: PathBuf,
    pub(super) shape: Vec<u64>,
    /// What a chunk is that is decoded at once: of the grid, or within a shard.
    pub(super) chunk: Vec<u64>,
    /// Chunks of a shard along each axis; `None` for chunks in files of their own.
    pub(super) shard: Option<Shards>,
    pub(super) codecs: Codecs,
    pub(super) bytes_per_pixel: u64,
    pub(super) fill: u16,
    pub(super) keys: Keys,
    /// Axis of the frames and of the channels; the last two are rows and columns.
    pub(super) frame_axis: usize,
    pub(super) channel_axis: Option<usize>,
    pub(super) period: Option<Duration>,
    pub(super) pixel_size_nm: Option<f64>,
}

/// How chunks lie in a shard.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shards {
    pub(super) chunks: Vec<u64>,
    pub(super) index_at_end: bool,
    pub(super) index_has_checksum: bool,
}

/// What was done to the bytes of a chunk, in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Codecs {
    pub(super) is_big_endian: bool,
    /// Checksums before compression.
    pub(super) inner_checksums: u64,
    pub(super) compression: Compression,
    /// Checksums after compression.
    pub(super) outer_checksums: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    Gzip,
    Zstd,
}

/// How the files of chunks are named.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Keys {
    pub(super) prefix: &'static str,
    pub(super) separator: char,
}

/// What a group says of the array in it.
#[derive(Debug, Default)]
struct Ome {
    axes: Option<Vec<(String, String)>>,
    scale: Vec<f64>,
}

/// Finds the array in a directory: itself, or the full resolution of an OME-Zarr image.
pub(super) fn read(directory: &Path) -> Result<ArrayLayout, ReplayError> {
    let path = directory.join(METADATA);
    let json = json(&path)?;
    if json["node_type"] != "group" {
        return array(directory, &path, &json, &Ome::default());
    }
    let image = &json["attributes"]["ome"]["multiscales"][0];
    let named = &image["datasets"][0]["path"];
    let Some(name) = named.as_str().filter(|name| is_plain(name)) else {
        let field = "attributes.ome.multiscales[0].datasets[0].path";
        return Err(ReplayError::damaged(&path, field, format!("{} names no array in it", short(named))));
    };
    let texts = |axis: &Value| {
        let text = |key: &str| axis[key].as_str().unwrap_or_default().to_owned();
        (text("name"), text("unit"))
    };
    let scale = &image["datasets"][0]["coordinateTransformations"][0]["scale"];
    let ome = Ome {
        axes: image["axes"].as_array().map(|axes| axes.iter().map(texts).collect()),
        scale: scale.as_array().into_iter().flatten().filter_map(Value::as_f64).collect(),
    };
    let directory = directory.join(name);
    let path = directory.join(METADATA);
    let json = self::json(&path)?;
    array(&directory, &path, &json, &ome)
}

fn json(path: &Path) -> Result<Value, ReplayError> {
    let text = SourceFile::open_unlinked(path)?.text(MAX_METADATA_BYTES)?;
    serde_json::from_str(&text).map_err(|error| ReplayError::damaged(path, "JSON", error.to_string()))
}

/// A name below, not above and not elsewhere.
fn is_plain(name: &str) -> bool {
    let plain = |part: &str| {
        !part.is_empty() && !part.starts_with('.') && part.bytes().all(|byte| byte.is_ascii_graphic())
    };
    name.len() < 200 && !name.contains('\\') && name.split('/').all(plain)
}

/// A value as short as a message takes it.
fn short(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() > 80 { text.chars().take(80).chain("...".chars()).collect() } else { text }
}

fn array(directory: &Path, path: &Path, json: &Value, ome: &Ome) -> Result<ArrayLayout, ReplayError> {
    let unsupported = |field: &str, found: &Value| {
        Err(ReplayError::unsupported(path, field, format!("{} is not read", short(found)), REMEDY))
    };
    if json["zarr_format"] != 3 || json["node_type"] != "array" {
        return unsupported("zarr_format and node_type", &json["zarr_format"]);
    }
    let (bytes_per_pixel, largest) = match json["data_type"].as_str() {
        Some("uint16") => (2, 65_535),
        Some("uint8") => (1, 255),
        _ => return unsupported("data_type", &json["data_type"]),
    };
    if json["storage_transformers"].as_array().is_some_and(|all| !all.is_empty()) {
        return unsupported("storage_transformers", &json["storage_transformers"]);
    }
    let Some(fill) = json["fill_value"].as_u64().filter(|fill| *fill <= largest) else {
        return unsupported("fill_value", &json["fill_value"]);
    };
    let shape = lengths(path, "shape", &json["shape"])?;
    if json["chunk_grid"]["name"] != "regular" {
        return unsupported("chunk_grid", &json["chunk_grid"]);
    }
    let grid = lengths(path, "chunk_grid", &json["chunk_grid"]["configuration"]["chunk_shape"])?;
    let keys = keys(path, &json["chunk_key_encoding"])?;
    let (chunk, shard, codecs) = codecs(path, &grid, &json["codecs"])?;
    let (frame_axis, channel_axis) = axes(path, &shape, json, ome)?;
    let last = shape.len() - 1;
    check_size(path, "shape", shape[last - 1], shape[last])?;
    check_frames(path, "shape", shape[frame_axis])?;
    check_chunks(path, &shape, &chunk, bytes_per_pixel)?;
    Ok(ArrayLayout {
        root: directory.to_path_buf(),
        period: ome.period(frame_axis),
        pixel_size_nm: ome.pixel_size_nm(last),
        shape,
        chunk,
        shard,
        codecs,
        bytes_per_pixel,
        fill: fill as u16,
        keys,
        frame_axis,
        channel_axis,
    })
}

/// A list of lengths, one for each axis.
fn lengths(path: &Path, field: &str, json: &Value) -> Result<Vec<u64>, ReplayError> {
    let list = json.as_array().filter(|list| (3..=MAX_AXES).contains(&list.len()));
    let lengths: Option<Vec<u64>> = list.and_then(|list| {
        list.iter().map(|length| length.as_u64().filter(|length| (1..=1 << 40).contains(length))).collect()
    });
    lengths.ok_or_else(|| {
        let detail = format!("{} is no list of 3 to {MAX_AXES} lengths", short(json));
        ReplayError::damaged(path, field, detail)
    })
}

fn keys(path: &Path, json: &Value) -> Result<Keys, ReplayError> {
    let separator = |default: char| match json["configuration"]["separator"].as_str() {
        None => Some(default),
        Some("/") => Some('/'),
        Some(".") => Some('.'),
        Some(_) => None,
    };
    let found = match json["name"].as_str() {
        Some("default") => separator('/').map(|separator| Keys { prefix: "c", separator }),
        Some("v2") => separator('.').map(|separator| Keys { prefix: "", separator }),
        _ => None,
    };
    let detail = || format!("{} is not read", short(json));
    found.ok_or_else(|| ReplayError::unsupported(path, "chunk_key_encoding", detail(), REMEDY))
}

type Chunking = (Vec<u64>, Option<Shards>, Codecs);

fn codecs(path: &Path, grid: &[u64], json: &Value) -> Result<Chunking, ReplayError> {
    let list = json.as_array().map(Vec::as_slice).unwrap_or_default();
    let [sharding] = list else { return Ok((grid.to_vec(), None, chain(path, "codecs", json)?)) };
    if sharding["name"] != "sharding_indexed" {
        return Ok((grid.to_vec(), None, chain(path, "codecs", json)?));
    }
    let configuration = &sharding["configuration"];
    let chunk = lengths(path, "sharding_indexed.chunk_shape", &configuration["chunk_shape"])?;
    let divides =
        chunk.len() == grid.len() && grid.iter().zip(&chunk).all(|(grid, chunk)| grid.is_multiple_of(*chunk));
    let chunks: Vec<u64> = grid.iter().zip(&chunk).map(|(grid, chunk)| grid / chunk).collect();
    let number = chunks.iter().try_fold(1_u64, |number, chunks| number.checked_mul(*chunks));
    if !divides || number.is_none_or(|number| number > MAX_SHARD_CHUNKS) {
        let detail = format!("chunks of {chunk:?} in shards of {grid:?}");
        return Err(ReplayError::damaged(path, "sharding_indexed.chunk_shape", detail));
    }
    let index = chain(path, "sharding_indexed.index_codecs", &configuration["index_codecs"])?;
    let is_plain = index.compression == Compression::None && !index.is_big_endian;
    let checksums = index.inner_checksums + index.outer_checksums;
    let index_at_end = match configuration["index_location"].as_str() {
        None | Some("end") => Some(true),
        Some("start") => Some(false),
        Some(_) => None,
    };
    let Some(index_at_end) = index_at_end.filter(|_| is_plain && checksums <= 1) else {
        let detail = format!("{} is not read", short(configuration));
        return Err(ReplayError::unsupported(path, "sharding_indexed.index_codecs", detail, REMEDY));
    };
    let codecs = chain(path, "sharding_indexed.codecs", &configuration["codecs"])?;
    Ok((chunk, Some(Shards { chunks, index_at_end, index_has_checksum: checksums == 1 }), codecs))
}

/// Codecs from numbers to bytes, one compression at most.
fn chain(path: &Path, field: &str, json: &Value) -> Result<Codecs, ReplayError> {
    let list = json.as_array().map(Vec::as_slice).unwrap_or_default();
    let unsupported = |found: &Value| {
        Err(ReplayError::unsupported(path, field, format!("{} is not read", short(found)), REMEDY))
    };
    let Some((first, rest)) = list.split_first() else { return unsupported(json) };
    let is_big_endian = match (first["name"].as_str(), first["configuration"]["endian"].as_str()) {
        (Some("bytes"), None | Some("little")) => false,
        (Some("bytes"), Some("big")) => true,
        _ => return unsupported(first),
    };
    let mut codecs =
        Codecs { is_big_endian, inner_checksums: 0, compression: Compression::None, outer_checksums: 0 };
    for codec in rest.iter().take(8) {
        match (codec["name"].as_str(), codecs.compression) {
            (Some("gzip"), Compression::None) => codecs.compression = Compression::Gzip,
            (Some("zstd"), Compression::None) => codecs.compression = Compression::Zstd,
            (Some("crc32c"), Compression::None) => codecs.inner_checksums += 1,
            (Some("crc32c"), _) => codecs.outer_checksums += 1,
            _ => return unsupported(codec),
        }
    }
    if rest.len() > 8 { unsupported(json) } else { Ok(codecs) }
}

/// The axes of frames and channels; all others but rows and columns have length 1.
fn axes(path: &Path, shape: &[u64], json: &Value, ome: &Ome) -> Result<(usize, Option<usize>), ReplayError> {
    let named = json["dimension_names"].as_array().map(|names| {
        names.iter().map(|name| name.as_str().unwrap_or_default().to_owned()).collect::<Vec<_>>()
    });
    let of_image = ome.axes.as_ref().map(|axes| axes.iter().map(|(name, _)| name.clone()).collect());
    let by_rank = || ["t", "c", "z", "y", "x"].map(str::to_owned).to_vec();
    let names = match of_image.or(named) {
        Some(names) => names,
        None if shape.len() == 3 => ["t", "y", "x"].map(str::to_owned).to_vec(),
        None if shape.len() == 4 => ["t", "c", "y", "x"].map(str::to_owned).to_vec(),
        None => by_rank(),
    };
    let refuse = |detail: String| Err(ReplayError::unsupported(path, "axes", detail, REMEDY));
    let last = shape.len() - 1;
    if names.len() != shape.len() || names[last - 1] != "y" || names[last] != "x" {
        return refuse(format!(
            "{} axes, {:?}",
            shape.len(),
            names.iter().take(MAX_AXES).collect::<Vec<_>>()
        ));
    }
    let long: Vec<usize> = (0..last - 1).filter(|axis| shape[*axis] > 1).collect();
    let place = |name: &str| names[..last - 1].iter().position(|other| other == name);
    let channel_axis = place("c");
    let frames: Vec<usize> = long.into_iter().filter(|axis| Some(*axis) != channel_axis).collect();
    let frame_axis = match frames[..] {
        [] => place("t").or(place("z")).or((0..last - 1).find(|axis| Some(*axis) != channel_axis)),
        [axis] => Some(axis),
        _ => None,
    };
    let channels = channel_axis.map_or(1, |axis| shape[axis]);
    match frame_axis {
        Some(frame_axis) if channels <= 2 => Ok((frame_axis, channel_axis)),
        _ => {
            refuse(format!("shape {shape:?} with {channels} channels is no sequence of two cameras' frames"))
        }
    }
}

/// Refuses chunks of which one, or one frame of them, is too much at once.
fn check_chunks(path: &Path, shape: &[u64], chunk: &[u64], bytes_per_pixel: u64) -> Result<(), ReplayError> {
    if chunk.len() != shape.len() {
        let detail = format!("chunks of {chunk:?} in {shape:?}");
        return Err(ReplayError::damaged(path, "chunk_shape", detail));
    }
    let bytes = chunk.iter().try_fold(bytes_per_pixel, |bytes, length| bytes.checked_mul(*length));
    if bytes.is_none_or(|bytes| bytes > MAX_CHUNK_BYTES) {
        let detail = format!("chunks of {chunk:?} are more than {} MiB", MAX_CHUNK_BYTES >> 20);
        return Err(ReplayError::unsupported(path, "chunk_shape", detail, "Export it in smaller chunks"));
    }
    let last = shape.len() - 1;
    let pieces = shape[last - 1].div_ceil(chunk[last - 1]) * shape[last].div_ceil(chunk[last]);
    if pieces > MAX_PIECES {
        let detail = format!("a frame has {pieces} chunks where at most {MAX_PIECES} are read");
        return Err(ReplayError::unsupported(path, "chunk_shape", detail, "Export it in larger chunks"));
    }
    Ok(())
}

impl Ome {
    fn scaled(&self, axis: usize, units: &[(&str, f64)]) -> Option<f64> {
        let (_, unit) = self.axes.as_ref()?.get(axis)?;
        let factor = units.iter().find(|(name, _)| name == unit)?.1;
        self.scale.get(axis).map(|scale| scale * factor).filter(|value| value.is_finite() && *value > 0.0)
    }

    fn period(&self, axis: usize) -> Option<Duration> {
        let units = [("second", 1.0), ("millisecond", 1e-3), ("microsecond", 1e-6), ("nanosecond", 1e-9)];
        let seconds = self.scaled(axis, &units).filter(|seconds| (1e-6..=3600.0).contains(seconds))?;
        Some(Duration::from_secs_f64(seconds))
    }

    fn pixel_size_nm(&self, axis: usize) -> Option<f64> {
        self.scaled(axis, &[("micrometer", 1e3), ("nanometer", 1.0), ("millimeter", 1e6), ("meter", 1e9)])
    }
}
