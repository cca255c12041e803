//! The focus lock as a state machine.
//!
//! In: readings with their time, commands. Out: the next state and what the drive shall do.
//! Never: reads a clock, talks to a device. Fails: towards standing still.

use std::ops::RangeInclusive;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use sofiscope_hal::{FocusReading, HostTime, Nanometers};

use super::calibration::Calibration;
use super::servo::{Servo, ServoSettings};

/// Readings in a row that are not believed, after which the lock is lost.
const BAD_READINGS: u32 = 10;
/// Periods in a row in which the error grew although it was answered.
const DIVERGING_PERIODS: u32 = 5;
/// Growth over these periods that is more than noise and drift.
const DIVERGENCE_NM: f64 = 15.0;
/// An error this large for [`FAR_OFF_FOR`] is no focus any more.
const FAR_OFF_NM: f64 = 1000.0;
const FAR_OFF_FOR: Duration = Duration::from_millis(500);
/// A jump between two readings that no sample makes.
const JUMP_NM: f64 = 700.0;
/// Step by which the direction of the drive is tried before the loop is closed.
const PROBE_NM: f64 = 60.0;
/// Time after which the drive has followed a step of the search or the probe.
const SETTLE: Duration = Duration::from_millis(120);
/// Reach of one search to both sides.
const SEARCH_NM: f64 = 10_000.0;
/// After the last place the search waits this long where it began: who blocked the beam may be done by then.
const LAST_LOOK: Duration = Duration::from_secs(3);
/// Readings whose quality is shown.
const REMEMBERED: u32 = 50;
/// Errors below this count as good.
const GOOD_NM: f64 = 20.0;

/// Everything about a lock that does not change while it works.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LockSettings {
    /// From signal to nanometers.
    pub calibration: Calibration,
    /// Gains and limits.
    pub servo: ServoSettings,
    /// Where the drive may go.
    pub range: RangeInclusive<Nanometers>,
}

/// Why a lock does not hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "kebab-case")]
pub enum LockEnd {
    /// The sensor gave nothing that can be believed.
    #[error("the signal of the focus sensor is gone")]
    SignalLost,
    /// The error stayed beyond what focus can be.
    #[error("the focus error stayed above 1 µm")]
    FarOff,
    /// The error grows with every answer; a probe will tell whether the answers make it grow.
    #[error("the focus error grew in {DIVERGING_PERIODS} periods although it was answered")]
    Diverging,
    /// The drive goes the wrong way.
    #[error("corrections make the focus error larger: the sign of the calibration is wrong; calibrate again")]
    WrongSign,
    /// The drive does not follow.
    #[error("the drive does not follow small steps; check that it is switched on and not blocked")]
    NoResponse,
    /// The drive is at the end of its range.
    #[error("the drive is at the end of its range; move the coarse focus")]
    RangeEnd,
    /// A whole search found no signal.
    #[error("no focus signal was found within ± 10 µm; focus by hand and lock again")]
    NotFound,
}

/// What the drive shall do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Correction {
    /// Stay where it is.
    Stay,
    /// Go there.
    MoveTo(Nanometers),
}

/// A search under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Search {
    center: Nanometers,
    place: u32,
    moved: HostTime,
    /// Whether all places have been seen.
    is_last_look: bool,
}

/// A step that shows which way the drive goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Probe {
    from: Nanometers,
    before_nm: f64,
    sent: HostTime,
}

/// A lock that holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hold {
    servo: Servo,
    error_nm: f64,
    number: u64,
    bad: u32,
    growing: u32,
    grown_nm: f64,
    far_since: Option<HostTime>,
    quality: f64,
    at_end: u32,
}

impl Hold {
    /// Focus error of the newest believed reading, nanometers.
    #[must_use]
    pub fn error_nm(&self) -> f64 {
        self.error_nm
    }

    /// Share of good readings lately, 0 to 1.
    #[must_use]
    pub fn quality(&self) -> f64 {
        self.quality
    }
}

/// The focus lock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FocusLock {
    /// Not working; with the reason when it ended by itself.
    Off(Option<LockEnd>),
    /// Looking for the signal, at most once.
    Searching(Search),
    /// Trying which way the drive goes.
    Probing(Probe),
    /// Holding.
    Locked(Hold),
    /// Standing still without a signal; searches once when `SETTLE` has passed.
    Lost {
        /// Why.
        end: LockEnd,
        /// Where the drive stands.
        z: Nanometers,
        /// Since when.
        since: HostTime,
    },
}

impl Default for FocusLock {
    fn default() -> Self {
        Self::Off(None)
    }
}

impl FocusLock {
    /// Begins to lock from where the drive stands.
    #[must_use]
    pub fn begin(z: Nanometers, now: HostTime) -> Self {
        Self::Searching(Search { center: z, place: 0, moved: now, is_last_look: false })
    }

    /// One step: `reading` is `None` when the sensor gave nothing in its time.
    #[must_use]
    pub fn step(
        self,
        reading: Option<&FocusReading>,
        z: Nanometers,
        now: HostTime,
        settings: &LockSettings,
    ) -> (Self, Correction) {
        let believed = reading.filter(|reading| settings.calibration.trust.accepts(reading));
        match self {
            Self::Off(_) => (self, Correction::Stay),
            Self::Searching(search) => search.step(believed, z, now, settings),
            Self::Probing(probe) => probe.step(believed, now, settings),
            Self::Locked(hold) => hold.step(believed, now, settings),
            Self::Lost { end, z, since } => lost(end, z, since, now),
        }
    }

    /// Focus error of the moment, nanometers; `None` while nothing holds.
    #[must_use]
    pub fn error_nm(&self) -> Option<f64> {
        match self {
            Self::Locked(hold) => Some(hold.error_nm),
            _ => None,
        }
    }
}

/// A lost lock stands still, then searches once; what a search cannot cure ends it.
fn lost(end: LockEnd, z: Nanometers, since: HostTime, now: HostTime) -> (FocusLock, Correction) {
    match end {
        LockEnd::SignalLost | LockEnd::FarOff | LockEnd::Diverging if now.since(since) >= SETTLE => {
            (FocusLock::begin(z, now), Correction::Stay)
        }
        LockEnd::SignalLost | LockEnd::FarOff | LockEnd::Diverging => {
            (FocusLock::Lost { end, z, since }, Correction::Stay)
        }
        _ => (FocusLock::Off(Some(end)), Correction::Stay),
    }
}

impl Search {
    /// Places alternate around the center, further out each time.
    fn place(&self, settings: &LockSettings) -> Option<Nanometers> {
        let stride = (settings.calibration.capture.value() * 0.5).clamp(100.0, 1000.0);
        let ring = f64::from(self.place.div_ceil(2)) * stride;
        if ring > SEARCH_NM {
            return None;
        }
        let side = if self.place.is_multiple_of(2) { -1.0 } else { 1.0 };
        let (least, greatest) = (settings.range.start().value(), settings.range.end().value());
        Nanometers::new((self.center.value() + side * ring).clamp(least, greatest)).ok()
    }

    fn step(
        mut self,
        believed: Option<&FocusReading>,
        z: Nanometers,
        now: HostTime,
        settings: &LockSettings,
    ) -> (FocusLock, Correction) {
        if now.since(self.moved) < SETTLE {
            return (FocusLock::Searching(self), Correction::Stay);
        }
        if let Some(reading) = believed {
            let error = settings.calibration.error_nm(reading);
            if error.abs() <= settings.calibration.capture.value() {
                return probe(z, error, now, settings);
            }
        }
        if self.is_last_look {
            let is_over = now.since(self.moved) >= LAST_LOOK;
            let next =
                if is_over { FocusLock::Off(Some(LockEnd::NotFound)) } else { FocusLock::Searching(self) };
            return (next, Correction::Stay);
        }
        self.place += 1;
        self.moved = now;
        let place = self.place(settings);
        self.is_last_look = place.is_none();
        (FocusLock::Searching(self), Correction::MoveTo(place.unwrap_or(self.center)))
    }
}

/// Steps a little towards focus, to see which way the drive goes.
fn probe(z: Nanometers, error_nm: f64, now: HostTime, settings: &LockSettings) -> (FocusLock, Correction) {
    let toward = z.value() - PROBE_NM.copysign(error_nm);
    let there = Nanometers::new(toward).ok().filter(|there| settings.range.contains(there));
    match there {
        Some(there) => {
            let probe = Probe { from: z, before_nm: error_nm, sent: now };
            (FocusLock::Probing(probe), Correction::MoveTo(there))
        }
        None => (FocusLock::Lost { end: LockEnd::RangeEnd, z, since: now }, Correction::Stay),
    }
}

impl Probe {
    fn step(
        self,
        believed: Option<&FocusReading>,
        now: HostTime,
        settings: &LockSettings,
    ) -> (FocusLock, Correction) {
        if now.since(self.sent) < SETTLE {
            return (FocusLock::Probing(self), Correction::Stay);
        }
        let back = |end| (FocusLock::Lost { end, z: self.from, since: now }, Correction::MoveTo(self.from));
        let Some(reading) = believed else { return back(LockEnd::SignalLost) };
        let error_nm = settings.calibration.error_nm(reading);
        let expected = -PROBE_NM.copysign(self.before_nm);
        let response = (error_nm - self.before_nm) / expected;
        if response < -0.3 {
            return back(LockEnd::WrongSign);
        }
        if !(0.3..3.0).contains(&response) {
            return back(LockEnd::NoResponse);
        }
        let z = Nanometers::new(self.from.value() + expected).unwrap_or(self.from);
        let hold = Hold {
            servo: Servo::at(z),
            error_nm,
            number: reading.number,
            bad: 0,
            growing: 0,
            grown_nm: 0.0,
            far_since: None,
            quality: 0.0,
            at_end: 0,
        };
        (FocusLock::Locked(hold), Correction::Stay)
    }
}

impl Hold {
    fn step(
        mut self,
        believed: Option<&FocusReading>,
        now: HostTime,
        settings: &LockSettings,
    ) -> (FocusLock, Correction) {
        let new = believed.filter(|reading| reading.number != self.number);
        let believed = new.map(|reading| (reading.number, settings.calibration.error_nm(reading)));
        // A jump is not believed at once; after a few of them it is where the sample really is.
        let jumps = |error: f64| (error - self.error_nm).abs() > JUMP_NM && self.bad < BAD_READINGS / 2;
        let Some((number, error_nm)) = believed.filter(|(_, error)| !jumps(*error)) else {
            self.bad += 1;
            self.servo.interrupt();
            self.remember(false);
            return if self.bad >= BAD_READINGS {
                self.lose(LockEnd::SignalLost, now)
            } else {
                (FocusLock::Locked(self), Correction::Stay)
            };
        };
        self.bad = 0;
        self.watch_divergence(error_nm);
        (self.number, self.error_nm) = (number, error_nm);
        self.remember(error_nm.abs() < GOOD_NM);
        if self.growing >= DIVERGING_PERIODS && self.grown_nm > DIVERGENCE_NM {
            return self.lose(LockEnd::Diverging, now);
        }
        self.far_since = (error_nm.abs() > FAR_OFF_NM).then(|| self.far_since.unwrap_or(now));
        if self.far_since.is_some_and(|since| now.since(since) >= FAR_OFF_FOR) {
            return self.lose(LockEnd::FarOff, now);
        }
        let step = self.servo.answer(error_nm, &settings.servo, &settings.range);
        self.at_end = if step.is_at_end { self.at_end + 1 } else { 0 };
        if self.at_end >= BAD_READINGS {
            return self.lose(LockEnd::RangeEnd, now);
        }
        (FocusLock::Locked(self), Correction::MoveTo(step.z))
    }

    /// An error that grows to the same side, period after period, is made by its answers.
    fn watch_divergence(&mut self, error_nm: f64) {
        let growth = error_nm.abs() - self.error_nm.abs();
        if growth > 0.0 && error_nm.signum() == self.error_nm.signum() {
            self.growing += 1;
            self.grown_nm += growth;
        } else {
            (self.growing, self.grown_nm) = (0, 0.0);
        }
    }

    fn remember(&mut self, is_good: bool) {
        let weight = 1.0 / f64::from(REMEMBERED);
        self.quality += weight * (f64::from(u8::from(is_good)) - self.quality);
    }

    fn lose(self, end: LockEnd, now: HostTime) -> (FocusLock, Correction) {
        (FocusLock::Lost { end, z: self.servo.z(), since: now }, Correction::Stay)
    }
}
