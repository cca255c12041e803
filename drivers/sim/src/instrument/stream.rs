//! The frames of one armed simulated camera.
//!
//! In: a schedule, a delivery, a view of the source. Out: frames, one per call.
//! Never: allocates per frame. Fails: as [`FrameStream`] says.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::time::Duration;

use sofiscope_hal::clock::nanoseconds;
use sofiscope_hal::{
    Channel, DeviceError, DeviceTime, ErrorKind, ExposureIndex, ExposureNumbering, FrameInfo, FrameStatus,
    FrameStream, HostTime, IdRule,
};

use super::delivery::{Arrival, Delivery};
use super::oracle::{IncidentKind, Record, SharedRecord};
use super::schedule::{Outlook, Schedule, Timing};
use super::settings::{CameraBehavior, Pace};
use super::source::Viewfinder;
use crate::random::{Stream, uniform};

/// What stands in memory that must not be used.
const RUBBISH: u16 = 0xBAD0;
/// What every pixel of an extra exposure shows, so that it is never taken for one of the sample.
const EXTRA: u16 = 0x0E17;
/// The farthest that a camera's clock jumps, seconds.
const MOST_STEP_S: f64 = 1e5;

/// Where a camera falls silent by a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Halt {
    Stall,
    Death,
}

/// What a stream is made of.
pub(super) struct Parts {
    pub(super) device: String,
    pub(super) channel: Channel,
    pub(super) seed: u64,
    pub(super) behavior: CameraBehavior,
    pub(super) timing: Arc<Timing>,
    pub(super) schedule: Arc<Schedule>,
    pub(super) view: Viewfinder,
    pub(super) record: SharedRecord,
    /// Exposures of the sample until there is nothing more to see.
    pub(super) source_end: u64,
    /// Exposures after which the camera ends.
    pub(super) limit: u64,
    /// Time on the camera's clock at arming.
    pub(super) clock_ns: u64,
    /// Set when the camera dies.
    pub(super) dead: Arc<AtomicBool>,
}

/// The frames of one armed simulated camera.
pub(super) struct SimulatedStream {
    parts: Parts,
    delivery: Delivery,
    rule: IdRule,
    numbering: Option<ExposureNumbering>,
    /// What has arrived and was not read yet: the buffers of the driver.
    arrived: VecDeque<Arrival>,
    halted: bool,
}

impl SimulatedStream {
    pub(super) fn new(parts: Parts) -> Self {
        let delivery = Delivery::new(parts.seed, parts.channel, &parts.behavior.faults);
        let places = parts.behavior.buffers.max(1) + delivery.most_at_once();
        Self {
            rule: parts.behavior.counter.rule(delivery.reorder()),
            delivery,
            numbering: None,
            arrived: VecDeque::with_capacity(places),
            halted: false,
            parts,
        }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.parts.device.clone(), message)
    }

    fn now(&self) -> HostTime {
        self.parts.timing.clock.now()
    }

    /// First exposure of which nothing comes, and why.
    fn halt(&self) -> Option<(u64, Halt)> {
        let faults = &self.parts.behavior.faults;
        let stall = faults.stall_at.map(|at| (at, Halt::Stall));
        let death = faults.die_at.map(|at| (at, Halt::Death));
        stall.into_iter().chain(death).min_by_key(|&(at, _)| at)
    }

    /// Lets finished exposures arrive: all of them by the clock, in virtual time up to the first that brings
    /// something. Tells whether `patience` of them brought nothing.
    fn advance(&mut self, until: u64, patience: u64) -> bool {
        let paced = self.parts.timing.pace != Pace::Unpaced;
        let buffers = if paced { self.parts.behavior.buffers.max(1) } else { usize::MAX };
        let last = if paced { until } else { until.min(self.delivery.next().saturating_add(patience)) };
        let mut record = self.parts.record.lock();
        let arrived = &mut self.arrived;
        let schedule = &self.parts.schedule;
        while self.delivery.next() < last
            && (paced || (arrived.is_empty() && schedule.claim(self.delivery.next())))
        {
            self.delivery.expose(&mut record, |arrival, record| arrive(arrived, arrival, buffers, record));
        }
        arrived.is_empty() && last < until && self.delivery.next() >= last
    }

    /// Lets everything arrive that is still on its way.
    fn flush(&mut self) {
        let mut record = self.parts.record.lock();
        let arrived = &mut self.arrived;
        self.delivery.flush(&mut record, |arrival, record| arrive(arrived, arrival, usize::MAX, record));
    }

    /// Takes the next arrival, if any.
    fn pop(&mut self) -> Option<Arrival> {
        let front = self.arrived.front_mut()?;
        let arrival = *front;
        front.copies -= 1;
        front.read = true;
        if front.copies == 0 {
            self.arrived.pop_front();
        }
        Some(arrival)
    }

    /// Notes the silence that begins here, once.
    fn halt_here(&mut self, (at, halt): (u64, Halt)) {
        if halt == Halt::Death {
            self.parts.dead.store(true, SeqCst);
        }
        if !self.halted {
            self.halted = true;
            let kind = if halt == Halt::Death { IncidentKind::Died } else { IncidentKind::Stalled };
            self.parts.record.lock().note(at, kind);
        }
    }

    fn deliver(
        &mut self,
        arrival: Arrival,
        outlook: Outlook,
        counts: &mut [u16],
    ) -> Result<FrameInfo, DeviceError> {
        let period = outlook.period.unwrap_or(Duration::ZERO);
        let exposure = ExposureIndex(outlook.first + arrival.exposure);
        let early_ns = if arrival.extra { nanoseconds(period) / 2 } else { 0 };
        let device_time = device_time(&self.parts, exposure, arrival.exposure, period);
        let device_time = DeviceTime(device_time.0.wrapping_sub(early_ns));
        let block_id = self.parts.behavior.counter.id(self.count_shown(arrival));
        let rule = self.rule;
        let numbering = self.numbering.get_or_insert_with(|| ExposureNumbering::new(rule, period));
        let numbered = numbering.exposure_of(block_id, device_time);
        let (numbered, epoch) = numbered.map_err(|error| {
            if is_of_sample(arrival) {
                self.parts.record.lock().note(arrival.exposure, IncidentKind::Unplaceable);
            }
            let message = format!("{error}; stop and arm the camera again");
            DeviceError::new(ErrorKind::Protocol, self.parts.device.clone(), message)
        })?;
        if arrival.extra {
            counts.fill(EXTRA);
            self.parts.record.lock().extra += 1;
        } else if arrival.status == FrameStatus::Complete {
            self.parts.view.expose(exposure, counts);
            let mut record = self.parts.record.lock();
            if arrival.read {
                record.duplicates += 1;
                record.note(arrival.exposure, IncidentKind::Duplicated);
            } else {
                record.intact += 1;
            }
        } else {
            counts.fill(RUBBISH);
        }
        Ok(FrameInfo { exposure: numbered, block_id, epoch, device_time, status: arrival.status })
    }

    /// Frames that the camera's counter shows, which a restart sets back.
    fn count_shown(&self, arrival: Arrival) -> u64 {
        let faults = &self.parts.behavior.faults;
        match faults.id_restart_at {
            Some(restart) if restart <= arrival.exposure => {
                let before = |all: &[u64]| all.iter().filter(|&&at| at < restart).count() as u64;
                let counted = restart + before(&faults.extra_trigger_at) - before(&faults.missed_trigger_at);
                arrival.number - counted
            }
            _ => arrival.number,
        }
    }

    /// Exposures in all, as far as known.
    fn end(&self, outlook: Outlook) -> u64 {
        let seen = self.parts.source_end.saturating_sub(outlook.first);
        outlook.end.min(seen).min(self.parts.limit)
    }
}

impl FrameStream for SimulatedStream {
    fn next_frame(&mut self, counts: &mut [u16], timeout: Duration) -> Result<FrameInfo, DeviceError> {
        let expected = self.parts.view.num_pixels();
        if counts.len() != expected {
            let message = format!("memory for {} pixels was given where {expected} are needed", counts.len());
            return Err(self.error(ErrorKind::OutOfRange, message));
        }
        let deadline = self.now().0.saturating_add(nanoseconds(timeout));
        loop {
            let heard = self.parts.timing.bell.rings();
            let outlook = self.parts.schedule.outlook();
            let end = self.end(outlook);
            let halt = self.halt().filter(|&(at, _)| at < end);
            let until = outlook.finished.min(halt.map_or(end, |(at, _)| at));
            let fruitless = self.advance(until, patience(outlook, timeout));
            let next = self.delivery.next();
            let halt = halt.filter(|&(at, _)| next >= at);
            if next >= end || halt.is_some() {
                self.flush();
            }
            if let Some(arrival) = self.pop() {
                return self.deliver(arrival, outlook, counts);
            }
            if let Some(halt) = halt {
                self.halt_here(halt);
            }
            match halt {
                Some((at, Halt::Death)) => {
                    let message = format!("is gone since exposure {at}; check cable and power");
                    return Err(self.error(ErrorKind::Lost, message));
                }
                Some((_, Halt::Stall)) if !outlook.stopped => {}
                None if next < end => {}
                _ => return Err(self.error(ErrorKind::Ended, "no exposure is left")),
            }
            if fruitless || self.now().0 >= deadline {
                let message = format!("no frame came within {} ms", timeout.as_millis());
                return Err(self.error(ErrorKind::Timeout, message));
            }
            let next_at = outlook.next_at.filter(|_| halt.is_none());
            let wake = HostTime(next_at.map_or(deadline, |at| at.0.min(deadline)));
            self.parts.timing.clock.wait(&self.parts.timing.bell, heard, wake);
        }
    }
}

impl Drop for SimulatedStream {
    fn drop(&mut self) {
        self.flush();
        let mut record = self.parts.record.lock();
        for arrival in &self.arrived {
            if is_of_sample(*arrival) {
                record.note(arrival.exposure, IncidentKind::Unread);
            }
        }
    }
}

/// Whether a frame that gets lost now is an exposure lost.
fn is_of_sample(arrival: Arrival) -> bool {
    arrival.status == FrameStatus::Complete && !arrival.read && !arrival.extra
}

/// Puts an arrival into the driver's buffers; when they are full, the oldest frame makes room.
fn arrive(arrived: &mut VecDeque<Arrival>, arrival: Arrival, buffers: usize, record: &mut Record) {
    if arrived.len() >= buffers
        && let Some(oldest) = arrived.pop_front()
        && is_of_sample(oldest)
    {
        record.note(oldest.exposure, IncidentKind::Overrun);
    }
    arrived.push_back(arrival);
}

/// Exposures of virtual time in a timeout; at least one, so that every call makes progress.
fn patience(outlook: Outlook, timeout: Duration) -> u64 {
    let period_ns = outlook.period.map_or(1, nanoseconds).max(1);
    (nanoseconds(timeout) / period_ns).max(1)
}

/// Begin of an exposure on the camera's clock; `exposure` counts for the sample, `since_arming` for
/// the faults.
fn device_time(parts: &Parts, exposure: ExposureIndex, since_arming: u64, period: Duration) -> DeviceTime {
    let clock = parts.behavior.clock;
    let nominal_ns = exposure.0.wrapping_mul(nanoseconds(period));
    let drift_ns = nominal_ns as f64 * clock.drift_ppm * 1e-6;
    let stream = Stream::Jitter { channel: parts.channel.index() as u64, exposure: since_arming };
    let jitter_ns = clock.jitter_ns.min(nanoseconds(period) / 4) as f64;
    let jitter_ns = jitter_ns * (2.0 * uniform(&mut stream.generator(parts.seed)) - 1.0);
    let step = parts.behavior.faults.clock_step.filter(|step| step.at <= since_arming);
    let step_ns = step.map_or(0.0, |step| step.seconds.clamp(-MOST_STEP_S, MOST_STEP_S) * 1e9);
    let shift_ns = (drift_ns + jitter_ns + step_ns).round() as i64;
    DeviceTime(parts.clock_ns.wrapping_add(nominal_ns).wrapping_add_signed(shift_ns))
}
