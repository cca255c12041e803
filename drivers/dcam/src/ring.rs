//! Which frames of the library's ring of buffers are still there.
//!
//! In: number and buffer of the newest frame, as often as one asks. Out: the buffer of the next frame to read,
//! and how many were overwritten before they were read.
//! Never: calls the library. Fails: never.
//!
//! Of `n` buffers the library may be writing one at any time, so `n - 1` frames can be behind.

/// A frame to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Place {
    /// Frames since the start, 0 for the first.
    pub(crate) number: u64,
    /// Buffer that has it.
    pub(crate) slot: i32,
    /// Frames that were overwritten since the last one was read.
    pub(crate) overwritten: u64,
}

/// Reading of a ring.
#[derive(Debug, Clone)]
pub(crate) struct Ring {
    buffers: u64,
    /// Frames that the library has finished.
    finished: u64,
    newest_slot: u64,
    /// Number of the next frame to read.
    next: u64,
}

impl Ring {
    pub(crate) fn new(buffers: u32) -> Self {
        Self { buffers: u64::from(buffers.max(2)), finished: 0, newest_slot: 0, next: 0 }
    }

    /// Takes over what the library says; its count wraps at 2^32.
    pub(crate) fn observe(&mut self, newest_slot: i32, count: u32) {
        let Ok(slot) = u64::try_from(newest_slot) else { return };
        let more = count.wrapping_sub(self.finished as u32);
        // A count that goes back is an older answer.
        if more <= u32::MAX / 2 {
            self.finished += u64::from(more);
            self.newest_slot = slot % self.buffers;
        }
    }

    /// The next frame, if there is one; the same until [`Self::done`] is called.
    pub(crate) fn next(&mut self) -> Option<Place> {
        let behind = self.finished - self.next;
        if behind == 0 {
            return None;
        }
        let kept = behind.min(self.buffers - 1);
        let overwritten = behind - kept;
        self.next += overwritten;
        let back = self.finished - 1 - self.next;
        let slot = (self.newest_slot + self.buffers - back % self.buffers) % self.buffers;
        Some(Place { number: self.next, slot: i32::try_from(slot).unwrap_or(0), overwritten })
    }

    /// Whether a frame may have been overwritten by now.
    pub(crate) fn is_gone(&self, place: Place) -> bool {
        self.finished >= place.number + self.buffers
    }

    /// The frame has been read.
    pub(crate) fn done(&mut self, place: Place) {
        self.next = place.number + 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn one_event_may_stand_for_many_frames() {
        let mut ring = Ring::new(5);
        assert_eq!(ring.next(), None);
        ring.observe(-1, 0);
        assert_eq!(ring.next(), None);
        ring.observe(2, 3);
        for number in 0..3 {
            let place = ring.next().unwrap();
            assert_eq!(place, Place { number, slot: number as i32, overwritten: 0 });
            ring.done(place);
        }
        assert_eq!(ring.next(), None);
    }

    #[test]
    fn overwritten_frames_are_counted_once() {
        let mut ring = Ring::new(4);
        ring.observe(1, 10);
        let place = ring.next().unwrap();
        assert_eq!(place, Place { number: 7, slot: 3, overwritten: 7 });
        assert!(!ring.is_gone(place));
        ring.observe(2, 11);
        assert!(ring.is_gone(place), "frame 11 goes into the buffer of frame 7");
        ring.done(place);
        assert_eq!(ring.next(), Some(Place { number: 8, slot: 0, overwritten: 0 }));
    }

    proptest! {
        #[test]
        fn every_frame_is_read_or_counted(
            buffers in 2_u32..20,
            steps in proptest::collection::vec((0_u32..30, 0_usize..30), 1..60),
            begin in prop_oneof![Just(0_u32), Just(u32::MAX - 40)],
        ) {
            let mut ring = Ring { finished: u64::from(begin), next: u64::from(begin), ..Ring::new(buffers) };
            let (mut count, mut seen, mut expected) = (u64::from(begin), 0, u64::from(begin));
            for (more, reads) in steps {
                count += u64::from(more);
                let slot = (count.wrapping_sub(1) % u64::from(buffers)) as i32;
                ring.observe(if count == 0 { -1 } else { slot }, count as u32);
                for _ in 0..reads {
                    let Some(place) = ring.next() else { break };
                    prop_assert_eq!(place.number, expected + place.overwritten);
                    prop_assert_eq!(place.slot as u64, place.number % u64::from(buffers));
                    prop_assert!(count - place.number < u64::from(buffers));
                    seen += 1 + place.overwritten;
                    expected = place.number + 1;
                    ring.done(place);
                }
            }
            prop_assert_eq!(seen, expected - u64::from(begin));
        }
    }
}
