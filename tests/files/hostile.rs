//! Damaged, foreign and absurd files end in a sentence within a second, never in a panic.

use std::path::Path;
use std::time::{Duration, Instant};

use proptest::prelude::*;
use sofiscope::files::{ErrorKind, FileError, ImageStack};

use crate::builder::{Chunks, Sample, Tiff};
use crate::common::{file_of, read_all};

/// What is said about a file that must be refused; checks the manner of saying it.
fn refusal(bytes: &[u8]) -> String {
    let (_folder, path) = file_of(bytes);
    let start = Instant::now();
    let error = read_all(&path).expect_err("the file must be refused");
    assert!(start.elapsed() < Duration::from_secs(1));
    assert_eq!(error.kind(), ErrorKind::Data);
    assert_eq!(error.kind().exit_code(), 4);
    let said = error.to_string();
    assert!(said.contains("stack.tif") && said.ends_with('.'), "{said}");
    assert!(said.matches(". ").count() <= 2, "{said}");
    said
}

fn plain() -> Tiff {
    Tiff::new(Sample::U16, 3, 8, 6)
}

#[test]
fn wrong_beginnings_are_named() {
    assert!(refusal(b"").contains("empty"));
    assert!(refusal(b"I").contains("not a TIFF"));
    assert!(refusal(b"\x89PNG\r\n\x1a\n........").contains("PNG"));
    assert!(refusal(b"II*\0\x08\0").contains("header"));
    assert!(refusal(b"II\x07\0\x08\0\0\0").contains("version number is 7"));
    assert!(refusal(b"II*\0\0\0\0\0").contains("no page"));
    assert!(refusal(b"II*\0\xff\xff\xff\x7f").contains("page 1, page directory"));
    assert!(refusal(b"II\x2b\0\x04\0\0\0\x10\0\0\0\0\0\0\0").contains("BigTIFF"));
}

#[test]
fn what_is_no_file_is_a_usage_error() {
    let folder = tempfile::tempdir().unwrap();
    let open = |path: &Path| {
        let error = ImageStack::open(path).unwrap_err();
        assert_eq!(error.kind().exit_code(), 2);
        error.to_string()
    };
    assert!(open(folder.path()).contains("is a directory"));
    assert!(open(&folder.path().join("none.tif")).contains("does not exist"));
    assert!(open(&folder.path().join("none.tif/x")).contains("does not exist"));
    assert!(open(Path::new("/dev/zero")).contains("device or pipe"));
    let (_folder, path) = file_of(&plain().build());
    std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o000)).unwrap();
    if std::fs::File::open(&path).is_err() {
        assert!(open(&path).contains("No permission"));
    }
}

#[test]
fn every_truncation_is_an_error() {
    for tiff in [plain(), Tiff { is_big: true, compression: 8, ..plain() }] {
        let whole = tiff.build();
        for length in 0..whole.len() {
            refusal(&whole[..length]);
        }
    }
}

#[test]
fn pages_in_a_circle_are_noticed() {
    let mut bytes = plain().build();
    let first = bytes[4..8].to_vec();
    let end = bytes.len();
    bytes[end - 4..].copy_from_slice(&first);
    assert!(refusal(&bytes).contains("circle"));
}

#[test]
fn unsupported_kinds_are_refused_by_name() {
    let cases = [
        (plain().set(262, 3, 0), "MinIsWhite"),
        (plain().set(262, 3, 2).set(277, 3, 3), "RGB"),
        (plain().set(262, 3, 3), "palette"),
        (plain().set(277, 3, 2), "2 samples per pixel"),
        (plain().set(258, 3, 12), "12-bit unsigned integer"),
        (plain().set(258, 3, 64).set(339, 3, 3), "64-bit floating-point"),
        (plain().set(339, 3, 2), "signed integer"),
        (plain().set(259, 3, 7), "JPEG"),
        (plain().set(259, 3, 32773), "PackBits"),
        (plain().set(317, 3, 2), "predictor 2"),
        (plain().set(266, 3, 2), "FillOrder"),
    ];
    for (tiff, word) in cases {
        let said = refusal(&tiff.build());
        assert!(said.contains(word) && said.contains("page 1"), "{said}");
    }
}

#[test]
fn absurd_sizes_ask_for_no_memory() {
    let huge = u64::from(u32::MAX);
    let cases = [
        plain().set(256, 4, huge),
        plain().set(256, 4, huge).set(257, 4, huge),
        plain().set(256, 4, 10_000).set(257, 4, 10_000),
        Tiff { compression: 8, ..plain() }.set(256, 4, 11_000).set(257, 4, 11_000),
        plain().set(256, 4, 0),
        plain().set(278, 4, 0),
        plain().set(273, 4, huge),
        Tiff { chunks: Chunks::Tiles(16, 16), ..plain() }.set(322, 4, huge),
        Tiff { chunks: Chunks::Tiles(16, 16), ..plain() }.set(323, 4, 0),
        plain().set(257, 4, 1 << 20).set(278, 4, 1),
        Tiff { compression: 5, ..plain() }.set(279, 4, 0),
    ];
    for tiff in cases {
        refusal(&tiff.build());
    }
    let mut many_fields = plain().build();
    let directory = u32::from_le_bytes(many_fields[4..8].try_into().unwrap()) as usize;
    many_fields[directory..directory + 2].copy_from_slice(&[0xff, 0xff]);
    assert!(refusal(&many_fields).contains("65535 fields"));
}

#[test]
fn missing_fields_are_named() {
    for (tag, name) in [(256, "ImageWidth"), (257, "ImageLength"), (273, "StripOffsets")] {
        let tiff = Tiff { without: vec![tag], ..plain() };
        assert!(refusal(&tiff.build()).contains(name));
    }
    let strips = Tiff { chunks: Chunks::Strips(2), without: vec![279], ..plain() };
    assert!(refusal(&strips.build()).contains("StripByteCounts"));
    let defaults = Tiff { without: vec![279, 262, 277, 339, 259, 317], ..plain() };
    let (_folder, path) = file_of(&defaults.build());
    assert_eq!(read_all(&path).unwrap().len(), 3);
}

#[test]
fn pages_of_differing_size_are_refused() {
    let first = Tiff::new(Sample::U16, 1, 8, 6).build();
    let other = Tiff::new(Sample::U16, 1, 6, 8);
    let mut file = first.clone();
    let directory = u32::from_le_bytes(first[4..8].try_into().unwrap()) as usize;
    let num_fields = usize::from(first[directory]);
    let pointer = directory + 2 + 12 * num_fields;
    let position = file.len();
    file[pointer..pointer + 4].copy_from_slice(&(position as u32).to_le_bytes());
    let second = other.build();
    let second_directory = u32::from_le_bytes(second[4..8].try_into().unwrap()) as usize;
    file.extend(&second[second_directory..]);
    let said = refusal(&file);
    assert!(said.contains("page 2") && said.contains("6 x 8") && said.contains("8 x 6"), "{said}");
}

#[test]
fn descriptions_that_do_not_fit_the_pages_are_refused() {
    let mut tiff = plain();
    tiff.description =
        r#"<?xml version="1.0"?><OME><Image><Pixels SizeC="2" SizeT="9"/></Image></OME>"#.to_owned();
    assert!(refusal(&tiff.build()).contains("2 channels"));
    tiff.description = "<?xml version=\"1.0\"?><OME><Image".to_owned();
    assert!(refusal(&tiff.build()).contains("OME-XML"));
    tiff.description = "<OME><Image><Pixels SizeC=\"0\"/></Image></OME>".to_owned();
    assert!(refusal(&tiff.build()).contains("SizeC"));
    tiff.description = "ImageJ=1.53t\nimages=9\nchannels=2\n".to_owned();
    assert!(refusal(&tiff.build()).contains("promises 9 images, the file holds 3"));
    tiff.description = "ImageJ=1.53t\nimages=3\nchannels=2\n".to_owned();
    assert!(refusal(&tiff.build()).contains("2 channels"));
}

fn damaged_file() -> impl Strategy<Value = Vec<u8>> {
    let kinds = (0..3_usize, 0..5_usize, any::<bool>(), any::<bool>(), any::<bool>());
    let flips = proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..12);
    (kinds, flips, any::<prop::sample::Index>(), any::<bool>()).prop_map(
        |((sample, compression, is_big, is_big_endian, is_tiled), flips, end, is_cut)| {
            let sample = [Sample::U8, Sample::U16, Sample::F32][sample];
            let mut tiff = Tiff {
                is_big,
                is_big_endian,
                compression: [1, 5, 8, 32946, 50000][compression],
                chunks: if is_tiled { Chunks::Tiles(16, 16) } else { Chunks::Strips(3) },
                ..Tiff::new(sample, 2, 9, 21)
            };
            tiff.description = if is_tiled {
                "ImageJ=1.53t\nimages=2\nchannels=2\n".to_owned()
            } else {
                r#"<OME><Image><Pixels SizeC="2" SizeT="1" PhysicalSizeX="0.1"/></Image></OME>"#.to_owned()
            };
            let mut bytes = tiff.build();
            for (at, value) in flips {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            if is_cut {
                bytes.truncate(end.index(bytes.len()));
            }
            bytes
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn damage_never_panics_or_takes_long(bytes in damaged_file()) {
        let (_folder, path) = file_of(&bytes);
        let start = Instant::now();
        match read_all(&path) {
            Ok(frames) => {
                let pixels: usize = frames.iter().map(|frame| crate::common::bits(frame).len()).sum();
                prop_assert!(pixels < 256 << 20);
            }
            Err(FileError::Io { .. }) => prop_assert!(false, "an operating-system error came through"),
            Err(error) => prop_assert_eq!(error.kind(), ErrorKind::Data),
        }
        prop_assert!(start.elapsed() < Duration::from_secs(1));
    }
}
