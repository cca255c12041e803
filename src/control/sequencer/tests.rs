//! The sequencer with fake devices that write down what is done to them, and a clock that only the tests turn.

use super::*;
use crate::control::contracts::{ArmedCamera, Illumination, NoLasers, StageDrive};
use crate::control::plan::StagePosition;
use crate::control::stop_rule::StopReason;
use crossbeam_channel::{Sender, bounded};
use proptest::prelude::*;
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
struct World {
    log: Vec<String>,
    /// Calls that fail from now on.
    failing: Vec<&'static str>,
    /// Exposure that cameras do instead of what they are asked.
    clamp: Option<Duration>,
    armed: [bool; 2],
    pulsing: bool,
    lit: bool,
}

type Shared = Arc<Mutex<World>>;

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

/// Gives ten exposures at each look while the trigger runs, and plays a script.
struct FakePath<'c> {
    world: Shared,
    clock: &'c FakeClock,
    exposures: u64,
    per_look: u64,
    /// No exposure is settled beyond this one.
    last: u64,
    looks: u64,
    drains: u64,
    /// Commands given by someone at the n-th look.
    script: Vec<(u64, Command)>,
    sender: Sender<Command>,
    failure: Option<(u64, DataPathError)>,
    drops_from: u64,
    drains_needed: u64,
    records: Vec<StopRecord>,
}

impl FakePath<'_> {
    fn note(&self, what: &str) {
        self.world.lock().unwrap().log.push(what.to_owned());
    }

    fn play(&mut self) {
        self.looks += 1;
        for (look, command) in &self.script {
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
        call(&self.world, "open").map_err(|error| DataPathError::Recording(error.to_string()))
    }

    fn progress(&mut self) -> PathProgress {
        self.play();
        self.clock.0.set(self.clock.0.get() + 10 * PERIOD.as_nanos() as u64);
        if self.world.lock().unwrap().pulsing {
            self.exposures = (self.exposures + self.per_look).min(self.last);
        }
        let failure = self.failure.take_if(|(look, _)| *look <= self.looks).map(|(_, error)| error);
        let record_drops = u64::from(self.exposures >= self.drops_from);
        PathProgress { exposures: self.exposures, record_drops, failure, ..PathProgress::default() }
    }

    fn drain(&mut self) -> Result<Drain, DataPathError> {
        self.drains += 1;
        self.play();
        self.clock.0.set(self.clock.0.get() + 100_000_000);
        let is_done = self.drains >= self.drains_needed;
        Ok(if is_done { Drain::Done } else { Drain::UnderWay })
    }

    fn abandon(&mut self) {
        self.note("abandon");
    }

    fn close(&mut self) -> Result<(), DataPathError> {
        call(&self.world, "close").map_err(|error| DataPathError::Recording(error.to_string()))
    }

    fn write_stop_record(&mut self, record: &StopRecord) -> Result<(), DataPathError> {
        self.records.push(record.clone());
        call(&self.world, "record").map_err(|error| DataPathError::Recording(error.to_string()))
    }
}

/// Everything for one test.
struct Bench {
    world: Shared,
    plan: String,
    script: Vec<(u64, Command)>,
    before: Vec<Command>,
    failure: Option<(u64, DataPathError)>,
    per_look: u64,
    /// No exposure is settled beyond this one.
    last: u64,
    drops_from: u64,
    drains_needed: u64,
    begin: Begin,
}

const PLAN: &str = "time_plan: {interval: 0, loops: 100}\nmetadata:\n  sofiscope:\n    cameras: {exposure_ms: 19, period_ms: 20}\n    laser_power_mw: {488: 5.0}\n";

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
            drops_from: u64::MAX,
            drains_needed: 1,
            begin: Begin::AtOnce,
        }
    }
}

impl Bench {
    fn failing(call: &'static str) -> Self {
        let bench = Self::default();
        bench.world.lock().unwrap().failing.push(call);
        bench
    }

    fn scripted(script: &[(u64, Command)]) -> Self {
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
    fn run(&self) -> Vec<StopRecord> {
        let clock = FakeClock(Cell::new(0));
        let (sender, commands) = bounded(64);
        for &command in &self.before {
            sender.send(command).unwrap();
        }
        let mut path = FakePath {
            world: Arc::clone(&self.world),
            clock: &clock,
            exposures: 0,
            per_look: self.per_look,
            last: self.last,
            looks: 0,
            drains: 0,
            script: self.script.clone(),
            sender,
            failure: self.failure.clone(),
            drops_from: self.drops_from,
            drains_needed: self.drains_needed,
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

    fn log(&self) -> Vec<String> {
        self.world.lock().unwrap().log.clone()
    }

    fn reason(&self) -> FinishReason {
        let mut records = self.run();
        assert_eq!(records.len(), 1);
        records.remove(0).reason
    }
}

#[test]
fn a_series_goes_from_setting_up_to_its_record() {
    let bench = Bench::default();
    let record = bench.run().remove(0);
    assert_eq!((record.reason, record.exposures), (FinishReason::Completed, 100));
    assert!((record.acquired_s - 2.0).abs() < 1e-9 && (record.dose_mj - 10.0).abs() < 1e-9);
    let expected = [
        "configure R",
        "configure T",
        "arm R",
        "arm T",
        "open",
        "light",
        "trigger",
        "pulses Some(100) every 20 ms",
        "hold",
        "dark",
        "stop R",
        "stop T",
        "close",
        "record",
    ];
    assert_eq!(bench.log()[..expected.len()], expected);
}

#[test]
fn when_one_camera_does_not_arm_the_other_is_stopped_and_the_next_start_works() {
    for call in ["arm R", "arm T"] {
        let bench = Bench::failing(call);
        let reason = bench.reason();
        assert!(matches!(&reason, FinishReason::Failed(message) if message.contains(call)), "{reason:?}");
        assert!(!bench.log().iter().any(|call| call == "trigger" || call == "light" || call == "open"));
        bench.world.lock().unwrap().failing.clear();
        assert_eq!(bench.reason(), FinishReason::Completed);
    }
}

#[test]
fn whatever_fails_ends_dark_with_a_record() {
    for call in [
        "configure R",
        "configure T",
        "open",
        "light",
        "trigger",
        "hold",
        "dark",
        "stop R",
        "stop T",
        "close",
        "record",
    ] {
        let bench = Bench::failing(call);
        let records = bench.run();
        let FinishReason::Failed(message) = &records[0].reason else {
            // What fails after the reason was settled stands in the failures.
            assert!(call == "close" || call == "record", "{call}: {:?}", records[0]);
            assert!(!records[0].failures.is_empty() || call == "close", "{call}: {:?}", records[0]);
            continue;
        };
        assert!(message.contains("does not work today"), "{call}: {message}");
    }
}

#[test]
fn a_camera_that_clamps_is_refused_with_both_numbers_unless_the_plan_accepts() {
    let mut bench = Bench::default();
    bench.world.lock().unwrap().clamp = Some(Duration::from_millis(10));
    let reason = bench.reason().to_string();
    assert!(reason.contains("exposure 19 ms was asked, the camera does 10 ms"), "{reason}");
    assert!(reason.contains("camera R") && reason.contains("camera T"), "{reason}");
    assert!(!bench.log().iter().any(|call| call.starts_with("arm")));
    bench.plan = PLAN.replace("period_ms: 20", "period_ms: 20, accept_readback: true");
    assert_eq!(bench.reason(), FinishReason::Completed);
}

#[test]
fn rounding_to_the_cameras_step_is_no_clamp() {
    let bench = Bench::default();
    bench.world.lock().unwrap().clamp = Some(Duration::from_micros(19_006));
    assert_eq!(bench.reason(), FinishReason::Completed);
}

#[test]
fn a_stop_while_preparing_starts_nothing() {
    for command in [Command::Stop, Command::Interrupt, Command::Abort] {
        let bench = Bench { before: vec![command], ..Bench::default() };
        let reason = bench.reason();
        assert!(matches!(reason, FinishReason::Stopped | FinishReason::Aborted), "{reason:?}");
        assert!(
            !bench.log().iter().any(|call| call == "trigger" || call.starts_with("arm")),
            "{:?}",
            bench.log()
        );
    }
}

#[test]
fn a_device_that_dies_ends_the_series() {
    let failure = Some((4, DataPathError::Device("camera T is gone".to_owned())));
    let bench = Bench { failure, ..Bench::default() };
    assert_eq!(bench.reason(), FinishReason::Failed("camera T is gone".to_owned()));
}

#[test]
fn stop_and_abort_end_in_their_own_way() {
    let stopped = Bench { drains_needed: 3, ..Bench::scripted(&[(3, Command::Stop), (4, Command::Stop)]) };
    assert_eq!(stopped.reason(), FinishReason::Stopped);
    assert!(!stopped.log().contains(&"abandon".to_owned()));
    let aborted = Bench::scripted(&[(3, Command::Abort)]);
    assert_eq!(aborted.reason(), FinishReason::Aborted);
    let log = aborted.log();
    let at = |name: &str| log.iter().position(|call| call == name).unwrap();
    assert!(at("dark") < at("hold") && at("stop T") < at("abandon") && at("abandon") < at("close"));
}

#[test]
fn the_second_interrupt_aborts_a_slow_stop() {
    let script = [(3, Command::Interrupt), (5, Command::Interrupt), (5, Command::Interrupt)];
    let bench = Bench { drains_needed: 50, ..Bench::scripted(&script) };
    assert_eq!(bench.reason(), FinishReason::Aborted);
    assert!(bench.log().contains(&"abandon".to_owned()));
}

#[test]
fn draining_is_given_up_after_its_time() {
    let bench = Bench { drains_needed: u64::MAX, ..Bench::default() };
    let reason = bench.reason().to_string();
    assert!(reason.contains("still on their way 10.0 s after the end"), "{reason}");
    assert!(bench.log().contains(&"abandon".to_owned()));
}

#[test]
fn a_pause_is_dark_and_its_time_does_not_count() {
    let bench = Bench::scripted(&[(3, Command::Pause), (9, Command::Resume)]);
    let record = bench.run().remove(0);
    assert_eq!((record.reason, record.exposures), (FinishReason::Completed, 100));
    assert!(record.acquired_s < 2.5, "{}", record.acquired_s);
    let log = bench.log();
    assert_eq!(log.iter().filter(|call| *call == "light").count(), 2);
    assert!(log.iter().any(|call| call.starts_with("pulses Some(") && !call.contains("100")), "{log:?}");
}

#[test]
fn cameras_without_any_exposure_have_stalled() {
    let bench = Bench { per_look: 0, ..Bench::default() };
    let reason = bench.reason().to_string();
    assert!(reason.contains("no exposure came for"), "{reason}");
}

#[test]
fn exposures_lost_at_the_end_do_not_hold_the_series() {
    // The trigger gives 100 pulses, and nothing is heard of the last ten.
    let bench = Bench { last: 90, ..Bench::default() };
    let record = bench.run().remove(0);
    assert_eq!((record.reason, record.exposures), (FinishReason::Completed, 90));
}

#[test]
fn a_recording_that_loses_frames_ends_the_series_unless_the_plan_goes_on() {
    let mut bench = Bench { drops_from: 50, ..Bench::default() };
    let reason = bench.reason().to_string();
    assert!(reason.contains("the recording lost 1 frames"), "{reason}");
    bench.plan = format!("{PLAN}    on_record_drop: continue\n");
    assert_eq!(bench.reason(), FinishReason::Completed);
}

#[test]
fn the_stop_rule_ends_a_series() {
    let plan = format!("{PLAN}    dose_limit_mj: 4\n");
    let bench = Bench { plan, ..Bench::default() };
    assert!(matches!(bench.reason(), FinishReason::StopRule(StopReason::Dose { .. })));
}

#[test]
fn every_position_has_a_series_of_its_own() {
    let plan = format!("{PLAN}stage_positions: [[1, 0], [2, 0]]\n");
    let bench = Bench { plan: plan.clone(), ..Bench::default() };
    let records = bench.run();
    assert_eq!(records.iter().map(|record| record.series).collect::<Vec<_>>(), [0, 1]);
    assert!(bench.log().contains(&"move 2.0".to_owned()));
    let stopped = Bench { plan, ..Bench::scripted(&[(3, Command::Stop)]) };
    assert_eq!(stopped.run().len(), 1, "after a stop no other series begins");
}

#[test]
fn a_series_waits_for_its_command_where_asked() {
    let bench = Bench { begin: Begin::OnCommand, ..Bench::scripted(&[(5, Command::Start)]) };
    assert_eq!(bench.reason(), FinishReason::Completed);
    let bench = Bench { begin: Begin::OnCommand, ..Bench::scripted(&[(5, Command::Stop)]) };
    assert_eq!(bench.reason(), FinishReason::Stopped);
}

#[test]
fn light_that_is_not_there_is_refused() {
    let mut lasers = NoLasers;
    assert!(lasers.on(&BTreeMap::new()).is_ok());
    let error = lasers.on(&[(488, 5.0)].into_iter().collect()).unwrap_err();
    assert!(error.to_string().contains("488 nm"));
}

fn any_command() -> impl Strategy<Value = Command> {
    prop::sample::select(vec![
        Command::Start,
        Command::Pause,
        Command::Resume,
        Command::Stop,
        Command::Abort,
        Command::Interrupt,
    ])
}

proptest! {
    #[test]
    fn no_course_of_commands_and_failures_leaves_anything_on(
        script in prop::collection::vec((1..30_u64, any_command()), 0..12),
        failing in prop::option::of(prop::sample::select(vec![
            "configure T", "arm R", "arm T", "open", "light", "trigger", "hold", "stop R", "stop T", "close",
        ])),
        drains_needed in 1..5_u64,
        failure in prop::option::of(1..20_u64),
    ) {
        let mut bench = Bench { drains_needed, ..Bench::scripted(&script) };
        // A pause without an end would be one.
        bench.script.push((31, Command::Stop));
        bench.failure = failure.map(|look| (look, DataPathError::Recording("disk full".to_owned())));
        bench.world.lock().unwrap().failing.extend(failing);
        prop_assert_eq!(bench.run().len(), 1);
    }
}
