//! What a recording holds, counted from the rows of its ledger.

use super::events::{StopRecord, StopStatus};
use crate::acquisition::{LedgerRow, Loss, PairState, RowState};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a recording holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordingSummary {
    /// Where it is.
    pub directory: PathBuf,
    /// Exposures in the ledger.
    pub exposures: u64,
    /// Frames in the files of R and T.
    pub recorded: [u64; 2],
    /// Frames that are not, by reason.
    pub lost: [BTreeMap<Loss, u64>; 2],
    /// Exposures whose frames make a pair and are both recorded.
    pub pairs: u64,
    /// How it ended.
    pub stop: StopRecord,
}

impl RecordingSummary {
    pub(super) fn empty(directory: &Path) -> Self {
        Self {
            directory: directory.to_path_buf(),
            exposures: 0,
            recorded: [0; 2],
            lost: [BTreeMap::new(), BTreeMap::new()],
            pairs: 0,
            stop: StopRecord { status: StopStatus::Success, reason: String::new() },
        }
    }

    /// Takes in both rows of an exposure.
    pub(super) fn count(&mut self, rows: &[LedgerRow; 2]) {
        self.exposures += 1;
        for (index, row) in rows.iter().enumerate() {
            match row.state {
                RowState::Recorded { .. } => self.recorded[index] += 1,
                RowState::Unrecorded => {}
                RowState::Lost(loss) => *self.lost[index].entry(loss).or_default() += 1,
            }
        }
        let all = rows.iter().all(|row| matches!(row.state, RowState::Recorded { .. }));
        self.pairs += u64::from(all && rows[0].pair == PairState::Paired);
    }
}
