//! TIFF stacks: pairs, two channels in one file, and those that cannot be replayed.

use crate::common::{LEN, PERIOD, SIDE, armed, pixels, read, replay};
use sofiscope::files::{StackHeader, StackWriter};
use sofiscope::replay::{ReplayOptions, open};
use sofiscope_hal::{Camera, Channel};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::{Gray16, Gray32Float};

fn stack(path: &Path, channel: Channel, frames: usize, side: usize, interval: Option<Duration>) -> PathBuf {
    let header = StackHeader {
        frames,
        height: side,
        width: LEN / side,
        channel: channel.to_string(),
        pixel_size_nm: Some(65.0),
        frame_interval: interval,
        ..StackHeader::default()
    };
    let mut writer = StackWriter::create(path, &header).unwrap();
    for frame in 0..frames as u64 {
        writer.push(&pixels(channel, frame)).unwrap();
    }
    writer.finish().unwrap();
    path.to_path_buf()
}

/// A hyperstack of ImageJ with channels side by side.
fn hyperstack(path: &Path, channels: u64, frames: u64) -> PathBuf {
    let mut encoder = TiffEncoder::new(std::fs::File::create(path).unwrap()).unwrap();
    for page in 0..channels * frames {
        let mut image = encoder.new_image::<Gray16>(SIDE, SIDE).unwrap();
        if page == 0 {
            let text = format!(
                "ImageJ=1.53t\nimages={}\nchannels={channels}\nframes={frames}\nhyperstack=true\n",
                channels * frames
            );
            image.encoder().write_tag(tiff::tags::Tag::ImageDescription, text.as_str()).unwrap();
        }
        let channel = Channel::BOTH[(page % channels) as usize % 2];
        image.write_data(&pixels(channel, page / channels)).unwrap();
    }
    path.to_path_buf()
}

fn assert_even(paths: &[PathBuf], period: Duration, frames: u64) {
    let mut replay = replay(paths, ReplayOptions::default());
    assert_eq!((replay.info.period, replay.info.exposures), (period, frames));
    assert!(replay.info.left_out.is_empty() && replay.info.provenance.is_empty());
    for channel in Channel::BOTH {
        let camera = &mut replay.cameras[channel.index()];
        assert!(camera.identity().model.starts_with("replay of "));
        let found = read(armed(camera).as_mut(), LEN);
        assert_eq!(found.len() as u64, frames);
        for (exposure, (info, counts)) in (0..).zip(found) {
            assert_eq!((info.exposure.0, info.block_id.0), (exposure, exposure));
            assert_eq!(info.device_time.0, exposure * period.as_nanos() as u64);
            assert_eq!(counts, pixels(channel, exposure));
        }
    }
}

#[test]
fn two_stacks_are_replayed_page_by_page() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name| folder.path().join(name);
    let r = stack(&path("r.ome.tif"), Channel::Reflected, 12, 16, Some(PERIOD));
    let t = stack(&path("t.ome.tif"), Channel::Transmitted, 12, 16, Some(PERIOD));
    assert_even(&[r.clone(), t.clone()], PERIOD, 12);
    let options = ReplayOptions { period: Some(Duration::from_millis(2)), ..ReplayOptions::default() };
    let replay = replay(&[r, t], options);
    assert_eq!(replay.info.period, Duration::from_millis(2));
    assert_eq!(replay.info.pixel_size_nm, Some(65.0));
}

#[test]
fn a_period_that_one_file_says_holds_for_both() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name| folder.path().join(name);
    let r = stack(&path("r.tif"), Channel::Reflected, 3, 16, None);
    let t = stack(&path("t.tif"), Channel::Transmitted, 3, 16, Some(PERIOD));
    assert_even(&[r.clone(), t.clone()], PERIOD, 3);
    let other = stack(&path("other.tif"), Channel::Reflected, 3, 16, Some(2 * PERIOD));
    let said = open(&[other, t], ReplayOptions::default()).unwrap_err().to_string();
    assert!(said.contains("differ in period"), "{said}");
    let unknown = replay(&[r.clone(), r], ReplayOptions::default()).info;
    assert!(unknown.is_period_assumed);
}

#[test]
fn two_channels_of_one_file_are_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let path = hyperstack(&folder.path().join("both.tif"), 2, 9);
    assert_even(&[path], Duration::from_millis(10), 9);
}

#[test]
fn what_cannot_be_replayed_is_refused_with_the_next_step() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name| folder.path().join(name);
    let said = |paths: &[PathBuf]| open(paths, ReplayOptions::default()).unwrap_err().to_string();
    let r = stack(&path("r.tif"), Channel::Reflected, 5, 16, None);
    let short = stack(&path("short.tif"), Channel::Transmitted, 4, 16, None);
    let wide = stack(&path("wide.tif"), Channel::Transmitted, 5, 8, None);
    let both = hyperstack(&path("both.tif"), 2, 5);
    let three = hyperstack(&path("three.tif"), 3, 5);
    assert!(said(std::slice::from_ref(&r)).contains("analyze"));
    assert!(said(&[r.clone(), short]).contains("counting"));
    assert!(said(&[r.clone(), wide]).contains("differ in size"));
    assert!(said(&[r.clone(), both]).contains("2 channels"));
    assert!(said(&[three]).contains("channels"));
    let mut encoder = TiffEncoder::new(std::fs::File::create(path("float.tif")).unwrap()).unwrap();
    encoder.write_image::<Gray32Float>(SIDE, SIDE, &vec![1.5; LEN]).unwrap();
    let float = said(&[r.clone(), path("float.tif")]);
    assert!(float.contains("16-bit counts") && float.contains("analyze"), "{float}");
    assert!(said(&[]).contains("0 paths"));
    assert!(said(&[folder.path().to_path_buf()]).contains("recording.json"));
    assert!(said(&[path("none.tif")]).contains("does not exist"));
    assert!(said(&[PathBuf::from("/dev/zero")]).contains("device or pipe"));
    std::fs::write(path("text.tif"), "hello").unwrap();
    assert!(said(&[r.clone(), path("text.tif")]).contains("text.tif"));
}
