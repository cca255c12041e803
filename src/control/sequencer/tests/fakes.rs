//! Fake devices that write down what is done to them, a data path that plays a script, and a bench for both.

use super::super::*;
use crate::control::contracts::{ArmedCamera, Illumination, StageDrive};
use crate::control::plan::StagePosition;
use crossbeam_channel::{Sender, bounded};
use sofiscope_hal::{
    Camera, CameraCapabilities, CameraIdentity, CameraSettings, Channel, DeviceError, ErrorKind, FrameInfo,
    FrameStream, Region, TriggerSource,
};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

const PERIOD: Duration = Duration::from_millis(20);

/// What all fakes share.
#[derive(Debug, Default)]
pub(super) struct World {
    pub(super) log: Vec<String>,
    /// Calls that fail from now on.
    pub(super) failing: Vec<&'static str>,
    /// Exposure that cameras do instead of what they are asked.
    pub(super) clamp: Option<Duration>,
    pub(super) armed: [bool; 2],
    pub(super) pulsing: bool,
    pub(super) lit: bool,
}

pub(super) type Shared = Arc<Mutex<World>>;

fn call(world: &Shared, name: &str) -> Result<(), DeviceError> {
    let mut world = world.lock().unwrap();
    world.log.push(name.to_owned());
    if world.failing.contains(&name) {
        return Err(DeviceError::new(ErrorKind::Fault, name, "does not work today"));
    }
    Ok(())
}

struct FakeCamera(Shared, Channel, CameraIdentity, CameraCapabilities);

impl FakeCamera {
    fn new(world: &Shared, channel: Channel) -> Self {
        let identity = CameraIdentity {
            vendor: "none".to_owned(),
            model: "fake".to_owned(),
            serial: channel.letter().to_string(),
            firmware: String::new(),
            simulated: true,
        };
        let capabilities = CameraCapabilities {
            sensor_width: 64,
            sensor_height: 64,
            region_step: 1,
            exposure: Duration::from_micros(10)..=Duration::from_secs(10),
            exposure_step: Duration::from_micros(10),
            shortest_period: Duration::from_millis(1),
            saturation_counts: u16::MAX,
        };
        Self(Arc::clone(world), channel, identity, capabilities)
    }

    fn call(&self, what: &str) -> Result<(), DeviceError> {
        call(&self.0, &format!("{what} {}", self.1.letter()))
    }
}

impl Camera for FakeCamera {
    fn identity(&self) -> &CameraIdentity {
        &self.2
    }

    fn capabilities(&self) -> &CameraCapabilities {
        &self.3
    }

    fn configure(&mut self, want: &CameraSettings) -> Result<CameraSettings, DeviceError> {
        self.call("configure")?;
        let clamp = self.0.lock().unwrap().clamp;
        Ok(CameraSettings { exposure: clamp.unwrap_or(want.exposure), ..*want })
    }

    fn arm(&mut self) -> Result<Box<dyn FrameStream>, DeviceError> {
        self.call("arm")?;
        let armed = &mut self.0.lock().unwrap().armed[self.1.index()];
        assert!(!*armed, "armed twice");
        *armed = true;
        Ok(Box::new(NoFrames))
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.0.lock().unwrap().armed[self.1.index()] = false;
        self.call("stop")
    }
}

struct NoFrames;

impl FrameStream for NoFrames {
    fn next_frame(&mut self, _: &mut [u16], _: Duration) -> Result<FrameInfo, DeviceError> {
        Err(DeviceError::new(ErrorKind::Ended, "fake", "has no frames"))
    }
}

struct FakeTrigger(Shared);

impl TriggerSource for FakeTrigger {
    fn start(&mut self, period: Duration, pulses: Option<u64>) -> Result<(), DeviceError> {
        assert_eq!(
            self.0.lock().unwrap().armed,
            [true; 2],
            "both cameras are armed before the trigger starts"
        );
        call(&self.0, "trigger")?;
        let mut world = self.0.lock().unwrap();
        world.pulsing = true;
        world.log.push(format!("pulses {pulses:?} every {} ms", period.as_millis()));
        Ok(())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.0.lock().unwrap().pulsing = false;
        call(&self.0, "hold")
    }
}

struct FakeLasers(Shared);

impl Illumination for FakeLasers {
    fn on(&mut self, _: &BTreeMap<u32, f64>) -> Result<(), DeviceError> {
        self.0.lock().unwrap().lit = true;
        call(&self.0, "light")
    }

    fn off(&mut self) -> Result<(), DeviceError> {
        self.0.lock().unwrap().lit = false;
        call(&self.0, "dark")
    }
}

struct FakeStage(Shared);

impl StageDrive for FakeStage {
    fn move_to(&mut self, position: &StagePosition) -> Result<(), DeviceError> {
        call(&self.0, &format!("move {:?}", position.x_um.unwrap_or_default()))
    }
}

struct FakeClock(Cell<u64>);

impl Clock for FakeClock {
    fn now(&self) -> HostTime {
        HostTime(self.0.get())
    }
}

/// Gives exposures at each look while the trigger runs, and plays the script of its bench.
struct FakePath<'b> {
    bench: &'b Bench,
    clock: &'b FakeClock,
    exposures: u64,
    looks: u64,
    drains: u64,
    has_failed: bool,
    sender: Sender<Command>,
    records: Vec<StopRecord>,
}

impl FakePath<'_> {
    fn note(&self, what: &str) {
        self.bench.world.lock().unwrap().log.push(what.to_owned());
    }

    fn play(&mut self) {
        self.looks += 1;
        for (look, command) in &self.bench.script {
            if *look == self.looks {
                self.sender.try_send(*command).unwrap_or(());
            }
        }
    }
}

impl DataPath for FakePath<'_> {
    fn arm(&mut self, _: &AcquisitionEvent, cameras: Vec<ArmedCamera>) -> Result<(), DataPathError> {
        assert_eq!(cameras.len(), 2);
        self.exposures = 0;
        call(&self.bench.world, "open").map_err(|error| DataPathError::Recording(error.to_string()))
    }

    fn progress(&mut self) -> PathProgress {
        self.play();
        self.clock.0.set(self.clock.0.get() + 10 * PERIOD.as_nanos() as u64);
        if self.bench.world.lock().unwrap().pulsing {
            self.exposures = (self.exposures + self.bench.per_look).min(self.bench.last);
        } else if self.bench.on_their_way.0 == self.looks {
            self.exposures += self.bench.on_their_way.1;
        }
        let due = self.bench.failure.as_ref().filter(|(look, _)| !self.has_failed && *look <= self.looks);
        let failure = due.map(|(_, error)| error.clone());
        self.has_failed |= failure.is_some();
        let record_drops = u64::from(self.exposures >= self.bench.drops_from);
        PathProgress { exposures: self.exposures, record_drops, failure, ..PathProgress::default() }
    }

    fn drain(&mut self) -> Result<Drain, DataPathError> {
        self.drains += 1;
        self.play();
        self.clock.0.set(self.clock.0.get() + 100_000_000);
        let is_done = self.drains >= self.bench.drains_needed;
        Ok(if is_done { Drain::Done } else { Drain::UnderWay })
    }

    fn abandon(&mut self) {
        self.note("abandon");
    }

    fn close(&mut self) -> Result<(), DataPathError> {
        call(&self.bench.world, "close").map_err(|error| DataPathError::Recording(error.to_string()))
    }

    fn write_stop_record(&mut self, record: &StopRecord) -> Result<(), DataPathError> {
        self.records.push(record.clone());
        call(&self.bench.world, "record").map_err(|error| DataPathError::Recording(error.to_string()))
    }
}

/// Everything for one test.
pub(super) struct Bench {
    pub(super) world: Shared,
    pub(super) plan: String,
    pub(super) script: Vec<(u64, Command)>,
    pub(super) before: Vec<Command>,
    pub(super) failure: Option<(u64, DataPathError)>,
    pub(super) per_look: u64,
    /// No exposure is settled beyond this one.
    pub(super) last: u64,
    /// At this look come so many exposures of before a pause.
    pub(super) on_their_way: (u64, u64),
    pub(super) drops_from: u64,
    pub(super) drains_needed: u64,
    pub(super) begin: Begin,
}

pub(super) const PLAN: &str = "time_plan: {interval: 0, loops: 100}\nmetadata:\n  sofiscope:\n    cameras: {exposure_ms: 19, period_ms: 20}\n    laser_power_mw: {488: 5.0}\n";

impl Default for Bench {
    fn default() -> Self {
        Self {
            world: Shared::default(),
            plan: PLAN.to_owned(),
            script: Vec::new(),
            before: Vec::new(),
            failure: None,
            per_look: 10,
            last: u64::MAX,
            on_their_way: (u64::MAX, 0),
            drops_from: u64::MAX,
            drains_needed: 1,
            begin: Begin::AtOnce,
        }
    }
}

impl Bench {
    pub(super) fn failing(call: &'static str) -> Self {
        let bench = Self::default();
        bench.world.lock().unwrap().failing.push(call);
        bench
    }

    pub(super) fn scripted(script: &[(u64, Command)]) -> Self {
        Self { script: script.to_vec(), ..Self::default() }
    }

    fn devices(&self) -> Devices {
        let region = Region { left: 0, top: 0, width: 64, height: 64 };
        let station = |channel| CameraStation {
            channel,
            camera: Box::new(FakeCamera::new(&self.world, channel)),
            region,
        };
        Devices::new(
            Channel::BOTH.map(station).into_iter().collect(),
            Some(Box::new(FakeTrigger(Arc::clone(&self.world)))),
            Box::new(FakeLasers(Arc::clone(&self.world))),
            Some(Box::new(FakeStage(Arc::clone(&self.world)))),
        )
    }

    /// Runs the plan and checks what must hold after every run, whatever happened.
    pub(super) fn run(&self) -> Vec<StopRecord> {
        let clock = FakeClock(Cell::new(0));
        let (sender, commands) = bounded(64);
        for &command in &self.before {
            sender.send(command).unwrap();
        }
        let mut path = FakePath {
            bench: self,
            clock: &clock,
            exposures: 0,
            looks: 0,
            drains: 0,
            has_failed: false,
            sender,
            records: Vec::new(),
        };
        let mut phases = Vec::new();
        let mut observer = |status: &Status<'_>| phases.push(status.phase.name());
        let patience = Patience { look: Duration::ZERO, ..Patience::default() };
        let mut sequencer = Sequencer {
            devices: self.devices(),
            path: &mut path,
            commands,
            clock: &clock,
            observer: &mut observer,
            begin: self.begin,
            patience,
        };
        let records = sequencer.run(&Plan::from_text(&self.plan).unwrap());
        {
            let world = self.world.lock().unwrap();
            assert!(!world.lit && !world.pulsing && world.armed == [false; 2], "{:?}", world.log);
        }
        assert_eq!(path.records.len(), records.len(), "one stop record for every series");
        self.assert_order();
        records
    }

    fn assert_order(&self) {
        let log = self.log();
        let last = |name: &str| log.iter().rposition(|call| call == name);
        let of_run = log.iter().rposition(|call| call == "record").unwrap();
        for quiet in ["hold", "dark", "stop R", "stop T"] {
            assert!(log[..of_run].iter().any(|call| call == quiet), "no {quiet} before the record: {log:?}");
        }
        assert!(last("close") < last("record"));
        let holds = log[..of_run].iter().rposition(|call| call == "hold");
        let stops = log[..of_run].iter().rposition(|call| call == "stop R");
        assert!(holds < stops, "the trigger stops before the cameras: {log:?}");
    }

    pub(super) fn log(&self) -> Vec<String> {
        self.world.lock().unwrap().log.clone()
    }

    pub(super) fn reason(&self) -> FinishReason {
        let mut records = self.run();
        assert_eq!(records.len(), 1);
        records.remove(0).reason
    }
}
