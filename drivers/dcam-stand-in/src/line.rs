//! A trigger line: pulses and when they came.
//!
//! In: trains of pulses, single pulses, the time now. Out: the time of each pulse by its number.
//! Never: reads a clock. Fails: never; pulses long past are forgotten.

use std::collections::VecDeque;
use std::time::Duration;

/// Pulses that are remembered.
const MOST_REMEMBERED: usize = 1 << 16;

/// Pulses that follow each other evenly.
#[derive(Debug, Clone, Copy)]
struct Train {
    next: Duration,
    period: Duration,
    left: Option<u64>,
}

/// A trigger line.
#[derive(Debug, Default)]
pub(crate) struct Line {
    times: VecDeque<Duration>,
    forgotten: u64,
    train: Option<Train>,
}

impl Line {
    /// Pulses that came since power-up.
    pub(crate) fn total(&self) -> u64 {
        self.forgotten + self.times.len() as u64
    }

    /// Begins a train with a pulse now; false while one runs.
    pub(crate) fn start(&mut self, now: Duration, period: Duration, pulses: Option<u64>) -> bool {
        self.advance(now);
        if self.train.is_some() {
            return false;
        }
        self.train = Some(Train { next: now, period, left: pulses });
        true
    }

    pub(crate) fn stop(&mut self, now: Duration) {
        self.advance(now);
        self.train = None;
    }

    pub(crate) fn pulse(&mut self, at: Duration) {
        if self.times.len() == MOST_REMEMBERED {
            self.times.pop_front();
            self.forgotten += 1;
        }
        self.times.push_back(at);
    }

    /// Lets the train come as far as `now`.
    pub(crate) fn advance(&mut self, now: Duration) {
        while let Some(Train { next, period, left }) = self.train {
            if left == Some(0) {
                self.train = None;
            } else if next <= now {
                self.train = Some(Train { next: next + period, period, left: left.map(|left| left - 1) });
                self.pulse(next);
            } else {
                break;
            }
        }
    }

    /// When the pulse with a number came.
    pub(crate) fn at(&self, number: u64) -> Option<Duration> {
        let place = number.checked_sub(self.forgotten)?;
        self.times.get(usize::try_from(place).ok()?).copied()
    }

    /// When the next pulse comes, if one is known to come.
    pub(crate) fn next_at(&self) -> Option<Duration> {
        self.train.filter(|train| train.left != Some(0)).map(|train| train.next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trains_give_their_pulses_and_end() {
        let ms = Duration::from_millis;
        let mut line = Line::default();
        assert!(line.start(ms(5), ms(10), Some(3)));
        assert!(!line.start(ms(6), ms(10), None), "one runs");
        line.advance(ms(100));
        assert_eq!((line.total(), line.at(0), line.at(2), line.at(3)), (3, Some(ms(5)), Some(ms(25)), None));
        assert!(line.start(ms(100), ms(10), None), "it has ended");
        line.stop(ms(115));
        line.advance(ms(500));
        assert_eq!(line.total(), 5);
    }
}
