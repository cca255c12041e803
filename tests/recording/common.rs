//! What all tests of the recording room share: a plan, exposures whose pixels say which they are.

use sofiscope::acquisition::{
    Analysis, Conditions, ExposureRecord, Frame, FrameFacts, LedgerRow, Light, Loss, PairState, RowState,
    Side,
};
use sofiscope::recording::{CameraDescription, Format, RecordedRun, RecordingPlan, StopRecord, StopStatus};
use sofiscope_hal::{
    BlockId, CameraIdentity, CameraSettings, Channel, DeviceTime, Epoch, ExposureIndex, FrameInfo,
    FrameStatus, HostTime, Region, TriggerMode,
};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

pub(crate) const FORMATS: [Format; 2] = [Format::OmeTiff, Format::OmeZarr];

pub(crate) fn camera(serial: &str, height: u32, width: u32) -> CameraDescription {
    CameraDescription {
        identity: CameraIdentity {
            vendor: "sofiscope".to_owned(),
            model: "simulated <camera> µ".to_owned(),
            serial: serial.to_owned(),
            firmware: "1".to_owned(),
            simulated: true,
        },
        settings: CameraSettings {
            region: Region { left: 0, top: 0, width, height },
            exposure: Duration::from_millis(4),
            period: Duration::from_millis(5),
            trigger: TriggerMode::External,
        },
        pixel_size_nm: Some(108.0),
    }
}

pub(crate) fn plan(directory: &Path, format: Format, height: u32, width: u32) -> RecordingPlan {
    RecordingPlan {
        directory: directory.to_path_buf(),
        format,
        cameras: [camera("R1", height, width), camera("T1", height, width)],
        planned_exposures: None,
        simulated: true,
        conditions: Conditions { focus_nm: None, ..conditions(Channel::Reflected, 0) },
        provenance: vec![("plan.yaml".to_owned(), "# as used\n".to_owned())],
    }
}

/// Pixels that name camera and exposure: the first four hold them, the others follow from them.
pub(crate) fn pixels(channel: Channel, exposure: u64, len: usize) -> Vec<u16> {
    let seed = exposure * 2 + channel.index() as u64 + 1;
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mut counts: Vec<u16> = (0..len)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 48) as u16
        })
        .collect();
    counts[0] = channel.index() as u16 + 1;
    counts[1] = exposure as u16;
    counts[2] = (exposure >> 16) as u16;
    counts
}

/// A focus error that comes and goes; place and light of the series.
pub(crate) fn conditions(channel: Channel, exposure: u64) -> Conditions {
    let steps = exposure as f64 * 37.0 - 4000.0 + channel.index() as f64;
    Conditions {
        focus_nm: (!exposure.is_multiple_of(3)).then_some(steps / 100.0),
        x_um: Some(1250.5),
        y_um: Some(-3.0),
        light: Light::of([(488, 10.0), (561, 2.5)]).unwrap(),
    }
}

pub(crate) fn frame(channel: Channel, exposure: u64, len: usize) -> Frame {
    let info = FrameInfo {
        exposure: ExposureIndex(exposure),
        block_id: BlockId(exposure + 65_400),
        epoch: Epoch(0),
        device_time: DeviceTime(exposure * 5_000_000 + 17),
        status: FrameStatus::Complete,
    };
    let received = HostTime(exposure * 5_000_000 + 1000);
    let facts = FrameFacts { channel, info, received, conditions: conditions(channel, exposure) };
    Frame::of_counts(facts, &pixels(channel, exposure, len))
}

/// Exposures with gaps on either and both sides, and pairs that are none.
pub(crate) fn exposure(exposure: u64, len: usize) -> ExposureRecord {
    let both = Channel::BOTH.map(|channel| Side::Frame(frame(channel, exposure, len)));
    let [r, t] = both;
    let facts = t.frame().map(|frame| *frame.facts());
    let (sides, pair) = match exposure % 23 {
        5 => ([Side::Lost(Loss::UpstreamGap, None), t], PairState::Not(Loss::Unpaired)),
        9 => ([r, Side::Lost(Loss::Incomplete, facts)], PairState::Not(Loss::Unpaired)),
        14 => (
            [Side::Lost(Loss::NoBuffer, None), Side::Lost(Loss::QueueFull, facts)],
            PairState::Not(Loss::Unpaired),
        ),
        17 => ([r, t], PairState::Not(Loss::Misaligned)),
        _ => ([r, t], PairState::Paired),
    };
    let analysis = match pair {
        PairState::Paired if exposure.is_multiple_of(7) => Analysis::LeftOut(Loss::ShedByPolicy),
        PairState::Paired => Analysis::Analyzed,
        PairState::Not(_) => Analysis::None,
    };
    ExposureRecord { exposure: ExposureIndex(exposure), sides, pair, analysis }
}

pub(crate) fn stop() -> StopRecord {
    StopRecord { status: StopStatus::Success, reason: "all exposures are recorded".to_owned() }
}

/// Checks every frame and row of a recording against what was pushed; returns the exposures in the ledger.
pub(crate) fn assert_true_to_exposures(run: &mut RecordedRun, height: u32, width: u32) -> u64 {
    let len = (height * width) as usize;
    let mut counts = vec![0; len];
    let rows: Vec<LedgerRow> = run.rows().unwrap().map(Result::unwrap).collect();
    for (at, row) in rows.iter().enumerate() {
        let index = at as u64 / 2;
        let channel = Channel::BOTH[at % 2];
        assert_eq!((row.exposure.0, row.channel), (index, channel));
        let pushed = exposure(index, len);
        match (pushed.side(channel), row.state) {
            (Side::Frame(frame), RowState::Recorded { page, .. }) => {
                assert_eq!((row.pair, row.analysis), (pushed.pair, pushed.analysis));
                assert_eq!(row.device_time, Some(frame.facts().info.device_time));
                assert_eq!(row.host_time, Some(frame.facts().received));
                assert_eq!(row.conditions, frame.facts().conditions, "{channel}, exposure {index}");
                assert_eq!(row.id, Some((frame.facts().info.block_id, Epoch(0))));
                run.read_checked(channel, page, &mut counts).unwrap();
                assert!(counts == frame.counts(), "{channel}, exposure {index}: wrong pixels");
            }
            (_, RowState::Lost(Loss::CrashTail | Loss::DiskFull | Loss::IoError)) => {}
            (Side::Lost(loss, facts), RowState::Lost(found)) => {
                assert_eq!(*loss, found);
                assert_eq!(row.host_time, facts.map(|facts| facts.received));
            }
            (_, state) => panic!("{channel}, exposure {index}: {state:?}"),
        }
    }
    rows.len() as u64 / 2
}

/// Every file below a directory with its bytes.
pub(crate) fn contents(directory: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(contents(&path));
        } else {
            let bytes = std::fs::read(&path).unwrap();
            found.insert(path, bytes);
        }
    }
    found
}
