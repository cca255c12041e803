//! Whole files of every kind come out as they went in.

use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::time::{Duration, Instant};

use sofiscope::files::{Dialect, FrameBuffer, ImageStack, SampleType};

use crate::builder::{Chunks, Sample, Tiff};
use crate::common::{bits, file_of, read_all};

fn assert_reads_back(tiff: &Tiff) {
    let (_folder, path) = file_of(&tiff.build());
    let frames = read_all(&path).unwrap_or_else(|error| panic!("{error}\n{tiff:?}"));
    assert_eq!(frames.len(), tiff.pages.len());
    for (frame, page) in frames.iter().zip(&tiff.pages) {
        assert!(bits(frame) == *page, "{tiff:?}");
    }
}

#[test]
fn every_type_compression_layout_order_and_size_reads_back() {
    let layouts = [Chunks::Strips(17), Chunks::Strips(5), Chunks::Tiles(16, 16), Chunks::Tiles(32, 48)];
    for sample in [Sample::U8, Sample::U16, Sample::F32] {
        for compression in [1, 5, 8, 32946, 50000] {
            for chunks in layouts {
                for (is_big, is_big_endian) in [(false, false), (false, true), (true, false), (true, true)] {
                    for predictor in [1, 2, 3] {
                        let is_defined = match predictor {
                            1 => true,
                            2 => compression != 1,
                            _ => compression != 1 && sample == Sample::F32,
                        };
                        if is_defined {
                            assert_reads_back(&Tiff {
                                is_big,
                                is_big_endian,
                                compression,
                                predictor,
                                chunks,
                                ..Tiff::new(sample, 2, 17, 41)
                            });
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn large_frames_pass_through_several_fetches() {
    for compression in [5, 8, 50000] {
        assert_reads_back(&Tiff { compression, ..Tiff::new(Sample::U16, 2, 300, 401) });
    }
}

#[test]
fn seeking_gives_the_same_frames_as_reading_on() {
    let tiff = Tiff::new(Sample::U16, 6, 4, 5);
    let (_folder, path) = file_of(&tiff.build());
    let mut stack = ImageStack::open(&path).unwrap();
    let mut counts = vec![0; 20];
    for frame in [4, 0, 5, 2] {
        stack.seek(frame).unwrap();
        assert!(stack.read_counts(&mut counts).unwrap());
        assert_eq!(bits(&FrameBuffer::Counts(counts.clone())), tiff.pages[frame]);
    }
    stack.seek(6).unwrap();
    assert!(!stack.read_counts(&mut counts).unwrap());
    assert!(stack.seek(7).is_err());
}

#[test]
fn memory_of_another_size_or_type_is_refused() {
    let (_folder, path) = file_of(&Tiff::new(Sample::U16, 1, 4, 5).build());
    let mut stack = ImageStack::open(&path).unwrap();
    assert!(stack.read_counts(&mut [0; 19]).is_err());
    assert!(stack.read_values(&mut [0.0; 20]).is_err());
    assert!(stack.select_channel(1).is_err());
}

#[test]
fn four_thousand_pages_open_quickly() {
    let (_folder, path) = file_of(&Tiff::new(Sample::U16, 4000, 16, 16).build());
    let start = Instant::now();
    let mut stack = ImageStack::open(&path).unwrap();
    assert_eq!(stack.info().frames, 4000);
    assert!(start.elapsed() < Duration::from_secs(1), "{:?}", start.elapsed());
    stack.seek(3999).unwrap();
    assert!(stack.read_counts(&mut [0; 256]).unwrap());
}

#[test]
fn ome_channels_are_told_apart_in_every_order() {
    for (order, planes) in [("XYCTZ", [0, 2, 4]), ("XYTCZ", [0, 1, 2])] {
        let mut tiff = Tiff::new(Sample::U16, 6, 3, 4);
        tiff.description = format!(
            r#"<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0"><Pixels DimensionOrder="{order}" SizeC="2" SizeT="3" SizeZ="1"><Channel Name="R"/><Channel Name="T"/><TiffData/></Pixels></Image></OME>"#
        );
        let (_folder, path) = file_of(&tiff.build());
        let mut stack = ImageStack::open(&path).unwrap();
        let info = stack.info().clone();
        assert_eq!((info.frames, info.channels, info.dialect), (3, 2, Dialect::Ome));
        assert_eq!(info.channel_names, ["R", "T"]);
        let step = planes[1] - planes[0];
        for channel in 0..2 {
            stack.select_channel(channel).unwrap();
            stack.seek(0).unwrap();
            let first = if step == 1 { 3 * channel } else { channel };
            for plane in planes {
                let mut frame = info.buffer();
                assert!(stack.read(&mut frame).unwrap());
                assert_eq!(bits(&frame), tiff.pages[first + plane]);
            }
        }
    }
}

fn contiguous_imagej(images: usize, channels: usize) -> Tiff {
    let mut tiff = Tiff::new(Sample::U16, 1, 3, 4);
    tiff.is_big_endian = true;
    tiff.description = format!(
        "ImageJ=1.53t\nimages={images}\nchannels={channels}\nhyperstack=true\nunit=micron\nfinterval=0.05\n"
    );
    let per_micron = (10_u64 << 32) | 1;
    tiff.set(282, 5, per_micron).set(283, 5, per_micron)
}

/// Directory and values first, then all pixels, as ImageJ writes; returns the bytes before the pixels.
fn build_contiguous(tiff: &Tiff) -> Vec<u8> {
    let mut probe = tiff.clone();
    probe.overrides.push((273, 4, vec![0]));
    let length = probe.build().len() as u64;
    probe.overrides.pop();
    probe.clone().set(273, 4, length).build()
}

#[test]
fn imagej_stacks_with_one_directory_hold_all_frames() {
    let tiff = contiguous_imagej(6, 2);
    let mut file = build_contiguous(&tiff);
    for sample in 0..6 * 12 {
        tiff.put(&mut file, sample, 2);
    }
    let (_folder, path) = file_of(&file);
    let mut stack = ImageStack::open(&path).unwrap();
    let info = stack.info().clone();
    assert_eq!((info.frames, info.channels, info.dialect), (3, 2, Dialect::ImageJ));
    assert_eq!(info.pixel_size_nm, Some([100.0, 100.0]));
    assert_eq!(info.frame_interval, Some(Duration::from_millis(50)));
    stack.select_channel(1).unwrap();
    stack.seek(2).unwrap();
    let mut counts = [0; 12];
    assert!(stack.read_counts(&mut counts).unwrap());
    assert_eq!(counts[0], 5 * 12);

    let (_folder, path) = file_of(&file[..file.len() - 1]);
    let said = ImageStack::open(&path).unwrap_err().to_string();
    assert!(said.contains("promises 6 images, the file holds 5"), "{said}");
}

#[test]
fn truncated_files_of_python_hold_all_frames() {
    let mut tiff = Tiff::new(Sample::F32, 1, 3, 4);
    tiff.description = r#"{"shape": [2, 2, 3, 4], "truncated": true}"#.to_owned();
    let mut file = build_contiguous(&tiff);
    for sample in 0..48_u8 {
        tiff.put(&mut file, u64::from(f32::from(sample).to_bits()), 4);
    }
    let (_folder, path) = file_of(&file);
    let frames = read_all(&path).unwrap();
    assert_eq!(frames.len(), 4);
    assert_eq!(bits(&frames[3])[0], 36.0_f32.to_bits());
}

#[test]
fn frames_beyond_four_gigabytes_are_reached() {
    let mut tiff = contiguous_imagej(3000, 1);
    tiff = tiff.set(256, 4, 1024).set(257, 4, 1024).set(278, 4, 1024);
    let head = build_contiguous(&tiff);
    let (_folder, path) = file_of(&head);
    let mut file = File::options().write(true).open(&path).unwrap();
    let frame_bytes = 2 * 1024 * 1024_u64;
    file.set_len(head.len() as u64 + 3000 * frame_bytes).unwrap();
    file.seek(SeekFrom::Start(head.len() as u64 + 2999 * frame_bytes)).unwrap();
    file.write_all(&[0x12, 0x34]).unwrap();
    let start = Instant::now();
    let mut stack = ImageStack::open(&path).unwrap();
    stack.seek(2999).unwrap();
    let mut counts = vec![0; 1024 * 1024];
    assert!(stack.read_counts(&mut counts).unwrap());
    assert_eq!(counts[0], 0x1234);
    assert!(start.elapsed() < Duration::from_secs(1));
}

#[test]
fn reduced_pages_are_passed_over() {
    let full = Tiff::new(Sample::U16, 1, 8, 8);
    let (_folder, path) = file_of(&full.clone().set(254, 4, 1).build());
    let said = ImageStack::open(&path).unwrap_err().to_string();
    assert!(said.contains("no page"), "{said}");
    assert_reads_back(&full.set(254, 4, 2));
}

#[test]
fn not_a_number_is_found_with_its_place() {
    let mut tiff = Tiff::new(Sample::F32, 2, 3, 4);
    tiff.pages[1][6] = f32::NAN.to_bits();
    let (_folder, path) = file_of(&tiff.build());
    let mut stack = ImageStack::open(&path).unwrap();
    assert_eq!(stack.info().sample, SampleType::Float32);
    let mut values = [0.0; 12];
    stack.read_values(&mut values).unwrap();
    stack.check_finite(&values).unwrap();
    stack.read_values(&mut values).unwrap();
    let said = stack.check_finite(&values).unwrap_err().to_string();
    assert!(said.contains("page 2") && said.contains("(1, 2)"), "{said}");
}

#[test]
fn files_of_others_open() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data");
    let Ok(groups) = std::fs::read_dir(folder) else {
        println!("skipped: {folder} is not there");
        return;
    };
    let mut num_files = 0;
    for group in groups.flatten().filter(|group| group.path().is_dir()) {
        for file in std::fs::read_dir(group.path()).unwrap().flatten() {
            if file.path().extension().is_some_and(|extension| extension == "tif") {
                let frames = read_all(&file.path()).unwrap();
                assert!(!frames.is_empty());
                num_files += 1;
            }
        }
    }
    println!("{num_files} files read");
}
