//! The stand-in on the bench, for one test at a time: a library is one for a process.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sofiscope_dcam::{Dcam, DcamCamera, DcamOptions, PulseInput};
use sofiscope_dcam_stand_in::{Remote, library};
use sofiscope_hal::{
    Camera, CameraSettings, DeviceError, ErrorKind, FrameInfo, FrameStream, Region, TriggerMode,
};

/// A line of the sensor at fast scan, seconds.
pub(crate) const LINE_S: f64 = 9.744_36e-6;
pub(crate) const PATIENCE: Duration = Duration::from_secs(5);
pub(crate) const REGION: Region = Region { left: 1008, top: 1008, width: 32, height: 32 };
pub(crate) const SERIALS: [&str; 2] = ["000001", "000002"];

static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

pub(crate) struct Bench {
    pub(crate) dcam: Arc<Dcam>,
    pub(crate) remote: Remote,
    _alone: MutexGuard<'static, ()>,
}

impl Bench {
    pub(crate) fn new() -> Self {
        let alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let path = library().expect("the stand-in is built as a library beside this test");
        let remote = Remote::open(&path).unwrap();
        remote.say("reset").unwrap();
        let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/bench/scene.toml");
        remote.say(&format!("scene {scene}")).unwrap();
        Self { dcam: Dcam::open(Some(&path)).unwrap(), remote, _alone: alone }
    }

    pub(crate) fn say(&self, words: &str) -> String {
        self.remote.say(words).unwrap()
    }

    pub(crate) fn open(&self, camera: usize, options: DcamOptions) -> DcamCamera {
        DcamCamera::open(&self.dcam, SERIALS[camera], options).unwrap()
    }

    pub(crate) fn both(&self, pulse_input: PulseInput) -> [DcamCamera; 2] {
        let options = DcamOptions { pulse_input, ..DcamOptions::default() };
        [self.open(0, options), self.open(1, options)]
    }

    /// A train of pulses on the line of both cameras.
    pub(crate) fn pulses(&self, period: Duration, number: u64) {
        self.say(&format!("pulses {} {number}", period.as_nanos() as f64 / 1e3));
    }
}

/// So many lines of the sensor.
pub(crate) fn lines(lines: f64) -> Duration {
    Duration::from_nanos((lines * LINE_S * 1e9).round() as u64)
}

/// 2 ms of exposure, or 5 ms between pulses.
pub(crate) fn wish(trigger: TriggerMode) -> CameraSettings {
    CameraSettings { region: REGION, exposure: lines(205.0), period: Duration::from_millis(5), trigger }
}

/// The frames of a stream until it has been quiet for `quiet`.
pub(crate) fn drain(stream: &mut dyn FrameStream, quiet: Duration) -> Vec<FrameInfo> {
    let mut counts = vec![0; REGION.num_pixels()];
    let mut frames = Vec::new();
    loop {
        match stream.next_frame(&mut counts, quiet) {
            Ok(info) => frames.push(info),
            Err(error) if matches!(error.kind(), ErrorKind::Timeout | ErrorKind::Ended) => return frames,
            Err(error) => panic!("{error}"),
        }
    }
}

/// So many frames, with their pixels.
pub(crate) fn take(stream: &mut dyn FrameStream, number: usize) -> Vec<(FrameInfo, Vec<u16>)> {
    let one = |_| {
        let mut counts = vec![0; REGION.num_pixels()];
        let info = stream.next_frame(&mut counts, PATIENCE).unwrap();
        (info, counts)
    };
    (0..number).map(one).collect()
}

pub(crate) fn exposures(frames: &[FrameInfo]) -> Vec<u64> {
    frames.iter().map(|info| info.exposure.0).collect()
}

pub(crate) fn armed(camera: &mut DcamCamera, want: &CameraSettings) -> Box<dyn FrameStream> {
    camera.configure(want).unwrap();
    camera.arm().unwrap()
}

/// The error of something that must not succeed.
pub(crate) fn failed<T>(result: Result<T, DeviceError>, kind: ErrorKind) -> String {
    let error = result.map(|_| ()).unwrap_err();
    assert_eq!(error.kind(), kind, "{error}");
    error.to_string()
}
