//! What all tests of the replay room share: recordings, and reading to the end.

use sofiscope::acquisition::{
    Analysis, Conditions, ExposureRecord, Frame, FrameFacts, Loss, PairState, Side,
};
use sofiscope::recording::{CameraDescription, Format, Recording, RecordingPlan, StopRecord, StopStatus};
use sofiscope::replay::{Replay, ReplayCamera, ReplayOptions, open};
use sofiscope_hal::{
    BlockId, Camera, CameraIdentity, CameraSettings, Channel, DeviceTime, Epoch, ErrorKind, ExposureIndex,
    FrameInfo, FrameStatus, FrameStream, HostTime, Region, TriggerMode,
};
use std::path::{Path, PathBuf};
use std::time::Duration;

pub(crate) const PERIOD: Duration = Duration::from_millis(5);
pub(crate) const SIDE: u32 = 16;
pub(crate) const LEN: usize = (SIDE * SIDE) as usize;
pub(crate) const FORMATS: [Format; 2] = [Format::OmeTiff, Format::OmeZarr];

/// Pixels that differ from frame to frame and camera to camera.
pub(crate) fn pixels(channel: Channel, exposure: u64) -> Vec<u16> {
    let mut state = (exposure * 2 + channel.index() as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 48) as u16
    };
    std::iter::repeat_with(next).take(LEN).collect()
}

/// When a frame was received: regular but for jitter, and T half a millisecond after R.
pub(crate) fn received_ns(channel: Channel, exposure: u64) -> u64 {
    let jitter_ns = exposure.wrapping_mul(2_654_435_761) % 900_000;
    7_000_000_000 + exposure * 5_000_000 + jitter_ns + channel.index() as u64 * 500_000
}

pub(crate) fn info(channel: Channel, exposure: u64) -> FrameInfo {
    FrameInfo {
        exposure: ExposureIndex(exposure),
        // A counter of 16 bit that wraps, and a restart of it.
        block_id: BlockId(if exposure < 60 { (65_500 + exposure) % 65_535 + 1 } else { exposure - 60 }),
        epoch: Epoch(u32::from(exposure >= 60)),
        device_time: DeviceTime(exposure * 5_000_100 + 17 + channel.index() as u64),
        status: FrameStatus::Complete,
    }
}

/// Whether the recording has the frame; gaps on either side, on both, and one of several exposures.
pub(crate) fn is_recorded(channel: Channel, exposure: u64) -> bool {
    let lost = match channel {
        Channel::Reflected => matches!(exposure % 23, 5 | 14) || (40..47).contains(&exposure),
        Channel::Transmitted => matches!(exposure % 23, 9 | 14) || exposure == 0,
    };
    !lost
}

pub(crate) fn is_left_out(exposure: u64) -> bool {
    Channel::BOTH.into_iter().all(|channel| is_recorded(channel, exposure)) && exposure.is_multiple_of(7)
}

/// Why an exposure is left out, if it is.
pub(crate) fn reason(exposure: u64) -> Loss {
    if exposure.is_multiple_of(2) { Loss::OutOfFocus } else { Loss::ShedByPolicy }
}

/// One exposure of a recording with gaps.
pub(crate) fn record(exposure: u64) -> ExposureRecord {
    let sides = Channel::BOTH.map(|channel| {
        if is_recorded(channel, exposure) {
            let received = HostTime(received_ns(channel, exposure));
            let facts = FrameFacts {
                channel,
                info: info(channel, exposure),
                received,
                conditions: Conditions::default(),
            };
            Side::Frame(Frame::of_counts(facts, &pixels(channel, exposure)))
        } else {
            Side::Lost(Loss::UpstreamGap, None)
        }
    });
    let is_pair = sides.iter().all(|side| side.frame().is_some());
    ExposureRecord {
        exposure: ExposureIndex(exposure),
        sides,
        pair: if is_pair { PairState::Paired } else { PairState::Not(Loss::Unpaired) },
        analysis: match is_pair {
            true if is_left_out(exposure) => Analysis::LeftOut(reason(exposure)),
            true => Analysis::Analyzed,
            false => Analysis::None,
        },
    }
}

pub(crate) fn camera(serial: &str) -> CameraDescription {
    CameraDescription {
        identity: CameraIdentity {
            vendor: "Hamamatsu".to_owned(),
            model: "C13440-20CU".to_owned(),
            serial: serial.to_owned(),
            firmware: "4.30".to_owned(),
            simulated: false,
        },
        settings: CameraSettings {
            region: Region { left: 4, top: 8, width: SIDE, height: SIDE },
            exposure: Duration::from_millis(4),
            period: PERIOD,
            trigger: TriggerMode::External,
        },
        pixel_size_nm: Some(108.0),
    }
}

pub(crate) fn plan(directory: &Path, format: Format) -> RecordingPlan {
    RecordingPlan {
        directory: directory.to_path_buf(),
        format,
        cameras: [camera("R1"), camera("T1")],
        planned_exposures: None,
        simulated: false,
        conditions: Conditions::default(),
        provenance: vec![("plan.yaml".to_owned(), "# as used\n".to_owned())],
    }
}

/// A recording with all kinds of gaps.
pub(crate) fn recording(directory: &Path, format: Format, exposures: u64) {
    recording_of(directory, format, (0..exposures).map(record));
}

/// A recording of which nothing is lost.
pub(crate) fn whole_recording(directory: &Path, format: Format, exposures: u64) {
    let whole = (0..exposures).map(|exposure| {
        let sides = Channel::BOTH.map(|channel| {
            let time_ns = exposure * 5_000_000;
            let info = FrameInfo {
                device_time: DeviceTime(time_ns + 3),
                block_id: BlockId(exposure),
                epoch: Epoch(0),
                ..info(channel, exposure)
            };
            let facts = FrameFacts {
                channel,
                info,
                received: HostTime(time_ns + 1000),
                conditions: Conditions::default(),
            };
            Side::Frame(Frame::of_counts(facts, &pixels(channel, exposure)))
        });
        let (pair, analysis) = (PairState::Paired, Analysis::Analyzed);
        ExposureRecord { exposure: ExposureIndex(exposure), sides, pair, analysis }
    });
    recording_of(directory, format, whole);
}

pub(crate) fn recording_of(directory: &Path, format: Format, records: impl Iterator<Item = ExposureRecord>) {
    let mut recording = Recording::create(&plan(directory, format)).unwrap();
    for record in records {
        recording.push(&record).unwrap();
    }
    let reason = "all exposures are recorded".to_owned();
    recording.finish(StopRecord { status: StopStatus::Success, reason }).unwrap();
}

pub(crate) fn replay(paths: &[PathBuf], options: ReplayOptions) -> Replay {
    open(paths, options).unwrap()
}

/// Configures a camera as recorded and arms it.
pub(crate) fn armed(camera: &mut ReplayCamera) -> Box<dyn FrameStream> {
    let settings = camera.recorded_settings();
    assert_eq!(camera.configure(&settings), Ok(settings));
    camera.arm().unwrap()
}

/// Reads to the end.
pub(crate) fn read(stream: &mut dyn FrameStream, pixels: usize) -> Vec<(FrameInfo, Vec<u16>)> {
    let mut counts = vec![0; pixels];
    let mut frames = Vec::new();
    loop {
        match stream.next_frame(&mut counts, Duration::from_secs(1)) {
            Ok(info) => frames.push((info, counts.clone())),
            Err(error) if error.kind() == ErrorKind::Ended => return frames,
            Err(error) => panic!("{error}"),
        }
    }
}
