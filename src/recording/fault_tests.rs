//! Every change of a file made to fail, one after another.

use super::gate::{Gate, Operation};
use super::sync::Pace;
use super::{
    CameraDescription, Format, Recording, RecordingError, RecordingPlan, StopRecord, StopStatus, open,
};
use crate::acquisition::{
    Analysis, Conditions, ExposureRecord, Frame, FrameFacts, LedgerRow, Loss, PairState, RowState, Side,
};
use rustix::io::Errno;
use sofiscope_hal::{
    BlockId, CameraIdentity, CameraSettings, Channel, DeviceTime, Epoch, ExposureIndex, FrameInfo,
    FrameStatus, HostTime, Region, TriggerMode,
};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

const SIDE: u32 = 16;
const LEN: usize = (SIDE * SIDE) as usize;
const EXPOSURES: u64 = 90;

/// A folder in memory where there is one: nothing here depends on a disk, and syncing takes time.
pub(super) fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// Syncs after every group.
pub(super) const EAGER: Pace = Pace { period: Duration::ZERO, bytes: 1 };

#[derive(Clone, Copy, Debug, PartialEq)]
enum Lasting {
    Once,
    FromThenOn,
}

/// Fails the `k`-th write, counted from 1.
fn failing(k: u64, errno: Errno, lasting: Lasting) -> Gate {
    let writes = Arc::new(AtomicU64::new(0));
    Gate::new(move |operation: Operation, _: &Path| {
        if operation == Operation::Sync {
            return Ok(());
        }
        let write = writes.fetch_add(1, Ordering::Relaxed) + 1;
        let fails = write == k || write > k && lasting == Lasting::FromThenOn;
        if fails { Err(errno.into()) } else { Ok(()) }
    })
}

pub(super) fn plan(directory: &Path, format: Format) -> RecordingPlan {
    let camera = CameraDescription {
        identity: CameraIdentity {
            vendor: String::new(),
            model: String::new(),
            serial: String::new(),
            firmware: String::new(),
            simulated: true,
        },
        settings: CameraSettings {
            region: Region { left: 0, top: 0, width: SIDE, height: SIDE },
            exposure: Duration::from_millis(1),
            period: Duration::from_millis(1),
            trigger: TriggerMode::External,
        },
        pixel_size_nm: None,
    };
    RecordingPlan {
        directory: directory.to_path_buf(),
        format,
        cameras: [camera.clone(), camera],
        planned_exposures: Some(EXPOSURES),
        simulated: true,
        conditions: Conditions::default(),
        provenance: Vec::new(),
    }
}

fn pixels(channel: Channel, exposure: u64) -> Vec<u16> {
    (0..LEN as u64).map(|pixel| (pixel * 7 + exposure * 2 + channel.index() as u64) as u16).collect()
}

pub(super) fn exposure(index: u64) -> ExposureRecord {
    let sides = Channel::BOTH.map(|channel| {
        let info = FrameInfo {
            exposure: ExposureIndex(index),
            block_id: BlockId(index),
            epoch: Epoch(0),
            device_time: DeviceTime(index),
            status: FrameStatus::Complete,
        };
        let facts =
            FrameFacts { channel, info, received: HostTime(index), conditions: Conditions::default() };
        Side::Frame(Frame::of_counts(facts, &pixels(channel, index)))
    });
    ExposureRecord {
        exposure: ExposureIndex(index),
        sides,
        pair: PairState::Paired,
        analysis: Analysis::None,
    }
}

/// Records through a gate; the errors on the way and how it ended, or why it never began.
fn record(
    directory: &Path,
    format: Format,
    gate: Gate,
    pace: Pace,
) -> Result<(Vec<RecordingError>, Result<StopStatus, RecordingError>), RecordingError> {
    let created = jiff::Timestamp::UNIX_EPOCH;
    let mut recording = Recording::create_through(&plan(directory, format), created, gate, pace)?;
    let mut errors = Vec::new();
    for index in 0..EXPOSURES {
        errors.extend(recording.push(&exposure(index)).err());
        if index % 5 == 4 {
            errors.extend(recording.commit().err());
        }
    }
    let stop = StopRecord { status: StopStatus::Success, reason: "planned".to_owned() };
    let ended = recording.finish(stop).map(|summary| summary.stop.status);
    Ok((errors, ended))
}

/// Every recorded row has its frame; returns the rows.
pub(super) fn assert_readable(directory: &Path) -> Vec<LedgerRow> {
    let mut run = open(directory).unwrap();
    let rows: Vec<LedgerRow> = run.rows().unwrap().map(Result::unwrap).collect();
    let mut counts = vec![0; LEN];
    for (at, row) in rows.iter().enumerate() {
        assert_eq!((row.exposure.0, row.channel.index()), (at as u64 / 2, at % 2));
        if let RowState::Recorded { page, .. } = row.state {
            run.read_checked(row.channel, page, &mut counts).unwrap();
            assert_eq!(counts, pixels(row.channel, row.exposure.0));
        }
    }
    rows
}

fn assert_survives(k: u64, errno: Errno, lasting: Lasting, format: Format) {
    let folder = folder();
    let directory = folder.path().join("run");
    let case = format!("{format:?}, write {k}, {errno:?}, {lasting:?}");
    let (errors, ended) = match record(&directory, format, failing(k, errno, lasting), Pace::default()) {
        Err(error) => {
            assert!(!directory.exists(), "{case}: {error}");
            return;
        }
        Ok(outcome) => outcome,
    };
    let rows = assert_readable(&directory);
    let loss = if errno == Errno::NOSPC { Loss::DiskFull } else { Loss::IoError };
    let lost = rows.iter().filter(|row| row.state == RowState::Lost(loss)).count();
    let recorded = rows.iter().filter(|row| matches!(row.state, RowState::Recorded { .. })).count();
    assert_eq!(lost + recorded, rows.len(), "{case}");
    for error in &errors {
        let said = error.to_string();
        let names_path = said.contains(&directory.display().to_string());
        assert!(names_path && said.contains("bytes are free"), "{case}: {said}");
        assert_eq!(error.loss(), loss, "{case}");
    }
    assert!(errors.len() <= 1, "{case}: {errors:?}");
    match (lasting, errors.first(), ended) {
        (Lasting::Once, Some(_), Ok(status)) => {
            assert_eq!((status, rows.len() as u64), (StopStatus::Fail, 2 * EXPOSURES), "{case}");
            assert_eq!(open(&directory).unwrap().stop().map(|stop| stop.status), Some(StopStatus::Fail));
        }
        (Lasting::Once, None, _) => assert_eq!(recorded as u64, 2 * EXPOSURES, "{case}"),
        (Lasting::FromThenOn, Some(_), Err(_)) => {}
        (Lasting::FromThenOn, None, _) => assert_eq!(recorded as u64, 2 * EXPOSURES, "{case}"),
        (_, _, ended) => panic!("{case}: {ended:?}"),
    }
}

#[test]
fn whichever_write_fails_everything_before_is_readable() {
    for format in [Format::OmeTiff, Format::OmeZarr] {
        for k in 1..=50 {
            for errno in [Errno::NOSPC, Errno::IO] {
                for lasting in [Lasting::Once, Lasting::FromThenOn] {
                    assert_survives(k, errno, lasting, format);
                }
            }
        }
        for k in [61, 77, 90, 130, 200] {
            assert_survives(k, Errno::ROFS, Lasting::Once, format);
        }
    }
}

/// Every sync fails from the `k`-th on, or only that one, counted from 1.
fn assert_survives_sync(k: u64, lasting: Lasting, format: Format) {
    let folder = folder();
    let directory = folder.path().join("run");
    let case = format!("{format:?}, sync {k}, {lasting:?}");
    let syncs = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&syncs);
    let gate = Gate::new(move |operation: Operation, _: &Path| {
        let sync = match operation {
            Operation::Write => return Ok(()),
            Operation::Sync => counted.fetch_add(1, Ordering::Relaxed) + 1,
        };
        let fails = sync == k || sync > k && lasting == Lasting::FromThenOn;
        if fails { Err(Errno::IO.into()) } else { Ok(()) }
    });
    let (errors, ended) = match record(&directory, format, gate, EAGER) {
        Err(error) => return assert!(!directory.exists(), "{case}: {error}"),
        Ok(outcome) => outcome,
    };
    assert!(errors.len() <= 1, "{case}: {errors:?}");
    for error in &errors {
        assert_eq!(error.loss(), Loss::IoError, "{case}");
        assert!(error.to_string().contains("sync"), "{case}: {error}");
    }
    let has_failed = syncs.load(Ordering::Relaxed) >= k;
    assert!(has_failed || errors.is_empty(), "{case}");
    match ended {
        Ok(status) => assert_eq!(status == StopStatus::Fail, has_failed, "{case}"),
        Err(error) => assert!(has_failed, "{case}: {error}"),
    }
    assert_eq!(assert_readable(&directory).len() as u64, 2 * EXPOSURES, "{case}");
}

#[test]
fn whichever_sync_fails_the_recording_has_failed_and_stays_readable() {
    for format in [Format::OmeTiff, Format::OmeZarr] {
        for k in (1..=24).chain([30, 41, 60, 90]) {
            for lasting in [Lasting::Once, Lasting::FromThenOn] {
                assert_survives_sync(k, lasting, format);
            }
        }
    }
}

#[test]
fn a_directory_that_is_deleted_or_renamed_is_missed() {
    for format in [Format::OmeTiff, Format::OmeZarr] {
        for is_deleted in [true, false] {
            let folder = folder();
            let directory = folder.path().join("run");
            let mut recording = Recording::create(&plan(&directory, format)).unwrap();
            recording.push(&exposure(0)).unwrap();
            recording.commit().unwrap();
            recording.ensure_present().unwrap();
            let renamed = folder.path().join("renamed");
            if is_deleted {
                std::fs::remove_dir_all(&directory).unwrap();
            } else {
                std::fs::rename(&directory, &renamed).unwrap();
            }
            let error = recording.ensure_present().unwrap_err();
            assert!(matches!(error, RecordingError::Gone { .. }), "{error}");
            assert!(error.to_string().contains(&directory.display().to_string()), "{error}");
            let stop = StopRecord { status: StopStatus::Fail, reason: error.to_string() };
            assert!(recording.finish(stop).is_err());
            assert!(is_deleted || assert_readable(&renamed).len() == 2);
        }
    }
}

#[test]
fn a_disk_that_hangs_at_the_end_keeps_nobody_waiting() {
    for format in [Format::OmeTiff, Format::OmeZarr] {
        let folder = folder();
        let directory = folder.path().join("run");
        let (release, held) = std::sync::mpsc::sync_channel::<()>(0);
        let held = std::sync::Mutex::new(held);
        let hangs = Arc::new(std::sync::atomic::AtomicBool::new(false));
        let is_hanging = Arc::clone(&hangs);
        let gate = Gate::new(move |operation: Operation, _: &Path| {
            if operation == Operation::Sync && is_hanging.load(Ordering::Relaxed) {
                // Until the test lets go.
                let _ = held.lock().unwrap().recv();
            }
            Ok(())
        });
        let created = jiff::Timestamp::UNIX_EPOCH;
        let mut recording =
            Recording::create_through(&plan(&directory, format), created, gate, Pace::default()).unwrap();
        hangs.store(true, Ordering::Relaxed);
        for index in 0..EXPOSURES {
            recording.push(&exposure(index)).unwrap();
            recording.settle(0).unwrap();
        }
        let stop = StopRecord { status: StopStatus::Success, reason: "planned".to_owned() };
        let error = recording.finish_within(stop, Duration::from_millis(50)).unwrap_err();
        assert!(matches!(error, RecordingError::Hangs { .. }), "{error}");
        let rows = assert_readable(&directory);
        assert!(rows.iter().all(|row| matches!(row.state, RowState::Recorded { .. })));
        assert_eq!(rows.len() as u64, 2 * EXPOSURES);
        drop(release);
    }
}
