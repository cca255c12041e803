//! The preview: snapshots of the running cumulants, through the whole chain, beside the analysis.
//!
//! In: snapshots from the analysis thread, when it has time and the preview too.
//! Out: the newest picture; older ones are replaced. Never: holds the analysis up longer than one drawing.
//! Fails: a picture that cannot be made is told as text in its place.
//!
//! Cameras too large for the whole chain at every look are drawn with squares of pixels averaged; how large
//! the squares are follows from the time that the last pictures took.

use super::AllCores;
use super::live::Moment;
use crate::acquisition::{HostClock, PressureGauge};
use crate::pipeline::{Publisher, Received, Receiver, Sender};
use crate::sofi::cumulant::{Binning, CumulantEngine, Drawing, Incomplete};
use sofiscope_hal::{ExposureIndex, HostTime};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Pixels of the fine grid that a picture begins with at most.
const FIRST_PIXELS: usize = 1 << 18;

/// A picture that takes a larger part of the time between pictures is made coarser.
const TOO_SLOW: f64 = 0.8;
/// A picture that takes a smaller part is made finer.
const QUICK: f64 = 0.1;

/// A moment of the running cumulants.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// What was drawn.
    pub drawing: Drawing,
    /// Squares of pixels averaged.
    pub binning: Binning,
    /// The newest exposure in it.
    pub exposure: ExposureIndex,
    /// When its frames were received.
    pub received: HostTime,
    /// Whether it was taken because a subsequence had closed.
    pub closes_subsequence: bool,
}

/// What the preview has shown so far.
#[derive(Debug)]
pub struct Shown<P> {
    /// The picture; none before the first.
    pub picture: Option<Arc<P>>,
    /// Pictures made.
    pub pictures: u64,
    /// From the last frame received to the picture.
    pub latency: Duration,
}

impl<P> Clone for Shown<P> {
    fn clone(&self) -> Self {
        Self { picture: self.picture.clone(), ..*self }
    }
}

impl<P> Default for Shown<P> {
    fn default() -> Self {
        Self { picture: None, pictures: 0, latency: Duration::ZERO }
    }
}

/// What both threads know.
#[derive(Debug, Default)]
struct Shared {
    /// Snapshots that the preview has finished with.
    finished: AtomicU64,
    /// Index into [`Binning::ALL`].
    binning: AtomicU8,
}

/// The analysis thread's end.
#[derive(Debug)]
pub struct PreviewLink {
    to_preview: Sender<Snapshot>,
    shared: Arc<Shared>,
    gauge: PressureGauge,
    every: Duration,
    sent: u64,
    last: Option<Instant>,
}

impl PreviewLink {
    /// Takes a snapshot if the preview is waiting for one and nobody more important is short of time.
    pub(super) fn offer(
        &mut self,
        engine: &CumulantEngine<u16>,
        moment: Moment,
        exposure: ExposureIndex,
        clock: HostClock,
    ) {
        let is_due = self.last.is_none_or(|last| last.elapsed() >= self.every) || moment.has_closed;
        let is_idle = self.shared.finished.load(Ordering::Acquire) == self.sent;
        if !is_due || !is_idle || self.gauge.preview_is_off() {
            return;
        }
        let begun = Instant::now();
        let index = usize::from(self.shared.binning.load(Ordering::Relaxed));
        let binning = Binning::ALL[index];
        let drawing = match binning {
            Binning::One => engine.draw(&AllCores, Incomplete::Any),
            _ => engine.draw_binned(&AllCores, Incomplete::Any, binning),
        };
        let Some(drawing) = drawing else { return };
        tracing::trace!(elapsed = ?begun.elapsed(), ?binning, at = clock.now().0, "snapshot");
        let (received, closes_subsequence) = (moment.received, moment.has_closed);
        let snapshot = Snapshot { drawing, binning, exposure, received, closes_subsequence };
        if self.to_preview.send(snapshot).is_ok() {
            self.sent += 1;
            self.last = Some(begun);
        }
    }
}

/// The work of the preview thread; `compose` makes a picture of a snapshot.
pub struct Preview<P: Send + Sync, C> {
    from_analysis: Receiver<Snapshot>,
    shared: Arc<Shared>,
    every: Duration,
    clock: HostClock,
    compose: C,
    publisher: Publisher<Shown<P>>,
}

/// What the thread leaves at its end.
#[derive(Debug, Clone, Default)]
pub struct PreviewReport {
    /// Pictures made.
    pub pictures: u64,
    /// Seconds from the last frame of a subsequence to its picture.
    pub latencies_s: Vec<f64>,
    /// Squares of the last picture.
    pub binning: Option<Binning>,
}

/// How a preview works.
#[derive(Debug, Clone)]
pub struct PreviewSettings {
    /// Shortest time between two pictures.
    pub every: Duration,
    /// Pixels of the fine grid at full size.
    pub fine_pixels: usize,
    /// Who goes without.
    pub gauge: PressureGauge,
    /// Stamps pictures.
    pub clock: HostClock,
}

/// Both ends of a preview.
#[must_use]
pub fn preview<P: Send + Sync, C: FnMut(&Snapshot) -> P>(
    settings: &PreviewSettings,
    compose: C,
    publisher: Publisher<Shown<P>>,
) -> (PreviewLink, Preview<P, C>) {
    use crate::pipeline::{Bell, WhenFull, bounded};
    let (to_preview, from_analysis) = bounded("analysis→preview", 1, WhenFull::Refuse, &Bell::default());
    let fits = |binning: &Binning| settings.fine_pixels / binning.side().pow(2) <= FIRST_PIXELS;
    let first = Binning::ALL.iter().position(fits).unwrap_or(Binning::ALL.len() - 1);
    let shared = Arc::new(Shared { finished: AtomicU64::new(0), binning: AtomicU8::new(first as u8) });
    let link = PreviewLink {
        to_preview,
        shared: Arc::clone(&shared),
        gauge: settings.gauge.clone(),
        every: settings.every,
        sent: 0,
        last: None,
    };
    let (every, clock) = (settings.every, settings.clock);
    (link, Preview { from_analysis, shared, every, clock, compose, publisher })
}

impl<P: Send + Sync, C: FnMut(&Snapshot) -> P> Preview<P, C> {
    /// Makes pictures until the analysis is gone.
    pub fn run(mut self) -> PreviewReport {
        let mut report = PreviewReport::default();
        loop {
            match self.from_analysis.receive(Duration::from_secs(1)) {
                Received::Value(snapshot) => self.show(&snapshot, &mut report),
                Received::Empty => {}
                Received::Closed => return report,
            }
        }
    }

    fn show(&mut self, snapshot: &Snapshot, report: &mut PreviewReport) {
        let begun = Instant::now();
        let picture = (self.compose)(snapshot);
        let latency = snapshot.time_since(self.clock);
        report.pictures += 1;
        report.binning = Some(snapshot.binning);
        if snapshot.closes_subsequence {
            report.latencies_s.push(latency.as_secs_f64());
        }
        let (picture, pictures) = (Some(Arc::new(picture)), report.pictures);
        self.publisher.publish(Shown { picture, pictures, latency });
        let share = begun.elapsed().as_secs_f64() / self.every.as_secs_f64().max(1e-3);
        self.shared.binning.store(next_binning(snapshot.binning, share), Ordering::Relaxed);
        self.shared.finished.fetch_add(1, Ordering::Release);
    }
}

/// The index of the binning for the next picture, when one took this share of the time between pictures.
fn next_binning(binning: Binning, share: f64) -> u8 {
    let now = Binning::ALL.iter().position(|&other| other == binning).unwrap_or(0);
    let next = match share {
        share if share > TOO_SLOW => (now + 1).min(Binning::ALL.len() - 1),
        share if share < QUICK => now.saturating_sub(1),
        _ => now,
    };
    next as u8
}

impl<P: Send + Sync, C> std::fmt::Debug for Preview<P, C> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Preview").field("every", &self.every).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_pictures_become_coarser_and_quick_ones_finer() {
        assert_eq!(next_binning(Binning::One, 2.0), 1);
        assert_eq!(next_binning(Binning::Eight, 2.0), 3);
        assert_eq!(next_binning(Binning::Four, 0.05), 1);
        assert_eq!(next_binning(Binning::Two, 0.4), 1);
        assert_eq!(next_binning(Binning::One, 0.01), 0);
    }
}
