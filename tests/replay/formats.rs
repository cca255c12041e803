//! Files of other programs: dcimg of both layouts, Zarr with every codec that is read, bare pixels.

use crate::builder::{Dcimg, Zarr, dcimg_pair, raw};
use crate::common::{FORMATS, LEN, armed, pixels, read, replay, whole_recording};
use sofiscope::replay::{ReplayOptions, open};
use sofiscope_hal::{Channel, FrameInfo};
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

const FRAMES: usize = 12;

/// Replays a pair and checks the pixels of frame `k`; gives what the cameras say.
fn assert_pixels(paths: &[PathBuf]) -> [Vec<FrameInfo>; 2] {
    let mut replay = replay(paths, ReplayOptions::default());
    Channel::BOTH.map(|channel| {
        let frames = read(armed(&mut replay.cameras[channel.index()]).as_mut(), LEN);
        assert_eq!(frames.len(), FRAMES);
        for (frame, (_, counts)) in (0..).zip(&frames) {
            assert!(
                *counts == pixels(channel, frame),
                "{channel}, frame {frame}: {}",
                replay.info.description
            );
        }
        frames.into_iter().map(|(info, _)| info).collect()
    })
}

#[test]
fn dcimg_of_every_layout_gives_pixels_numbers_and_times() {
    let folder = tempfile::tempdir().unwrap();
    for version in [7, 0x100_0000, 0x105_0000, 0x200_0000] {
        for (padding, footer_bytes, top) in [(0, 32, 1020), (6, 512, 1008), (0, 16, 0), (0, 32, 0)] {
            let mut files = Channel::BOTH.map(|channel| Dcimg::new(version, channel));
            for file in &mut files {
                (file.padding, file.top) = (padding, top);
                file.footer_bytes = footer_bytes;
                if footer_bytes == 16 && version != 7 {
                    // No pixels lie elsewhere, so none may be marked.
                    (file.version, file.top) = (0x100_0000, 1200);
                }
            }
            let paths = dcimg_pair(folder.path(), files);
            let seen = assert_pixels(&paths);
            for (exposure, info) in (0..).zip(&seen[0]) {
                assert_eq!((info.exposure.0, info.block_id.0), (exposure, exposure));
                assert_eq!(info.device_time.0, (1_700_000_000_000_000 + exposure * 5000) * 1000);
            }
            let info = replay(&paths, ReplayOptions::default()).info;
            assert_eq!((info.period, info.exposures), (Duration::from_millis(5), FRAMES as u64));
        }
    }
}

#[test]
fn frames_that_dcimg_has_not_are_gaps_also_at_the_begin() {
    let folder = tempfile::tempdir().unwrap();
    for version in [7, 0x200_0000] {
        let mut files = Channel::BOTH.map(|channel| Dcimg::new(version, channel));
        let numbers: [Vec<u32>; 2] =
            [(100..112).collect(), (103..116).filter(|number| *number != 107).collect()];
        for (file, numbers) in files.iter_mut().zip(&numbers) {
            let time = |number: u32| 1_700_000_000_000_000 + u64::from(number) * 5000;
            file.stamps = numbers.iter().map(|number| (*number, time(*number))).collect();
        }
        let paths = dcimg_pair(folder.path(), files.clone());
        let seen = assert_pixels(&paths);
        for (seen, numbers) in seen.iter().zip(&numbers) {
            let exposures: Vec<u64> = numbers.iter().map(|number| u64::from(number - 100)).collect();
            assert_eq!(seen.iter().map(|info| info.exposure.0).collect::<Vec<_>>(), exposures);
        }
        assert_eq!(replay(&paths, ReplayOptions::default()).info.exposures, 16);
        let counted = raw(folder.path(), "r", Channel::Reflected, FRAMES as u64, false);
        let said = open(&[counted, paths[1].clone()], ReplayOptions::default()).unwrap_err().to_string();
        assert!(said.contains("lost 1 frames"), "{said}");
        // Numbers that do not rise, and two cameras that did not start together.
        files[1].stamps[5].0 = files[1].stamps[4].0;
        let paths = dcimg_pair(folder.path(), files.clone());
        let mut replay = replay(&paths, ReplayOptions::default());
        let mut stream = armed(&mut replay.cameras[1]);
        let mut counts = vec![0; LEN];
        let errors: Vec<String> = (0..12)
            .filter_map(|_| stream.next_frame(&mut counts, Duration::ZERO).err())
            .map(|error| error.to_string())
            .collect();
        let named = errors.iter().all(|error| error.contains("T.dcimg, frame 5, number"));
        assert!(named && errors.len() == 7, "{errors:?}");
        files[1].stamps.iter_mut().for_each(|stamp| stamp.0 += 5000);
        let paths = dcimg_pair(folder.path(), files);
        let said = open(&paths, ReplayOptions::default()).unwrap_err().to_string();
        assert!(said.contains("start together"), "{said}");
    }
}

#[test]
fn zarr_is_read_whatever_its_chunks_and_codecs() {
    let kinds = [
        Zarr::default(),
        Zarr { separator: ".", is_big_endian: true, ..Zarr::default() },
        Zarr { codecs: &["gzip"], chunk: [5, 16, 16], ..Zarr::default() },
        Zarr { codecs: &["zstd"], chunk: [3, 7, 10], ..Zarr::default() },
        Zarr { codecs: &["crc32c", "zstd", "crc32c"], ..Zarr::default() },
        Zarr { shard: Some(8), ..Zarr::default() },
        Zarr { shard: Some(4), chunk: [2, 16, 8], codecs: &["gzip", "crc32c"], ..Zarr::default() },
        Zarr { shard: Some(4), codecs: &["zstd"], index_location: "start", ..Zarr::default() },
    ];
    for (number, zarr) in kinds.into_iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let paths = Channel::BOTH.map(|channel| {
            zarr.write(&folder.path().join(format!("{}.zarr", channel.letter())), channel, FRAMES)
        });
        let seen = assert_pixels(&paths);
        assert!((0..).zip(&seen[1]).all(|(exposure, info)| info.exposure.0 == exposure), "{number}");
    }
}

#[test]
fn zarr_and_tiff_of_our_own_recordings_are_read_alone() {
    for (format, ending) in FORMATS.into_iter().zip(["tif", "zarr"]) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run");
        whole_recording(&path, format, FRAMES as u64);
        let paths = ["reflection", "transmission"].map(|name| path.join(format!("{name}.ome.{ending}")));
        assert_pixels(&paths);
        let info = replay(&paths, ReplayOptions::default()).info;
        assert_eq!(info.period, Duration::from_millis(5));
        assert!((info.pixel_size_nm.unwrap() - 108.0).abs() < 1e-9);
    }
}

#[test]
fn one_array_may_have_both_channels() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("both.zarr");
    let zarr = Zarr::default();
    let mut metadata = zarr.metadata(FRAMES);
    metadata["shape"] = serde_json::json!([FRAMES, 2, 1, 16, 16]);
    metadata["chunk_grid"]["configuration"]["chunk_shape"] = serde_json::json!([1, 2, 1, 16, 16]);
    metadata["dimension_names"] = serde_json::Value::Null;
    fs::create_dir_all(&root).unwrap();
    fs::write(root.join("zarr.json"), metadata.to_string()).unwrap();
    for frame in 0..FRAMES as u64 {
        let path = root.join(format!("c/{frame}/0/0/0/0"));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let counts = Channel::BOTH.map(|channel| pixels(channel, frame)).concat();
        fs::write(path, counts.iter().flat_map(|count| count.to_le_bytes()).collect::<Vec<u8>>()).unwrap();
    }
    assert_pixels(&[root]);
}

#[test]
fn bare_pixels_are_read_by_their_header() {
    let folder = tempfile::tempdir().unwrap();
    for is_big_endian in [false, true] {
        let r = raw(folder.path(), "r", Channel::Reflected, FRAMES as u64, is_big_endian);
        let t = raw(folder.path(), "t", Channel::Transmitted, FRAMES as u64, is_big_endian);
        let seen = assert_pixels(&[r.with_extension("toml"), t.clone()]);
        assert_eq!(seen[0][11].device_time.0, 55_000_000);
        let text = fs::read_to_string(t.with_extension("toml")).unwrap();
        fs::write(t.with_extension("toml"), text.replace("frames = 12", "frames = 13")).unwrap();
        let said = open(&[r, t], ReplayOptions::default()).unwrap_err().to_string();
        assert!(said.contains("t.toml, frames: 13 where"), "{said}");
    }
}
