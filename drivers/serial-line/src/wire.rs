//! Makes a model as slow as a real line, and as faulty as the scenario says.

use std::collections::VecDeque;
use std::time::Duration;

use crate::model::LineModel;
use crate::port::LineSettings;

/// What a line does to the bytes of the device; nothing by default.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WireFaults {
    /// Pause between single bytes of an answer, beside the time that they take.
    pub pause: Duration,
    /// Bytes from the device that are swallowed from now on; `usize::MAX` for a line that has died.
    pub swallow: usize,
    /// Bytes that appear before the next answer.
    pub garbage: Vec<u8>,
    /// Delay of everything that the device sends.
    pub delay: Duration,
    /// Whether the plug is out.
    pub unplugged: bool,
}

/// A model behind a wire.
pub struct Wire<M> {
    model: M,
    time_per_byte: Duration,
    faults: WireFaults,
    under_way: VecDeque<(Duration, u8)>,
    free_at: Duration,
}

impl<M: LineModel> Wire<M> {
    /// A wire without faults.
    pub fn new(model: M, settings: LineSettings) -> Self {
        Self {
            model,
            time_per_byte: settings.time_per_byte(),
            faults: WireFaults::default(),
            under_way: VecDeque::new(),
            free_at: Duration::ZERO,
        }
    }

    /// The device at the other end.
    pub fn model(&mut self) -> &mut M {
        &mut self.model
    }

    /// What the line does from now on.
    pub fn faults(&mut self) -> &mut WireFaults {
        &mut self.faults
    }

    fn put(&mut self, now: Duration, bytes: &[u8]) {
        for byte in bytes {
            if self.faults.swallow > 0 {
                self.faults.swallow = match self.faults.swallow {
                    usize::MAX => usize::MAX,
                    left => left - 1,
                };
                continue;
            }
            let begin = self.free_at.max(now + self.faults.delay);
            self.free_at = begin + self.time_per_byte + self.faults.pause;
            self.under_way.push_back((self.free_at, *byte));
        }
    }
}

impl<M: LineModel> LineModel for Wire<M> {
    fn receive(&mut self, bytes: &[u8], now: Duration) {
        self.model.receive(bytes, now);
    }

    fn advance(&mut self, now: Duration, out: &mut Vec<u8>) -> Option<Duration> {
        let mut sent = Vec::new();
        let model_next = self.model.advance(now, &mut sent);
        if !sent.is_empty() {
            let garbage = std::mem::take(&mut self.faults.garbage);
            self.put(now, &garbage);
            self.put(now, &sent);
        }
        while let Some((_, byte)) = self.under_way.pop_front_if(|(at, _)| *at <= now) {
            out.push(byte);
        }
        let wire_next = self.under_way.front().map(|(at, _)| *at);
        [model_next, wire_next].into_iter().flatten().min()
    }

    fn plugged(&self) -> bool {
        !self.faults.unplugged && self.model.plugged()
    }
}
