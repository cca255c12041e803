//! Files of every kind that is replayed, written byte by byte.

use crate::common::{LEN, SIDE, pixels};
use serde_json::{Value, json};
use sofiscope_hal::Channel;
use std::fs;
use std::path::{Path, PathBuf};

/// What a `.dcimg` file has.
#[derive(Debug, Clone)]
pub(crate) struct Dcimg {
    pub(crate) version: u32,
    pub(crate) channel: Channel,
    /// Number and time in microseconds of each frame.
    pub(crate) stamps: Vec<(u32, u64)>,
    /// Bytes behind the pixels of each row.
    pub(crate) padding: usize,
    pub(crate) footer_bytes: usize,
    /// First row on the sensor.
    pub(crate) top: u16,
}

impl Dcimg {
    pub(crate) fn new(version: u32, channel: Channel) -> Self {
        let stamps = (0..12).map(|frame| (frame, 1_700_000_000_000_000 + u64::from(frame) * 5000)).collect();
        Self { version, channel, stamps, padding: 0, footer_bytes: 32, top: 1020 }
    }

    /// The row whose first pixels lie elsewhere.
    pub(crate) fn marked_row(&self) -> Option<usize> {
        match self.version {
            7 => Some(2),
            0x200_0000 => Some(0),
            _ => (1023_usize).checked_sub(usize::from(self.top)).filter(|row| *row < SIDE as usize),
        }
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        let (side, frames) = (SIDE as usize, self.stamps.len());
        let row_bytes = 2 * side + self.padding;
        let is_old = self.version == 7;
        let (session_at, data_at) = (80, if is_old { 100 } else { 740 });
        let mut bytes = vec![0; session_at + data_at];
        bytes[..5].copy_from_slice(b"DCIMG");
        let mut put = |at: usize, value: u64, width: usize| {
            bytes[at..at + width].copy_from_slice(&value.to_le_bytes()[..width]);
        };
        put(8, u64::from(self.version), 4);
        put(36, frames as u64, 4);
        put(40, session_at as u64, 4);
        let sizes = [frames, 2, side, side, row_bytes, row_bytes * side].map(|size| size as u64);
        let places = if is_old { [32, 36, 44, 52, 48, 56] } else { [60, 64, 72, 76, 80, 84] };
        for (place, size) in places.into_iter().zip(sizes) {
            put(session_at + place, size, 4);
        }
        if is_old {
            put(session_at + 68, data_at as u64, 4);
            put(session_at + 72, (data_at + frames * row_bytes * side) as u64, 8);
        } else {
            put(session_at + 96, data_at as u64, 8);
            put(session_at + 124, self.footer_bytes as u64, 4);
            for (at, value) in [(0, 0), (2, side), (4, usize::from(self.top)), (6, side)] {
                put(session_at + 712 + at, value as u64, 2);
            }
        }
        let mut lost = Vec::new();
        for (frame, (number, time)) in (0_u64..).zip(&self.stamps) {
            let mut counts = pixels(self.channel, frame);
            let marked = self.marked_row().map(|row| &mut counts[row * side..row * side + 4]);
            let elsewhere: Vec<u8> = marked.map_or(vec![0; 8], |marked| {
                let pixels = marked.iter().flat_map(|count| count.to_le_bytes()).collect();
                marked.copy_from_slice(&[0, 0xffff, 0, 0xffff]);
                pixels
            });
            for row in counts.chunks(side) {
                bytes.extend(row.iter().flat_map(|count| count.to_le_bytes()));
                bytes.extend(vec![0xee; self.padding]);
            }
            if !is_old {
                let mut footer = vec![0; self.footer_bytes];
                footer[..4].copy_from_slice(&number.to_le_bytes());
                footer[4..8].copy_from_slice(&((time / 1_000_000) as u32).to_le_bytes());
                footer[8..12].copy_from_slice(&((time % 1_000_000) as u32).to_le_bytes());
                if self.footer_bytes >= 20 {
                    footer[12..20].copy_from_slice(&elsewhere);
                }
                bytes.extend(footer);
            }
            lost.extend(elsewhere);
        }
        if is_old {
            bytes.extend(self.footer(row_bytes, &lost));
        }
        bytes
    }

    /// The footer of the old layout.
    fn footer(&self, row_bytes: usize, lost: &[u8]) -> Vec<u8> {
        let mut footer = vec![0; 272];
        let lost_at = 272 + 12 * self.stamps.len();
        footer[8..16].copy_from_slice(&160_u64.to_le_bytes());
        footer[40..44].copy_from_slice(&((lost_at + lost.len()) as u32).to_le_bytes());
        footer[160 + 88..160 + 96].copy_from_slice(&(lost_at as u64).to_le_bytes());
        footer[160 + 100..160 + 104].copy_from_slice(&((2 * row_bytes) as u32).to_le_bytes());
        footer.extend(self.stamps.iter().flat_map(|(number, _)| number.to_le_bytes()));
        for (_, time) in &self.stamps {
            footer.extend(((time / 1_000_000) as u32).to_le_bytes());
            footer.extend(((time % 1_000_000) as u32).to_le_bytes());
        }
        footer.extend(lost);
        footer
    }
}

/// Writes both cameras' files; gives their paths.
pub(crate) fn dcimg_pair(folder: &Path, files: [Dcimg; 2]) -> [PathBuf; 2] {
    files.map(|file| {
        let path = folder.join(format!("{}.dcimg", file.channel.letter()));
        fs::write(&path, file.bytes()).unwrap();
        path
    })
}

/// How an array is stored.
#[derive(Debug, Clone)]
pub(crate) struct Zarr {
    /// Shape of chunks along time, rows and columns.
    pub(crate) chunk: [usize; 3],
    /// Frames of a shard, if there are shards.
    pub(crate) shard: Option<usize>,
    pub(crate) codecs: &'static [&'static str],
    pub(crate) index_location: &'static str,
    pub(crate) separator: &'static str,
    pub(crate) is_big_endian: bool,
}

impl Default for Zarr {
    fn default() -> Self {
        Self {
            chunk: [1, SIDE as usize, SIDE as usize],
            shard: None,
            codecs: &[],
            index_location: "end",
            separator: "/",
            is_big_endian: false,
        }
    }
}

impl Zarr {
    pub(crate) fn metadata(&self, frames: usize) -> Value {
        let side = SIDE as usize;
        let endian = if self.is_big_endian { "big" } else { "little" };
        let mut codecs = vec![json!({"name": "bytes", "configuration": {"endian": endian}})];
        codecs.extend(self.codecs.iter().map(|name| json!({"name": name})));
        let mut grid = self.chunk;
        if let Some(shard) = self.shard {
            grid[0] = shard;
            codecs = vec![json!({"name": "sharding_indexed", "configuration": {
                "chunk_shape": self.chunk,
                "codecs": codecs,
                "index_codecs": [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "crc32c"}],
                "index_location": self.index_location,
            }})];
        }
        json!({
            "zarr_format": 3,
            "node_type": "array",
            "shape": [frames, side, side],
            "data_type": "uint16",
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": grid}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": self.separator}},
            "fill_value": 0,
            "codecs": codecs,
            "dimension_names": ["t", "y", "x"],
        })
    }

    pub(crate) fn write(&self, root: &Path, channel: Channel, frames: usize) -> PathBuf {
        let side = SIDE as usize;
        fs::create_dir_all(root).unwrap();
        fs::write(root.join("zarr.json"), self.metadata(frames).to_string()).unwrap();
        let grid = [frames, side, side].map(|length| length);
        let number = |axis: usize| grid[axis].div_ceil(self.chunk[axis]);
        for first in (0..number(0)).step_by(self.shard.map_or(1, |shard| shard / self.chunk[0])) {
            for (y, x) in (0..number(1)).flat_map(|y| (0..number(2)).map(move |x| (y, x))) {
                let in_shard = self.shard.map_or(1, |shard| shard / self.chunk[0]);
                let chunks: Vec<Vec<u8>> =
                    (first..first + in_shard).map(|t| self.encoded(channel, frames, [t, y, x])).collect();
                let file = [first / in_shard, y, x].map(|number| number.to_string()).join(self.separator);
                let path = root.join(format!("c{}{file}", self.separator));
                fs::create_dir_all(path.parent().unwrap()).unwrap();
                let bytes = if self.shard.is_some() { self.shard_of(&chunks) } else { chunks[0].clone() };
                fs::write(path, bytes).unwrap();
            }
        }
        root.to_path_buf()
    }

    fn encoded(&self, channel: Channel, frames: usize, [t, y, x]: [usize; 3]) -> Vec<u8> {
        let side = SIDE as usize;
        let [frames_in, rows, columns] = self.chunk;
        let mut bytes = Vec::new();
        for frame in t * frames_in..(t + 1) * frames_in {
            let counts = if frame < frames { pixels(channel, frame as u64) } else { vec![0; LEN] };
            for row in y * rows..(y + 1) * rows {
                for column in x * columns..(x + 1) * columns {
                    let count = if row < side && column < side { counts[row * side + column] } else { 0 };
                    bytes.extend(if self.is_big_endian { count.to_be_bytes() } else { count.to_le_bytes() });
                }
            }
        }
        self.codecs.iter().fold(bytes, |bytes, codec| match *codec {
            "gzip" => {
                use std::io::Write;
                let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
                encoder.write_all(&bytes).unwrap();
                encoder.finish().unwrap()
            }
            "zstd" => zstd::bulk::compress(&bytes, 1).unwrap(),
            _ => {
                let checksum = crc32c::crc32c(&bytes).to_le_bytes();
                [bytes, checksum.to_vec()].concat()
            }
        })
    }

    fn shard_of(&self, chunks: &[Vec<u8>]) -> Vec<u8> {
        let index_bytes = 16 * chunks.len() + 4;
        let mut offset = if self.index_location == "start" { index_bytes } else { 0 };
        let mut index = Vec::new();
        for chunk in chunks {
            index.extend((offset as u64).to_le_bytes());
            index.extend((chunk.len() as u64).to_le_bytes());
            offset += chunk.len();
        }
        index.extend(crc32c::crc32c(&index).to_le_bytes());
        let pixels = chunks.concat();
        if self.index_location == "start" { [index, pixels].concat() } else { [pixels, index].concat() }
    }
}

/// Writes `name.raw` and `name.toml`; gives the path of the first.
pub(crate) fn raw(folder: &Path, name: &str, channel: Channel, frames: u64, is_big_endian: bool) -> PathBuf {
    let path = folder.join(format!("{name}.raw"));
    let mut bytes = vec![7; 10];
    for frame in 0..frames {
        for count in pixels(channel, frame) {
            bytes.extend(if is_big_endian { count.to_be_bytes() } else { count.to_le_bytes() });
        }
    }
    fs::write(&path, bytes).unwrap();
    let order = if is_big_endian { "big" } else { "little" };
    let header = format!(
        "width = {SIDE}\nheight = {SIDE}\nframes = {frames}\noffset_bytes = 10\nbyte_order = \"{order}\"\n\
         bits = 16\nperiod_ms = 5.0\n"
    );
    fs::write(path.with_extension("toml"), header).unwrap();
    path
}
