//! Recordings in the programs that others use: tifffile and Pillow, zarr-python and tensorstore, where they are installed.

use crate::common::{FORMATS, exposure, plan, stop};
use sofiscope::recording::{Recording, open};
use std::path::PathBuf;
use std::process::Command;

/// Names a python that has them; `python3` otherwise.
const PYTHON: &str = "SOFISCOPE_TEST_PYTHON";

/// Prints two lines per image, one per reader: path, reader, number of frames, wrong frames.
/// Readers that are not there print `skipped`.
const SCRIPT: &str = r#"
import sys, numpy as np
tables = {}
def table(n):
    # state after i steps is factor[i] * seed + term[i], modulo 2 ** 64
    if n not in tables:
        factor, term, m = [1], [0], (1 << 64) - 1
        for _ in range(n):
            factor.append(factor[-1] * 6364136223846793005 & m)
            term.append((term[-1] * 6364136223846793005 + 1442695040888963407) & m)
        tables[n] = np.array(factor[1:], np.uint64), np.array(term[1:], np.uint64)
    return tables[n]
def pixels(channel, exposure, n):
    factor, term = table(n)
    seed = np.uint64((exposure * 2 + channel + 1) * 0x9e3779b97f4a7c15 & (1 << 64) - 1)
    out = ((factor * seed + term) >> np.uint64(48)).astype(np.uint16)
    out[0], out[1], out[2] = channel + 1, exposure & 0xffff, exposure >> 16
    return out
def check(path, reader, frames, channel):
    wrong, last = 0, -1
    for frame in frames:
        flat = np.asarray(frame).reshape(-1)
        exposure = int(flat[1]) | int(flat[2]) << 16
        if flat[0] != channel + 1 or exposure <= last or not (flat == pixels(channel, exposure, flat.size)).all():
            wrong += 1
        last = exposure
    print(path, reader, len(frames), wrong)
def with_tifffile(path):
    import tifffile
    with tifffile.TiffFile(path) as tif:
        if tif.is_ome:
            assert len(tif.series) == 1 and tif.series[0].size == sum(page.size for page in tif.pages), path
        return [page.asarray() for page in tif.pages]
def with_pillow(path):
    from PIL import Image
    with Image.open(path) as image:
        frames = []
        for page in range(image.n_frames):
            image.seek(page)
            frames.append(np.array(image, np.uint16))
        return frames
def with_zarr(path):
    import zarr
    return zarr.open_group(path, mode='r')['0'][:]
def with_tensorstore(path):
    import tensorstore
    spec = {'driver': 'zarr3', 'kvstore': {'driver': 'file', 'path': path + '/0'}}
    return tensorstore.open(spec, read=True).result().read().result()
for path in sys.argv[1:]:
    channel = 1 if 'transmission' in path else 0
    for reader in [with_tifffile, with_pillow] if path.endswith('.tif') else [with_zarr, with_tensorstore]:
        name = reader.__name__.removeprefix('with_')
        try:
            frames = reader(path)
        except ImportError:
            print('skipped', path, name)
            continue
        check(path, name, frames, channel)
"#;

/// Opens recordings with stock readers; frames and pixels must be those of the recording.
pub(crate) fn assert_open(directories: &[PathBuf], height: u32, width: u32) {
    let mut images = Vec::new();
    for directory in directories {
        let run = open(directory).unwrap();
        for channel in sofiscope_hal::Channel::BOTH {
            if run.frames(channel) > 0 {
                images.push((directory.join(run.metadata().image_name(channel)), run.frames(channel)));
            }
        }
    }
    let python = std::env::var(PYTHON).unwrap_or_else(|_| "python3".to_owned());
    let paths = images.iter().map(|(path, _)| path);
    let Ok(output) = Command::new(&python).arg("-c").arg(SCRIPT).args(paths).output() else {
        println!("skipped: no {python}");
        return;
    };
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    let lines: Vec<&str> = said.lines().collect();
    assert_eq!(lines.len(), 2 * images.len(), "{said}");
    let mut skipped = 0;
    for ((path, frames), lines) in images.iter().zip(lines.chunks_exact(2)) {
        let is_tiff = path.extension().is_some_and(|ending| ending == "tif");
        let readers = if is_tiff { ["tifffile", "pillow"] } else { ["zarr", "tensorstore"] };
        for (line, reader) in lines.iter().zip(readers) {
            if line.starts_with("skipped") {
                skipped += 1;
                continue;
            }
            assert_eq!(*line, format!("{} {reader} {frames} 0", path.display()), "{height} x {width}");
        }
    }
    if skipped > 0 {
        println!("skipped: {skipped} of {} readings, {python} has no such reader", 2 * images.len());
    }
}

#[test]
fn finished_recordings_open_in_stock_readers() {
    let folder = tempfile::tempdir().unwrap();
    let mut directories = Vec::new();
    for format in FORMATS {
        let directory = folder.path().join(format!("{format:?}"));
        let mut recording = Recording::create(&plan(&directory, format, 40, 57)).unwrap();
        for index in 0..150 {
            recording.push(&exposure(index, 40 * 57)).unwrap();
            if index % 21 == 20 {
                recording.commit().unwrap();
            }
        }
        recording.finish(stop()).unwrap();
        directories.push(directory);
    }
    assert_open(&directories, 40, 57);
}
