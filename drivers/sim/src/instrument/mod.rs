//! Two simulated cameras that look at one world, their trigger, and the stage that carries the sample.
//!
//! ```text
//! Source (World or Film) ──────────────► pixels ─┐
//! SimulatedTrigger ─► schedule ─► delivery ──────┴─► SimulatedCamera R, T ─► frames
//!                                    └─ incidents ─► Oracle
//! ```
//!
//! In: a source, and settings or a [`Scenario`] with everything that shall go wrong.
//! Out: cameras and a trigger behind the contracts of `sofiscope_hal`, and an [`Oracle`] that knows
//! what they did.
//! Never: decides by anything but seed, channel and exposure, so every run with one seed is the same run;
//! in real time only what a slow reader loses is decided by the clock.
//! Fails: as the contracts say; [`ScenarioError`] with all faults of a scenario at once.
//!
//! ```
//! use sofiscope_hal::{Camera, CameraSettings, Channel, Region, TriggerMode};
//! use sofiscope_sim::{Film, InstrumentSettings, SimulatedInstrument};
//! use std::time::Duration;
//!
//! let film = Film::noise(32, 48, 10, 1);
//! let settings = InstrumentSettings { exposures: Some(100), ..Default::default() };
//! let instrument = SimulatedInstrument::new(film, settings);
//! let [mut reflected, _transmitted] = instrument.cameras();
//! let region = Region { left: 0, top: 0, width: 48, height: 32 };
//! let (exposure, period) = (Duration::from_millis(10), Duration::from_millis(10));
//! reflected.configure(&CameraSettings { region, exposure, period, trigger: TriggerMode::FreeRunning })?;
//! let mut stream = reflected.arm()?;
//! let mut counts = vec![0; region.num_pixels()];
//! while stream.next_frame(&mut counts, Duration::from_secs(1)).is_ok() {}
//! assert_eq!(instrument.oracle().intact(Channel::Reflected), 100);
//! # Ok::<(), sofiscope_hal::DeviceError>(())
//! ```

mod camera;
mod cooling;
mod delivery;
mod film;
mod oracle;
mod scenario;
mod schedule;
mod settings;
mod source;
mod stage;
mod stream;
mod trigger;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use sofiscope_hal::{Channel, StageEnvelope};

use camera::Body;
pub use camera::SimulatedCamera;
pub use film::Film;
pub use oracle::{Incident, IncidentKind, Oracle, Record};
pub use scenario::{Scenario, ScenarioError};
use schedule::Timing;
pub use settings::{
    Bursts, CameraBehavior, CameraFaults, ClockStep, Counter, DeviceClock, InstrumentSettings, Pace,
};
pub use source::Source;
use stage::SamplePlace;
pub use stage::{SimulatedStage, StageClock};
pub use trigger::SimulatedTrigger;

/// The simulated microscope: two cameras, their trigger, and the judge of it all.
#[derive(Debug)]
pub struct SimulatedInstrument {
    bodies: [Body; 2],
    timing: Arc<Timing>,
    oracle: Oracle,
    place: SamplePlace,
}

impl SimulatedInstrument {
    /// Puts both cameras in front of a source.
    #[must_use]
    pub fn new(source: impl Into<Source>, settings: InstrumentSettings) -> Self {
        Self::timed(source, settings, StageClock::default())
    }

    /// The same with a stage that moves by this clock.
    #[must_use]
    pub fn timed(source: impl Into<Source>, settings: InstrumentSettings, clock: StageClock) -> Self {
        let place = SamplePlace::with_clock(clock);
        let source = source.into();
        let oracle = Oracle::default();
        let InstrumentSettings { pace, seed, exposures, cameras, clock } = settings;
        let timing = Arc::new(Timing::new(pace, clock));
        let [reflected, transmitted] = cameras;
        let body = |channel, behavior| Body {
            channel,
            source: source.clone(),
            seed,
            limit: exposures.unwrap_or(u64::MAX),
            behavior,
            timing: timing.clone(),
            oracle: oracle.clone(),
            dead: Arc::new(AtomicBool::new(false)),
            place: place.clone(),
        };
        let bodies = [body(Channel::Reflected, reflected), body(Channel::Transmitted, transmitted)];
        Self { bodies, timing, oracle, place }
    }

    /// Camera R and camera T, as if just opened; open them once.
    #[must_use]
    pub fn cameras(&self) -> [SimulatedCamera; 2] {
        self.bodies.clone().map(SimulatedCamera::new)
    }

    /// The source of trigger pulses for both cameras.
    #[must_use]
    pub fn trigger(&self) -> SimulatedTrigger {
        SimulatedTrigger::new(self.timing.clone())
    }

    /// The stage that carries the sample, in the middle of where it may go, and not homed yet.
    #[must_use]
    pub fn stage(&self, envelope: StageEnvelope) -> SimulatedStage {
        SimulatedStage::new(self.place.clone(), envelope)
    }

    /// The judge; stays readable after everything else is gone.
    #[must_use]
    pub fn oracle(&self) -> Oracle {
        self.oracle.clone()
    }
}
