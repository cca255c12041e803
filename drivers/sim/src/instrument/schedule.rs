//! When exposures begin and which of them are finished.
//!
//! In: arming, trigger trains, stops, the time now. Out: how many exposures are finished, when the next one
//! is, and after how many the camera is done. Never: waits.
//!
//! Unpaced, virtual time is where the faster of both readers is; a stop is a stop at that time for
//! both cameras. In real time, a train that is stopped while cameras follow it is held: the next start goes on
//! with it, as a camera goes on with the next pulse.

use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sofiscope_hal::clock::nanoseconds;
use sofiscope_hal::{Bell, CameraSettings, Channel, Clock, HostTime, TriggerMode};

use super::settings::Pace;

/// A count that is not known yet.
const OPEN: u64 = u64::MAX;

/// Exposures that follow each other: a train of pulses, or those of free-running cameras.
#[derive(Debug)]
pub(super) struct Train {
    period: Duration,
    /// One lock for all counts, so that a stop and a reader agree about the last exposure.
    counts: Mutex<Counts>,
}

#[derive(Debug, Clone, Copy)]
struct Counts {
    /// Exposures that a reader has taken, for virtual time.
    taken: u64,
    /// Number of exposures; `OPEN` until stopped.
    end: u64,
    /// When the first exposure began; later by the time for which the train was held.
    start: HostTime,
    /// Cameras that follow the train and were not stopped.
    followers: u64,
    /// Whether it was stopped before its end and may go on.
    is_held: bool,
}

impl Train {
    fn new(start: HostTime, period: Duration, pulses: Option<u64>) -> Arc<Self> {
        let end = pulses.unwrap_or(OPEN);
        let counts = Mutex::new(Counts { taken: 0, end, start, followers: 0, is_held: false });
        Arc::new(Self { period, counts })
    }

    fn lock(&self) -> MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes an exposure for a reader, unless the train ends before it.
    fn claim(&self, exposure: u64) -> bool {
        let mut counts = self.lock();
        let given = exposure < counts.end;
        if given {
            counts.taken = counts.taken.max(exposure + 1);
        }
        given
    }

    /// Pulses given by now.
    fn given(&self, counts: Counts, pace: Pace, now: HostTime) -> u64 {
        let given = match pace {
            Pace::Unpaced => counts.taken,
            Pace::RealTime { speed } => {
                nanoseconds(now.since(counts.start)) / paced_ns(self.period, speed) + 1
            }
        };
        given.min(counts.end)
    }

    /// Ends the train with the pulses given by now.
    fn stop(&self, pace: Pace, now: HostTime) {
        let mut counts = self.lock();
        let given = self.given(*counts, pace, now);
        counts.is_held |= given < counts.end && matches!(pace, Pace::RealTime { .. });
        counts.end = given;
    }

    /// Goes on with a train that is held, if cameras still follow it.
    fn go_on(&self, pace: Pace, now: HostTime, pulses: Option<u64>) -> bool {
        let mut counts = self.lock();
        let Pace::RealTime { speed } = pace else { return false };
        if !counts.is_held || counts.followers == 0 {
            return false;
        }
        let passed_ns = counts.end.saturating_mul(paced_ns(self.period, speed));
        counts.start = HostTime(now.0.saturating_sub(passed_ns));
        counts.end = pulses.map_or(OPEN, |pulses| counts.end.saturating_add(pulses));
        counts.is_held = false;
        true
    }
}

/// Nanoseconds of the clock in which one exposure passes.
fn paced_ns(period: Duration, speed: f64) -> u64 {
    ((nanoseconds(period) as f64 / speed) as u64).max(1)
}

/// What both cameras and the trigger share.
#[derive(Debug)]
pub(super) struct Timing {
    pub(super) pace: Pace,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) bell: Bell,
    trains: Mutex<Trains>,
}

#[derive(Debug, Default)]
struct Trains {
    triggered: Option<Arc<Train>>,
    /// The exposures of each camera that is armed and runs free.
    free: [Option<Arc<Train>>; 2],
}

impl Timing {
    pub(super) fn new(pace: Pace, clock: Arc<dyn Clock>) -> Self {
        Self { pace, clock, bell: Bell::default(), trains: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Trains> {
        self.trains.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The train that gives pulses now.
    fn running(&self, trains: &Trains) -> Option<Arc<Train>> {
        let now = self.clock.now();
        let running = |train: &&Arc<Train>| {
            let counts = *train.lock();
            train.given(counts, self.pace, now) < counts.end
        };
        trains.triggered.as_ref().filter(running).cloned()
    }

    /// Begins a train unless one runs.
    pub(super) fn start(&self, period: Duration, pulses: Option<u64>) -> bool {
        let mut trains = self.lock();
        if self.running(&trains).is_some() {
            return false;
        }
        let now = self.clock.now();
        let held = trains.triggered.as_ref().filter(|train| train.period == period);
        if !held.is_some_and(|train| train.go_on(self.pace, now, pulses)) {
            trains.triggered = Some(Train::new(now, period, pulses));
        }
        drop(trains);
        self.bell.ring();
        true
    }

    /// Ends the train with the pulses given by now.
    pub(super) fn stop(&self) {
        if let Some(train) = &self.lock().triggered {
            train.stop(self.pace, self.clock.now());
        }
        self.bell.ring();
    }

    /// The exposures of a camera that is armed now.
    ///
    /// Unpaced free-running cameras share their virtual time.
    pub(super) fn schedule(self: &Arc<Self>, channel: Channel, settings: &CameraSettings) -> Arc<Schedule> {
        let now = self.clock.now();
        let mut trains = self.lock();
        let (run, before) = match settings.trigger {
            TriggerMode::FreeRunning => {
                let other = trains.free[channel.other().index()].clone();
                let joined =
                    other.filter(|train| self.pace == Pace::Unpaced && train.period == settings.period);
                let train = joined.unwrap_or_else(|| Train::new(now, settings.period, None));
                trains.free[channel.index()] = Some(train.clone());
                (Attached { train: Some(train), first: 0 }, None)
            }
            TriggerMode::External => {
                let train = self.running(&trains);
                if let Some(train) = &train {
                    train.lock().followers += 1;
                }
                let first = train.as_ref().map_or(0, |train| train.given(*train.lock(), self.pace, now));
                (Attached { train, first }, trains.triggered.clone())
            }
        };
        drop(trains);
        let run = Mutex::new(run);
        Arc::new(Schedule { timing: self.clone(), channel, before, run, end: AtomicU64::new(OPEN) })
    }
}

/// The train that a camera follows.
#[derive(Debug, Clone)]
struct Attached {
    train: Option<Arc<Train>>,
    /// Pulses of the train before the camera was armed.
    first: u64,
}

/// The exposures of one armed camera; shared by the camera and its stream.
#[derive(Debug)]
pub(super) struct Schedule {
    timing: Arc<Timing>,
    channel: Channel,
    /// The train that had ended before the camera was armed.
    before: Option<Arc<Train>>,
    run: Mutex<Attached>,
    /// Exposures until the camera was stopped.
    end: AtomicU64,
}

/// How far exposures are.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outlook {
    /// Exposures finished by now.
    pub(super) finished: u64,
    /// Exposures in all, as far as known; larger than any count otherwise.
    pub(super) end: u64,
    /// When the exposure after the finished ones will be finished, where that is known.
    pub(super) next_at: Option<HostTime>,
    /// Exposures of the sample before exposure 0 of the camera.
    pub(super) first: u64,
    /// From the begin of one exposure to the next; `None` before there is any.
    pub(super) period: Option<Duration>,
    /// Whether the camera was stopped.
    pub(super) stopped: bool,
}

impl Schedule {
    fn attached(&self) -> Attached {
        let mut run = self.run.lock().unwrap_or_else(PoisonError::into_inner);
        if run.train.is_none()
            && let Some(train) = &self.timing.lock().triggered
            && self.before.as_ref().is_none_or(|before| !Arc::ptr_eq(before, train))
        {
            train.lock().followers += 1;
            run.train = Some(train.clone());
        }
        run.clone()
    }

    /// How far exposures are now.
    pub(super) fn outlook(&self) -> Outlook {
        let Attached { train, first } = self.attached();
        let own_end = self.end.load(SeqCst);
        let stopped = own_end != OPEN;
        let Some(train) = train else {
            return Outlook { finished: 0, end: own_end, next_at: None, first, period: None, stopped };
        };
        let counts = *train.lock();
        let (finished, next_at) = match self.timing.pace {
            Pace::Unpaced => (OPEN, None),
            Pace::RealTime { speed } => {
                let paced_ns = paced_ns(train.period, speed);
                let done = nanoseconds(self.timing.clock.now().since(counts.start)) / paced_ns;
                let next_ns = (done.max(first) + 1).saturating_mul(paced_ns);
                let next_at = HostTime(counts.start.0.saturating_add(next_ns));
                let is_next = !counts.is_held || done < counts.end;
                (done.min(counts.end).saturating_sub(first), Some(next_at).filter(|_| is_next))
            }
        };
        let end = if counts.is_held { OPEN } else { counts.end };
        let end = end.saturating_sub(first).min(own_end);
        Outlook { finished, end, next_at, first, period: Some(train.period), stopped }
    }

    /// In virtual time, takes an exposure, unless the train ends before it.
    pub(super) fn claim(&self, exposure: u64) -> bool {
        let run = self.run.lock().unwrap_or_else(PoisonError::into_inner);
        run.train.as_ref().is_some_and(|train| train.claim(run.first.saturating_add(exposure)))
    }

    /// Ends the exposures with those that are finished now.
    pub(super) fn stop(&self) {
        let Attached { train, first } = self.attached();
        let finished = match (train, self.timing.pace) {
            (None, _) => 0,
            (Some(train), Pace::Unpaced) => train.lock().taken.saturating_sub(first),
            (Some(_), Pace::RealTime { .. }) => self.outlook().finished,
        };
        self.end.fetch_min(finished, SeqCst);
        if let Some(train) = self.attached().train {
            let mut counts = train.lock();
            counts.followers = counts.followers.saturating_sub(1);
        }
        self.timing.lock().free[self.channel.index()] = None;
        self.timing.bell.ring();
    }
}
