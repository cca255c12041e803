//! When a rolling-shutter camera exposes and when its frames are there.
//!
//! In: the trigger line, the time now. Out: frames in the order in which they are finished.
//! Never: reads a clock. Fails: never; triggers that come too early are dropped and counted.
//!
//! Free run: a frame each interval. Edge: a pulse begins one exposure. Synchronous readout: a pulse ends one
//! exposure and begins the next, so that `N + 1` pulses give `N` frames. Start: the first pulse begins free run.
//! (Hamamatsu, "Synchronization and Triggering with the ORCA-Flash4.0".)

use std::collections::VecDeque;
use std::time::Duration;

use crate::line::Line;

/// What a trigger does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Input {
    Internal,
    Edge,
    Synchronous,
    Start,
}

/// Times of the shutter, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Timing {
    pub(crate) exposure_s: f64,
    pub(crate) readout_s: f64,
    pub(crate) line_s: f64,
    pub(crate) interval_s: f64,
    pub(crate) least_interval_s: f64,
}

/// Lines from a pulse to the first row.
const EDGE_DELAY_LINES: f64 = 3.0;
const SYNCHRONOUS_DELAY_LINES: f64 = 6.0;

/// A frame on its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Shot {
    /// Number of the exposure: the pulse that began it, or the frame of a free run.
    pub(crate) exposure: u64,
    /// When the library has it.
    pub(crate) done_at: Duration,
}

/// One capture.
#[derive(Debug)]
pub(crate) struct Capture {
    input: Input,
    timing: Timing,
    /// Number of the first pulse that it can hear, and of the next.
    first_pulse: u64,
    next_pulse: u64,
    /// The newest pulse that was heard.
    heard: Option<(u64, Duration)>,
    /// Begin of a free run and its next frame.
    free: Option<(Duration, u64)>,
    pending: VecDeque<Shot>,
    /// Triggers dropped because they came too early.
    pub(crate) too_frequent: u64,
}

impl Capture {
    pub(crate) fn new(input: Input, timing: Timing, line: &Line, now: Duration) -> Self {
        let free = (input == Input::Internal).then_some((now, 0));
        let first_pulse = line.total();
        Self {
            input,
            timing,
            first_pulse,
            next_pulse: first_pulse,
            heard: None,
            free,
            pending: VecDeque::new(),
            too_frequent: 0,
        }
    }

    /// Whether a start trigger has come.
    pub(crate) fn has_started(&self) -> bool {
        self.input == Input::Start && self.free.is_some()
    }

    /// Lets exposures begin up to `now`; pulses for which `misses` holds are not heard. Begins of frames in free
    /// run go to `output`.
    pub(crate) fn advance(
        &mut self,
        line: &Line,
        now: Duration,
        misses: impl Fn(u64) -> bool,
        mut output: impl FnMut(Duration),
    ) {
        while self.next_pulse < line.total() {
            let number = self.next_pulse;
            self.next_pulse += 1;
            if let Some(at) = line.at(number).filter(|_| !misses(number - self.first_pulse)) {
                self.pulse(number - self.first_pulse, at);
            }
        }
        while let Some((begun, frame)) = self.free {
            let at = begun + seconds(self.timing.interval_s * frame as f64);
            if at > now {
                break;
            }
            output(at);
            let done_at = at + seconds(self.timing.exposure_s + self.timing.readout_s);
            self.pending.push_back(Shot { exposure: frame, done_at });
            self.free = Some((begun, frame + 1));
        }
    }

    fn pulse(&mut self, number: u64, at: Duration) {
        let Timing { exposure_s, readout_s, line_s, least_interval_s, .. } = self.timing;
        let early = |(_, heard): (u64, Duration)| {
            (at.saturating_sub(heard)).as_secs_f64() < least_interval_s * (1.0 - 1e-6)
        };
        match self.input {
            Input::Internal => {}
            Input::Start if self.free.is_none() => {
                self.free = Some((at + seconds(EDGE_DELAY_LINES * line_s), 0));
            }
            Input::Start => {}
            _ if self.heard.is_some_and(early) => self.too_frequent += 1,
            Input::Edge => {
                let done_at = at + seconds(EDGE_DELAY_LINES * line_s + exposure_s + readout_s);
                self.pending.push_back(Shot { exposure: number, done_at });
                self.heard = Some((number, at));
            }
            Input::Synchronous => {
                if let Some((begun, _)) = self.heard {
                    let done_at = at + seconds(SYNCHRONOUS_DELAY_LINES * line_s + readout_s);
                    self.pending.push_back(Shot { exposure: begun, done_at });
                }
                self.heard = Some((number, at));
            }
        }
    }

    /// The next frame that is there by `now`.
    pub(crate) fn finished(&mut self, now: Duration) -> Option<Shot> {
        self.pending.front().filter(|shot| shot.done_at <= now)?;
        self.pending.pop_front()
    }

    /// When something happens next, as far as is known.
    pub(crate) fn next_at(&self, line: &Line) -> Option<Duration> {
        let frame = self.pending.front().map(|shot| shot.done_at);
        let free = self.free.map(|(begun, frame)| begun + seconds(self.timing.interval_s * frame as f64));
        [frame, free, line.next_at()].into_iter().flatten().min()
    }
}

fn seconds(seconds: f64) -> Duration {
    Duration::from_nanos((seconds * 1e9).round() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIMING: Timing = Timing {
        exposure_s: 0.004,
        readout_s: 0.002,
        line_s: 1e-5,
        interval_s: 0.004,
        least_interval_s: 0.0061,
    };

    fn frames(input: Input, period_ms: u64, pulses: u64, misses: impl Fn(u64) -> bool) -> (Vec<u64>, u64) {
        let mut line = Line::default();
        line.pulse(Duration::ZERO);
        let mut capture = Capture::new(input, TIMING, &line, Duration::ZERO);
        line.start(Duration::from_millis(1), Duration::from_millis(period_ms), Some(pulses));
        let now = Duration::from_secs(1);
        line.advance(now);
        capture.advance(&line, now, misses, |_| {});
        let shots = std::iter::from_fn(|| capture.finished(now)).map(|shot| shot.exposure).collect();
        (shots, capture.too_frequent)
    }

    #[test]
    fn edges_give_as_many_frames_as_pulses() {
        assert_eq!(frames(Input::Edge, 10, 5, |_| false), (vec![0, 1, 2, 3, 4], 0));
    }

    #[test]
    fn synchronous_readout_gives_one_frame_less_than_pulses() {
        let timing = (vec![0, 1, 2, 3], 0);
        assert_eq!(frames(Input::Synchronous, 10, 5, |_| false), timing);
    }

    #[test]
    fn triggers_that_come_too_early_are_dropped_and_counted() {
        assert_eq!(frames(Input::Edge, 4, 6, |_| false), (vec![0, 2, 4], 3));
    }

    #[test]
    fn missed_triggers_leave_no_trace_but_the_time() {
        assert_eq!(frames(Input::Edge, 10, 4, |pulse| pulse == 1), (vec![0, 2, 3], 0));
        assert_eq!(frames(Input::Synchronous, 10, 5, |pulse| pulse == 2), (vec![0, 1, 3], 0));
    }

    #[test]
    fn a_start_trigger_begins_a_free_run() {
        let (frames, _) = frames(Input::Start, 500, 1, |_| false);
        assert_eq!(frames.len(), 249, "{frames:?}");
    }
}
