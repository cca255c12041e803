//! The analysis thread: frame pairs as they come, into the running cumulants, block by block.
//!
//! In: [`FramePair`]s in order of exposure. Out: the engine at the end, snapshots for the preview and quality meanwhile.
//! Never: waits for the preview, keeps a frame longer than its block, lets the division into blocks change a bit.
//! Fails: [`PushError`], which only a defect in the program can cause.

use super::feed::{mean_counts, raw_masks};
use super::preview::{PreviewLink, Snapshot};
use super::{AllCores, BLOCK, Feed, Quality, QualityMonitor};
use crate::acquisition::{FramePair, HostClock};
use crate::pipeline::{Received, Receiver};
use crate::sofi::cumulant::{CumulantEngine, Exposure, PushError};
use ndarray::Array2;
use sofiscope_hal::HostTime;
use std::time::{Duration, Instant};

/// A block that is not full waits this long for more pairs.
const BLOCK_AGE: Duration = Duration::from_millis(100);

/// The work of the analysis thread.
#[derive(Debug)]
pub struct LiveAnalysis {
    /// Running cumulants, empty.
    pub engine: CumulantEngine<u16>,
    /// Pairs from the dispatch.
    pub pairs: Receiver<FramePair>,
    /// Mean counts are kept of every so manieth exposure.
    pub trace_every: u64,
    /// To the preview, if there is one.
    pub preview: Option<PreviewLink>,
    /// Watches how good the result is, if it is to be watched.
    pub quality: Option<QualityMonitor>,
    /// Stamps snapshots.
    pub clock: HostClock,
}

/// What the thread leaves at its end.
#[derive(Debug)]
pub struct LiveReport {
    /// The cumulants of all pairs.
    pub engine: CumulantEngine<u16>,
    /// Exposures, subsequences and mean counts.
    pub feed: Feed,
    /// Quality after each subsequence; empty if it was not watched.
    pub quality: Vec<Quality>,
}

impl LiveAnalysis {
    /// Works until the dispatch is gone.
    ///
    /// # Errors
    /// [`PushError`] for pairs that do not fit the engine.
    pub fn run(mut self) -> Result<LiveReport, PushError> {
        let mut feed = Feed::default();
        let masks = raw_masks(self.engine.settings());
        let mut block: Vec<FramePair> = Vec::with_capacity(BLOCK);
        loop {
            let open = self.gather(&mut block);
            if !block.is_empty() {
                self.push(&block, &mut feed, &masks)?;
                block.clear();
            }
            if !open {
                let quality = self.quality.map_or_else(Vec::new, QualityMonitor::into_history);
                return Ok(LiveReport { engine: self.engine, feed, quality });
            }
        }
    }

    /// Fills a block; says whether more pairs can come.
    fn gather(&mut self, block: &mut Vec<FramePair>) -> bool {
        let mut begun = Instant::now();
        loop {
            let left = BLOCK_AGE.saturating_sub(begun.elapsed());
            match self.pairs.receive(left) {
                Received::Value(pair) => {
                    if block.is_empty() {
                        begun = Instant::now();
                    }
                    let ends_subsequence =
                        (pair.exposure.0 + 1).is_multiple_of(self.engine.settings().subsequence);
                    block.push(pair);
                    if block.len() == BLOCK || ends_subsequence {
                        return true;
                    }
                }
                Received::Empty => return true,
                Received::Closed => return false,
            }
        }
    }

    fn push(
        &mut self,
        block: &[FramePair],
        feed: &mut Feed,
        masks: &[Option<Array2<bool>>],
    ) -> Result<(), PushError> {
        let planes: Vec<[&[u16]; 2]> =
            block.iter().map(|pair| [pair.frames[0].counts(), pair.frames[1].counts()]).collect();
        let exposures: Vec<Exposure<'_, u16>> = block
            .iter()
            .zip(&planes)
            .map(|(pair, planes)| Exposure { index: pair.exposure.0, planes })
            .collect();
        let closed = self.engine.push(&AllCores, &exposures)?;
        if let Some(quality) = &mut self.quality {
            quality.push(&exposures)?;
        }
        feed.exposures += exposures.len() as u64;
        for exposure in exposures.iter().filter(|e| e.index.is_multiple_of(self.trace_every.max(1))) {
            let mean = |(plane, mask): (&&[u16], &Option<Array2<bool>>)| mean_counts(plane, mask.as_ref());
            feed.trace.push((exposure.index, exposure.planes.iter().zip(masks).map(mean).collect()));
        }
        let has_closed = !closed.is_empty();
        feed.closed.extend(closed);
        if let (Some(preview), Some(last)) = (&mut self.preview, block.last()) {
            let received = last.frames.each_ref().map(|frame| frame.facts().received);
            let moment = Moment { received: received[0].max(received[1]), has_closed };
            preview.offer(&self.engine, moment, last.exposure, self.clock);
        }
        Ok(())
    }
}

/// When a snapshot could be taken.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment {
    /// When the newest frame was received.
    pub(super) received: HostTime,
    /// Whether a subsequence has just closed.
    pub(super) has_closed: bool,
}

impl Snapshot {
    pub(super) fn time_since(&self, clock: HostClock) -> Duration {
        clock.now().since(self.received)
    }
}
