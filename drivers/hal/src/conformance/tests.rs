//! A camera that keeps its contract passes; each broken promise is caught.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};

use super::*;
use crate::{
    BlockId, CameraCapabilities, CameraIdentity, DeviceTime, Epoch, ExposureIndex, Region, TriggerMode,
};

/// What the camera does wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bug {
    None,
    NoSerial,
    ArmsUnconfigured,
    EchoesSettings,
    TakesAnyRegion,
    KeepsPartOfRefused,
    ConfiguresWhileArmed,
    ArmsTwice,
    CountsOn,
    CountsFromOne,
    StandingClock,
    SlowClock,
    Repeats,
    LeavesLastPixel,
    TakesAnyMemory,
    LosesWithWrongMemory,
    LosesWithTimeout,
    TimesOutForEver,
    EndsBeforeTheFirstPulse,
    NeverEnds,
    RevivesAfterEnd,
    StopsOnceOnly,
}

const PERIOD: Duration = Duration::from_millis(10);
const PATIENCE: Duration = Duration::from_millis(100);

struct Fake {
    bug: Bug,
    identity: CameraIdentity,
    capabilities: CameraCapabilities,
    settings: Option<CameraSettings>,
    armed: Option<Arc<AtomicBool>>,
    pulses: Arc<AtomicBool>,
    runs: u64,
}

impl Fake {
    fn error(kind: ErrorKind) -> DeviceError {
        DeviceError::new(kind, "fake", "no")
    }
}

impl Camera for Fake {
    fn identity(&self) -> &CameraIdentity {
        &self.identity
    }

    fn capabilities(&self) -> &CameraCapabilities {
        &self.capabilities
    }

    fn configure(&mut self, want: &CameraSettings) -> Result<CameraSettings, DeviceError> {
        if self.armed.is_some() && self.bug != Bug::ConfiguresWhileArmed {
            return Err(Self::error(ErrorKind::Busy));
        }
        if self.bug == Bug::KeepsPartOfRefused
            && let Some(settings) = &mut self.settings
        {
            settings.region.width = want.region.width.min(64);
        }
        let Region { left, top, width, height } = want.region;
        let step = |value: u32| value / 4 * 4;
        let region = Region { left: step(left), top: step(top), width: step(width), height: step(height) };
        let fits = left.checked_add(width).is_some_and(|end| end <= 64)
            && top.checked_add(height).is_some_and(|end| end <= 32);
        let sound = fits && region.num_pixels() > 0;
        if (!sound && self.bug != Bug::TakesAnyRegion) || !self.capabilities.exposure.contains(&want.exposure)
        {
            return Err(Self::error(ErrorKind::OutOfRange));
        }
        let done = CameraSettings { region, period: want.period.max(PERIOD), ..*want };
        self.settings = Some(done);
        Ok(if self.bug == Bug::EchoesSettings { *want } else { done })
    }

    fn arm(&mut self) -> Result<Box<dyn FrameStream>, DeviceError> {
        let settings = match (self.settings, self.bug) {
            (Some(settings), _) => settings,
            (None, Bug::ArmsUnconfigured) => settings(TriggerMode::FreeRunning),
            (None, _) => return Err(Self::error(ErrorKind::Busy)),
        };
        if self.armed.is_some() && self.bug != Bug::ArmsTwice {
            return Err(Self::error(ErrorKind::Busy));
        }
        let stopped = Arc::new(AtomicBool::new(false));
        self.armed = Some(stopped.clone());
        let pulses = self.pulses.clone();
        self.runs += 1;
        let first = match self.bug {
            Bug::CountsOn => (self.runs - 1) * 1000,
            Bug::CountsFromOne => 1,
            _ => 0,
        };
        Ok(Box::new(FakeStream {
            bug: self.bug,
            settings,
            stopped,
            pulses,
            next: first,
            impatient: 0,
            ended: false,
        }))
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        match self.armed.take() {
            Some(stopped) => stopped.store(true, SeqCst),
            None if self.bug == Bug::StopsOnceOnly && self.runs > 0 => {
                return Err(Self::error(ErrorKind::Busy));
            }
            None => {}
        }
        Ok(())
    }
}

struct FakeStream {
    bug: Bug,
    settings: CameraSettings,
    stopped: Arc<AtomicBool>,
    pulses: Arc<AtomicBool>,
    next: u64,
    /// Calls with no time since the last frame.
    impatient: u64,
    ended: bool,
}

impl FrameStream for FakeStream {
    fn next_frame(&mut self, counts: &mut [u16], timeout: Duration) -> Result<FrameInfo, DeviceError> {
        if counts.len() != self.settings.region.num_pixels() && self.bug != Bug::TakesAnyMemory {
            self.next += u64::from(self.bug == Bug::LosesWithWrongMemory);
            return Err(Fake::error(ErrorKind::OutOfRange));
        }
        if self.stopped.load(SeqCst) && self.bug != Bug::NeverEnds {
            let revived = self.ended && self.bug == Bug::RevivesAfterEnd;
            self.ended = true;
            return Err(Fake::error(if revived { ErrorKind::Timeout } else { ErrorKind::Ended }));
        }
        let external = self.settings.trigger == TriggerMode::External;
        if external && !self.pulses.load(SeqCst) && !self.stopped.load(SeqCst) {
            let early = self.bug == Bug::EndsBeforeTheFirstPulse;
            return Err(Fake::error(if early { ErrorKind::Ended } else { ErrorKind::Timeout }));
        }
        let forever = self.bug == Bug::TimesOutForEver && self.impatient > 0;
        if timeout.is_zero() && self.impatient < 2 || forever {
            self.impatient += 1;
            self.next += u64::from(self.bug == Bug::LosesWithTimeout);
            return Err(Fake::error(ErrorKind::Timeout));
        }
        self.impatient = 0;
        let exposure = self.next;
        self.next += u64::from(self.bug != Bug::Repeats || exposure != 5);
        let writes = counts.len() - usize::from(self.bug == Bug::LeavesLastPixel);
        counts[..writes].fill(100);
        let period_ns = self.settings.period.as_nanos() as u64;
        let device_ns = match self.bug {
            Bug::StandingClock => 0,
            Bug::SlowClock => exposure * period_ns / 3,
            _ => exposure * period_ns,
        };
        Ok(FrameInfo {
            exposure: ExposureIndex(exposure),
            block_id: BlockId(exposure),
            epoch: Epoch(0),
            device_time: DeviceTime(5_000 + device_ns),
            status: FrameStatus::Complete,
        })
    }
}

struct FakeTrigger {
    pulses: Arc<AtomicBool>,
}

impl TriggerSource for FakeTrigger {
    fn start(&mut self, period: Duration, _: Option<u64>) -> Result<(), DeviceError> {
        if period.is_zero() {
            return Err(Fake::error(ErrorKind::OutOfRange));
        }
        if self.pulses.swap(true, SeqCst) { Err(Fake::error(ErrorKind::Busy)) } else { Ok(()) }
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.pulses.store(false, SeqCst);
        Ok(())
    }
}

fn settings(trigger: TriggerMode) -> CameraSettings {
    let region = Region { left: 4, top: 8, width: 32, height: 16 };
    CameraSettings { region, exposure: Duration::from_millis(5), period: PERIOD, trigger }
}

struct FakeRig {
    camera: Fake,
    trigger: Option<FakeTrigger>,
}

impl FakeRig {
    fn new(bug: Bug, mode: TriggerMode) -> Self {
        let serial = if bug == Bug::NoSerial { "" } else { "7" };
        let pulses = Arc::new(AtomicBool::new(false));
        let trigger = FakeTrigger { pulses: pulses.clone() };
        let camera = Fake {
            bug,
            identity: CameraIdentity {
                vendor: "nobody".into(),
                model: "fake".into(),
                serial: serial.into(),
                firmware: "1".into(),
                simulated: true,
            },
            capabilities: CameraCapabilities {
                sensor_width: 64,
                sensor_height: 32,
                region_step: 4,
                exposure: Duration::from_millis(1)..=Duration::from_secs(1),
                exposure_step: Duration::from_micros(1),
                shortest_period: PERIOD,
                saturation_counts: 4095,
            },
            settings: None,
            armed: None,
            pulses,
            runs: 0,
        };
        Self { camera, trigger: (mode == TriggerMode::External).then_some(trigger) }
    }
}

impl CameraRig for FakeRig {
    fn camera(&mut self) -> &mut dyn Camera {
        &mut self.camera
    }

    fn trigger(&mut self) -> Option<&mut dyn TriggerSource> {
        self.trigger.as_mut().map(|trigger| trigger as &mut dyn TriggerSource)
    }

    fn settings(&self) -> CameraSettings {
        settings(if self.trigger.is_some() { TriggerMode::External } else { TriggerMode::FreeRunning })
    }

    fn patience(&self) -> Duration {
        PATIENCE
    }
}

#[test]
fn a_camera_that_keeps_its_contract_passes() {
    camera(&mut FakeRig::new(Bug::None, TriggerMode::FreeRunning));
    camera(&mut FakeRig::new(Bug::None, TriggerMode::External));
    trigger(&mut FakeTrigger { pulses: Arc::new(AtomicBool::new(false)) }, PERIOD);
}

macro_rules! caught {
    ($($name:ident: $bug:ident, $mode:ident, $says:literal;)*) => {
        $(
            #[test]
            #[should_panic(expected = $says)]
            fn $name() {
                camera(&mut FakeRig::new(Bug::$bug, TriggerMode::$mode));
            }
        )*
    };
}

caught! {
    a_missing_serial_number_is_caught: NoSerial, FreeRunning, "has a serial number";
    arming_without_settings_is_caught: ArmsUnconfigured, FreeRunning, "never configured must be refused";
    settings_that_are_only_echoed_are_caught: EchoesSettings, FreeRunning, "read back";
    regions_beside_the_sensor_are_caught: TakesAnyRegion, FreeRunning, "wider than the sensor must";
    settings_half_taken_over_are_caught: KeepsPartOfRefused, FreeRunning, "the next frame must succeed";
    configuring_while_armed_is_caught: ConfiguresWhileArmed, FreeRunning, "configuring an armed camera";
    arming_twice_is_caught: ArmsTwice, FreeRunning, "arming an armed camera";
    counters_that_go_on_are_caught: CountsOn, FreeRunning, "is 0";
    counters_that_begin_with_one_are_caught: CountsFromOne, External, "is 0";
    standing_clocks_are_caught: StandingClock, FreeRunning, "device time rises";
    slow_clocks_are_caught: SlowClock, FreeRunning, "device time rises";
    repeated_frames_are_caught: Repeats, FreeRunning, "exposures rise";
    pixels_never_written_are_caught: LeavesLastPixel, FreeRunning, "1 were never written";
    memory_of_any_size_is_caught: TakesAnyMemory, FreeRunning, "memory of the size before";
    frames_lost_with_wrong_memory_are_caught: LosesWithWrongMemory, FreeRunning, "refusing memory loses no";
    frames_lost_with_timeouts_are_caught: LosesWithTimeout, FreeRunning, "timeouts lose no frame";
    timeouts_without_end_are_caught: TimesOutForEver, FreeRunning, "none did";
    an_end_before_the_beginning_is_caught: EndsBeforeTheFirstPulse, External, "before the first pulse";
    streams_without_end_are_caught: NeverEnds, FreeRunning, "must come to Ended";
    streams_that_revive_are_caught: RevivesAfterEnd, FreeRunning, "a frame after the end";
    stops_that_fail_the_second_time_are_caught: StopsOnceOnly, FreeRunning, "stopping the camera must";
}
