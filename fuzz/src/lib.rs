//! Files made of fuzzed bytes, opened and read as a replay does.
//!
//! In: bytes. Out: nothing. Never: keeps a file. Fails: panics where a reader does.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use sofiscope::replay::{ReplayOptions, open};
use sofiscope_hal::Camera;

/// Frames larger than this are opened and not read.
const MOST_PIXELS: usize = 1 << 20;

/// Opens a replay and reads some frames of both cameras.
pub fn replay(paths: &[PathBuf]) {
    let Ok(mut replay) = open(paths, ReplayOptions::default()) else { return };
    for camera in &mut replay.cameras {
        let settings = camera.recorded_settings();
        let pixels = settings.region.num_pixels();
        if pixels > MOST_PIXELS || camera.configure(&settings).is_err() {
            continue;
        }
        let Ok(mut stream) = camera.arm() else { continue };
        let mut counts = vec![0; pixels];
        for _ in 0..8 {
            if stream.next_frame(&mut counts, Duration::ZERO).is_err() {
                break;
            }
        }
    }
}

/// A folder in memory that is gone after `with`.
pub fn in_folder(with: impl FnOnce(&Path)) {
    let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir());
    with(folder.expect("a folder for the input").path());
}

/// Writes files of these names, one piece of the input each; pieces are parted by `|||`.
pub fn write_pieces(folder: &Path, names: &[&str], data: &[u8]) {
    let mut rest = data;
    for (number, name) in names.iter().enumerate() {
        let end = rest.windows(3).position(|window| window == b"|||").filter(|_| number + 1 < names.len());
        let (piece, later) = match end {
            Some(end) => (&rest[..end], &rest[end + 3..]),
            None => (rest, &[][..]),
        };
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap_or(folder)).expect("a folder for the input");
        fs::write(path, piece).expect("room for the input");
        rest = later;
    }
}
