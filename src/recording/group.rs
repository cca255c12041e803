//! A group of exposures: frames of both cameras that are committed together, and their rows.
//!
//! In: rows as far as they are known, and frames. Out: frames in the files, rows with page and checksum.
//! Never: decides what a failure means. Fails: [`RecordingError`]; rows are then marked by [`lose_beyond`].

use super::RecordingError;
use super::facts::{self, FactsBytes};
use super::writer::{ImageWriter, Staged};
use crate::acquisition::{Frame, LedgerRow, Loss, RowState};

/// From this size on, both cameras' frames are written side by side.
const SIDE_BY_SIDE_BYTES: usize = 1 << 20;

/// One exposure on its way to the disk.
#[derive(Debug)]
pub(super) struct Pending {
    pub(super) rows: [LedgerRow; 2],
    pub(super) frames: [Option<Frame>; 2],
}

/// Writes the frames of a group to the files of both cameras, then makes readers see them.
pub(super) fn write_images(
    images: &mut [ImageWriter; 2],
    group: &mut [Pending],
) -> Result<(), RecordingError> {
    let (mut side_r, mut side_t): (Vec<Numbered<'_>>, Vec<Numbered<'_>>) = (Vec::new(), Vec::new());
    for Pending { rows: [row_r, row_t], frames: [frame_r, frame_t] } in group {
        side_r.extend(frame_r.as_ref().map(|frame| (row_r, frame)));
        side_t.extend(frame_t.as_ref().map(|frame| (row_t, frame)));
    }
    let bytes: usize = side_t.iter().map(|(_, frame)| frame.bytes().len()).sum();
    let [image_r, image_t] = images;
    if bytes < SIDE_BY_SIDE_BYTES {
        stage(image_r, side_r)?;
        stage(image_t, side_t)?;
    } else {
        // Checksums of one camera are computed while the disk is busy with the other.
        std::thread::scope(|scope| {
            let other = scope.spawn(|| stage(image_t, side_t));
            let this = stage(image_r, side_r);
            let other = other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            this.and(other)
        })?;
    }
    images.iter_mut().try_for_each(ImageWriter::publish)
}

/// A frame and its row, which gets page and checksum.
type Numbered<'a> = (&'a mut LedgerRow, &'a Frame);

/// Numbers the frames of one camera and writes them, not yet for readers to see.
fn stage(image: &mut ImageWriter, side: Vec<Numbered<'_>>) -> Result<(), RecordingError> {
    if side.is_empty() {
        return Ok(());
    }
    let mut facts: Vec<FactsBytes> = Vec::with_capacity(side.len());
    let mut pixels = Vec::with_capacity(side.len());
    for ((row, frame), page) in side.into_iter().zip(image.pages()..) {
        row.state = RowState::Recorded { page, crc32c: crc32c::crc32c(frame.bytes()) };
        facts.push(facts::encode(row).unwrap_or([0; facts::FACTS_BYTES]));
        pixels.push(frame.bytes());
    }
    let staged: Vec<Staged<'_>> =
        pixels.into_iter().zip(&facts).map(|(pixels, facts)| Staged { pixels, facts }).collect();
    image.stage(&staged)
}

/// Marks every frame of a group as lost.
pub(super) fn lose(group: &mut [Pending], loss: Loss) {
    lose_beyond(group, [0; 2], loss);
}

/// Marks the frames at `pages` and behind as lost, and those that have no page yet.
pub(super) fn lose_beyond(group: &mut [Pending], pages: [u64; 2], loss: Loss) {
    for Pending { rows, frames } in group {
        for ((row, frame), pages) in rows.iter_mut().zip(frames.iter_mut()).zip(pages) {
            let is_there = matches!(row.state, RowState::Recorded { page, .. } if page < pages);
            if frame.take().is_some() && !is_there {
                row.state = RowState::Lost(loss);
            }
        }
    }
}
