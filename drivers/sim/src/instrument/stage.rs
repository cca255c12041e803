//! A simulated stage: moving it moves what both cameras see.
//!
//! In: moves within an envelope, the time. Out: its place, and by how many pixels the view is shifted.
//! Never: leaves its envelope, moves before it was homed. Fails: as [`Stage`] says.
//!
//! The sample repeats itself in all directions, so that there is something to see wherever the stage stands.
//! Cameras see whole pixels of the move, both in the same direction, whatever mirror stands before them.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use sofiscope_hal::{
    DeviceError, DeviceIdentity, ErrorKind, Micrometers, Motion, Properties, Property, PropertyValue, Stage,
    StageEnvelope, StagePoint, StopMotion,
};

const SPEED_UM_PER_S: f64 = 5000.0;
const HOMING: Duration = Duration::from_millis(200);

/// A time that only grows; by default that of this computer.
#[derive(Clone)]
pub struct StageClock(Arc<dyn Fn() -> Duration + Send + Sync>);

impl StageClock {
    /// A clock that tells the time by a function.
    pub fn new(now: impl Fn() -> Duration + Send + Sync + 'static) -> Self {
        Self(Arc::new(now))
    }
}

impl Default for StageClock {
    fn default() -> Self {
        let begun = Instant::now();
        Self::new(move || begun.elapsed())
    }
}

impl std::fmt::Debug for StageClock {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("StageClock")
    }
}

/// What it is doing, in micrometers from where it stood first.
#[derive(Debug, Clone, Copy, Default)]
struct Travel {
    from: [f64; 2],
    to: [f64; 2],
    begun: Duration,
    lasts: Duration,
    is_homing: bool,
    is_known: bool,
    motions: usize,
}

impl Travel {
    fn is_over(&self, now: Duration) -> bool {
        now.saturating_sub(self.begun) >= self.lasts
    }

    fn place(&self, now: Duration) -> [f64; 2] {
        if self.is_over(now) {
            return self.to;
        }
        let share = now.saturating_sub(self.begun).as_secs_f64() / self.lasts.as_secs_f64();
        [0, 1].map(|axis| self.from[axis] + share * (self.to[axis] - self.from[axis]))
    }

    /// What a search for the end switches has found by now.
    fn settle(&mut self, now: Duration) {
        if self.is_homing && self.is_over(now) {
            (self.is_homing, self.is_known) = (false, true);
        }
    }
}

/// Where the sample is, for the cameras.
#[derive(Debug, Clone, Default)]
pub(super) struct SamplePlace {
    travel: Arc<Mutex<Travel>>,
    clock: StageClock,
}

impl SamplePlace {
    fn travel(&self) -> (MutexGuard<'_, Travel>, Duration) {
        let now = (self.clock.0)();
        let mut travel = self.travel.lock().unwrap_or_else(PoisonError::into_inner);
        travel.settle(now);
        (travel, now)
    }

    /// Columns and rows by which the view has moved.
    pub(super) fn shift_px(&self, pixel_pitch_nm: f64) -> (i64, i64) {
        let (travel, now) = self.travel();
        let [x, y] = travel.place(now).map(|um| (um * 1e3 / pixel_pitch_nm).round() as i64);
        (x, y)
    }
}

/// A simulated stage.
#[derive(Debug)]
pub struct SimulatedStage {
    place: SamplePlace,
    envelope: StageEnvelope,
    /// Where it stood first, micrometers.
    origin: [f64; 2],
    identity: DeviceIdentity,
}

impl SimulatedStage {
    pub(super) fn new(place: SamplePlace, envelope: StageEnvelope) -> Self {
        let middle = |range: &std::ops::RangeInclusive<Micrometers>| {
            0.5 * (range.start().value() + range.end().value())
        };
        let origin = [middle(&envelope.x), middle(&envelope.y)];
        let identity = DeviceIdentity {
            vendor: "sofiscope".into(),
            model: "simulated stage".into(),
            serial: "SIM-S".into(),
            firmware: env!("CARGO_PKG_VERSION").into(),
            simulated: true,
        };
        Self { place, envelope, origin, identity }
    }

    /// Moves and searches so far.
    #[must_use]
    pub fn num_motions(&self) -> usize {
        self.place.travel().0.motions
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.identity.to_string(), message)
    }
}

impl Properties for SimulatedStage {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        Ok(vec![Property::reading("speed", PropertyValue::Number(SPEED_UM_PER_S), "µm/s")])
    }
}

impl Stage for SimulatedStage {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn envelope(&self) -> &StageEnvelope {
        &self.envelope
    }

    fn position(&mut self) -> Result<StagePoint, DeviceError> {
        let (travel, now) = self.place.travel();
        let [x, y] = travel.place(now);
        let um = |value: f64| Micrometers::new(value).unwrap_or_default();
        Ok(StagePoint { x: um(self.origin[0] + x), y: um(self.origin[1] + y) })
    }

    fn move_to(&mut self, target: StagePoint) -> Result<(), DeviceError> {
        if !self.envelope.contains(target) {
            let StageEnvelope { x, y } = &self.envelope;
            let message = format!(
                "({}, {}) is outside {} to {} and {} to {}; choose a place inside",
                target.x,
                target.y,
                x.start(),
                x.end(),
                y.start(),
                y.end()
            );
            return Err(self.error(ErrorKind::OutOfRange, message));
        }
        let (mut travel, now) = self.place.travel();
        if !travel.is_known {
            drop(travel);
            return Err(self.error(ErrorKind::Busy, "its place is not known yet; home it first"));
        }
        let from = travel.place(now);
        let to = [target.x.value() - self.origin[0], target.y.value() - self.origin[1]];
        let way = (to[0] - from[0]).hypot(to[1] - from[1]);
        let lasts = Duration::from_secs_f64(way / SPEED_UM_PER_S);
        *travel = Travel { from, to, begun: now, lasts, motions: travel.motions + 1, ..*travel };
        Ok(())
    }

    fn motion(&mut self) -> Result<Motion, DeviceError> {
        let (travel, now) = self.place.travel();
        Ok(match (travel.is_over(now), travel.is_known) {
            (false, _) => Motion::Moving,
            (true, true) => Motion::Still,
            (true, false) => Motion::Unknown,
        })
    }

    fn stopper(&self) -> Box<dyn StopMotion> {
        Box::new(self.place.clone())
    }

    fn begin_homing(&mut self) -> Result<(), DeviceError> {
        let (mut travel, now) = self.place.travel();
        let here = travel.place(now);
        *travel = Travel {
            from: here,
            to: here,
            begun: now,
            lasts: HOMING,
            is_homing: true,
            is_known: false,
            motions: travel.motions + 1,
        };
        Ok(())
    }
}

impl StopMotion for SamplePlace {
    fn stop_motion(&self) -> Result<(), DeviceError> {
        let (mut travel, now) = self.travel();
        let here = travel.place(now);
        (travel.from, travel.to, travel.lasts, travel.is_homing) = (here, here, Duration::ZERO, false);
        Ok(())
    }
}

impl SamplePlace {
    pub(super) fn with_clock(clock: StageClock) -> Self {
        Self { travel: Arc::default(), clock }
    }
}
