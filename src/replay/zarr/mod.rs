//! Arrays of Zarr version 3, with or without OME metadata, as the frames of cameras.
//!
//! In: a directory with `zarr.json`. Out: place `k` along the axis of time as exposure `k`, one source per channel.
//! Never: follows links, makes a frame of which no chunk is there. Fails: [`ReplayError`] with file and field.
//!
//! Codecs: `bytes`, `gzip`, `zstd`, `crc32c`, and `sharding_indexed` around them.

mod chunks;
mod metadata;

use super::ReplayError;
use super::source::{FrameSource, Numbering, Opened, SourceFrame, check_read};
use super::stack::{Even, PERIOD_UNKNOWN};
use chunks::Chunks;
pub(super) use metadata::METADATA;
use metadata::{ArrayLayout, MAX_CHUNK_BYTES};
use std::path::Path;
use std::time::Duration;

#[derive(Debug)]
struct ZarrFrames {
    layout: ArrayLayout,
    channel: u64,
    chunks: Chunks,
    /// Decoded chunks: all of a frame where chunks hold several frames and memory allows, else one.
    pieces: Vec<Piece>,
    even: Even,
}

/// A decoded chunk.
#[derive(Debug, Clone)]
struct Piece {
    place: Vec<u64>,
    is_there: bool,
    bytes: Vec<u8>,
}

/// Opens each channel of an array with handles of its own.
pub(super) fn open(directory: &Path, period: Option<Duration>) -> Result<Vec<Opened>, ReplayError> {
    let layout = metadata::read(directory)?;
    let channels = layout.channel_axis.map_or(1, |axis| layout.shape[axis]);
    let known = period.or(layout.period);
    let even = Even { period: known.unwrap_or(PERIOD_UNKNOWN) };
    (0..channels)
        .map(|channel| {
            let source = ZarrFrames::new(layout.clone(), channel, even)?;
            Ok(Opened {
                path: directory.to_path_buf(),
                height: source.height() as u32,
                width: source.width() as u32,
                exposures: layout.shape[layout.frame_axis],
                numbering: Numbering::Counted,
                period: known,
                pixel_size_nm: layout.pixel_size_nm,
                saturation_counts: if layout.bytes_per_pixel == 1 { 255 } else { u16::MAX },
                simulated: false,
                kind: "Zarr",
                source: Box::new(source),
            })
        })
        .collect()
}

impl ZarrFrames {
    fn new(layout: ArrayLayout, channel: u64, even: Even) -> Result<Self, ReplayError> {
        let chunks = Chunks::new(&layout)?;
        let [rows, columns] = pieces_of(&layout);
        let is_shared = layout.chunk[layout.frame_axis] > 1;
        let all = rows * columns;
        let fits = all * chunks.bytes as u64 <= MAX_CHUNK_BYTES;
        let number = if is_shared && fits { all } else { 1 };
        let empty = Piece { place: Vec::new(), is_there: false, bytes: Vec::new() };
        Ok(Self { layout, channel, chunks, pieces: vec![empty; number as usize], even })
    }

    fn height(&self) -> u64 {
        self.layout.shape[self.layout.shape.len() - 2]
    }

    fn width(&self) -> u64 {
        self.layout.shape[self.layout.shape.len() - 1]
    }

    /// Place of a chunk in the grid, and offset of the frame's pixels in it, in pixels.
    fn place(&self, frame: u64, row: u64, column: u64) -> (Vec<u64>, u64) {
        let ArrayLayout { shape, chunk, frame_axis, channel_axis, .. } = &self.layout;
        let last = shape.len() - 1;
        let mut place = vec![0; shape.len()];
        let mut offset = 0;
        for axis in 0..last - 1 {
            let at = match axis {
                _ if axis == *frame_axis => frame,
                _ if Some(axis) == *channel_axis => self.channel,
                _ => 0,
            };
            place[axis] = at / chunk[axis];
            offset = offset * chunk[axis] + at % chunk[axis];
        }
        (place[last - 1], place[last]) = (row, column);
        (place, offset * chunk[last - 1] * chunk[last])
    }

    /// Brings a chunk into memory; gives the number of its piece.
    fn load(&mut self, place: Vec<u64>, number: usize) -> Result<usize, ReplayError> {
        let number = number % self.pieces.len();
        let piece = &mut self.pieces[number];
        if piece.place == place {
            return Ok(number);
        }
        piece.place.clear();
        piece.bytes.resize(self.chunks.bytes, 0);
        piece.is_there = self.chunks.read(&self.layout, &place, &mut piece.bytes)?;
        piece.place = place;
        Ok(number)
    }
}

/// Rows and columns of the chunks of one frame.
fn pieces_of(layout: &ArrayLayout) -> [u64; 2] {
    let last = layout.shape.len() - 1;
    [last - 1, last].map(|axis| layout.shape[axis].div_ceil(layout.chunk[axis]))
}

impl FrameSource for ZarrFrames {
    fn frames(&self) -> u64 {
        self.layout.shape[self.layout.frame_axis]
    }

    fn frame(&mut self, frame: u64) -> Result<SourceFrame, ReplayError> {
        Ok(self.even.frame(frame))
    }

    fn read(&mut self, frame: u64, counts: &mut [u16]) -> Result<(), ReplayError> {
        let (height, width) = (self.height() as usize, self.width() as usize);
        check_read(&self.layout.root, (frame, self.frames()), (counts.len(), height * width))?;
        let last = self.layout.shape.len() - 1;
        let [rows, columns] = [self.layout.chunk[last - 1] as usize, self.layout.chunk[last] as usize];
        let [pieces_down, pieces_across] = pieces_of(&self.layout);
        let mut missing = 0;
        for piece_row in 0..pieces_down {
            for piece_column in 0..pieces_across {
                let (place, offset) = self.place(frame, piece_row, piece_column);
                let number = self.load(place, (piece_row * pieces_across + piece_column) as usize)?;
                let piece = &self.pieces[number];
                missing += u64::from(!piece.is_there);
                let [top, left] = [piece_row as usize * rows, piece_column as usize * columns];
                let copied = columns.min(width - left);
                for row in 0..rows.min(height - top) {
                    let target = &mut counts[(top + row) * width + left..][..copied];
                    if piece.is_there {
                        copy(&piece.bytes, offset as usize + row * columns, &self.layout, target);
                    } else {
                        target.fill(self.layout.fill);
                    }
                }
            }
        }
        if missing == pieces_down * pieces_across {
            let (place, _) = self.place(frame, 0, 0);
            let detail =
                format!("no chunk of frame {frame} is there, for example {}", self.layout.key(&place));
            return Err(ReplayError::damaged(&self.layout.root, "chunks", detail));
        }
        Ok(())
    }
}

/// Copies pixels from place `at` of a chunk.
fn copy(bytes: &[u8], at: usize, layout: &ArrayLayout, target: &mut [u16]) {
    if layout.bytes_per_pixel == 1 {
        for (count, byte) in target.iter_mut().zip(&bytes[at..]) {
            *count = u16::from(*byte);
        }
        return;
    }
    let (pairs, _) = bytes[2 * at..].as_chunks::<2>();
    for (count, pair) in target.iter_mut().zip(pairs) {
        *count =
            if layout.codecs.is_big_endian { u16::from_be_bytes(*pair) } else { u16::from_le_bytes(*pair) };
    }
}
