//! Checks of frames: numbers, times, sizes, ends.

use std::time::Duration;

use super::{CameraRig, MOST_TIMEOUTS, Run, SEVERAL, halt, must, refused, states};
use crate::{CameraSettings, Epoch, ErrorKind, ExposureIndex, FrameInfo, FrameStatus};

pub(super) fn exposures_count_from_arming(rig: &mut impl CameraRig) {
    for run in 0..3 {
        let mut armed = Run::begin(rig);
        let mut frames = armed.several();
        let first = frames[0].exposure;
        assert_eq!(first, ExposureIndex(0), "the first exposure after arming for the {run}th time is 0");
        let period = armed.settings.period;
        frames.extend(armed.end(rig));
        assert_even(&frames, period);
    }
}

/// Asserts that exposures rise, and device times with them by the period.
pub(super) fn assert_even(frames: &[FrameInfo], period: Duration) {
    for pair in frames.windows(2) {
        let (earlier, later) = (pair[0], pair[1]);
        assert!(later.exposure > earlier.exposure, "exposures rise: {earlier:?}, then {later:?}");
        assert_eq!(later.epoch, Epoch(0), "a healthy counter does not restart: {later:?}");
        assert_ne!(later.block_id, earlier.block_id, "ids differ: {earlier:?}, then {later:?}");
        let periods = (later.exposure.0 - earlier.exposure.0) as f64;
        let expected_ns = periods * period.as_nanos() as f64;
        let found_ns = later.device_time.nanoseconds_since(earlier.device_time) as f64;
        assert!(
            (found_ns - expected_ns).abs() <= 0.5 * period.as_nanos() as f64 + 1e-3 * expected_ns,
            "device time rises by {expected_ns} ns in {periods} exposures, but it rose by {found_ns} ns",
        );
    }
}

pub(super) fn every_pixel_is_written(rig: &mut impl CameraRig) {
    let mut run = Run::begin(rig);
    let mut counts = run.memory();
    let mut touched = vec![false; counts.len()];
    for sentinel in [0xA5A5, 0x5A5A, 0xFFFF, 0x0001] {
        counts.fill(sentinel);
        run.next(&mut counts);
        for (touched, &count) in touched.iter_mut().zip(&counts) {
            *touched |= count != sentinel;
        }
    }
    let missing = touched.iter().filter(|&&touched| !touched).count();
    assert_eq!(missing, 0, "a complete frame writes every pixel, but {missing} were never written");
    run.end(rig);
}

pub(super) fn a_smaller_region_gives_smaller_frames(rig: &mut impl CameraRig) {
    let full = rig.settings();
    let step = rig.camera().capabilities().region_step;
    let want = CameraSettings { region: states::smaller(full.region, step), ..full };
    let done = must(rig.camera().configure(&want), "configuring a smaller region");
    states::assert_within(rig.camera().capabilities(), &done);
    let mut run = Run::begin_with(rig, &want);
    assert_eq!(run.settings, done, "equal wishes give equal settings");
    run.several();
    if done.region.num_pixels() != full.region.num_pixels() {
        let mut before = vec![0; full.region.num_pixels()];
        let next = run.stream.next_frame(&mut before, run.patience);
        refused(next, ErrorKind::OutOfRange, "memory of the size before");
    }
    run.end(rig);
}

pub(super) fn memory_of_the_wrong_size_is_refused(rig: &mut impl CameraRig) {
    let mut run = Run::begin(rig);
    let mut frames = run.several();
    let right = run.settings.region.num_pixels();
    for wrong in [0, right - 1, right + 1, 2 * right] {
        let mut counts = vec![0; wrong];
        let next = run.stream.next_frame(&mut counts, run.patience);
        refused(next, ErrorKind::OutOfRange, &format!("memory for {wrong} pixels where {right} are needed"));
    }
    let next = run.several();
    let last = frames.last().map(|info| info.exposure.0 + 1);
    assert_eq!(last, Some(next[0].exposure.0), "refusing memory loses no frame");
    frames.extend(next);
    assert_even(&frames, run.settings.period);
    run.end(rig);
}

/// Frames that are asked for with no time at all come nevertheless, each once, however often it is asked.
pub(super) fn timeouts_lose_nothing(rig: &mut impl CameraRig) {
    let want = rig.settings();
    let settings = must(rig.camera().configure(&want), "configuring");
    let mut run = Run::arm(rig, settings);
    let mut counts = run.memory();
    if rig.trigger().is_some() {
        for timeout in [Duration::ZERO, settings.period] {
            let next = run.stream.next_frame(&mut counts, timeout);
            refused(next, ErrorKind::Timeout, "a frame before the first pulse");
        }
    }
    Run::expose(rig, settings);
    let mut frames = Vec::new();
    while frames.len() < SEVERAL {
        let mut timeouts = 0;
        // Impatient first; the last answer must be a frame.
        frames.push(loop {
            let patience = if timeouts % 4 == 3 { run.patience } else { Duration::ZERO };
            match run.stream.next_frame(&mut counts, patience) {
                Ok(info) => break info,
                Err(error) => {
                    assert_eq!(error.kind(), ErrorKind::Timeout, "no frame yet is a timeout, but: {error}");
                    timeouts += 1;
                    assert!(timeouts < MOST_TIMEOUTS, "frames come after timeouts, but none did");
                }
            }
        });
    }
    let exposures: Vec<u64> = frames.iter().map(|info| info.exposure.0).collect();
    let expected: Vec<u64> = (0..SEVERAL as u64).collect();
    assert_eq!(exposures, expected, "timeouts lose no frame");
    run.end(rig);
}

pub(super) fn stopped_streams_end(rig: &mut impl CameraRig) {
    // Stopped on the way.
    let mut run = Run::begin(rig);
    let last = run.several().pop().map_or(0, |info| info.exposure.0);
    let finished = run.end(rig);
    let rising = finished.iter().all(|info| info.exposure.0 > last && info.status == FrameStatus::Complete);
    assert!(rising, "finished frames come after those before the stop, but after {last} came {finished:?}");
    // Stopped before anything was read, and twice.
    let run = Run::begin(rig);
    halt(rig);
    halt(rig);
    run.end(rig);
    // Stopped before anything was exposed.
    let settings = rig.settings();
    let run = Run::arm(rig, settings);
    run.end(rig);
}

pub(super) fn streams_move_to_other_threads(rig: &mut impl CameraRig) {
    let mut run = Run::begin(rig);
    let handle = std::thread::Builder::new().name("grab".into()).spawn(move || {
        let frames = run.several();
        (run, frames)
    });
    let joined = handle.expect("this computer can start a thread").join();
    let (run, frames) = match joined {
        Ok(done) => done,
        Err(panic) => std::panic::resume_unwind(panic),
    };
    assert_eq!(frames[0].exposure, ExposureIndex(0), "a stream on another thread begins with exposure 0");
    run.end(rig);
}

pub(super) fn streams_may_be_dropped_while_armed(rig: &mut impl CameraRig) {
    let mut run = Run::begin(rig);
    run.several();
    drop(run);
    refused(rig.camera().arm(), ErrorKind::Busy, "arming a camera that is armed without a stream");
    halt(rig);
    let mut run = Run::begin(rig);
    let frames = run.several();
    assert_eq!(frames[0].exposure, ExposureIndex(0), "armed again, exposures begin with 0");
    run.end(rig);
}
