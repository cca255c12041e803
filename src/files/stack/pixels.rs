//! From the strips and tiles of one page to one frame in memory.
//!
//! In: a page and memory of exactly one frame. Out: samples in this computer's byte order, predictor undone.
//! Never: holds a second frame; at most one row of a tile. Fails: [`FileError`] naming page and strip.

use std::io::{self, Read};

use super::SampleType;
use super::decompress::plain_bytes;
use super::page::{Chunk, Compression, Geometry, Page, Predictor};
use super::source::Source;
use crate::files::FileError;

const FIELD: &str = "pixel data";

/// Reads `page` into `frame`, which has `geometry.frame_bytes()` bytes.
pub(super) fn read_page(
    source: &Source,
    page: &Page,
    geometry: Geometry,
    frame: &mut [u8],
) -> Result<(), FileError> {
    let chunks = page.chunks(source, geometry)?;
    if let Some(offset) = contiguous_start(page, &chunks) {
        source.read(frame, offset, page.place, FIELD)?;
        make_native(frame, geometry.sample, source);
        return Ok(());
    }
    let mut row = vec![0; page.chunk_row_bytes(geometry)];
    for (index, chunk) in chunks.iter().enumerate() {
        read_chunk(source, page, geometry, (index, *chunk), &mut row, frame).map_err(|error| {
            let noun = if page.is_tiled { "tile" } else { "strip" };
            let detail = match error.kind() {
                io::ErrorKind::UnexpectedEof => "it ends too early".to_owned(),
                _ => error.to_string(),
            };
            let detail = format!("{noun} {} of {}: {detail}", index + 1, chunks.len());
            source.damaged(page.place, FIELD, detail)
        })?;
    }
    Ok(())
}

/// Reads samples of a plain frame at `offset`, as in ImageJ stacks with a single directory.
pub(super) fn read_plain(
    source: &Source,
    page: &Page,
    geometry: Geometry,
    offset: u64,
    frame: &mut [u8],
) -> Result<(), FileError> {
    source.read(frame, offset, page.place, FIELD)?;
    make_native(frame, geometry.sample, source);
    Ok(())
}

/// Where the frame starts when it lies in the file in one piece.
pub(super) fn contiguous_start(page: &Page, chunks: &[Chunk]) -> Option<u64> {
    let is_seamless = chunks.windows(2).all(|pair| pair[0].offset + pair[0].bytes == pair[1].offset);
    let is_plain = page.compression == Compression::None && !page.is_tiled;
    (is_plain && is_seamless).then(|| chunks[0].offset)
}

fn read_chunk(
    source: &Source,
    page: &Page,
    geometry: Geometry,
    (index, chunk): (usize, Chunk),
    row: &mut [u8],
    frame: &mut [u8],
) -> io::Result<()> {
    let section = source.section(chunk.offset, chunk.bytes);
    let mut plain = plain_bytes(section, chunk.bytes, page.compression)?;
    let across = page.chunks_across(geometry);
    let left = index % across * row.len();
    let top = index / across * page.chunk_height;
    let visible = row.len().min(geometry.row_bytes() - left);
    for y in top..top + page.rows_of(geometry, index) {
        plain.read_exact(row)?;
        let start = y * geometry.row_bytes() + left;
        let target = &mut frame[start..start + visible];
        match page.predictor {
            Predictor::FloatingPoint => undo_floating_point(row, target),
            Predictor::None => {
                target.copy_from_slice(&row[..visible]);
                make_native(target, geometry.sample, source);
            }
            Predictor::Horizontal => {
                make_native(row, geometry.sample, source);
                undo_horizontal(row, geometry.sample);
                target.copy_from_slice(&row[..visible]);
            }
        }
    }
    Ok(())
}

fn make_native(bytes: &mut [u8], sample: SampleType, source: &Source) {
    if source.order.is_native() {
        return;
    }
    match sample {
        SampleType::Uint8 => {}
        SampleType::Uint16 => bytes.as_chunks_mut::<2>().0.iter_mut().for_each(|number| number.reverse()),
        SampleType::Float32 => bytes.as_chunks_mut::<4>().0.iter_mut().for_each(|number| number.reverse()),
    }
}

/// Predictor 2: each sample is the difference to its left neighbor, modulo its width (TIFF 6.0, section 14).
fn undo_horizontal(row: &mut [u8], sample: SampleType) {
    match sample {
        SampleType::Uint8 => accumulate::<1>(row, |sum, step| [sum[0].wrapping_add(step[0])]),
        SampleType::Uint16 => accumulate::<2>(row, |sum, step| {
            u16::from_ne_bytes(sum).wrapping_add(u16::from_ne_bytes(step)).to_ne_bytes()
        }),
        SampleType::Float32 => accumulate::<4>(row, |sum, step| {
            u32::from_ne_bytes(sum).wrapping_add(u32::from_ne_bytes(step)).to_ne_bytes()
        }),
    }
}

fn accumulate<const N: usize>(row: &mut [u8], add: impl Fn([u8; N], [u8; N]) -> [u8; N]) {
    let mut sum = [0; N];
    let (numbers, _) = row.as_chunks_mut::<N>();
    for number in numbers {
        sum = add(sum, *number);
        *number = sum;
    }
}

/// Predictor 3: bytes of equal significance together, most significant first, as differences (Adobe technical note 3).
fn undo_floating_point(row: &mut [u8], target: &mut [u8]) {
    accumulate::<1>(row, |sum, step| [sum[0].wrapping_add(step[0])]);
    let width = row.len() / 4;
    let (numbers, _) = target.as_chunks_mut::<4>();
    for (x, number) in numbers.iter_mut().enumerate() {
        let bits = [row[x], row[width + x], row[2 * width + x], row[3 * width + x]];
        *number = u32::from_be_bytes(bits).to_ne_bytes();
    }
}
