//! The numbers of a run as the window shows them, put together from sequencer and data path.
//!
//! In: the sequencer's status, the board, times. Out: [`RunNumbers`]. Never: reads a clock. Fails: not at all.

use super::board::PathNumbers;
use crate::control::sequencer::Status;
use crate::viewer::bench::RunNumbers;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::time::Duration;

/// Frame rates are means over this time.
const RATE_OVER: Duration = Duration::from_millis(1500);

/// What is known of a run before it begins.
#[derive(Debug, Clone, Default)]
pub(super) struct RunOutline {
    /// Exposures of each series.
    pub(super) planned: Option<u64>,
    /// Series in all.
    pub(super) series: usize,
    /// Time from exposure to exposure.
    pub(super) period: Duration,
    /// Where the recording goes.
    pub(super) recording: Option<PathBuf>,
    /// Bytes of both frames of an exposure.
    pub(super) bytes_per_exposure: u64,
}

/// Puts the numbers together while a run goes on.
#[derive(Debug, Default)]
pub(super) struct Counter {
    outline: RunOutline,
    frames: VecDeque<(Duration, [u64; 2])>,
}

impl Counter {
    pub(super) fn new(outline: RunOutline) -> Self {
        Self { outline, frames: VecDeque::new() }
    }

    /// The numbers at `now`, a time since the run began; `disk_free` where frames are recorded.
    pub(super) fn numbers(
        &mut self,
        status: &Status<'_>,
        path: &PathNumbers,
        now: Duration,
        disk_free: Option<u64>,
    ) -> RunNumbers {
        let outline = &self.outline;
        let (done, planned) = (status.progress.frames, outline.planned);
        let later = outline.series.saturating_sub(status.series + 1) as u64;
        let left = planned.map(|planned| planned.saturating_sub(done) + later * planned);
        let rate = 1.0 / outline.period.as_secs_f64().max(1e-6);
        let disk_left = disk_free
            .filter(|_| outline.bytes_per_exposure > 0)
            .map(|free| Duration::from_secs_f64(free as f64 / (outline.bytes_per_exposure as f64 * rate)));
        RunNumbers {
            phase: status.phase.name().to_owned(),
            series: (status.series + 1, outline.series),
            exposures: done,
            planned,
            received: path.progress.received,
            lost: path
                .progress
                .lost
                .iter()
                .map(|(reason, frames)| (reason.in_words().to_owned(), *frames))
                .collect(),
            pairs: path.progress.pairs,
            pairs_analyzed: path.progress.pairs_analyzed,
            left_out: path.progress.analysis_left_out,
            unrecorded: path.progress.unrecorded,
            frame_rate: self.frame_rate(now, path.frames),
            fill: path.progress.fill,
            latency: path.latency,
            elapsed: status.progress.acquired,
            remaining: left.map(|left| Duration::from_secs_f64(left as f64 / rate)),
            disk_free,
            disk_left,
            recording: self.outline.recording.clone(),
            ended: String::new(),
        }
    }

    fn frame_rate(&mut self, now: Duration, frames: [u64; 2]) -> [f64; 2] {
        // The count of a new series begins at zero.
        if self.frames.back().is_some_and(|(_, last)| last[0] > frames[0] || last[1] > frames[1]) {
            self.frames.clear();
        }
        self.frames.push_back((now, frames));
        while self.frames.len() > 2
            && self.frames.get(1).is_some_and(|(at, _)| now.saturating_sub(*at) > RATE_OVER)
        {
            self.frames.pop_front();
        }
        let (begun, first) = self.frames[0];
        let seconds = now.saturating_sub(begun).as_secs_f64();
        [0, 1].map(
            |camera| {
                if seconds > 0.0 { (frames[camera] - first[camera]) as f64 / seconds } else { 0.0 }
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::run_state::RunPhase;
    use crate::control::stop_rule::Progress;

    #[test]
    fn rates_and_what_is_left_follow_from_counts() {
        let outline = RunOutline {
            planned: Some(1000),
            series: 2,
            period: Duration::from_millis(20),
            recording: None,
            bytes_per_exposure: 1000,
        };
        let mut counter = Counter::new(outline);
        let mut numbers = RunNumbers::default();
        for step in 0..=100 {
            let progress = Progress { frames: step * 5, ..Progress::default() };
            let status =
                Status { series: 0, phase: &RunPhase::Acquiring, progress: &progress, record_drops: 0 };
            let path = PathNumbers { frames: [step * 5, step * 4], ..PathNumbers::default() };
            numbers = counter.numbers(&status, &path, Duration::from_millis(100 * step), Some(5_000_000));
        }
        assert!((numbers.frame_rate[0] - 50.0).abs() < 1e-6 && (numbers.frame_rate[1] - 40.0).abs() < 1e-6);
        assert_eq!(numbers.remaining, Some(Duration::from_secs(30)), "500 and another 1000 at 50 per second");
        assert_eq!(numbers.disk_left, Some(Duration::from_secs(100)));
        assert_eq!(numbers.series, (1, 2));
        let (progress, path) =
            (Progress::default(), PathNumbers { frames: [1, 1], ..PathNumbers::default() });
        let status = Status { series: 1, phase: &RunPhase::Acquiring, progress: &progress, record_drops: 0 };
        let next = counter.numbers(&status, &path, Duration::from_secs(11), None);
        assert_eq!((next.frame_rate, next.disk_left), ([0.0, 0.0], None), "a new series counts anew");
    }
}
