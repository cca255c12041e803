//! Frames and ledger of a crashed recording brought together, row by row.
//!
//! In: the old rows as far as they can be read, and the frames with the facts they carry.
//! Out: every exposure of each camera once, in order. Never: a row of a frame that is not there.
//! Fails: [`RecordingError`] when the frames contradict their own order.

use super::RecordingError;
use super::ledger_file::LEDGER;
use super::reader::{ImagePages, LedgerRows};
use crate::acquisition::{Analysis, Conditions, LedgerRow, Loss, PairState, RowState};
use sofiscope_hal::{Channel, ExposureIndex};
use std::path::Path;

/// Longer gaps between exposures are no gaps of a recording.
const MAX_GAP: u64 = 10_000_000;

/// What is different from the old ledger.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Changes {
    pub(super) added: u64,
    pub(super) changed: u64,
    /// Lines that are no rows or not in their place.
    pub(super) dropped: u64,
    pub(super) torn_bytes: u64,
}

/// The merge under way.
pub(super) struct Merge<'a> {
    /// `None` for a ledger that has not even its header.
    old: Option<LedgerRows>,
    next_old: Option<LedgerRow>,
    images: &'a mut [ImagePages; 2],
    next_page: [u64; 2],
    next_frame: [Option<LedgerRow>; 2],
    ledger_bytes: u64,
    /// Place and light of the recording, which frames do not carry.
    conditions: Conditions,
    changes: Changes,
}

impl<'a> Merge<'a> {
    pub(super) fn of(
        directory: &Path,
        images: &'a mut [ImagePages; 2],
        conditions: Conditions,
    ) -> Result<Self, RecordingError> {
        let ledger_bytes = std::fs::metadata(directory.join(LEDGER)).map_or(0, |metadata| metadata.len());
        let mut merge = Self {
            old: LedgerRows::open(directory).ok(),
            next_old: None,
            images,
            next_page: [0; 2],
            next_frame: [None, None],
            ledger_bytes,
            conditions,
            changes: Changes::default(),
        };
        if merge.old.is_none() {
            merge.changes.dropped += 1;
        }
        merge.take_old(None);
        for channel in Channel::BOTH {
            merge.take_frame(channel)?;
        }
        Ok(merge)
    }

    /// Hands every row to `each`.
    pub(super) fn run(
        mut self,
        mut each: impl FnMut(&LedgerRow) -> Result<(), RecordingError>,
    ) -> Result<Changes, RecordingError> {
        let mut exposure = 0;
        while let Some(next) = self.next_exposure() {
            if next - exposure > MAX_GAP {
                let field = format!("exposure {next}");
                let path = self.images[0].path();
                return Err(RecordingError::damaged(path, field, format!("comes after {exposure}")));
            }
            for exposure in exposure..=next {
                for channel in Channel::BOTH {
                    each(&self.row(ExposureIndex(exposure), channel)?)?;
                }
            }
            exposure = next + 1;
        }
        let whole = self.old.as_ref().map_or(0, LedgerRows::bytes);
        self.changes.torn_bytes = self.ledger_bytes.saturating_sub(whole);
        Ok(self.changes)
    }

    /// The exposure of the first frame or row that is left.
    fn next_exposure(&self) -> Option<u64> {
        let frames = self.next_frame.iter().flatten();
        frames.chain(&self.next_old).map(|row| row.exposure.0).min()
    }

    /// The row of one exposure and camera.
    fn row(&mut self, exposure: ExposureIndex, channel: Channel) -> Result<LedgerRow, RecordingError> {
        let is_here =
            |row: &Option<LedgerRow>| row.filter(|row| (row.exposure, row.channel) == (exposure, channel));
        let (old, frame) = (is_here(&self.next_old), is_here(&self.next_frame[channel.index()]));
        if let Some(row) = old {
            self.take_old(Some(row));
        }
        if frame.is_some() {
            self.take_frame(channel)?;
        }
        let row = match (frame, old) {
            (Some(frame), _) => {
                let conditions = Conditions { focus_nm: frame.conditions.focus_nm, ..self.conditions };
                LedgerRow { conditions, ..frame }
            }
            (None, Some(old)) if !matches!(old.state, RowState::Recorded { .. }) => old,
            (None, Some(old)) => LedgerRow { state: RowState::Lost(Loss::CrashTail), ..old },
            (None, None) => missing(exposure, channel),
        };
        match old {
            None => self.changes.added += 1,
            Some(old) => self.changes.changed += u64::from(old != row),
        }
        Ok(row)
    }

    /// Reads on to the next row behind `last`; what is no row or not behind it is dropped.
    fn take_old(&mut self, last: Option<LedgerRow>) {
        let key = |row: &LedgerRow| (row.exposure, row.channel);
        self.next_old = None;
        let Some(rows) = &mut self.old else { return };
        for row in rows {
            match row {
                Ok(row) if last.is_none_or(|last| key(&row) > key(&last)) => {
                    self.next_old = Some(row);
                    return;
                }
                _ => self.changes.dropped += 1,
            }
        }
    }

    /// Reads on to the next frame; a frame whose facts cannot be read has no row.
    fn take_frame(&mut self, channel: Channel) -> Result<(), RecordingError> {
        let index = channel.index();
        let image = &mut self.images[index];
        let last = self.next_frame[index].take();
        let page = self.next_page[index];
        if page >= image.len() {
            return Ok(());
        }
        let Some(row) = image.row(channel, page)? else {
            let path = image.path();
            return Err(RecordingError::damaged(path, format!("page {page}, facts"), "not those of a frame"));
        };
        if last.is_some_and(|last| last.exposure >= row.exposure) {
            let detail = format!("exposure {} is not behind the page before", row.exposure.0);
            return Err(RecordingError::damaged(image.path(), format!("page {page}, facts"), detail));
        }
        self.next_page[index] += 1;
        self.next_frame[index] = Some(row);
        Ok(())
    }
}

/// The row of an exposure of which nothing is left.
fn missing(exposure: ExposureIndex, channel: Channel) -> LedgerRow {
    LedgerRow {
        exposure,
        channel,
        state: RowState::Lost(Loss::CrashTail),
        id: None,
        device_time: None,
        host_time: None,
        pair: PairState::Not(Loss::Unpaired),
        analysis: Analysis::None,
        conditions: Conditions::default(),
    }
}
