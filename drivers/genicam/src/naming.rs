//! Ids and times of frames whose leader is lost; pure.
//!
//! Aravis knows id and time of a frame by its leader alone, and delivers frames in the order in which they began.
//! A frame without a leader is thus the one after the frame before it. Where whole frames are missing just there,
//! it may have been one of them; then another of the missing frames is called incomplete, and none is called good.
//!
//! In: ids and times as Aravis gives them. Out: [`Named`]. Never: gives an id twice, or that of a frame to come.

use std::time::Duration;

use sofiscope_hal::{BlockId, DeviceTime, IdRule};

/// Stands in a buffer until Aravis writes an id.
pub(crate) const UNKNOWN: u64 = u64::MAX;
/// Frames that may come without a leader before the first one with a leader.
pub(crate) const MOST_NAMELESS: usize = 64;

/// A frame with its id, and its time or an estimate of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Named {
    pub(crate) id: BlockId,
    pub(crate) time: DeviceTime,
}

#[derive(Debug)]
pub(crate) struct Names {
    rule: IdRule,
    period_ns: u64,
    newest: Option<Named>,
    num_nameless: usize,
}

impl Names {
    pub(crate) fn new(rule: IdRule, period: Duration) -> Self {
        let period_ns = u64::try_from(period.as_nanos()).unwrap_or(u64::MAX);
        Self { rule, period_ns, newest: None, num_nameless: 0 }
    }

    pub(crate) fn rule(&self) -> IdRule {
        self.rule
    }

    /// The frame's id and time; `None` for one that comes before any whose id is known, to be had of
    /// [`Self::nameless`] later.
    pub(crate) fn name(&mut self, id: u64, time_ns: u64) -> Option<Named> {
        let named = match (id, self.newest) {
            (UNKNOWN, None) => {
                self.num_nameless = (self.num_nameless + 1).min(MOST_NAMELESS);
                return None;
            }
            (UNKNOWN, Some(newest)) => Named { id: self.after(newest.id), time: self.later(newest.time) },
            (id, Some(newest)) if time_ns == 0 => Named { id: BlockId(id), time: self.later(newest.time) },
            (id, _) => Named { id: BlockId(id), time: DeviceTime(time_ns) },
        };
        self.newest = Some(named);
        Some(named)
    }

    /// The frames that came before the first one whose id is known, which must be the newest.
    pub(crate) fn nameless(&mut self) -> Vec<Named> {
        let Some(mut next) = self.newest else { return Vec::new() };
        let mut before = Vec::with_capacity(self.num_nameless);
        for _ in 0..std::mem::take(&mut self.num_nameless) {
            next = Named {
                id: self.before(next.id),
                time: DeviceTime(next.time.0.wrapping_sub(self.period_ns)),
            };
            before.push(next);
        }
        before.reverse();
        before
    }

    fn later(&self, time: DeviceTime) -> DeviceTime {
        DeviceTime(time.0.wrapping_add(self.period_ns))
    }

    fn after(&self, id: BlockId) -> BlockId {
        BlockId(if id.0 >= self.rule.largest { self.rule.smallest } else { id.0 + 1 })
    }

    fn before(&self, id: BlockId) -> BlockId {
        BlockId(if id.0 <= self.rule.smallest { self.rule.largest } else { id.0 - 1 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names() -> Names {
        Names::new(IdRule::GIGE_VISION_16_BIT, Duration::from_nanos(10))
    }

    fn named(id: u64, time: u64) -> Named {
        Named { id: BlockId(id), time: DeviceTime(time) }
    }

    #[test]
    fn a_frame_without_leader_follows_the_one_before_it() {
        let mut names = names();
        assert_eq!(names.name(65_534, 100), Some(named(65_534, 100)));
        assert_eq!(names.name(UNKNOWN, 0), Some(named(65_535, 110)));
        assert_eq!(names.name(UNKNOWN, 0), Some(named(1, 120)));
        assert_eq!(names.name(2, 131), Some(named(2, 131)));
        assert_eq!(names.nameless(), []);
    }

    #[test]
    fn frames_without_leader_at_the_begin_are_named_by_the_first_with_one() {
        let mut names = names();
        assert_eq!([names.name(UNKNOWN, 0), names.name(UNKNOWN, 0)], [None, None]);
        assert_eq!(names.name(2, 130), Some(named(2, 130)));
        assert_eq!(names.nameless(), [named(65_535, 110), named(1, 120)]);
        assert_eq!(names.nameless(), [], "once");
    }
}
