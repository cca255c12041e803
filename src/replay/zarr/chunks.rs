//! The chunks of an array: files, shards, codecs.
//!
//! In: places in the grid of chunks. Out: their bytes, as many as the shape of a chunk says.
//! Never: follows a link, lets a chunk grow beyond its shape. Fails: [`ReplayError`] with file and field.

use super::super::ReplayError;
use super::super::source::SourceFile;
use super::metadata::{ArrayLayout, Codecs, Compression, Shards};
use crate::files::FileError;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

/// A chunk of incompressible bytes grows by less than this.
const MOST_GROWTH_BYTES: u64 = 64 << 10;

/// Reads chunks; keeps the shard read last open.
#[derive(Debug)]
pub(super) struct Chunks {
    root: PathBuf,
    /// Bytes of a chunk when it is decoded.
    pub(super) bytes: usize,
    encoded: Vec<u8>,
    shard: Option<OpenShard>,
}

/// A shard and its index.
#[derive(Debug)]
struct OpenShard {
    place: Vec<u64>,
    file: SourceFile,
    index: Vec<u8>,
}

impl Chunks {
    pub(super) fn new(layout: &ArrayLayout) -> Result<Self, ReplayError> {
        let root =
            fs::canonicalize(&layout.root).map_err(|source| ReplayError::io(&layout.root, "open", source))?;
        let bytes = layout.chunk.iter().product::<u64>() * layout.bytes_per_pixel;
        Ok(Self { root, bytes: bytes as usize, encoded: Vec::new(), shard: None })
    }

    /// Decodes the chunk at `place`; `false` where there is none.
    pub(super) fn read(
        &mut self,
        layout: &ArrayLayout,
        place: &[u64],
        decoded: &mut [u8],
    ) -> Result<bool, ReplayError> {
        let Some(shards) = &layout.shard else {
            let Some(file) = self.open(layout, place)? else { return Ok(false) };
            let length = file.length;
            self.load(&file, 0, length, "chunk")?;
            decode(&file.path, "chunk", layout.codecs, &self.encoded, decoded)?;
            return Ok(true);
        };
        let of_shard: Vec<u64> =
            place.iter().zip(&shards.chunks).map(|(place, number)| place / number).collect();
        let shard = match self.shard.take() {
            Some(shard) if shard.place == of_shard => shard,
            _ => {
                let Some(file) = self.open(layout, &of_shard)? else { return Ok(false) };
                let index = read_index(&file, shards)?;
                OpenShard { place: of_shard, file, index }
            }
        };
        let slot =
            place.iter().zip(&shards.chunks).fold(0, |slot, (place, number)| slot * number + place % number)
                as usize;
        let number = |at: usize| u64::from_le_bytes(std::array::from_fn(|byte| shard.index[at + byte]));
        let (offset, length) = (number(16 * slot), number(16 * slot + 8));
        let is_there = (offset, length) != (u64::MAX, u64::MAX);
        if is_there {
            let field = format!("chunk {slot} of the shard");
            self.load(&shard.file, offset, length, &field)?;
            decode(&shard.file.path, &field, layout.codecs, &self.encoded, decoded)?;
        }
        self.shard = Some(shard);
        Ok(is_there)
    }

    /// Reads the encoded bytes of a chunk.
    fn load(&mut self, file: &SourceFile, offset: u64, length: u64, field: &str) -> Result<(), ReplayError> {
        file.check_inside(offset, length, field)?;
        let most = self.bytes as u64 + self.bytes as u64 / 8 + MOST_GROWTH_BYTES;
        if length > most {
            let detail = format!("{length} bytes where a chunk has {}", self.bytes);
            return Err(ReplayError::damaged(&file.path, field, detail));
        }
        self.encoded.resize(length as usize, 0);
        file.read(&mut self.encoded, offset, field)
    }

    /// Opens the file of a chunk or shard, if it exists.
    fn open(&self, layout: &ArrayLayout, place: &[u64]) -> Result<Option<SourceFile>, ReplayError> {
        let path = self.root.join(layout.key(place));
        let parent = path.parent().unwrap_or(&self.root);
        match fs::canonicalize(parent) {
            Ok(real) if real == parent => {}
            Ok(_) => {
                return Err(ReplayError::damaged(
                    &path,
                    "path",
                    "a link leads to it, and links are not followed",
                ));
            }
            Err(_) => return Ok(None),
        }
        match SourceFile::open_unlinked(&path) {
            Ok(file) => Ok(Some(file)),
            Err(ReplayError::File(FileError::Missing { .. })) => Ok(None),
            Err(error) => Err(error),
        }
    }
}

impl ArrayLayout {
    /// Path of a chunk or shard below the root.
    pub(super) fn key(&self, place: &[u64]) -> String {
        let numbers: Vec<String> = place.iter().map(u64::to_string).collect();
        let separator = self.keys.separator.to_string();
        let numbers = numbers.join(&separator);
        if self.keys.prefix.is_empty() {
            numbers
        } else {
            format!("{}{separator}{numbers}", self.keys.prefix)
        }
    }
}

fn read_index(file: &SourceFile, shards: &Shards) -> Result<Vec<u8>, ReplayError> {
    let field = "index of the shard";
    let plain = 16 * shards.chunks.iter().product::<u64>();
    let bytes = plain + if shards.index_has_checksum { 4 } else { 0 };
    let Some(end) = file.length.checked_sub(bytes) else {
        let detail = format!("{bytes} bytes in a file of {}", file.length);
        return Err(ReplayError::damaged(&file.path, field, detail));
    };
    let mut index = vec![0; bytes as usize];
    file.read(&mut index, if shards.index_at_end { end } else { 0 }, field)?;
    if shards.index_has_checksum {
        check_sum(&file.path, field, &index)?;
    }
    Ok(index)
}

/// Proves the checksum in the last 4 bytes; gives those before.
fn check_sum<'a>(path: &Path, field: &str, bytes: &'a [u8]) -> Result<&'a [u8], ReplayError> {
    let Some((rest, stored)) = bytes.split_last_chunk::<4>() else {
        return Err(ReplayError::damaged(path, field, "no room for a checksum"));
    };
    let (stored, found) = (u32::from_le_bytes(*stored), crc32c::crc32c(rest));
    if stored == found {
        return Ok(rest);
    }
    Err(ReplayError::damaged(
        path,
        field,
        format!("the checksum is {stored:08x}, the bytes have {found:08x}"),
    ))
}

fn decode(
    path: &Path,
    field: &str,
    codecs: Codecs,
    encoded: &[u8],
    decoded: &mut [u8],
) -> Result<(), ReplayError> {
    let mut encoded = encoded;
    for _ in 0..codecs.outer_checksums {
        encoded = check_sum(path, field, encoded)?;
    }
    let bytes = decoded.len() + 4 * codecs.inner_checksums as usize;
    let unpacked;
    let mut plain = match codecs.compression {
        Compression::None => encoded,
        // Straight into its place where nothing has to be checked.
        compression if codecs.inner_checksums == 0 => {
            return unpack(path, field, compression, encoded, decoded);
        }
        compression => {
            let mut memory = vec![0; bytes];
            unpack(path, field, compression, encoded, &mut memory)?;
            unpacked = memory;
            &unpacked
        }
    };
    for _ in 0..codecs.inner_checksums {
        plain = check_sum(path, field, plain)?;
    }
    if plain.len() != decoded.len() {
        let detail = format!("{} bytes where a chunk has {}", plain.len(), decoded.len());
        return Err(ReplayError::damaged(path, field, detail));
    }
    decoded.copy_from_slice(plain);
    Ok(())
}

/// Decompresses exactly as many bytes as there is memory.
fn unpack(
    path: &Path,
    field: &str,
    compression: Compression,
    encoded: &[u8],
    decoded: &mut [u8],
) -> Result<(), ReplayError> {
    let wrong = |error: String| ReplayError::damaged(path, field, error);
    let expected = decoded.len();
    let found = match compression {
        Compression::Zstd => zstd::bulk::decompress_to_buffer(encoded, decoded)
            .map_err(|error| wrong(format!("zstd says: {error}")))?,
        _ => {
            let mut reader = flate2::read::GzDecoder::new(encoded);
            reader.read_exact(decoded).map_err(|error| wrong(format!("gzip says: {error}")))?;
            let more = reader.read(&mut [0]).map_err(|error| wrong(format!("gzip says: {error}")))?;
            expected + more
        }
    };
    if found == expected {
        Ok(())
    } else {
        Err(wrong(format!("{found} bytes or more where a chunk has {expected}")))
    }
}
