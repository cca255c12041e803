//! Raw frame ids to exposure indices: ids wrap, jump and restart, indices never do.
//!
//! In: ids and device times in the order of delivery. Out: [`ExposureIndex`] and [`Epoch`].
//! Never: guesses silently; an id that fits no rule is an error. Fails: [`NumberingError`].
//!
//! An id that is ahead by less than half of a turn is a later exposure, with everything between them missing,
//! unless it is far ahead and the camera's clock says otherwise.
//! An id that is behind by at most [`IdRule::reorder`] is an earlier exposure that comes late, if its time is earlier too.
//! Anything else is a restart of the counter: a new [`Epoch`], whose first exposure is placed by device time.

use crate::{DeviceTime, ExposureIndex};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A camera's own counter of frames, as it came; 16 bit on some, where 65535 is followed by 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct BlockId(pub u64);

/// How often a camera has restarted its counter since arming.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Epoch(pub u32);

/// How a camera counts its frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct IdRule {
    /// Id of the first exposure after arming; `None` when it is whatever comes first.
    pub first: Option<BlockId>,
    /// The smallest id, to which the counter wraps.
    pub smallest: u64,
    /// The largest id, after which it wraps.
    pub largest: u64,
    /// Frames by which one may come late.
    pub reorder: u64,
}

impl IdRule {
    /// GigE Vision 1: 16 bit, never 0.
    pub const GIGE_VISION_16_BIT: Self = Self { first: None, smallest: 1, largest: 65_535, reorder: 64 };

    /// Counters of 64 bit that begin with 0 at arming.
    pub const FROM_ZERO: Self = Self { first: Some(BlockId(0)), smallest: 0, largest: u64::MAX, reorder: 64 };

    fn turn(self) -> u128 {
        u128::from(self.largest) - u128::from(self.smallest) + 1
    }
}

/// Why an id has no exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NumberingError {
    /// The id is outside of what the counter can show.
    #[error("frame id {} is outside {smallest} to {largest}", .id.0)]
    Outside {
        /// The id that came.
        id: BlockId,
        /// Smallest id of the rule.
        smallest: u64,
        /// Largest id of the rule.
        largest: u64,
    },
    /// The counter restarted and the device time went back, so the exposure cannot be known.
    #[error(
        "the frame counter restarted at {} and the camera's clock went back by {back_ns} ns; \
         the exposures after it cannot be numbered",
        .id.0
    )]
    Unplaceable {
        /// The id that came.
        id: BlockId,
        /// Nanoseconds by which the clock went back.
        back_ns: u64,
    },
}

/// The newest exposure seen.
#[derive(Debug, Clone, Copy)]
struct Newest {
    id: u64,
    exposure: u64,
    time: DeviceTime,
}

/// Numbers the frames of one armed camera.
#[derive(Debug, Clone)]
pub struct ExposureNumbering {
    rule: IdRule,
    period: Duration,
    newest: Option<Newest>,
    /// The last jump of the clock: the first exposure after it, and by how many nanoseconds it went.
    jump: Option<(u64, i64)>,
    epoch: Epoch,
}

impl ExposureNumbering {
    /// Numbering for a camera that was just armed with exposures `period` apart.
    ///
    /// # Panics
    /// When the rule's largest id is not above its smallest.
    #[must_use]
    pub fn new(rule: IdRule, period: Duration) -> Self {
        assert!(rule.largest > rule.smallest, "a counter has more than one id");
        Self { rule, period, newest: None, jump: None, epoch: Epoch(0) }
    }

    /// The exposure of a frame.
    ///
    /// # Errors
    /// [`NumberingError`]; the frame cannot be used and the numbering has not changed.
    pub fn exposure_of(
        &mut self,
        id: BlockId,
        time: DeviceTime,
    ) -> Result<(ExposureIndex, Epoch), NumberingError> {
        let IdRule { smallest, largest, .. } = self.rule;
        if !(smallest..=largest).contains(&id.0) {
            return Err(NumberingError::Outside { id, smallest, largest });
        }
        let Some(newest) = self.newest else {
            let first = self.rule.first.map_or(id.0, |first| first.0);
            let exposure = self.ahead(first, id.0) as u64;
            self.newest = Some(Newest { id: id.0, exposure, time });
            return Ok((ExposureIndex(exposure), self.epoch));
        };
        let turn = self.rule.turn();
        let ahead = self.ahead(newest.id, id.0);
        let elapsed_ns = time.nanoseconds_since(newest.time);
        if ahead < turn / 2 && self.is_in_time(ahead, elapsed_ns) {
            let exposure = newest.exposure + ahead as u64;
            let late_ns = elapsed_ns - self.due_ns(ahead);
            if late_ns.unsigned_abs() > self.period_ns() as u64 {
                self.jump = Some((exposure, late_ns));
            }
            self.newest = Some(Newest { id: id.0, exposure, time });
            return Ok((ExposureIndex(exposure), self.epoch));
        }
        let behind = turn - ahead;
        let may_be_late = ahead > 0 && behind <= u128::from(self.rule.reorder.min(newest.exposure));
        if may_be_late && self.is_earlier(newest.exposure - behind as u64, elapsed_ns, behind) {
            return Ok((ExposureIndex(newest.exposure - behind as u64), self.epoch));
        }
        self.restart(newest, id, time)
    }

    /// Whether a gap of so many ids took about as long as so many exposures; short gaps are always believed,
    /// as clocks may step and triggers may be missed. The same id again is the same frame, of the same time.
    fn is_in_time(&self, ahead: u128, elapsed_ns: i64) -> bool {
        if ahead == 0 {
            return elapsed_ns.abs() <= self.period_ns() / 2;
        }
        if ahead <= u128::from(self.rule.reorder) {
            return true;
        }
        let due_ns = ahead as f64 * self.period.as_nanos() as f64;
        (elapsed_ns as f64 - due_ns).abs() <= due_ns / 2.0
    }

    /// Whether the time of a frame that may be late says that it is: it is the earlier one, or would be had the
    /// clock not been set back after it.
    fn is_earlier(&self, exposure: u64, elapsed_ns: i64, behind: u128) -> bool {
        elapsed_ns <= 0
            || self.jump.is_some_and(|(after, jump_ns)| {
                let before_ns = elapsed_ns.saturating_add(self.due_ns(behind)).saturating_add(jump_ns);
                exposure < after && before_ns.abs() <= self.period_ns()
            })
    }

    fn period_ns(&self) -> i64 {
        i64::try_from(self.period.as_nanos()).unwrap_or(i64::MAX).max(1)
    }

    /// The time that so many exposures take.
    fn due_ns(&self, exposures: u128) -> i64 {
        i64::try_from(exposures).unwrap_or(i64::MAX).saturating_mul(self.period_ns())
    }

    /// Ids from `from` to `to` along the counter, 0 to a turn.
    fn ahead(&self, from: u64, to: u64) -> u128 {
        let (from, to) = (u128::from(from), u128::from(to));
        if to >= from { to - from } else { to + self.rule.turn() - from }
    }

    fn restart(
        &mut self,
        newest: Newest,
        id: BlockId,
        time: DeviceTime,
    ) -> Result<(ExposureIndex, Epoch), NumberingError> {
        let elapsed_ns = time.nanoseconds_since(newest.time);
        if elapsed_ns <= 0 {
            return Err(NumberingError::Unplaceable { id, back_ns: elapsed_ns.unsigned_abs() });
        }
        let period_ns = (self.period.as_nanos() as u64).max(1);
        let elapsed = (elapsed_ns.unsigned_abs() + period_ns / 2) / period_ns;
        let exposure = newest.exposure + elapsed.max(1);
        self.epoch = Epoch(self.epoch.0 + 1);
        self.newest = Some(Newest { id: id.0, exposure, time });
        Ok((ExposureIndex(exposure), self.epoch))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(20);

    fn at(exposure: u64) -> DeviceTime {
        DeviceTime(7_000_000_000 + exposure * 20_000_000)
    }

    #[test]
    fn after_65535_comes_1_and_that_is_no_gap() {
        let mut numbering = ExposureNumbering::new(IdRule::GIGE_VISION_16_BIT, PERIOD);
        let mut id = 65_400;
        for exposure in 0..200_000 {
            let found = numbering.exposure_of(BlockId(id), at(exposure));
            assert_eq!(found, Ok((ExposureIndex(exposure), Epoch(0))));
            id = if id == 65_535 { 1 } else { id + 1 };
        }
    }

    #[test]
    fn lost_and_late_frames_keep_their_numbers_across_the_wrap() {
        let mut numbering = ExposureNumbering::new(IdRule::GIGE_VISION_16_BIT, PERIOD);
        for (id, exposure) in [(65_530, 0), (65_534, 4), (3, 8), (65_532, 2), (1, 6), (503, 508)] {
            let found = numbering.exposure_of(BlockId(id), at(exposure));
            assert_eq!(found, Ok((ExposureIndex(exposure), Epoch(0))), "{id}");
        }
    }

    #[test]
    fn the_first_exposure_may_be_lost_where_its_id_is_known() {
        let mut numbering = ExposureNumbering::new(IdRule::FROM_ZERO, PERIOD);
        let found = numbering.exposure_of(BlockId(3), at(3));
        assert_eq!(found, Ok((ExposureIndex(3), Epoch(0))));
    }

    #[test]
    fn a_restart_is_placed_by_the_clock_in_a_new_epoch() {
        let mut numbering = ExposureNumbering::new(IdRule::FROM_ZERO, PERIOD);
        for exposure in 0..1000 {
            numbering.exposure_of(BlockId(exposure), at(exposure)).unwrap();
        }
        let found = numbering.exposure_of(BlockId(0), at(1012));
        assert_eq!(found, Ok((ExposureIndex(1012), Epoch(1))));
        assert_eq!(numbering.exposure_of(BlockId(1), at(1013)), Ok((ExposureIndex(1013), Epoch(1))));
    }

    #[test]
    fn a_restart_that_looks_like_a_gap_is_told_by_the_clock() {
        let mut numbering = ExposureNumbering::new(IdRule::GIGE_VISION_16_BIT, PERIOD);
        numbering.exposure_of(BlockId(40_000), at(0)).unwrap();
        assert_eq!(numbering.exposure_of(BlockId(1), at(3)), Ok((ExposureIndex(3), Epoch(1))));
        assert_eq!(numbering.exposure_of(BlockId(20), at(22)), Ok((ExposureIndex(22), Epoch(1))));
        assert_eq!(numbering.exposure_of(BlockId(1020), at(1022)), Ok((ExposureIndex(1022), Epoch(1))));
    }

    #[test]
    fn a_restart_soon_after_arming_or_wrapping_is_no_late_frame() {
        for (rule, from) in [(IdRule::FROM_ZERO, 0), (IdRule::GIGE_VISION_16_BIT, 1)] {
            for restart in [1, 2, 20, 63] {
                let mut numbering = ExposureNumbering::new(rule, PERIOD);
                for exposure in 0..restart {
                    numbering.exposure_of(BlockId(from + exposure), at(exposure)).unwrap();
                }
                for exposure in restart..200 {
                    let found = numbering.exposure_of(BlockId(from + exposure - restart), at(exposure));
                    assert_eq!(found, Ok((ExposureIndex(exposure), Epoch(1))), "restart at {restart}");
                }
            }
        }
    }

    #[test]
    fn a_frame_from_before_the_clock_was_set_back_may_still_come_late() {
        let mut numbering = ExposureNumbering::new(IdRule::FROM_ZERO, PERIOD);
        let set_back = |exposure: u64| DeviceTime(at(exposure).0 - 1_000_000_000);
        for exposure in [0, 1, 2, 3, 5] {
            numbering.exposure_of(BlockId(exposure), at(exposure)).unwrap();
        }
        for (exposure, time) in [(7, set_back(7)), (4, at(4)), (6, at(6)), (8, set_back(8))] {
            let found = numbering.exposure_of(BlockId(exposure), time);
            assert_eq!(found, Ok((ExposureIndex(exposure), Epoch(0))), "{exposure}");
        }
    }

    #[test]
    fn what_cannot_be_numbered_is_refused_and_changes_nothing() {
        let mut numbering = ExposureNumbering::new(IdRule::GIGE_VISION_16_BIT, PERIOD);
        assert!(matches!(numbering.exposure_of(BlockId(0), at(0)), Err(NumberingError::Outside { .. })));
        numbering.exposure_of(BlockId(1000), at(0)).unwrap();
        let back = numbering.exposure_of(BlockId(1), DeviceTime(0));
        assert!(matches!(back, Err(NumberingError::Unplaceable { back_ns: 7_000_000_000, .. })), "{back:?}");
        assert_eq!(numbering.exposure_of(BlockId(1001), at(1)), Ok((ExposureIndex(1), Epoch(0))));
    }
}
