//! What starts exposures, and when: the camera's own rate, pulses on the optical table, or commands.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::PoisonError;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use super::control::Body;
use super::gvsp::{self, Packets};
use super::sending::Sending;
use super::setup::{Setup, Trigger};
use super::{Damage, Exposure, Fate, FrameSource};
use crate::table::Quantity;

/// How often the trigger line is looked at.
const LINE_LOOK: Duration = Duration::from_micros(200);
/// Longest wait without a look at the flags.
const LONGEST_WAIT: Duration = Duration::from_millis(20);
/// A camera that cannot send its frames for longer than this exposes more slowly.
const MEMORY: Duration = Duration::from_millis(300);

/// One acquisition after another, until the camera is over.
pub(super) fn run(body: &Body, source: &mut dyn FrameSource) {
    while let Some((run, setup)) = next_acquisition(body) {
        let mut acquisition = Acquisition {
            body,
            run,
            setup,
            pulses: Pulses::new(body),
            index: 0,
            block_id: body.settings.first_block_id.max(1),
            counts: vec![0; setup.region.num_pixels()],
        };
        acquisition.expose(source);
    }
}

/// Waits until exposures are asked for; `None` at the end.
fn next_acquisition(body: &Body) -> Option<(u64, Setup)> {
    let mut state = body.state();
    loop {
        if body.is_over.load(Relaxed) {
            return None;
        }
        if state.registers.is_exposing {
            return Some((state.run, state.registers.setup()));
        }
        let waited = body.changed.wait_timeout(state, LONGEST_WAIT);
        state = waited.unwrap_or_else(PoisonError::into_inner).0;
    }
}

struct Acquisition<'a> {
    body: &'a Body,
    run: u64,
    setup: Setup,
    pulses: Pulses,
    /// Exposures since the begin, those included that were missed.
    index: u64,
    block_id: u16,
    counts: Vec<u16>,
}

impl Acquisition<'_> {
    fn expose(&mut self, source: &mut dyn FrameSource) {
        let faults = &self.body.settings.faults;
        let mut sending = Sending::new(self.body, self.run, self.setup);
        let mut free_from = Duration::ZERO;
        let mut begin = crate::monotonic();
        while let Some(begun) = self.next_begin(begin) {
            begin = begun;
            let index = self.index;
            self.index += 1;
            if begin < free_from || faults.missed_triggers.contains(&index) {
                self.note(index, Fate::Missed);
                continue;
            }
            free_from = begin + self.setup.exposure;
            if faults.silent_at.is_some_and(|at| index >= at) {
                self.body.is_silent.store(true, Relaxed);
            }
            if faults.control_lost_at == Some(index) {
                self.body.lose_control();
            }
            if faults.restart_ids_at == Some(index) {
                self.block_id = 1;
            }
            let frame = self.frame(source, index, begin);
            if !self.wait_until(free_from) {
                return;
            }
            let halts = [faults.stall_at, faults.silent_at];
            if !halts.into_iter().flatten().any(|at| index >= at) {
                sending.send(&frame, index);
            }
            self.block_id = self.block_id.checked_add(1).unwrap_or(1);
            let late = crate::monotonic().saturating_sub(free_from);
            if late > MEMORY.max(self.setup.period) {
                begin += late;
            }
        }
    }

    fn note(&self, exposure: u64, fate: Fate) {
        self.body.record.note(Damage { run: self.run, exposure, block_id: self.block_id, fate });
    }

    fn frame(&mut self, source: &mut dyn FrameSource, index: u64, begin: Duration) -> Arc<Packets> {
        let Setup { region, format, packet_size, exposure, .. } = self.setup;
        let exposure = Exposure {
            index,
            left: region.left,
            top: region.top,
            width: region.width,
            height: region.height,
            time: exposure,
        };
        source.expose(&exposure, &mut self.counts);
        let mut payload = Vec::with_capacity(format.num_bytes(self.counts.len()));
        gvsp::pack(format, &self.counts, &mut payload);
        let time_ns = u64::try_from(begin.as_nanos()).unwrap_or(u64::MAX);
        Arc::new(Packets { block_id: self.block_id, time_ns, region, format, payload, packet_size })
    }

    /// Begin of the next exposure; `None` when the acquisition is over.
    fn next_begin(&mut self, previous: Duration) -> Option<Duration> {
        match self.setup.trigger {
            Trigger::Off if self.index == 0 => self.is_on().then_some(previous),
            Trigger::Off => self.is_on().then_some(previous + self.setup.period),
            trigger => loop {
                if let Some(pulse) = self.pulses.next(self.body, trigger) {
                    return Some(pulse);
                }
                if !self.wait_until(crate::monotonic() + LINE_LOOK) {
                    return None;
                }
            },
        }
    }

    fn is_on(&self) -> bool {
        self.wait_until(Duration::ZERO)
    }

    /// Waits; false when the acquisition is over before.
    fn wait_until(&self, deadline: Duration) -> bool {
        let mut state = self.body.state();
        loop {
            let is_over = self.body.is_over.load(Relaxed);
            if is_over || !state.registers.is_exposing || state.run != self.run {
                return false;
            }
            let now = crate::monotonic();
            if now >= deadline {
                return true;
            }
            let wait = (deadline - now).min(LONGEST_WAIT);
            let waited = self.body.changed.wait_timeout(state, wait);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// Pulses that came and were not yet taken for an exposure.
struct Pulses {
    line: u64,
    last: Duration,
    software: u64,
    waiting: VecDeque<Duration>,
}

impl Pulses {
    fn new(body: &Body) -> Self {
        let (line, last) = newest_pulse(body);
        Self { line, last, software: body.state().software_pulses, waiting: VecDeque::new() }
    }

    fn next(&mut self, body: &Body, trigger: Trigger) -> Option<Duration> {
        if self.waiting.is_empty() {
            if trigger == Trigger::Line {
                self.look_at_line(body);
            } else {
                let pulses = body.state().software_pulses;
                let new = usize::try_from(pulses - self.software).unwrap_or(0);
                self.waiting.extend(std::iter::repeat_n(crate::monotonic(), new));
                self.software = pulses;
            }
        }
        self.waiting.pop_front()
    }

    /// Several pulses since the last look lie evenly between the last one seen and the newest.
    fn look_at_line(&mut self, body: &Body) {
        let (line, newest) = newest_pulse(body);
        let new = line.saturating_sub(self.line);
        if new > 0 {
            let apart = newest.saturating_sub(self.last) / u32::try_from(new).unwrap_or(u32::MAX);
            self.waiting.extend(
                (0..new)
                    .rev()
                    .map(|before| newest.saturating_sub(apart * u32::try_from(before).unwrap_or(u32::MAX))),
            );
        }
        // A trigger controller that was switched off and on counts from zero.
        (self.line, self.last) = (line, newest);
    }
}

fn newest_pulse(body: &Body) -> (u64, Duration) {
    let Some(table) = &body.settings.table else { return (0, Duration::ZERO) };
    let seconds = table.get(Quantity::LastPulse).max(0.0);
    let last = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO);
    (table.get(Quantity::Pulses).max(0.0) as u64, last)
}
