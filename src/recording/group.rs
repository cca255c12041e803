//! A group of exposures: frames of both cameras that are committed together, and their rows.
//!
//! In: rows as far as they are known, and frames. Out: frames in the files, rows with page and checksum.
//! Never: decides what a failure means. Fails: [`RecordingError`]; rows are then marked by [`lose_beyond`].

use super::RecordingError;
use super::facts::{self, FactsBytes};
use super::writer::ImageWriter;
use crate::acquisition::{Frame, LedgerRow, Loss, RowState};

/// From this size on, the frames of both cameras are written side by side.
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
    let [image_r, image_t] = images;
    let pages = [image_r.pages(), image_t.pages()];
    let [pixels_r, pixels_t] = [&side_r, &side_t].map(|side| pixels(side));
    let bytes: usize = pixels_t.iter().map(|frame| frame.len()).sum();
    let facts = if bytes < SIDE_BY_SIDE_BYTES {
        image_r.stage(&pixels_r)?;
        image_t.stage(&pixels_t)?;
        [number(side_r, pages[0]), number(side_t, pages[1])]
    } else {
        // Checksums are computed while the disk is busy, so that it never waits for them.
        std::thread::scope(|scope| {
            let writing_r = scope.spawn(|| image_r.stage(&pixels_r));
            let writing_t = scope.spawn(|| image_t.stage(&pixels_t));
            let facts = [number(side_r, pages[0]), number(side_t, pages[1])];
            let [wrote_r, wrote_t] = [writing_r, writing_t]
                .map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
            wrote_r.and(wrote_t).map(|()| facts)
        })?
    };
    images.iter_mut().zip(&facts).try_for_each(|(image, facts)| image.publish(facts))
}

/// A frame and its row, which gets page and checksum.
type Numbered<'a> = (&'a mut LedgerRow, &'a Frame);

fn pixels<'a>(side: &[Numbered<'a>]) -> Vec<&'a [u8]> {
    side.iter().map(|(_, frame)| frame.bytes()).collect()
}

/// Numbers the frames of one camera from `pages` on; what each carries with it.
fn number(side: Vec<Numbered<'_>>, pages: u64) -> Vec<FactsBytes> {
    let of_frame = |((row, frame), page): (Numbered<'_>, u64)| {
        row.state = RowState::Recorded { page, crc32c: crc32c::crc32c(frame.bytes()) };
        facts::encode(row).unwrap_or([0; facts::FACTS_BYTES])
    };
    side.into_iter().zip(pages..).map(of_frame).collect()
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
