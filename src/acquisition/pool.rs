//! Memory for frames: filled before arming, lent to readers, home again when the last reader lets go.
//!
//! In: the number and size of frames, once. Out: [`FrameMemory`] to write into, [`Frame`]s to read.
//! Never: allocates after [`FramePool::new`], locks, waits. Fails: `None` when every slot is out on loan.
//!
//! A frame needs no way back: the last reader that drops its [`Frame`] has returned the memory, see [`Slots`].

use super::Conditions;
use crate::pipeline::{Loan, Slots};
use bytemuck::{cast_slice, cast_slice_mut};
#[cfg(target_os = "linux")]
use memmap2::Advice;
use memmap2::{MmapMut, MmapOptions};
use sofiscope_hal::{Channel, FrameInfo, HostTime};
use std::sync::Arc;

/// Pixels begin on a page, as writing past the page cache demands.
pub const PAGE_BYTES: usize = 4096;

/// What is known of a frame beside its pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameFacts {
    /// The camera.
    pub channel: Channel,
    /// What the camera says.
    pub info: FrameInfo,
    /// When the frame was received.
    pub received: HostTime,
    /// What surrounded it then.
    pub conditions: Conditions,
}

/// Frames of at least this size lie in huge pages where the system has them; they are there sooner.
const HUGE_PAGE_BYTES: usize = 2 << 20;

/// One slot: whole pages of memory of its own.
#[derive(Debug)]
struct Slot {
    memory: MmapMut,
    bytes: usize,
    facts: Option<FrameFacts>,
}

impl Slot {
    fn new(pixels: usize) -> std::io::Result<Self> {
        let bytes = pixels * size_of::<u16>();
        let mut memory = MmapOptions::new().len(bytes.max(1)).map_anon()?;
        #[cfg(target_os = "linux")]
        if bytes >= HUGE_PAGE_BYTES && memory.advise(Advice::HugePage).is_err() {
            tracing::debug!("no huge pages for frames");
        }
        // Written, not only reserved: the pages exist before the first frame comes.
        memory.fill(1);
        Ok(Self { memory, bytes, facts: None })
    }

    fn counts(&self) -> &[u16] {
        cast_slice(&self.memory[..self.bytes])
    }

    fn counts_mut(&mut self) -> &mut [u16] {
        cast_slice_mut(&mut self.memory[..self.bytes])
    }
}

/// A frame to read; cloning it shares the memory.
#[derive(Debug, Clone)]
pub struct Frame(Arc<Slot>);

impl Frame {
    /// A frame with memory of its own, outside of any pool; for tests and for reading files.
    ///
    /// # Panics
    /// When the system has no memory.
    #[must_use]
    pub fn of_counts(facts: FrameFacts, counts: &[u16]) -> Self {
        let mut slot = Slot::new(counts.len()).expect("memory for one frame");
        slot.counts_mut().copy_from_slice(counts);
        slot.facts = Some(facts);
        Self(Arc::new(slot))
    }

    /// The facts of this frame.
    #[must_use]
    pub fn facts(&self) -> &FrameFacts {
        self.0.facts.as_ref().expect("a slot becomes a frame together with its facts")
    }

    /// Pixels, row by row, in counts.
    #[must_use]
    pub fn counts(&self) -> &[u16] {
        self.0.counts()
    }

    /// The same pixels as they lie in memory; the first byte begins a page.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        cast_slice(self.counts())
    }
}

/// A slot that nobody else holds, to be written.
#[derive(Debug)]
pub struct FrameMemory<'a>(Loan<'a, Slot>);

impl FrameMemory<'_> {
    /// The memory for the pixels, row by row.
    pub fn counts_mut(&mut self) -> &mut [u16] {
        self.0.get_mut().counts_mut()
    }

    /// Makes what was written a frame.
    #[must_use]
    pub fn into_frame(mut self, facts: FrameFacts) -> Frame {
        self.0.get_mut().facts = Some(facts);
        Frame(self.0.share())
    }
}

/// Slots of equal size.
#[derive(Debug)]
pub struct FramePool(Slots<Slot>);

impl FramePool {
    /// A pool of `slots` frames of `pixels` pixels, its memory written once so that it is really there.
    ///
    /// # Errors
    /// What the system says when it has not that much memory.
    pub fn new(slots: usize, pixels: usize) -> std::io::Result<Self> {
        let slots = (0..slots).map(|_| Slot::new(pixels)).collect::<Result<_, _>>()?;
        Ok(Self(Slots::new(slots)))
    }

    /// Frames that the pool can hold.
    #[must_use]
    pub fn capacity(&self) -> usize {
        self.0.capacity()
    }

    /// A slot that nobody holds; `None` when all are out.
    pub fn take(&mut self) -> Option<FrameMemory<'_>> {
        self.0.take().map(FrameMemory)
    }

    /// Frames out on loan at this moment.
    #[must_use]
    pub fn lent(&self) -> usize {
        self.0.lent()
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use sofiscope_hal::{BlockId, DeviceTime, Epoch, ExposureIndex, FrameStatus};

    pub(crate) fn facts(channel: Channel, exposure: u64) -> FrameFacts {
        let info = FrameInfo {
            exposure: ExposureIndex(exposure),
            block_id: BlockId(exposure),
            epoch: Epoch(0),
            device_time: DeviceTime(exposure * 20_000_000),
            status: FrameStatus::Complete,
        };
        FrameFacts {
            channel,
            info,
            received: HostTime(exposure * 20_000_000 + 1000),
            conditions: Conditions::default(),
        }
    }

    #[test]
    fn memory_comes_home_with_the_last_reader() {
        let mut pool = FramePool::new(2, 10).unwrap();
        let fill = |pool: &mut FramePool, value: u16| {
            let mut memory = pool.take()?;
            memory.counts_mut().fill(value);
            Some(memory.into_frame(facts(Channel::Reflected, u64::from(value))))
        };
        let first = fill(&mut pool, 1).unwrap();
        let second = fill(&mut pool, 2).unwrap();
        assert!(fill(&mut pool, 3).is_none());
        let other_reader = first.clone();
        drop(first);
        assert!(fill(&mut pool, 3).is_none());
        assert_eq!(other_reader.counts(), [1; 10]);
        drop(other_reader);
        let third = fill(&mut pool, 3).unwrap();
        assert_eq!((second.counts()[0], third.counts()[0], pool.lent()), (2, 3, 2));
    }

    #[test]
    fn slots_that_are_never_filled_are_not_lost() {
        let mut pool = FramePool::new(1, 4).unwrap();
        for _ in 0..3 {
            assert!(pool.take().is_some());
        }
    }

    #[test]
    fn pixels_begin_on_a_page() {
        for pixels in [1, 100, 64 * 64] {
            let frame = Frame::of_counts(facts(Channel::Transmitted, 0), &vec![7; pixels]);
            assert_eq!(frame.bytes().as_ptr().align_offset(PAGE_BYTES), 0);
            assert_eq!(frame.counts(), vec![7; pixels]);
        }
    }
}
