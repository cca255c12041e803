//! Whether a silent camera is still there; pure, with time as an argument.
//!
//! In: frames, and answers of the control channel. Out: what to do next. Never: reads a clock, talks to a camera.

use std::time::{Duration, Instant};

/// Silence after which the control channel is asked.
const QUIET: Duration = Duration::from_millis(250);
/// Time that it has for an answer.
const ANSWER: Duration = Duration::from_millis(150);
/// Unanswered questions after which the camera is gone.
const MOST_UNANSWERED: u32 = 4;
/// Shortest silence that is a stall.
const SHORTEST_STALL: Duration = Duration::from_millis(500);
/// Periods of silence that are a stall.
const STALLED_PERIODS: u32 = 5;

/// What the control channel answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Answer {
    /// The camera is there, and somebody has control of it.
    Controlled,
    /// The camera is there, and nobody has control: its heartbeat ran out.
    Uncontrolled,
}

/// What to do while no frame comes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Advice {
    Wait,
    /// Ask the control channel now.
    Ask,
    /// The control channel answers no more.
    Gone,
    /// The camera answers, but is no longer ours.
    ControlLost,
}

#[derive(Debug, Clone)]
pub(crate) struct Watchdog {
    stall_after: Duration,
    last_frame: Instant,
    ask_at: Instant,
    unanswered: u32,
    has_answered: bool,
}

impl Watchdog {
    /// For a camera that was just armed with exposures `period` apart.
    pub(crate) fn new(period: Duration, now: Instant) -> Self {
        Self {
            stall_after: period.saturating_mul(STALLED_PERIODS).max(SHORTEST_STALL),
            last_frame: now,
            ask_at: now + QUIET,
            unanswered: 0,
            has_answered: false,
        }
    }

    pub(crate) fn frame(&mut self, now: Instant) {
        self.last_frame = now;
        self.ask_at = now + QUIET;
        self.unanswered = 0;
    }

    /// What to do at `now`, when no frame is there; `answer` is what came from the control channel since.
    pub(crate) fn step(&mut self, now: Instant, answer: Option<Answer>) -> Advice {
        match answer {
            Some(Answer::Uncontrolled) => return Advice::ControlLost,
            Some(Answer::Controlled) => {
                self.unanswered = 0;
                self.has_answered = true;
                self.ask_at = now + QUIET;
            }
            None => {}
        }
        if now < self.ask_at {
            return Advice::Wait;
        }
        if self.unanswered >= MOST_UNANSWERED {
            return Advice::Gone;
        }
        self.unanswered += 1;
        self.ask_at = now + ANSWER;
        Advice::Ask
    }

    /// Silence so far, if it is a stall: frames should have come, and the control channel answers.
    pub(crate) fn stall(&self, now: Instant) -> Option<Duration> {
        let silence = now.saturating_duration_since(self.last_frame);
        (silence >= self.stall_after).then_some(silence)
    }

    /// Whether the control channel has answered during the present silence.
    pub(crate) fn control_answers(&self) -> bool {
        self.has_answered && self.unanswered <= 1
    }

    /// Silence so far.
    pub(crate) fn silence(&self, now: Instant) -> Duration {
        now.saturating_duration_since(self.last_frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(10);

    /// Milliseconds until the watchdog gives up, with what answers each question.
    fn gives_up_after(answer: impl Fn(u32) -> Option<Answer>) -> Option<(u128, Advice)> {
        let begun = Instant::now();
        let mut watchdog = Watchdog::new(PERIOD, begun);
        let mut asked = 0;
        let mut answers = None;
        for millisecond in 0..20_000 {
            let now = begun + Duration::from_millis(millisecond);
            match watchdog.step(now, answers.take()) {
                Advice::Wait => {}
                Advice::Ask => {
                    answers = answer(asked);
                    asked += 1;
                }
                over => return Some((u128::from(millisecond), over)),
            }
        }
        assert!(watchdog.control_answers());
        assert!(watchdog.stall(begun + Duration::from_secs(20)).is_some());
        None
    }

    #[test]
    fn a_camera_that_answers_is_never_given_up() {
        assert_eq!(gives_up_after(|_| Some(Answer::Controlled)), None);
        let deaf_at_times = |asked| (asked % 4 == 3).then_some(Answer::Controlled);
        assert_eq!(gives_up_after(deaf_at_times), None);
    }

    #[test]
    fn a_dead_camera_is_given_up_within_a_second() {
        assert_eq!(gives_up_after(|_| None), Some((850, Advice::Gone)));
        let lost = gives_up_after(|_| Some(Answer::Uncontrolled));
        assert_eq!(lost, Some((251, Advice::ControlLost)));
    }

    #[test]
    fn a_stall_is_five_periods_and_at_least_half_a_second() {
        let begun = Instant::now();
        for (period_ms, stall_ms) in [(10, 500), (100, 500), (300, 1500)] {
            let mut watchdog = Watchdog::new(Duration::from_millis(period_ms), begun);
            watchdog.frame(begun + Duration::from_millis(7));
            let at = |ms| begun + Duration::from_millis(7 + ms);
            assert_eq!(watchdog.stall(at(stall_ms - 1)), None);
            assert_eq!(watchdog.stall(at(stall_ms)), Some(Duration::from_millis(stall_ms)));
        }
    }
}
