//! From exposures to arrivals at the driver: what is lost, late, doubled or shuffled on the way.
//!
//! In: one exposure after another. Out: arrivals in the order of delivery, incidents for the record.
//! Never: reads a clock, looks at pixels, allocates after it was made.
//! Every decision depends on seed, channel and exposure only.

use std::collections::VecDeque;

use rand::Rng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sofiscope_hal::{Channel, FrameStatus};

use super::oracle::{IncidentKind, Record};
use super::settings::CameraFaults;
use crate::random::{Stream, uniform};

const MOST_REORDERED: u64 = 64;
const MOST_LATE: u64 = 64;

/// A frame on its way to the reader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Arrival {
    /// Exposure in triggers since arming.
    pub(super) exposure: u64,
    /// Frames that the camera had counted before it; behind `exposure` by the triggers it missed, ahead by extra ones.
    pub(super) number: u64,
    pub(super) status: FrameStatus,
    /// How often it is still to be delivered.
    pub(super) copies: u8,
    /// Whether the reader has it already.
    pub(super) read: bool,
    /// Whether it is of an extra trigger before the exposure.
    pub(super) extra: bool,
}

/// The way of one camera's frames.
#[derive(Debug)]
pub(super) struct Delivery {
    seed: u64,
    channel: Channel,
    faults: CameraFaults,
    window_length: u64,
    /// The next exposure.
    next: u64,
    missed: u64,
    extra: u64,
    burst_until: u64,
    window: Vec<Arrival>,
    /// Late frames with the exposure after which they arrive.
    late: VecDeque<(u64, Arrival)>,
}

/// The chances of one exposure; drawn in fixed order, so that no setting changes those of another.
struct Chances {
    drop: f64,
    burst: f64,
    burst_length: f64,
    incomplete: f64,
    duplicate: f64,
    late: f64,
}

impl Chances {
    fn of(seed: u64, channel: Channel, exposure: u64) -> Self {
        let mut rng = Stream::Mishap { channel: channel.index() as u64, exposure }.generator(seed);
        let mut draw = || uniform(&mut rng);
        Self {
            drop: draw(),
            burst: draw(),
            burst_length: draw(),
            incomplete: draw(),
            duplicate: draw(),
            late: draw(),
        }
    }
}

impl Delivery {
    pub(super) fn new(seed: u64, channel: Channel, faults: &CameraFaults) -> Self {
        let window_length = faults.reorder_within.unwrap_or(1).clamp(1, MOST_REORDERED);
        let late_by_frames = faults.late_by_frames.clamp(1, MOST_LATE);
        Self {
            seed,
            channel,
            faults: CameraFaults { late_by_frames, ..faults.clone() },
            window_length,
            next: 0,
            missed: 0,
            extra: 0,
            burst_until: 0,
            window: Vec::with_capacity(2 * window_length as usize),
            late: VecDeque::with_capacity(late_by_frames as usize + 1),
        }
    }

    /// The next exposure to take.
    pub(super) fn next(&self) -> u64 {
        self.next
    }

    /// Frames by which one may come after a later one.
    pub(super) fn reorder(&self) -> u64 {
        2 * self.window_length + self.faults.late_by_frames
    }

    /// The most frames that one exposure can let arrive.
    pub(super) fn most_at_once(&self) -> usize {
        self.window.capacity() + self.late.capacity() + 1
    }

    /// Takes the next exposure and hands on what arrives with its end.
    pub(super) fn expose(&mut self, record: &mut Record, mut arrive: impl FnMut(Arrival, &mut Record)) {
        let exposure = self.next;
        self.next += 1;
        record.begun += 1;
        if self.faults.id_restart_at == Some(exposure) {
            // A camera that restarts has nothing on its way any more.
            self.flush(record, &mut arrive);
            record.note(exposure, IncidentKind::CounterRestart);
        }
        if self.faults.clock_step.is_some_and(|step| step.at == exposure) {
            record.note(exposure, IncidentKind::ClockStep);
        }
        while self.late.front().is_some_and(|&(due, _)| due <= exposure) {
            if let Some((_, arrival)) = self.late.pop_front() {
                arrive(arrival, record);
            }
        }
        self.take(exposure, record);
        if self.next.is_multiple_of(self.window_length) {
            self.close_window(record, &mut arrive);
        }
    }

    /// Hands on everything that is still on its way.
    pub(super) fn flush(&mut self, record: &mut Record, mut arrive: impl FnMut(Arrival, &mut Record)) {
        self.close_window(record, &mut arrive);
        for (_, arrival) in self.late.drain(..) {
            arrive(arrival, record);
        }
    }

    /// Decides about one exposure.
    fn take(&mut self, exposure: u64, record: &mut Record) {
        let chances = Chances::of(self.seed, self.channel, exposure);
        if let Some(bursts) = self.faults.bursts
            && chances.burst < bursts.probability
        {
            let [fewest, most] = bursts.lengths;
            let choices = most.saturating_sub(fewest) + 1;
            let length = fewest + ((chances.burst_length * choices as f64) as u64).min(choices - 1);
            self.burst_until = self.burst_until.max(exposure + length);
        }
        if self.faults.missed_trigger_at.contains(&exposure) {
            self.missed += 1;
            record.note(exposure, IncidentKind::MissedTrigger);
            return;
        }
        let mut number = exposure + self.extra - self.missed;
        if self.faults.extra_trigger_at.contains(&exposure) {
            record.note(exposure, IncidentKind::ExtraTrigger);
            let status = FrameStatus::Complete;
            self.window.push(Arrival { exposure, number, status, copies: 1, read: false, extra: true });
            self.extra += 1;
            number += 1;
        }
        if exposure < self.burst_until {
            record.note(exposure, IncidentKind::DroppedInBurst);
            return;
        }
        if one_in(self.faults.drop_one_in, chances.drop) {
            record.note(exposure, IncidentKind::Dropped);
            return;
        }
        let status = self.status(exposure, chances.incomplete, record);
        let twice =
            status == FrameStatus::Complete && one_in(self.faults.duplicate_one_in, chances.duplicate);
        let copies = 1 + u8::from(twice);
        let arrival = Arrival { exposure, number, status, copies, read: false, extra: false };
        if one_in(self.faults.late_one_in, chances.late) {
            record.note(exposure, IncidentKind::Late);
            self.late.push_back((exposure + self.faults.late_by_frames, arrival));
        } else {
            self.window.push(arrival);
        }
    }

    fn status(&self, exposure: u64, chance: f64, record: &mut Record) -> FrameStatus {
        if self.faults.wrong_size_at.contains(&exposure) {
            record.note(exposure, IncidentKind::WrongSize);
            FrameStatus::SizeMismatch
        } else if one_in(self.faults.incomplete_one_in, chance) {
            record.note(exposure, IncidentKind::Incomplete);
            FrameStatus::Incomplete
        } else {
            FrameStatus::Complete
        }
    }

    fn close_window(&mut self, record: &mut Record, arrive: &mut impl FnMut(Arrival, &mut Record)) {
        if self.window_length > 1 {
            let window = self.next.saturating_sub(1) / self.window_length;
            let stream = Stream::Order { channel: self.channel.index() as u64, window };
            shuffle(&mut self.window, &mut stream.generator(self.seed));
        }
        for arrival in self.window.drain(..) {
            arrive(arrival, record);
        }
    }
}

fn one_in(number: Option<u64>, chance: f64) -> bool {
    number.is_some_and(|number| chance * (number as f64) < 1.0)
}

/// Fisher and Yates; the modulo is harmless for so few.
fn shuffle(window: &mut [Arrival], rng: &mut Xoshiro256PlusPlus) {
    for last in (1..window.len()).rev() {
        window.swap(last, (rng.next_u64() % (last as u64 + 1)) as usize);
    }
}
