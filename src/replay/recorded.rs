//! The frames of one camera of a recording of ours.
//!
//! In: a directory with `recording.json`. Out: the frames that were recorded, in the order in which they came.
//! Never: gives a frame that its checksum does not prove. Fails: [`ReplayError`] with file and line.
//!
//! Frames that were lost, on whatever way, are absent, as they would be at a camera.

use super::ReplayError;
use super::source::{FrameSource, MAX_EXPOSURES, SourceFile, SourceFrame, check_read};
use crate::acquisition::{Analysis, LedgerRow, Loss, RowState};
use crate::recording::{self, CameraDescription, RecordedRun};
use sofiscope_hal::{BlockId, Channel, DeviceTime, Epoch, ExposureIndex, FrameStatus, HostTime};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Name of the file that makes a directory a recording.
pub(super) const METADATA: &str = "recording.json";
const LEDGER: &str = "ledger.csv";
/// Directories below a recorded array, and files in all of them: three for each 64 frames.
const MAX_DEPTH: u32 = 5;
const MAX_ENTRIES: u64 = MAX_EXPOSURES / 16;
/// Longer texts beside the frames are not taken along.
const MAX_TEXT_BYTES: u64 = 1 << 20;

/// A whole recording.
#[derive(Debug)]
pub(super) struct Recorded {
    pub(super) cameras: [CameraDescription; 2],
    pub(super) simulated: bool,
    /// When it was made, and by what, for people.
    pub(super) origin: String,
    pub(super) sources: [RecordedFrames; 2],
    pub(super) exposures: u64,
    pub(super) left_out: BTreeMap<u64, Loss>,
    pub(super) provenance: Vec<(String, String)>,
}

/// The frames of one camera.
#[derive(Debug)]
pub(super) struct RecordedFrames {
    run: RecordedRun,
    channel: Channel,
    image: PathBuf,
    frames: Vec<Place>,
}

/// A frame and where it is.
#[derive(Debug, Clone, Copy)]
struct Place {
    exposure: u64,
    block_id: u64,
    device_ns: u64,
    received_ns: u64,
    epoch: u32,
    page: u32,
}

/// What the rows of the ledger tell.
#[derive(Debug, Default)]
struct Rows {
    places: [Vec<Place>; 2],
    exposures: u64,
    left_out: BTreeMap<u64, Loss>,
}

pub(super) fn open(directory: &Path) -> Result<Recorded, ReplayError> {
    check_plain(directory)?;
    let runs = [recording::open(directory)?, recording::open(directory)?];
    let metadata = runs[0].metadata().clone();
    let Rows { mut places, exposures, left_out } = rows(directory, &runs[0])?;
    let provenance = provenance(directory, &metadata.provenance)?;
    let mut channels = Channel::BOTH.into_iter();
    let sources = runs.map(|run| {
        let channel = channels.next().unwrap_or(Channel::Transmitted);
        let mut frames = std::mem::take(&mut places[channel.index()]);
        // Rows are in order of exposure; a camera may have delivered in another.
        frames.sort_by_key(|place| place.received_ns);
        RecordedFrames { image: directory.join(metadata.image_name(channel)), run, channel, frames }
    });
    let origin = format!("recorded {} by {}", metadata.created, metadata.program);
    let (cameras, simulated) = (metadata.cameras, metadata.simulated);
    Ok(Recorded { cameras, simulated, origin, sources, exposures, left_out, provenance })
}

/// Refuses links, pipes and devices, which could lead elsewhere or keep the reader waiting for ever.
fn check_plain(directory: &Path) -> Result<(), ReplayError> {
    for name in [METADATA, LEDGER, "events.jsonl"] {
        drop(SourceFile::open_unlinked(&directory.join(name))?);
    }
    for camera in ["reflection", "transmission"] {
        let mut left = MAX_ENTRIES;
        for ending in ["tif", "zarr"] {
            check_tree(&directory.join(format!("{camera}.ome.{ending}")), MAX_DEPTH, &mut left)?;
        }
    }
    Ok(())
}

/// Walks over a file or directory; one that is not there is plain.
fn check_tree(path: &Path, depth: u32, left: &mut u64) -> Result<(), ReplayError> {
    let Ok(found) = fs::symlink_metadata(path) else { return Ok(()) };
    let refuse = |detail: &str| Err(ReplayError::damaged(path, "kind of file", detail));
    if found.is_file() {
        return Ok(());
    }
    if !found.is_dir() {
        return refuse("a link, device or pipe");
    }
    let failed = |source| ReplayError::io(path, "list", source);
    for entry in fs::read_dir(path).map_err(failed)? {
        *left = left.saturating_sub(1);
        if depth == 0 || *left == 0 {
            return refuse("more directories and files than a recording has");
        }
        check_tree(&entry.map_err(failed)?.path(), depth - 1, left)?;
    }
    Ok(())
}

fn rows(directory: &Path, run: &RecordedRun) -> Result<Rows, ReplayError> {
    let path = directory.join(LEDGER);
    let mut rows = Rows::default();
    for (at, row) in run.rows()?.enumerate() {
        let (row, line) = (row?, at + 2);
        let (index, exposure) = (row.channel.index(), row.exposure.0);
        let in_order = exposure + 1 >= rows.exposures
            && rows.places[index].last().is_none_or(|place| place.exposure < exposure);
        if !in_order || exposure >= MAX_EXPOSURES {
            let detail = format!("{exposure} after {} exposures", rows.exposures);
            return Err(ReplayError::damaged(&path, format!("line {line}, exposure"), detail));
        }
        rows.exposures = exposure + 1;
        if let Analysis::LeftOut(reason) = row.analysis {
            rows.left_out.insert(exposure, reason);
        }
        if let RowState::Recorded { page, .. } = row.state {
            let pages = run.frames(row.channel);
            if page >= pages {
                let detail =
                    format!("{page} where the file of {} has {pages} frames; recover it first", row.channel);
                return Err(ReplayError::damaged(&path, format!("line {line}, page"), detail));
            }
            let place = place(&row, page).ok_or_else(|| {
                ReplayError::damaged(&path, format!("line {line}"), "a frame without its times")
            })?;
            rows.places[index].push(place);
        }
    }
    Ok(rows)
}

fn place(row: &LedgerRow, page: u64) -> Option<Place> {
    let (block_id, epoch) = row.id?;
    Some(Place {
        exposure: row.exposure.0,
        block_id: block_id.0,
        device_ns: row.device_time?.0,
        received_ns: row.host_time?.0,
        epoch: epoch.0,
        page: u32::try_from(page).ok()?,
    })
}

/// Texts that say how the recording was made; those that are gone or too long are left out.
fn provenance(directory: &Path, names: &[String]) -> Result<Vec<(String, String)>, ReplayError> {
    let mut texts = Vec::new();
    for name in names.iter().take(64) {
        let path = directory.join(name);
        if fs::symlink_metadata(&path).is_err() {
            continue;
        }
        texts.push((name.clone(), SourceFile::open_unlinked(&path)?.text(MAX_TEXT_BYTES)?));
    }
    Ok(texts)
}

impl RecordedFrames {
    fn place(&self, frame: u64) -> Result<Place, ReplayError> {
        let place = usize::try_from(frame).ok().and_then(|frame| self.frames.get(frame)).copied();
        place.ok_or_else(|| {
            let reason = format!("frame {frame} of {} in {}", self.frames.len(), self.image.display());
            ReplayError::Refused { reason }
        })
    }
}

impl FrameSource for RecordedFrames {
    fn frames(&self) -> u64 {
        self.frames.len() as u64
    }

    fn frame(&mut self, frame: u64) -> Result<SourceFrame, ReplayError> {
        let place = self.place(frame)?;
        Ok(SourceFrame {
            exposure: ExposureIndex(place.exposure),
            block_id: BlockId(place.block_id),
            epoch: Epoch(place.epoch),
            device_time: DeviceTime(place.device_ns),
            received: HostTime(place.received_ns),
            status: FrameStatus::Complete,
        })
    }

    fn read(&mut self, frame: u64, counts: &mut [u16]) -> Result<(), ReplayError> {
        let expected = self.run.metadata().cameras[self.channel.index()].pixels();
        check_read(&self.image, (frame, self.frames()), (counts.len(), expected))?;
        let page = u64::from(self.place(frame)?.page);
        Ok(self.run.read_checked(self.channel, page, counts)?)
    }
}
