//! What is written can be read back here and by an independent reader; what fails leaves nothing.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::time::Duration;

use sofiscope::files::{
    Dialect, FileError, FrameBuffer, ImageStack, OutputDirectory, ResultHeader, StackHeader, StackWriter,
    Storage, write_result,
};
use tiff::decoder::{Decoder, DecodingResult};

use crate::common::read_all;

fn result_header(storage: Storage) -> ResultHeader {
    ResultHeader {
        name: "cumulants <order 2>".to_owned(),
        channels: vec!["RR".to_owned(), "TR & µ".to_owned(), "TT".to_owned()],
        height: 5,
        width: 7,
        pixel_size_nm: Some(54.166),
        description: "line 1\nline \"2\" κ".to_owned(),
        settings: vec![("order".to_owned(), "2".to_owned())],
        storage,
    }
}

fn planes() -> Vec<Vec<f32>> {
    let plane = |page: u32| (0..35).map(|index| (page * 100 + index) as f32 * 0.25).collect();
    let mut planes: Vec<Vec<f32>> = (0..3).map(plane).collect();
    planes[1][3] = f32::NAN;
    planes
}

fn assert_same_bits(left: &[f32], right: &[f32]) {
    let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(left), bits(right));
}

#[test]
fn results_come_back_with_names_and_pixel_size() {
    let folder = tempfile::tempdir().unwrap();
    for storage in [Storage::Uncompressed, Storage::Deflate] {
        let path = folder.path().join(format!("{storage:?}.ome.tif"));
        let planes = planes();
        let slices: Vec<&[f32]> = planes.iter().map(Vec::as_slice).collect();
        write_result(&path, &result_header(storage), &slices).unwrap();

        let info = ImageStack::open(&path).unwrap().info().clone();
        assert_eq!((info.frames, info.channels, info.dialect), (1, 3, Dialect::Ome));
        assert_eq!(info.channel_names, ["RR", "TR & µ", "TT"]);
        let [x, y] = info.pixel_size_nm.unwrap();
        assert!((x - 54.166).abs() < 1e-9 && x == y);
        for (frame, plane) in read_all(&path).unwrap().iter().zip(&planes) {
            let FrameBuffer::Values(values) = frame else {
                panic!("results are float32");
            };
            assert_same_bits(values, plane);
        }

        let mut decoder = Decoder::new(BufReader::new(File::open(&path).unwrap())).unwrap();
        for (index, plane) in planes.iter().enumerate() {
            decoder.seek_to_image(index).unwrap();
            let DecodingResult::F32(values) = decoder.read_image().unwrap() else {
                panic!("results are float32");
            };
            assert_same_bits(&values, plane);
        }

        let taken = write_result(&path, &result_header(storage), &slices).unwrap_err();
        assert!(matches!(taken, FileError::OutputExists { .. }));
    }
}

#[test]
fn stacks_come_back_with_their_frame_interval() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("reflection.ome.tif");
    let header = StackHeader {
        frames: 4,
        height: 3,
        width: 5,
        channel: "Reflected".to_owned(),
        pixel_size_nm: Some(108.0),
        frame_interval: Some(Duration::from_millis(20)),
        ..StackHeader::default()
    };
    let mut writer = StackWriter::create(&path, &header).unwrap();
    let frames: Vec<Vec<u16>> = (0..4).map(|frame| (0..15).map(|x| frame * 1000 + x).collect()).collect();
    for frame in &frames {
        writer.push(frame).unwrap();
    }
    assert!(writer.push(&frames[0]).is_err());
    writer.finish().unwrap();
    let written = std::fs::metadata(&path).unwrap().len();
    assert!(written <= header.file_bytes(&path).unwrap());

    let info = ImageStack::open(&path).unwrap().info().clone();
    assert_eq!((info.frames, info.channels), (4, 1));
    assert_eq!(info.channel_names, ["Reflected"]);
    assert_eq!(info.frame_interval, Some(Duration::from_millis(20)));
    for (read, frame) in read_all(&path).unwrap().iter().zip(&frames) {
        assert_eq!(*read, FrameBuffer::Counts(frame.clone()));
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.tif");
    let header = result_header(Storage::Uncompressed);
    let plane = [0.0; 35];
    assert!(write_result(&path, &header, &[&plane, &plane]).is_err());
    assert!(write_result(&path, &header, &[&plane, &plane, &plane[1..]]).is_err());
    assert!(StackWriter::create(&path, &StackHeader::default()).is_err());
    assert!(!path.exists());
    let nowhere = folder.path().join("none/x.tif");
    let said = write_result(&nowhere, &header, &[&plane[..]; 3]).unwrap_err().to_string();
    assert!(said.contains("directory does not exist"), "{said}");
}

fn entries(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap().flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
}

#[test]
fn an_output_appears_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("out");

    let output = OutputDirectory::create(&target).unwrap();
    std::fs::write(output.file("a"), "1").unwrap();
    assert!(!target.exists());
    assert!(entries(folder.path())[0].starts_with(".out.partial-"));
    drop(output);
    assert!(entries(folder.path()).is_empty());

    let output = OutputDirectory::create(&target).unwrap();
    let beside = OutputDirectory::create(&target).unwrap();
    std::fs::create_dir(output.file("sub")).unwrap();
    std::fs::write(output.file("sub").join("a"), "1").unwrap();
    assert_eq!(output.commit().unwrap(), target);
    assert!(target.join("sub/a").exists());

    std::fs::write(beside.file("b"), "2").unwrap();
    assert!(matches!(beside.commit().unwrap_err(), FileError::OutputExists { .. }));
    assert_eq!(entries(folder.path()), ["out"]);
}

#[test]
fn outputs_that_cannot_be_are_usage_errors() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "1").unwrap();
    let refusal = |path: &Path| {
        let error = OutputDirectory::create(path).unwrap_err();
        assert_eq!(error.kind().exit_code(), 2);
        error.to_string()
    };
    assert!(refusal(folder.path()).contains("Choose another --out or remove it"));
    assert!(refusal(&file).contains("exists already"));
    assert!(refusal(&file.join("x")).contains("is a file"));
    assert!(refusal(&folder.path().join("none/x")).contains("none does not exist"));
    assert!(refusal(Path::new("/")).contains("no name"));
    assert_eq!(entries(folder.path()), ["file"]);
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    OutputDirectory::create(&empty).unwrap().commit().unwrap();
}

#[test]
fn a_full_disk_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let attempt = || -> Result<(), FileError> {
        let output = OutputDirectory::create(&folder.path().join("out"))?;
        std::fs::write(output.file("half"), "half a file").unwrap();
        sofiscope::files::ensure_free(output.directory(), u64::MAX)?;
        output.commit().map(|_| ())
    };
    let error = attempt().unwrap_err();
    assert!(matches!(error, FileError::DiskFull { .. }));
    assert_eq!(error.kind().exit_code(), 4);
    assert!(entries(folder.path()).is_empty());
}
