//! Recordings come again as they were: frames, numbers, times, gaps.

use crate::common::{
    FORMATS, LEN, armed, info, is_left_out, is_recorded, pixels, read, reason, recording, replay,
};
use sofiscope::acquisition::Loss;
use sofiscope::recording::{Format, Outcome, recover};
use sofiscope::replay::{Repeat, ReplayError, ReplayOptions, open};
use sofiscope_hal::{Camera, Channel, ErrorKind, FrameStatus, TriggerMode};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Duration;

const EXPOSURES: u64 = 200;

#[test]
fn exactly_the_recorded_frames_come_with_all_their_facts() {
    for format in FORMATS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run");
        recording(&path, format, EXPOSURES);
        let mut replay = replay(std::slice::from_ref(&path), ReplayOptions::default());
        let info_of = &replay.info;
        assert_eq!((info_of.height, info_of.width, info_of.exposures), (16, 16, EXPOSURES));
        assert_eq!((info_of.period, info_of.is_period_assumed), (Duration::from_millis(5), false));
        assert_eq!((info_of.pixel_size_nm, info_of.simulated), (Some(108.0), false));
        let left_out: BTreeMap<u64, Loss> = (0..EXPOSURES)
            .filter(|exposure| is_left_out(*exposure))
            .map(|exposure| (exposure, reason(exposure)))
            .collect();
        assert!(!left_out.is_empty());
        assert_eq!(info_of.left_out, left_out);
        assert_eq!(info_of.provenance, [("plan.yaml".to_owned(), "# as used\n".to_owned())]);
        assert!(info_of.description.contains("run"), "{}", info_of.description);
        for channel in Channel::BOTH {
            let camera = &mut replay.cameras[channel.index()];
            let identity = camera.identity();
            assert_eq!(identity.model, "replay of C13440-20CU");
            assert_eq!(identity.serial, ["R1", "T1"][channel.index()]);
            assert!(!identity.simulated);
            assert_eq!(camera.recorded_settings().trigger, TriggerMode::FreeRunning);
            let frames = read(armed(camera).as_mut(), LEN);
            let expected: Vec<_> = (0..EXPOSURES)
                .filter(|exposure| is_recorded(channel, *exposure))
                .map(|exposure| (info(channel, exposure), pixels(channel, exposure)))
                .collect();
            assert!(frames == expected, "{format:?}, {channel}");
        }
    }
}

#[test]
fn a_replay_may_begin_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    recording(&path, Format::OmeTiff, EXPOSURES);
    for start in [1, 40, 46, 47, 199] {
        let options = ReplayOptions { start, ..ReplayOptions::default() };
        let mut replay = replay(std::slice::from_ref(&path), options);
        assert_eq!(replay.control.start(), start);
        for channel in Channel::BOTH {
            let frames = read(armed(&mut replay.cameras[channel.index()]).as_mut(), LEN);
            let expected: Vec<u64> =
                (start..EXPOSURES).filter(|exposure| is_recorded(channel, *exposure)).collect();
            let found: Vec<u64> = frames.iter().map(|(info, _)| info.exposure.0 + start).collect();
            assert_eq!(found, expected, "{channel} from {start}");
            let right =
                frames.iter().all(|(info, counts)| *counts == pixels(channel, info.exposure.0 + start));
            assert!(right);
        }
        let left_out = replay.info.left_out_from(start);
        assert!(
            left_out
                .iter()
                .all(|(exposure, why)| { is_left_out(exposure + start) && *why == reason(exposure + start) })
        );
        assert!(matches!(replay.control.seek(3), Err(ReplayError::Refused { .. })), "a camera is armed");
        for camera in &mut replay.cameras {
            camera.stop().unwrap();
        }
        replay.control.seek(3).unwrap();
        let frames = read(armed(&mut replay.cameras[0]).as_mut(), LEN);
        assert_eq!(frames[0].1, pixels(Channel::Reflected, 3));
        assert!(replay.control.seek(EXPOSURES).is_err());
    }
    let options = ReplayOptions { start: EXPOSURES, ..ReplayOptions::default() };
    assert!(open(&[path], options).unwrap_err().to_string().contains("beyond the end"));
}

#[test]
fn a_loop_goes_on_in_exposures_and_times() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    recording(&path, Format::OmeZarr, 30);
    let options = ReplayOptions { repeat: Repeat::Forever, ..ReplayOptions::default() };
    let mut replay = replay(&[path], options);
    for channel in Channel::BOTH {
        let mut stream = armed(&mut replay.cameras[channel.index()]);
        let mut counts = vec![0; LEN];
        let mut last = None;
        for round in 0..3 {
            for exposure in (0..30).filter(|exposure| is_recorded(channel, *exposure)) {
                let found = stream.next_frame(&mut counts, Duration::ZERO).unwrap();
                assert_eq!(found.exposure.0, exposure + 30 * round);
                assert_eq!(counts, pixels(channel, exposure));
                assert!(last.is_none_or(|last| found.device_time > last));
                last = Some(found.device_time);
            }
        }
    }
}

#[test]
fn a_frame_with_a_wrong_checksum_is_incomplete_and_the_others_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    recording(&path, Format::OmeTiff, 30);
    let image = path.join("reflection.ome.tif");
    let mut bytes = fs::read(&image).unwrap();
    let target: Vec<u8> =
        pixels(Channel::Reflected, 20).iter().flat_map(|count| count.to_le_bytes()).collect();
    let at = bytes.windows(target.len()).position(|window| window == target).unwrap();
    bytes[at + 100] ^= 1;
    fs::write(&image, bytes).unwrap();
    let mut replay = replay(&[path], ReplayOptions::default());
    let frames = read(armed(&mut replay.cameras[0]).as_mut(), LEN);
    let bad: Vec<u64> = frames
        .iter()
        .filter(|(info, _)| info.status == FrameStatus::Incomplete)
        .map(|(info, _)| info.exposure.0)
        .collect();
    assert_eq!(bad, [20]);
}

#[test]
fn damaged_ledgers_and_images_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    recording(&path, Format::OmeTiff, 30);
    let said = || open(std::slice::from_ref(&path), ReplayOptions::default()).unwrap_err().to_string();
    let ledger = fs::read_to_string(path.join("ledger.csv")).unwrap();
    fs::write(path.join("ledger.csv"), ledger.replace("\n12,R", "\n4000000000,R")).unwrap();
    assert!(said().contains("ledger.csv, line 26, exposure"), "{}", said());
    fs::write(path.join("ledger.csv"), &ledger).unwrap();
    let image = fs::OpenOptions::new().write(true).open(path.join("transmission.ome.tif")).unwrap();
    image.set_len(9000).unwrap();
    assert!(said().contains("transmission.ome.tif"), "{}", said());
    fs::remove_file(path.join("ledger.csv")).unwrap();
    std::os::unix::fs::symlink("/dev/zero", path.join("ledger.csv")).unwrap();
    assert!(said().contains("ledger.csv"), "{}", said());
}

#[test]
fn a_camera_takes_what_was_recorded_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    recording(&path, Format::OmeTiff, 3);
    let mut replay = replay(&[path], ReplayOptions::default());
    let camera = &mut replay.cameras[1];
    let recorded = camera.recorded_settings();
    let mut others = [recorded; 4];
    others[0].period *= 2;
    others[1].exposure /= 2;
    others[2].trigger = TriggerMode::External;
    others[3].region.left -= 1;
    for other in others {
        let error = camera.configure(&other).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::OutOfRange);
        assert!(error.to_string().contains("camera T (replay of C13440-20CU, S/N T1)"), "{error}");
    }
}

#[test]
fn a_stream_of_before_stays_at_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    recording(&path, Format::OmeTiff, 30);
    let mut replay = replay(&[path], ReplayOptions::default());
    let camera = &mut replay.cameras[0];
    let mut before = armed(camera);
    let mut counts = vec![0; LEN];
    before.next_frame(&mut counts, Duration::ZERO).unwrap();
    camera.stop().unwrap();
    let mut now = armed(camera);
    assert_eq!(before.next_frame(&mut counts, Duration::ZERO).unwrap_err().kind(), ErrorKind::Ended);
    assert_eq!(now.next_frame(&mut counts, Duration::ZERO).unwrap().exposure.0, 0);
}

/// Makes a recording what it was before conditions were recorded.
fn make_old(path: &Path) {
    let ledger = fs::read_to_string(path.join("ledger.csv")).unwrap();
    let first = |line: &str| line.split(',').take(12).collect::<Vec<_>>().join(",") + "\n";
    fs::write(path.join("ledger.csv"), ledger.lines().map(first).collect::<String>()).unwrap();
    let text = fs::read_to_string(path.join("recording.json")).unwrap();
    let mut metadata: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(metadata.as_object_mut().unwrap().remove("conditions").is_some());
    fs::write(path.join("recording.json"), metadata.to_string()).unwrap();
    for image in ["reflection.ome.tif", "transmission.ome.tif"].map(|name| path.join(name)) {
        let Ok(mut bytes) = fs::read(&image) else { continue };
        // Tag 65100 of type 7 with 47 bytes.
        let field = [0x4c, 0xfe, 7, 0, 47, 0, 0, 0, 0, 0, 0, 0];
        let mut changed = 0;
        for at in 0..bytes.len() - field.len() {
            if bytes[at..].starts_with(&field) {
                bytes[at + 4] = 44;
                changed += 1;
            }
        }
        assert!(changed > 100, "{changed} pages");
        fs::write(&image, bytes).unwrap();
    }
}

#[test]
fn recordings_of_before_are_played_and_recovered() {
    for format in FORMATS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run");
        recording(&path, format, EXPOSURES);
        make_old(&path);
        let old = fs::read_to_string(path.join("ledger.csv")).unwrap();
        let mut replay = replay(std::slice::from_ref(&path), ReplayOptions::default());
        assert_eq!(replay.info.exposures, EXPOSURES);
        for channel in Channel::BOTH {
            let frames = read(armed(&mut replay.cameras[channel.index()]).as_mut(), LEN);
            let expected = (0..EXPOSURES).filter(|exposure| is_recorded(channel, *exposure)).count();
            assert_eq!(frames.len(), expected, "{channel}");
            assert!(frames.iter().all(|(info, counts)| *counts == pixels(channel, info.exposure.0)));
        }
        assert_eq!(recover(&path).unwrap().outcome, Outcome::Sound);
        assert_eq!(fs::read_to_string(path.join("ledger.csv")).unwrap(), old, "nothing was to be done");
        fs::write(path.join("ledger.csv"), &old[..old.len() / 2]).unwrap();
        assert_eq!(recover(&path).unwrap().outcome, Outcome::Repaired);
        let new = fs::read_to_string(path.join("ledger.csv")).unwrap();
        let rows = |text: &str, more: &str| {
            let rows = text.lines().filter(|line| line.contains("recorded"));
            rows.map(|line| line.to_owned() + more).collect::<Vec<_>>()
        };
        assert_eq!(rows(&new, ""), rows(&old, ",,,,"));
    }
}
