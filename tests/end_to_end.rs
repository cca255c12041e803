//! Frames in, everything a person finds afterwards: images, report, pictures, and the words for scripts.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use serde_json::Value;
use sofiscope::files::{ImageStack, SampleType};
use sofiscope::report::AnalysisReport;
use tempfile::TempDir;
use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::Tag;

const DYES: [&str; 3] = ["Alexa Fluor 488", "Atto 565", "Alexa Fluor 647"];
const FRAMES: u64 = 600;
/// Pixels along a side of the camera image of figure-s4.
const SIDE: usize = 72;

/// Frames of figure-s4, simulated once for all tests: `reflection.ome.tif` and `transmission.ome.tif`.
fn frames() -> &'static Path {
    static FRAMES_OF_ALL: OnceLock<TempDir> = OnceLock::new();
    let folder = FRAMES_OF_ALL.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("s4");
        let frames = FRAMES.to_string();
        said(&sofiscope(&["simulate", "figure-s4", "--frames", &frames, "--out", text(&out)], &[]));
        folder
    });
    folder.path()
}

fn camera(name: &str) -> String {
    text(&frames().join("s4").join(name)).to_owned()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn sofiscope(arguments: &[&str], environment: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sofiscope"));
    command.args(arguments).envs(environment.iter().copied()).output().unwrap()
}

/// What a command printed on stdout; it must have ended well.
fn said(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Analyzes both cameras into `folder/name`.
fn analyzed(folder: &TempDir, name: &str, more: &[&str], environment: &[(&str, &str)]) -> (PathBuf, String) {
    let out = folder.path().join(name);
    let (r, t) = (camera("reflection.ome.tif"), camera("transmission.ome.tif"));
    let dyes = DYES.join(",");
    let both = ["analyze", &r, &t, "--species", &dyes, "--dichroic", "zt 594 RDC", "--out", text(&out)];
    let printed = said(&sofiscope(&[&both[..], more].concat(), environment));
    (out, printed)
}

/// Pages, size, type, channel names and pixel size of a result, twice: by our reader and by another one.
fn check_image(path: &Path, names: &[&str], side: usize, pixel_nm: f64) {
    let stack = ImageStack::open(path).unwrap();
    let info = stack.info();
    assert_eq!((info.channels * info.frames, info.height, info.width), (names.len(), side, side), "{path:?}");
    assert_eq!((info.sample, &info.channel_names[..]), (SampleType::Float32, &strings(names)[..]));
    assert!(info.pixel_size_nm.unwrap().iter().all(|size| (size - pixel_nm).abs() < 1e-6));
    let mut other = tiff::decoder::Decoder::new(File::open(path).unwrap()).unwrap();
    for page in 0..names.len() {
        other.seek_to_image(page).unwrap();
        assert_eq!(other.dimensions().unwrap(), (side as u32, side as u32));
        assert_eq!(other.colortype().unwrap(), tiff::ColorType::Gray(32));
        let tiff::decoder::DecodingResult::F32(values) = other.read_image().unwrap() else {
            panic!("{path:?} is not float32");
        };
        assert!(values.iter().any(|value| value.is_finite() && *value != 0.0));
    }
    assert!(!other.more_images());
}

fn strings(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

fn names(directory: &Path) -> Vec<String> {
    let entries = fs::read_dir(directory).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn an_analysis_writes_what_the_readme_promises() {
    let folder = tempfile::tempdir().unwrap();
    let (out, printed) = analyzed(&folder, "out", &["--json"], &[]);
    let summary: Value = serde_json::from_str(&printed).unwrap();
    assert_eq!((&summary["pairs"], &summary["frames_used"]), (&FRAMES.into(), &FRAMES.into()));
    assert_eq!(summary["results"].as_str(), Some(text(&out)));
    for file in summary["files"].as_array().unwrap() {
        assert!(out.join(file.as_str().unwrap()).is_file(), "{file}");
    }
    assert_eq!(names(folder.path()), ["out"]);

    check_image(&out.join("mean.ome.tif"), &["R", "T"], SIDE, 108.0);
    check_image(&out.join("cumulants.ome.tif"), &["RR", "TR", "TT"], 2 * SIDE, 54.0);
    for stage in ["unmixed", "flattened", "linearized"] {
        check_image(&out.join(format!("{stage}.ome.tif")), &DYES, 2 * SIDE, 54.0);
    }

    let composite = File::open(out.join("composite.png")).unwrap();
    let mut picture = png::Decoder::new(std::io::BufReader::new(composite)).read_info().unwrap();
    let mut pixels = vec![0; picture.output_buffer_size().unwrap()];
    let frame = picture.next_frame(&mut pixels).unwrap();
    assert_eq!(frame.width, frame.height);
    assert!(pixels.iter().any(|&value| value > 128));
}

#[test]
fn the_report_says_simulated_and_needs_nothing_from_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    let (out, _) = analyzed(&folder, "out", &["--subsequence", "150"], &[]);
    let report: AnalysisReport =
        serde_json::from_str(&fs::read_to_string(out.join("report.json")).unwrap()).unwrap();
    assert!(report.simulated);
    assert_eq!((report.frames.received, report.frames.used), (FRAMES, FRAMES));
    assert_eq!((report.settings.order, report.settings.subsequence_length), (2, 150));
    assert_eq!(report.subsequences.len(), 4);
    assert_eq!(report.species.iter().map(|species| species.name.as_str()).collect::<Vec<_>>(), DYES);
    assert_eq!(report.species[1].transmission, 0.35);
    let written = names(&out);
    assert!(report.outputs.iter().all(|file| written.contains(&file.path)), "{written:?}");

    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("class=\"banner\"") && page.contains("Simulated data."));
    for outside in ["src=\"http", "href=\"http", "url(http", "@import", "<script", "<link", "src=\"/"] {
        assert!(!page.contains(outside), "{outside}");
    }
    let sources = page.matches("src=\"").count();
    assert!(sources > 0 && sources == page.matches("src=\"data:image/png;base64,").count());
}

#[test]
fn the_same_frames_give_the_same_bytes_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let (first, _) = analyzed(&folder, "first", &[], &[]);
    for (name, threads) in [("one", "1"), ("two", "2"), ("three", "3")] {
        let (again, _) = analyzed(&folder, name, &[], &[("RAYON_NUM_THREADS", threads)]);
        for file in names(&first).iter().filter(|file| !file.starts_with("report")) {
            let bytes = |directory: &Path| fs::read(directory.join(file)).unwrap();
            assert!(bytes(&first) == bytes(&again), "{file} differs on {threads} threads");
        }
    }
}

#[test]
fn higher_orders_have_more_channels_on_a_finer_grid() {
    let folder = tempfile::tempdir().unwrap();
    let orders = [("3", &["RRR", "TRR", "TTR", "TTT"][..]), ("4", &["RRRR", "TRRR", "TTRR", "TTTR", "TTTT"])];
    for (order, channels) in orders {
        let (out, _) = analyzed(&folder, order, &["--order", order], &[]);
        let fold: usize = order.parse().unwrap();
        let pixel_nm = 108.0 / fold as f64;
        check_image(&out.join("cumulants.ome.tif"), channels, fold * SIDE, pixel_nm);
        check_image(&out.join("linearized.ome.tif"), &DYES, fold * SIDE, pixel_nm);
    }
}

#[test]
fn one_camera_alone_is_analyzed() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("one");
    let printed =
        said(&sofiscope(&["analyze", &camera("reflection.ome.tif"), "--out", text(&out), "--json"], &[]));
    let summary: Value = serde_json::from_str(&printed).unwrap();
    assert_eq!((&summary["pairs"], &summary["frames_received"]), (&0.into(), &FRAMES.into()));
    check_image(&out.join("mean.ome.tif"), &["camera"], SIDE, 108.0);
    check_image(&out.join("cumulants.ome.tif"), &["order 2"], 2 * SIDE, 54.0);
    check_image(&out.join("linearized.ome.tif"), &["sample"], 2 * SIDE, 54.0);
}

#[test]
fn both_cameras_in_one_file_are_the_same_as_in_two() {
    let folder = tempfile::tempdir().unwrap();
    let both = folder.path().join("both.ome.tif");
    write_both(&both);
    let (two, _) = analyzed(&folder, "two", &[], &[]);
    let one = folder.path().join("one");
    let dyes = DYES.join(",");
    said(&sofiscope(
        &["analyze", text(&both), "--species", &dyes, "--dichroic", "zt 594 RDC", "--out", text(&one)],
        &[],
    ));
    for file in ["mean.ome.tif", "cumulants.ome.tif", "linearized.ome.tif"] {
        let planes = |directory: &Path| planes(&directory.join(file));
        assert_eq!(planes(&one), planes(&two), "{file}");
    }
}

/// Interleaves the frames of both cameras as channels of one OME-TIFF, by another program's writer.
fn write_both(path: &Path) {
    let mut cameras = ["reflection.ome.tif", "transmission.ome.tif"]
        .map(|name| ImageStack::open(Path::new(&camera(name))).unwrap());
    let document = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\
         <OME xmlns=\"http://www.openmicroscopy.org/Schemas/OME/2016-06\"><Image ID=\"Image:0\">\
         <Pixels ID=\"Pixels:0\" DimensionOrder=\"XYCZT\" Type=\"uint16\" SizeX=\"{SIDE}\" SizeY=\"{SIDE}\" \
         SizeC=\"2\" SizeZ=\"1\" SizeT=\"{FRAMES}\" PhysicalSizeX=\"108\" PhysicalSizeXUnit=\"nm\" \
         PhysicalSizeY=\"108\" PhysicalSizeYUnit=\"nm\"><Channel ID=\"Channel:0:0\" Name=\"R\"/>\
         <Channel ID=\"Channel:0:1\" Name=\"T\"/><TiffData/></Pixels></Image></OME>"
    );
    let mut encoder = TiffEncoder::new(File::create(path).unwrap()).unwrap();
    let mut counts = vec![0_u16; SIDE * SIDE];
    for page in 0..2 * FRAMES as usize {
        assert!(cameras[page % 2].read_counts(&mut counts).unwrap());
        let mut image = encoder.new_image::<colortype::Gray16>(SIDE as u32, SIDE as u32).unwrap();
        if page == 0 {
            image.encoder().write_tag(Tag::ImageDescription, document.as_str()).unwrap();
        }
        image.write_data(&counts).unwrap();
    }
}

/// Bits of every page.
fn planes(path: &Path) -> Vec<Vec<u32>> {
    let mut stack = ImageStack::open(path).unwrap();
    let mut planes = Vec::new();
    for channel in 0..stack.info().channels {
        stack.select_channel(channel).unwrap();
        stack.seek(0).unwrap();
        let mut values = vec![0.0_f32; stack.info().height * stack.info().width];
        while stack.read_values(&mut values).unwrap() {
            planes.push(values.iter().map(|value| value.to_bits()).collect());
        }
    }
    planes
}

#[test]
fn the_demo_ends_with_one_object_for_scripts() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("demo");
    let printed =
        said(&sofiscope(&["demo", "--frames", "400", "--speed", "0", "--json", "--out", text(&out)], &[]));
    let ended: Value = serde_json::from_str(&printed).unwrap();
    for (key, value) in [("frames_received", 800), ("pairs", 400), ("pairs_analyzed", 400)] {
        assert_eq!(ended[key], value, "{key}");
    }
    assert!(ended["frames_recorded"].is_u64() && ended["frames_lost"].is_object());
    assert!(ended.as_object().unwrap().contains_key("recording"));
    let results = out.join("results");
    assert_eq!(ended["results"].as_str(), Some(text(&results)));
    assert_eq!(ended["recording"].as_str(), Some(text(&out)));
    assert_eq!(ended["frames_recorded"], 800);
    assert!(results.join("linearized.ome.tif").is_file() && results.join("report.html").is_file());
    assert_eq!(names(folder.path()), ["demo"]);
}
