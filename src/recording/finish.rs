//! The end of an image file: the number of frames is promised only when it is known.
//!
//! In: a file with all its pages. Out: for TIFF, OME-XML behind the last page and then the description that names it.
//! Never: moves a page or touches a pixel. Fails: [`RecordingError`]; the file is then a plain stack of pages.

use super::RecordingError;
use super::direct::PAGE;
use super::gate::{Change, Gate, Operation};
use super::metadata::Metadata;
use super::writer::ImageWriter;
use super::zarr;
use crate::files::{OmeImage, ome_document};
use sofiscope_hal::Channel;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Files with more pages than this leave the times to the ledger.
pub(super) const MAX_PLANE_TIMES: usize = 20_000;
/// Fields of a directory of ours.
const MAX_FIELDS: u64 = 32;

/// Closes the images of one camera.
pub(super) fn finish_image(
    image: &mut ImageWriter,
    metadata: &Metadata,
    channel: Channel,
    times: &[u64],
    gate: &Gate,
) -> Result<(), RecordingError> {
    image.cut()?;
    let path = image.path();
    match image {
        ImageWriter::Tiff { file, .. } => {
            let (pages, end) = (file.pages(), file.bytes());
            describe(&path, metadata, channel, pages, times, end, gate)
        }
        ImageWriter::Zarr(_) => zarr::sync_metadata(&path, gate),
    }
}

/// Writes the OME-XML of a file with `pages` pages at `end`, a whole page, and makes the first directory name it.
pub(super) fn describe(
    path: &Path,
    metadata: &Metadata,
    channel: Channel,
    pages: u64,
    times: &[u64],
    end: u64,
    gate: &Gate,
) -> Result<(), RecordingError> {
    if pages == 0 {
        return Ok(());
    }
    let mut text = ome_xml(metadata, channel, pages, times).into_bytes();
    text.push(0);
    let count = text.len() as u64;
    text.resize(text.len().next_multiple_of(PAGE), 0);
    let write = |file: &File, bytes: &[u8], offset| -> std::io::Result<()> {
        gate.pass(Operation::Write, path).and_then(|()| file.write_all_at(bytes, offset))?;
        gate.note(Change::Bytes(offset, bytes), path);
        Ok(())
    };
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .open(path)
        .map_err(|source| RecordingError::storage(path, "open", source))?;
    write(&file, &text, end)
        .and_then(|()| file.set_len(end + text.len() as u64))
        .and_then(|()| gate.pass(Operation::Sync, path))
        .and_then(|()| file.sync_data())
        .and_then(|()| {
            gate.note(Change::Synced, path);
            let (at, mut field) = description_field(&file)?;
            field[4..12].copy_from_slice(&count.to_le_bytes());
            field[12..].copy_from_slice(&end.to_le_bytes());
            write(&file, &field, at)
        })
        .map_err(|source| {
            let _ = file.set_len(end);
            RecordingError::storage(path, "write the description of", source)
        })
}

/// Place and bytes of the description in the first directory.
fn description_field(file: &File) -> std::io::Result<(u64, [u8; 20])> {
    let mut word = [0; 8];
    file.read_exact_at(&mut word, 8)?;
    let ifd = u64::from_le_bytes(word);
    file.read_exact_at(&mut word, ifd)?;
    for index in 0..u64::from_le_bytes(word).min(MAX_FIELDS) {
        let at = ifd + 8 + index * 20;
        let mut field = [0; 20];
        file.read_exact_at(&mut field, at)?;
        if u16::from_le_bytes([field[0], field[1]]) == 270 {
            return Ok((at, field));
        }
    }
    Err(std::io::Error::new(std::io::ErrorKind::InvalidData, "the first page has no description"))
}

fn ome_xml(metadata: &Metadata, channel: Channel, pages: u64, times: &[u64]) -> String {
    let camera = &metadata.cameras[channel.index()];
    let period = camera.settings.period.as_secs_f64();
    let has_times = times.len() as u64 == pages;
    let first = times.first().copied().unwrap_or(0);
    let delta_t_s: Vec<f64> = times
        .iter()
        .filter(|_| has_times)
        .map(|time| time.wrapping_sub(first).cast_signed() as f64 / 1e9)
        .collect();
    let settings = vec![
        ("camera".to_owned(), format!("{} {}", camera.identity.vendor, camera.identity.model)),
        ("serial number".to_owned(), camera.identity.serial.clone()),
        ("exposure time in s".to_owned(), camera.settings.exposure.as_secs_f64().to_string()),
        ("simulated".to_owned(), metadata.simulated.to_string()),
        ("created".to_owned(), metadata.created.to_string()),
    ];
    ome_document(&OmeImage {
        name: &metadata.image_name(channel),
        description: "raw frames; ledger.csv names the exposure of each",
        sample: "uint16",
        height: camera.height(),
        width: camera.width(),
        channels: &[channel.to_string()],
        frames: usize::try_from(pages).unwrap_or(usize::MAX),
        pixel_size_nm: camera.pixel_size_nm,
        frame_interval_s: (period > 0.0).then_some(period),
        delta_t_s: &delta_t_s,
        settings: &settings,
    })
}
