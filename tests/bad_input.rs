//! `analyze` given what it cannot use: a sentence that says what, where and what next; the right exit code;
//! no result and nothing left behind.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use sofiscope::files::{StackHeader, StackWriter};
use sofiscope::sofi::spectra::Species;
use sofiscope::sofi::unmixing::UnmixingMatrix;
use tempfile::TempDir;
use tiff::encoder::{TiffEncoder, colortype};

const USAGE: i32 = 2;
const DATA: i32 = 4;
const THREE: [&str; 4] =
    ["--species", "Alexa Fluor 488,Atto 565,Alexa Fluor 647", "--dichroic", "zt 594 RDC"];

/// A folder of stacks, and what is said about them.
struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    /// Writes a stack of counts, `count(frame, pixel)`.
    fn stack(&self, name: &str, [frames, height, width]: [usize; 3], count: impl Fn(usize, usize) -> u16) {
        let header = StackHeader { frames, height, width, ..StackHeader::default() };
        let mut writer = StackWriter::create(&self.path(name), &header).unwrap();
        for frame in 0..frames {
            let counts: Vec<u16> = (0..height * width).map(|pixel| count(frame, pixel)).collect();
            writer.push(&counts).unwrap();
        }
        writer.finish().unwrap();
    }

    /// Two blinking stacks, `r.tif` and `t.tif`.
    fn pair(&self, size: [usize; 3]) {
        self.stack("r.tif", size, blinking);
        self.stack("t.tif", size, |frame, pixel| blinking(frame, pixel + 7));
    }

    /// Writes a float stack, `value(frame, pixel)`.
    fn floats(&self, name: &str, [frames, height, width]: [usize; 3], value: impl Fn(usize, usize) -> f32) {
        let mut encoder = TiffEncoder::new(File::create(self.path(name)).unwrap()).unwrap();
        for frame in 0..frames {
            let values: Vec<f32> = (0..height * width).map(|pixel| value(frame, pixel)).collect();
            encoder.write_image::<colortype::Gray32Float>(width as u32, height as u32, &values).unwrap();
        }
    }

    fn analyze(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sofiscope"));
        let command = command.current_dir(self.folder.path()).arg("analyze").args(arguments);
        command.output().unwrap()
    }

    fn names(&self) -> Vec<String> {
        names(self.folder.path())
    }

    /// Analyzes into `out`, which must end with `code`, one line that has every part, and no trace.
    fn refuses(&self, arguments: &[&str], code: i32, parts: &[&str]) {
        let before = self.names();
        let output = self.analyze(&[arguments, &["--out", "out"]].concat());
        check(&output, code, parts);
        assert_eq!(self.names(), before, "something was left behind or removed");
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// The message is the last line, has the parts, and is neither a panic nor a trace nor an essay.
fn check(output: &Output, code: i32, parts: &[&str]) {
    let said = String::from_utf8(output.stderr.clone()).unwrap();
    let message = said.lines().last().unwrap_or_default();
    println!("{code}  {message}");
    assert_eq!(output.status.code(), Some(code), "{said}");
    assert!(output.stdout.is_empty(), "{}", String::from_utf8_lossy(&output.stdout));
    assert!(message.starts_with("sofiscope: ") && message.len() < 500, "{said}");
    let errors = said.lines().filter(|line| !line.starts_with("cumulants: "));
    assert_eq!(errors.count(), 1, "more than the message: {said}");
    for part in parts {
        assert!(message.contains(part), "{part}: {said}");
    }
    for trace in ["panicked", "RUST_BACKTRACE", "stack backtrace", "src/", "Err("] {
        assert!(!said.contains(trace), "{trace}: {said}");
    }
}

/// Counts that differ from frame to frame and pixel to pixel.
fn blinking(frame: usize, pixel: usize) -> u16 {
    let mixed = (frame * 2_654_435_761 + pixel * 40_503 + frame * pixel) % 1009;
    100 + mixed as u16
}

#[test]
fn files_that_are_no_stacks() {
    let bench = Bench::new();
    bench.pair([8, 8, 8]);
    bench.text("words.tif", "This is no picture at all.\n");
    bench.text("empty.tif", "");
    fs::create_dir(bench.path("folder.tif")).unwrap();
    let whole = fs::read(bench.path("r.tif")).unwrap();
    fs::write(bench.path("cut.tif"), &whole[..whole.len() - 100]).unwrap();
    fs::write(bench.path("short.tif"), &whole[..whole.len() / 2]).unwrap();
    fs::write(bench.path("stub.tif"), &whole[..6]).unwrap();
    for (file, code, parts) in [
        ("words.tif", DATA, &["words.tif", "not a TIFF file", "Save it as"][..]),
        ("empty.tif", DATA, &["empty.tif", "empty"]),
        ("missing.tif", USAGE, &["missing.tif", "does not exist", "Check"]),
        ("folder.tif", USAGE, &["folder.tif", "directory", "Name one"]),
        ("cut.tif", DATA, &["cut.tif", "page", "again"]),
        ("short.tif", DATA, &["short.tif", "again"]),
        ("stub.tif", DATA, &["stub.tif", "again"]),
        ("/dev/null", USAGE, &["/dev/null", "not a file"]),
    ] {
        bench.refuses(&[file, "t.tif"], code, parts);
        bench.refuses(&["r.tif", file], code, parts);
        bench.refuses(&[file], code, parts);
    }
}

#[test]
fn cameras_that_do_not_belong_together() {
    let bench = Bench::new();
    bench.pair([8, 8, 8]);
    bench.stack("wide.tif", [8, 8, 9], blinking);
    bench.stack("long.tif", [9, 8, 8], blinking);
    bench.refuses(&["r.tif", "wide.tif"], DATA, &["r.tif has 8 x 8", "wide.tif has 9 x 8", "crop"]);
    bench.refuses(&["r.tif", "long.tif"], DATA, &["r.tif has 8", "long.tif has 9", "export"]);
}

#[test]
fn dyes_that_cannot_be_told_apart_or_are_not_known() {
    let bench = Bench::new();
    bench.pair([8, 8, 8]);
    for (species, dichroic, parts) in [
        (
            "Alexa Fluor 488,Atto 565,Alexa Fluor 568,Alexa Fluor 647",
            "zt 594 RDC",
            &["4", "3", "--order 3"][..],
        ),
        ("Abberior Flip 565,Flip 565", "zt 594 RDC", &["Abberior Flip 565", "twice"]),
        ("Alexa Flour 488,Atto 565", "zt 594 RDC", &["Alexa Flour 488", "Did you mean Alexa Fluor 488"]),
        ("Cy5", "zt 594 RDC", &["Cy5", "Known are: ", "Alexa Fluor 647"]),
        ("Atto 565", "zt 595 RDC", &["zt 595 RDC", "Did you mean zt 594 RDC"]),
        ("Atto 565", "a mirror", &["a mirror", "Known are: ", "HC BS 640"]),
        (
            "Atto 565,Alexa Fluor 568",
            "HC BS 640",
            &["Alexa Fluor 568", "HC BS 640", "it has one behind: zt 594 RDC"],
        ),
    ] {
        bench.refuses(&["r.tif", "t.tif", "--species", species, "--dichroic", dichroic], USAGE, parts);
    }
    bench.refuses(
        &["r.tif", "t.tif", "--species", "Atto 565,Alexa Fluor 647"],
        USAGE,
        &["--dichroic", "zt 594 RDC"],
    );
    bench.refuses(&["r.tif", "--species", "Atto 565,Alexa Fluor 647"], USAGE, &["dichroic"]);
    bench.refuses(&[&["r.tif"][..], &THREE].concat(), USAGE, &["3 species", "one camera", "or name one"]);
}

#[test]
fn dyes_with_equal_coefficients_are_both_named() {
    let dye = |name: &str, transmission| Species::new(name, transmission).unwrap();
    let species = [dye("first", 0.35), dye("other", 0.9), dye("second", 0.35)];
    let said = UnmixingMatrix::new(2, &species).unwrap_err().to_string();
    assert!(said.contains("first and second") && !said.contains("other"), "{said}");
}

#[test]
fn orders_and_subsequences_out_of_range() {
    let bench = Bench::new();
    bench.pair([8, 8, 8]);
    for (more, code, parts) in [
        (["--order", "1"], USAGE, &["order 1", "from 2 to 6"][..]),
        (["--order", "9"], USAGE, &["order 9", "from 2 to 6"]),
        (["--subsequence", "9"], USAGE, &["9 exposures", "8 frames of r.tif", "--subsequence 8"]),
        (["--subsequence", "1"], USAGE, &["subsequence of 1", "at least 2"]),
        (["--subsequence", "0"], USAGE, &["subsequence of 0", "at least 2"]),
        (["--combinations", "sofi"], USAGE, &["combinations", "sofipackage"]),
        (["--psf-sigma", "0"], USAGE, &["psf_sigma_px", "positive"]),
        (["--psf-sigma", "1e9"], USAGE, &["psf_sigma_px", "at most 1000 px"]),
        (["--pixel-nm", "nan"], USAGE, &["pixel_pitch_nm", "positive"]),
    ] {
        bench.refuses(&["r.tif", "t.tif", more[0], more[1]], code, parts);
    }
    bench.refuses(
        &["r.tif", "t.tif", "--combinations", "sofipackage", "--order", "3"],
        USAGE,
        &["sofipackage", "order 2", "not at order 3"],
    );
}

#[test]
fn frames_without_a_signal() {
    let bench = Bench::new();
    bench.pair([8, 8, 8]);
    bench.stack("dark.tif", [8, 8, 8], |_, _| 0);
    bench.stack("full.tif", [8, 8, 8], |_, _| u16::MAX);
    bench.stack("frozen.tif", [8, 8, 8], |_, pixel| 100 + pixel as u16);
    bench.stack("one.tif", [1, 8, 8], blinking);
    bench.stack("tiny.tif", [8, 3, 8], blinking);
    for (file, parts) in [
        ("dark.tif", &["dark.tif", "up to 0", "check"][..]),
        ("full.tif", &["full.tif", "up to 65535", "saturated"]),
        ("frozen.tif", &["frozen.tif", "no pixel ever changes", "frozen"]),
        ("one.tif", &["one.tif has 1 frame;", "at least 2"]),
        ("tiny.tif", &["tiny.tif", "8 x 3", "at least 4 x 4", "larger region"]),
    ] {
        bench.refuses(&[file], DATA, parts);
    }
    bench.refuses(&["r.tif", "full.tif"], DATA, &["camera T full.tif", "saturated"]);
}

#[test]
fn a_value_that_is_no_number_is_found() {
    let bench = Bench::new();
    for (name, value) in [("nan.tif", f32::NAN), ("infinite.tif", f32::INFINITY)] {
        let odd = |frame, pixel| match (frame, pixel) {
            (37, 13) => value,
            _ => f32::from(blinking(frame, pixel)),
        };
        bench.floats(name, [40, 5, 8], odd);
        bench.refuses(&[name], DATA, &[name, "page 38", "(y, x) = (1, 5)", "leave that frame out"]);
    }
}

#[test]
fn outputs_that_cannot_be_made() {
    let bench = Bench::new();
    bench.pair([8, 8, 8]);
    fs::create_dir(bench.path("taken")).unwrap();
    bench.text("taken/mine.txt", "precious");
    for (out, parts) in [
        ("taken", &["taken", "exists already", "--out"][..]),
        ("r.tif", &["r.tif", "exists already", "--out"]),
        ("no/where/out", &["no/where/out", "does not exist", "--out"]),
        ("r.tif/out", &["r.tif/out", "--out"]),
    ] {
        let before = bench.names();
        check(&bench.analyze(&["r.tif", "t.tif", "--out", out]), USAGE, parts);
        assert_eq!(bench.names(), before);
    }
    assert_eq!(names(&bench.path("taken")), ["mine.txt"]);
    assert_eq!(fs::read_to_string(bench.path("taken/mine.txt")).unwrap(), "precious");
}

#[test]
fn settings_that_cannot_be_used() {
    let bench = Bench::new();
    bench.pair([8, 8, 8]);
    bench.text("key.toml", "order = 2\nsubsequence_exposure = 4\n");
    bench.text("kind.toml", "order = 2\n\niterations = \"many\"\n");
    bench.text("syntax.toml", "order = = 2\n");
    bench.text("values.toml", "order = 9\nflattening = \"flat\"\nlags_exposures = [0, 1, 2]\n");
    bench.text("lags.toml", "lags_exposures = [0, 1, 2]\n");
    fs::write(bench.path("latin.toml"), b"order = 2\n# \xb5m\n").unwrap();
    fs::create_dir(bench.path("folder")).unwrap();
    for (settings, parts) in [
        ("key.toml", &["key.toml, line 2", "`subsequence_exposure`", "write `subsequence_exposures`"][..]),
        ("kind.toml", &["kind.toml, line 3", "invalid type", "give"]),
        ("syntax.toml", &["syntax.toml, line 1", "TOML"]),
        ("values.toml", &["values.toml", "order 9", "flattening", "equal-means"]),
        ("lags.toml", &["3 time lags", "order 2"]),
        ("latin.toml", &["latin.toml, line 2", "UTF-8"]),
        ("folder", &["folder is a directory"]),
        ("r.tif", &["r.tif"]),
        ("missing.toml", &["missing.toml does not exist"]),
    ] {
        bench.refuses(&["r.tif", "t.tif", "--settings", settings], USAGE, parts);
    }
}

#[test]
fn a_full_disk_is_said_before_the_first_frame() {
    let bench = Bench::new();
    bench.pair([8, 8, 8]);
    fs::create_dir(bench.path("disk")).unwrap();
    let script = "mount -t tmpfs -o size=1m tmpfs disk || exit 77
        \"$0\" analyze r.tif t.tif --out disk/out; code=$?; ls -A disk; exit $code";
    let mut unshare = Command::new("unshare");
    unshare.current_dir(bench.folder.path());
    let output = unshare.args(["--mount", "sh", "-c", script, env!("CARGO_BIN_EXE_sofiscope")]).output();
    match output {
        Ok(output) if output.status.code() == Some(DATA) => {
            check(&output, DATA, &["disk/out: not enough space", "MB needed", "Free some space"]);
        }
        other => println!("skipped: no small disk can be mounted here ({other:?})"),
    }
}

#[test]
fn a_disk_that_fills_up_leaves_nothing_behind() {
    let bench = Bench::new();
    bench.pair([8, 64, 64]);
    // Sixteen blocks hold no image of cumulants; the signal is ignored so that writing fails as on a full disk.
    let script = "trap '' XFSZ; ulimit -f 16; exec \"$0\" analyze r.tif t.tif --out out";
    let mut shell = Command::new("bash");
    let shell = shell.current_dir(bench.folder.path());
    let output = shell.args(["-c", script, env!("CARGO_BIN_EXE_sofiscope")]).output().unwrap();
    check(&output, DATA, &["/out: not enough space", "Free some space"]);
    assert_eq!(bench.names(), ["r.tif", "t.tif"]);
}

#[test]
fn partly_saturated_frames_are_analyzed_with_a_warning() {
    let bench = Bench::new();
    let bright = |frame, pixel| if pixel % 64 < 3 { u16::MAX } else { blinking(frame, pixel) };
    bench.stack("r.tif", [40, 8, 8], bright);
    for (out, more) in [("lines", &[][..]), ("json", &["--json"])] {
        let output = bench.analyze(&[&["r.tif", "--out", out][..], more].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        let warned =
            |text: &str| text.contains("r.tif") && text.contains("4.69 % of the pixel values are saturated");
        assert!(said.lines().any(|line| line.starts_with("warning: ") && warned(line)), "{said}");
        assert!(warned(&fs::read_to_string(bench.path(out).join("report.json")).unwrap()));
    }
}

#[test]
fn one_file_for_both_cameras_brings_a_warning() {
    let bench = Bench::new();
    bench.pair([40, 8, 8]);
    let output = bench.analyze(&["r.tif", "./r.tif", "--out", "out"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("warning: r.tif was given for both cameras"), "{said}");
}
