//! Damaged, foreign and absurd files end in a sentence within a second and 256 MiB, never in a panic.

use crate::builder::{Dcimg, Zarr, dcimg_pair, raw};
use crate::common::{FORMATS, armed, recording, whole_recording};
use allocation_counter::measure;
use sofiscope::files::{StackHeader, StackWriter};
use sofiscope::recording::Format;
use sofiscope::replay::{ReplayOptions, open};
use sofiscope_hal::{Camera, Channel, ErrorKind, FrameInfo};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const MOST_BYTES: u64 = 256 << 20;
const MOST_TIME: Duration = Duration::from_secs(1);
/// Inputs per reader; the long run has more.
const MUTATIONS: u64 = 400;
/// Frames larger than this are opened and not read.
const MOST_PIXELS: usize = 1 << 20;

/// Files to replay, and those of them that are damaged in turn.
struct Corpus {
    folder: TempDir,
    paths: Vec<PathBuf>,
    files: Vec<PathBuf>,
}

/// A small generator of its own, so that every run is the same run.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) % sides.max(1)
    }
}

fn corpus(paths: impl FnOnce(&Path) -> (Vec<PathBuf>, Vec<PathBuf>)) -> Corpus {
    let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
    let (paths, files) = paths(folder.path());
    Corpus { folder, paths, files }
}

fn recording_corpus(format: Format) -> Corpus {
    corpus(|folder| {
        let path = folder.join("run");
        recording(&path, format, 30);
        let images: &[&str] = match format {
            Format::OmeTiff => &["reflection.ome.tif"],
            Format::OmeZarr => &["reflection.ome.zarr/0/zarr.json", "transmission.ome.zarr/0/c/0/0/0"],
        };
        let texts = ["ledger.csv", "ledger.csv", "recording.json", "events.jsonl", "plan.yaml"];
        let files = texts.iter().chain(images).map(|name| path.join(name)).collect();
        (vec![path], files)
    })
}

fn stack_corpus() -> Corpus {
    corpus(|folder| {
        let paths = Channel::BOTH.map(|channel| {
            let path = folder.join(format!("{}.ome.tif", channel.letter()));
            let header = StackHeader { frames: 4, height: 8, width: 8, ..StackHeader::default() };
            let mut writer = StackWriter::create(&path, &header).unwrap();
            (0..4).for_each(|frame| writer.push(&[frame; 64]).unwrap());
            writer.finish().unwrap();
            path
        });
        (paths.to_vec(), paths[..1].to_vec())
    })
}

fn dcimg_corpus(version: u32) -> Corpus {
    corpus(|folder| {
        let paths = dcimg_pair(folder, Channel::BOTH.map(|channel| Dcimg::new(version, channel)));
        (paths.to_vec(), paths[1..].to_vec())
    })
}

fn raw_corpus() -> Corpus {
    corpus(|folder| {
        let r = raw(folder, "r", Channel::Reflected, 5, false);
        let t = raw(folder, "t", Channel::Transmitted, 5, false);
        let files = vec![r.with_extension("toml"), r.with_extension("toml"), t.clone()];
        (vec![r, t], files)
    })
}

fn zarr_corpus(zarr: &Zarr) -> Corpus {
    corpus(|folder| {
        let paths = Channel::BOTH
            .map(|channel| zarr.write(&folder.join(format!("{}.zarr", channel.letter())), channel, 6));
        let files = vec![paths[0].join("zarr.json"), paths[0].join("zarr.json"), paths[1].join("c/0/0/0")];
        (paths.to_vec(), files)
    })
}

fn corpora() -> Vec<(&'static str, Corpus)> {
    let gzip = Zarr { codecs: &["gzip", "crc32c"], chunk: [3, 9, 16], ..Zarr::default() };
    let zstd = Zarr { codecs: &["zstd"], shard: Some(4), ..Zarr::default() };
    vec![
        ("recording as TIFF", recording_corpus(Format::OmeTiff)),
        ("recording as Zarr", recording_corpus(Format::OmeZarr)),
        ("TIFF", stack_corpus()),
        ("dcimg, old", dcimg_corpus(7)),
        ("dcimg, new", dcimg_corpus(0x100_0000)),
        ("raw", raw_corpus()),
        ("Zarr, gzip", zarr_corpus(&gzip)),
        ("Zarr, zstd in shards", zarr_corpus(&zstd)),
    ]
}

/// Opens and reads some frames; what was said, if it did not work.
fn attempt(paths: &[PathBuf]) -> Result<(), String> {
    let mut replay = open(paths, ReplayOptions::default()).map_err(|error| error.to_string())?;
    for camera in &mut replay.cameras {
        let settings = camera.recorded_settings();
        let pixels = settings.region.num_pixels();
        if pixels > MOST_PIXELS {
            continue;
        }
        camera.configure(&settings).map_err(|error| error.to_string())?;
        let mut stream = camera.arm().map_err(|error| error.to_string())?;
        let mut counts = vec![0; pixels];
        for _ in 0..8 {
            match stream.next_frame(&mut counts, Duration::from_millis(1)) {
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::Ended => break,
                Err(error) => return Err(error.to_string()),
            }
        }
    }
    Ok(())
}

/// As `attempt`, within the limits and with a message that names the file.
fn bounded(corpus: &Corpus, what: &str) -> Result<(), String> {
    let mut outcome = Ok(());
    let mut took = Duration::MAX;
    let mut used = None;
    // On a busy computer anything may take a second once; what is slow by itself is slow every time.
    for _ in 0..3 {
        let begun = Instant::now();
        used = Some(measure(|| outcome = attempt(&corpus.paths)));
        took = took.min(begun.elapsed());
        if took < MOST_TIME {
            break;
        }
    }
    assert!(took < MOST_TIME, "{what}: {took:?}");
    let used = used.unwrap();
    assert!(used.bytes_max < MOST_BYTES, "{what}: {} bytes", used.bytes_max);
    if let Err(said) = &outcome {
        let names = said.contains(&corpus.folder.path().display().to_string());
        assert!(names || said.contains("replay of"), "{what}: {said}");
        assert!(said.chars().count() < 2000, "{what}: {said}");
    }
    outcome
}

/// Changes some bytes, cuts, doubles or inserts.
fn mutate(bytes: &[u8], dice: &mut Dice) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=dice.roll(3) {
        // Headers are small and at the ends.
        let span = if dice.roll(2) == 0 { bytes.len().min(1024) } else { bytes.len() } as u64;
        let at =
            if dice.roll(4) == 0 { bytes.len() as u64 - span + dice.roll(span) } else { dice.roll(span) };
        let at = (at as usize).min(bytes.len());
        match dice.roll(10) {
            0..=3 if at < bytes.len() => bytes[at] ^= 1 << dice.roll(8),
            4 | 5 if at < bytes.len() => {
                bytes[at] = [0, 1, 0x7f, 0x80, 0xff, b'9', b'-', b'"'][dice.roll(8) as usize];
            }
            6 => {
                let values = [0, u64::MAX, 1 << 63, 1 << 40, 1 << 31, 0xffff_ffff, 65_536, 1 << 20];
                let value = values[dice.roll(8) as usize].to_le_bytes();
                let end = bytes.len().min(at + 1 + dice.roll(8) as usize);
                let place = &mut bytes[at..end];
                place.copy_from_slice(&value[..place.len()]);
            }
            7 => bytes.truncate(at),
            8 => {
                let digits: &[u8] = [&b"99999999999"[..], b"-1", b"1e300", b"null", b",", b"\n", b"{}", b"0"]
                    [dice.roll(8) as usize];
                bytes.splice(at..at, digits.iter().copied());
            }
            _ => {
                let end = bytes.len().min(at + dice.roll(64) as usize);
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
        }
    }
    bytes
}

/// Damages the files of every reader whose name contains `wanted`.
fn run(mutations: u64, wanted: &str) {
    for (name, corpus) in corpora().into_iter().filter(|(name, _)| name.contains(wanted)) {
        bounded(&corpus, name).unwrap();
        let whole: Vec<Vec<u8>> = corpus.files.iter().map(|file| fs::read(file).unwrap()).collect();
        let mut refused = 0;
        let first: u64 = std::env::var("REPLAY_FIRST").map_or(0, |first| first.parse().unwrap());
        for seed in first..first + mutations {
            let mut dice = Dice(0x9e37_79b9_7f4a_7c15 ^ (seed + 1));
            let number = dice.roll(corpus.files.len() as u64) as usize;
            fs::write(&corpus.files[number], mutate(&whole[number], &mut dice)).unwrap();
            let what = format!("{name}, {}, seed {seed}", corpus.files[number].display());
            refused += u64::from(bounded(&corpus, &what).is_err());
            fs::write(&corpus.files[number], &whole[number]).unwrap();
        }
        println!("{name}: {refused} of {mutations} damaged inputs refused, none worse");
        assert!(refused > mutations / 20, "{name}: only {refused} of {mutations} were noticed");
    }
}

#[test]
fn damaged_files_end_in_a_sentence() {
    run(MUTATIONS, "");
}

#[test]
#[ignore = "minutes: 10^5 damaged inputs per reader, or as many as REPLAY_MUTATIONS says; REPLAY_READER names one, REPLAY_FIRST the first input"]
fn very_many_damaged_files_end_in_a_sentence() {
    let wanted = std::env::var("REPLAY_MUTATIONS").ok();
    let reader = std::env::var("REPLAY_READER").unwrap_or_default();
    run(wanted.map_or(100_000, |number| number.parse().expect("REPLAY_MUTATIONS is a number")), &reader);
}

/// Every frame of both cameras.
fn all_frames(paths: &[PathBuf]) -> Result<Vec<(FrameInfo, Vec<u16>)>, String> {
    let mut replay = open(paths, ReplayOptions::default()).map_err(|error| error.to_string())?;
    let mut frames = Vec::new();
    for camera in &mut replay.cameras {
        let mut stream = armed(camera);
        let mut counts = vec![0; camera.recorded_settings().region.num_pixels()];
        loop {
            match stream.next_frame(&mut counts, Duration::ZERO) {
                Ok(info) => frames.push((info, counts.clone())),
                Err(error) if error.kind() == ErrorKind::Ended => break,
                Err(error) => return Err(error.to_string()),
            }
        }
    }
    Ok(frames)
}

#[test]
fn every_truncation_is_refused_unless_every_frame_is_right() {
    for (name, corpus) in corpora() {
        let number = corpus.files.len() - 1;
        let (whole, frames) = (fs::read(&corpus.files[number]).unwrap(), all_frames(&corpus.paths).unwrap());
        let mut refused = 0;
        let lengths = (0..whole.len()).step_by(whole.len() / 60 + 1);
        for length in lengths.clone() {
            fs::write(&corpus.files[number], &whole[..length]).unwrap();
            let _ = bounded(&corpus, &format!("{name}, {length} bytes"));
            match all_frames(&corpus.paths) {
                Err(_) => refused += 1,
                Ok(found) => assert!(found == frames, "{name}: {length} of {} bytes", whole.len()),
            }
        }
        assert!(2 * refused > lengths.count(), "{name}: {refused}");
    }
}

#[test]
fn huge_sizes_are_refused_before_memory_is_asked_for() {
    let corpus = raw_corpus();
    let header = fs::read_to_string(&corpus.files[0]).unwrap();
    for (from, to) in [
        ("width = 16", "width = 1073741824"),
        ("width = 16", "width = 32768"),
        ("height = 16", "height = 9223372036854775807"),
        ("frames = 5", "frames = 4000000000"),
        ("offset_bytes = 10", "offset_bytes = 1099511627776"),
        ("period_ms = 5.0", "period_ms = nan"),
    ] {
        fs::write(&corpus.files[0], header.replace(from, to)).unwrap();
        assert!(bounded(&corpus, to).unwrap_err().contains("r.toml"));
    }
    let corpus = zarr_corpus(&Zarr::default());
    let metadata = fs::read_to_string(&corpus.files[0]).unwrap();
    for (from, to) in [
        ("[6,16,16]", "[6,1073741824,1073741824]"),
        ("[6,16,16]", "[18446744073709551615,16,16]"),
        ("[6,16,16]", "[6,32768,32768]"),
        ("[1,16,16]", "[1,1073741824,1073741824]"),
        ("[1,16,16]", "[1099511627776,1099511627776,1099511627776]"),
        ("[1,16,16]", "[0,16,16]"),
        ("[1,16,16]", "[1,16]"),
        ("\"bytes\"", "\"blosc\""),
    ] {
        let damaged = metadata.replace(from, to);
        assert_ne!(damaged, metadata);
        fs::write(&corpus.files[0], damaged).unwrap();
        assert!(bounded(&corpus, to).unwrap_err().contains("zarr.json"));
    }
    for version in [7, 0x200_0000] {
        let corpus = dcimg_corpus(version);
        let whole = fs::read(&corpus.files[0]).unwrap();
        for at in (32..160).step_by(4).chain([36, 40]) {
            for value in [u32::MAX, 1 << 30, 0] {
                let mut bytes = whole.clone();
                bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
                fs::write(&corpus.files[0], bytes).unwrap();
                let _ = bounded(&corpus, &format!("dcimg {version}, {value} at {at}"));
            }
        }
    }
}

#[test]
fn bombs_and_links_in_arrays_are_refused() {
    let gzip = Zarr { codecs: &["gzip"], ..Zarr::default() };
    let corpus = zarr_corpus(&gzip);
    let bomb = {
        use std::io::Write;
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(&vec![0; 1 << 24]).unwrap();
        encoder.finish().unwrap()
    };
    let chunk = &corpus.files[2];
    let whole = fs::read(chunk).unwrap();
    fs::write(chunk, bomb).unwrap();
    assert!(bounded(&corpus, "a bomb").unwrap_err().contains("or more where"));
    fs::remove_file(chunk).unwrap();
    assert!(bounded(&corpus, "no chunk").unwrap_err().contains("no chunk of frame 0"));
    let elsewhere = corpus.folder.path().join("elsewhere");
    fs::write(&elsewhere, whole).unwrap();
    std::os::unix::fs::symlink(&elsewhere, chunk).unwrap();
    assert!(bounded(&corpus, "a link").is_err());
    fs::remove_dir_all(corpus.paths[1].join("c")).unwrap();
    std::os::unix::fs::symlink(corpus.paths[0].join("c"), corpus.paths[1].join("c")).unwrap();
    assert!(bounded(&corpus, "a linked directory").unwrap_err().contains("link"));
}

#[test]
fn pipes_keep_nobody_waiting() {
    let corpus = recording_corpus(Format::OmeTiff);
    let ledger = corpus.paths[0].join("ledger.csv");
    fs::remove_file(&ledger).unwrap();
    rustix::fs::mknodat(
        rustix::fs::CWD,
        &ledger,
        rustix::fs::FileType::Fifo,
        rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR,
        0,
    )
    .unwrap();
    assert!(bounded(&corpus, "a pipe").unwrap_err().contains("ledger.csv"));
}

#[test]
fn nothing_is_allocated_per_frame() {
    for format in FORMATS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run");
        whole_recording(&path, format, 60);
        assert_eq!(allocations(&[path]), 0, "{format:?}");
    }
    // Stacks and arrays of Zarr decode, and that takes memory; these do not.
    for corpus in [dcimg_corpus(7), dcimg_corpus(0x200_0000), raw_corpus()] {
        assert_eq!(allocations(&corpus.paths), 0, "{:?}", corpus.paths);
    }
}

/// Allocations while all frames of a camera but the first are read, which may open something.
fn allocations(paths: &[PathBuf]) -> u64 {
    let mut replay = open(paths, ReplayOptions::default()).unwrap();
    let mut stream = armed(&mut replay.cameras[0]);
    let mut counts = vec![0; replay.cameras[0].recorded_settings().region.num_pixels()];
    let frames = replay.info.exposures;
    stream.next_frame(&mut counts, Duration::ZERO).unwrap();
    let used = measure(|| {
        for _ in 1..frames {
            stream.next_frame(&mut counts, Duration::ZERO).unwrap();
        }
    });
    used.count_total
}
