//! The commands `simulate`, `score` and `check` as a script sees them: files, stdout, exit codes.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use sofiscope::files::{ImageStack, ResultHeader, write_result};
use sofiscope_sim::Truth;
use tempfile::TempDir;

fn sofiscope(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sofiscope")).args(arguments).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Simulates a scene into `folder/name` and says what the command printed.
fn simulated(folder: &TempDir, name: &str, scene: &str, more: &[&str]) -> Output {
    let out = folder.path().join(name);
    let output = sofiscope(&[&["simulate", scene, "--out", text(&out)], more].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    output
}

#[test]
fn simulate_writes_stacks_that_open_with_their_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let output = simulated(&folder, "s4", "figure-s4", &["--frames", "7", "--seed", "5", "--json"]);
    let said = json(&output);
    assert_eq!((said["frames"].as_u64(), said["seed"].as_u64()), (Some(7), Some(5)));
    assert_eq!(said["simulated"], true);
    for key in ["reflection", "transmission"] {
        let path = Path::new(said[key].as_str().unwrap());
        let mut stack = ImageStack::open(path).unwrap();
        let info = stack.info().clone();
        assert_eq!((info.frames, info.height, info.width), (7, 72, 72));
        let [pixel_y, pixel_x] = info.pixel_size_nm.unwrap();
        assert!((pixel_y - 108.0).abs() < 1e-6 && (pixel_x - 108.0).abs() < 1e-6);
        assert_eq!(info.frame_interval.unwrap().as_millis(), 20);
        let mut counts = vec![0_u16; 72 * 72];
        assert!(stack.read_counts(&mut counts).unwrap());
        assert!(counts.iter().any(|&count| count > 100));
        let head = fs::read(path).unwrap();
        assert!(String::from_utf8_lossy(&head).contains("SIMULATED, not measured"));
    }
    let directory = folder.path().join("s4");
    let truth = Truth::from_json(&fs::read_to_string(directory.join("truth.json")).unwrap()).unwrap();
    assert_eq!((truth.frames, truth.seed), (7, 5));
    let mut files: Vec<_> =
        fs::read_dir(&directory).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    files.sort();
    assert_eq!(files, ["reflection.ome.tif", "scene.toml", "transmission.ome.tif", "truth.json"]);
}

#[test]
fn equal_seeds_give_equal_bytes_and_the_scene_file_repeats_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let few = ["--frames", "150"];
    simulated(&folder, "first", "figure-2", &[&few[..], &["--seed", "3"]].concat());
    simulated(&folder, "other", "figure-2", &[&few[..], &["--seed", "4"]].concat());
    let scene = folder.path().join("first/scene.toml");
    simulated(&folder, "again", text(&scene), &[]);
    let bytes = |name: &str, file: &str| fs::read(folder.path().join(name).join(file)).unwrap();
    for file in ["reflection.ome.tif", "transmission.ome.tif", "truth.json", "scene.toml"] {
        assert_eq!(bytes("first", file), bytes("again", file), "{file}");
        assert_ne!(bytes("first", file), bytes("other", file), "{file}");
    }
}

#[test]
fn unknown_scenes_bring_the_nearest_name() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    for (typed, meant) in
        [("figure-4s", "figure-s4"), ("scenes/bead.toml", "beads"), ("Figure-S10", "figure-s10")]
    {
        let output = sofiscope(&["simulate", typed, "--out", text(&out)]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(&format!("Did you mean {meant}?")), "{}", stderr(&output));
    }
    assert!(!out.exists());
}

#[test]
fn an_existing_output_is_refused_and_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let mine = folder.path().join("mine.txt");
    fs::write(&mine, "precious").unwrap();
    for out in [folder.path(), &mine] {
        let output = sofiscope(&["simulate", "figure-s4", "--frames", "2", "--out", text(out)]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("exists already"), "{}", stderr(&output));
    }
    assert_eq!(fs::read_to_string(&mine).unwrap(), "precious");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn impossible_frames_and_faulty_scenes_leave_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.toml");
    fs::write(&scene, "name = \"x\"\nframs = 3\n").unwrap();
    let out = folder.path().join("out");
    let out = text(&out);
    let refused = |arguments: &[&str]| {
        let output = sofiscope(arguments);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        stderr(&output)
    };
    assert!(refused(&["simulate", "figure-s4", "--frames", "0", "--out", out]).contains("frames"));
    assert!(refused(&["simulate", text(&scene), "--out", out]).contains("`frames`"));
    assert!(refused(&["simulate", text(folder.path()), "--out", out]).contains("a directory"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn check_lists_all_faults_with_line_and_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let dichroics = folder.path().join("mine.toml");
    fs::write(
        &dichroics,
        "[[dichroic]]\nname = \"mine\"\nabuot = \"x\"\ncoefficients = [\n  { fluorophore = \"Alexa Flour 647\", transmission = 2.0 },\n]\n",
    )
    .unwrap();
    let output = sofiscope(&["check", text(&dichroics)]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    for part in
        ["3 faults", "line 3", "write `about`", "line 5", "Did you mean Alexa Fluor 647", "from 0 to 1"]
    {
        assert!(said.contains(part), "{part}: {said}");
    }
    let found = json(&sofiscope(&["check", text(&dichroics), "--json"]));
    assert_eq!((&found["kind"], &found["valid"]), (&"dichroics".into(), &false.into()));
    assert_eq!(found["faults"].as_array().unwrap().len(), 3);
    assert_eq!(found["faults"][0]["line"], 3);
}

#[test]
fn check_tells_kinds_apart_and_accepts_what_ships() {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    for (file, kind) in [
        ("scenes/figure-2.toml", "scene"),
        ("scenes/cell.toml", "scene"),
        ("fluorophores.toml", "fluorophores"),
        ("dichroics.toml", "dichroics"),
        ("simulated.toml", "instrument"),
        ("plans/quick-look.yaml", "plan"),
    ] {
        let output = sofiscope(&["check", text(&config.join(file)), "--json"]);
        assert!(output.status.success(), "{}", stderr(&output));
        assert_eq!((&json(&output)["kind"], &json(&output)["valid"]), (&kind.into(), &true.into()));
    }
    let folder = tempfile::tempdir().unwrap();
    for (content, part) in [
        ("[[dichorics]]\n", "write `dichroic`"),
        ("a = = 2\n", "line 1"),
        ("\u{1}", "fault"),
        ("frames = 1e\n[[species]]\n", "this scene has"),
    ] {
        let path = folder.path().join("odd.toml");
        fs::write(&path, content).unwrap();
        let output = sofiscope(&["check", text(&path)]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(part), "{content}: {}", stderr(&output));
    }
    fs::write(folder.path().join("latin.toml"), b"a = 1\nname = \"\xb5\"\n").unwrap();
    let output = sofiscope(&["check", text(&folder.path().join("latin.toml"))]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("line 2: not UTF-8"), "{}", stderr(&output));
}

/// Crosstalk put into the hand-made images: row = species, column = image.
const MIXED: [[f32; 3]; 3] = [[100.0, 5.0, 1.0], [2.0, 100.0, 2.5], [-3.0, 4.0, 100.0]];
const NAMES: [&str; 3] = ["Alexa Fluor 488", "Atto 565", "Alexa Fluor 647"];

/// Writes images whose every pixel shows the species around it, mixed by `MIXED`, in the order given.
fn write_images(directory: &Path, file: &str, truth: &Truth, order: [usize; 3], names: [&str; 3]) {
    let (height, width) = (2 * truth.height_px, 2 * truth.width_px);
    let value = |image: usize, pixel: usize| {
        let (y, x) = ((pixel / width) as f64 / 2.0, (pixel % width) as f64 / 2.0);
        let near = |&species: &usize| truth.distance_px(species, y, x) <= 3.0;
        let seen: f32 = (0..3).filter(near).map(|species| MIXED[species][image]).sum();
        10.0 + seen
    };
    let planes: Vec<Vec<f32>> =
        order.iter().map(|&image| (0..height * width).map(|pixel| value(image, pixel)).collect()).collect();
    let planes: Vec<&[f32]> = planes.iter().map(Vec::as_slice).collect();
    let channels = names.map(str::to_owned).to_vec();
    let header = ResultHeader { channels, height, width, ..ResultHeader::default() };
    write_result(&directory.join(file), &header, &planes).unwrap();
}

/// A simulated scene with its truth, and an empty directory for results.
fn scene_to_score(scene: &str) -> (TempDir, Truth) {
    let folder = tempfile::tempdir().unwrap();
    simulated(&folder, "truth", scene, &["--frames", "1"]);
    fs::create_dir(folder.path().join("result")).unwrap();
    let truth = fs::read_to_string(folder.path().join("truth/truth.json")).unwrap();
    (folder, Truth::from_json(&truth).unwrap())
}

fn score(folder: &TempDir, more: &[&str]) -> Output {
    let (result, truth) = (folder.path().join("result"), folder.path().join("truth"));
    sofiscope(&[&["score", text(&result), "--truth", text(&truth)], more].concat())
}

#[test]
fn score_finds_the_crosstalk_that_was_put_in_whatever_the_order() {
    let (folder, truth) = scene_to_score("figure-s4");
    let result = folder.path().join("result");
    for file in ["unmixed.ome.tif", "flattened.ome.tif", "linearized.ome.tif"] {
        write_images(&result, file, &truth, [2, 0, 1], ["AF647", "alexa-fluor 488", "Atto565"]);
    }
    let output = score(&folder, &["--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let score_found = json(&output);
    assert_eq!(score_found["species"], serde_json::json!(NAMES));
    for stage in ["unmixed", "flattened", "linearized"] {
        for (row, expected) in MIXED.iter().enumerate() {
            for (column, &expected) in expected.iter().enumerate() {
                let found = score_found["crosstalk_percent"][stage][row][column].as_f64().unwrap();
                assert!((found - f64::from(expected)).abs() < 1e-3, "{stage} {row} {column}: {found}");
            }
        }
        let no_peak = serde_json::json!([null, null, null]);
        assert_eq!(score_found["resolution_nm"][stage], no_peak, "these images have plateaus");
        assert!(score_found["snr"][stage][0].is_null(), "this background has no spread");
    }
    assert_eq!(score_found["paper"]["crosstalk_percent"][0], serde_json::json!([100.0, 5.0, 1.0]));
    let said = stdout(&score(&folder, &[]));
    for part in
        ["linearized, worst 5.0 %", "the paper, Table 2", "Read line by line", "Resolution", "no noise"]
    {
        assert!(said.contains(part), "{part}: {said}");
    }
}

#[test]
fn score_refuses_images_that_do_not_belong_to_the_truth() {
    let (folder, truth) = scene_to_score("figure-s4");
    let result = folder.path().join("result");
    let output = score(&folder, &[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("has none of unmixed.ome.tif"), "{}", stderr(&output));

    write_images(&result, "flattened.ome.tif", &truth, [0, 1, 2], ["AF488", "Atto 565", "AF568"]);
    let output = score(&folder, &[]);
    assert_eq!(output.status.code(), Some(4));
    assert!(stderr(&output).contains("but the scene figure-s4 has Alexa Fluor 488"), "{}", stderr(&output));

    let smaller = Truth { height_px: 50, ..truth };
    write_images(&result, "unmixed.ome.tif", &smaller, [0, 1, 2], NAMES);
    fs::remove_file(result.join("flattened.ome.tif")).unwrap();
    let output = score(&folder, &[]);
    assert_eq!(output.status.code(), Some(4));
    assert!(stderr(&output).contains("no whole multiple"), "{}", stderr(&output));

    fs::write(result.join("linearized.ome.tif"), "no image").unwrap();
    assert_eq!(score(&folder, &[]).status.code(), Some(4));
    fs::write(folder.path().join("truth/truth.json"), "{").unwrap();
    let output = score(&folder, &[]);
    assert_eq!(output.status.code(), Some(4));
    assert!(stderr(&output).contains("truth.json: not a ground truth"), "{}", stderr(&output));
}

#[test]
fn score_of_patches_says_how_well_they_are_told_apart() {
    let (folder, truth) = scene_to_score("figure-2");
    let (height, width) = (2 * truth.height_px, 2 * truth.width_px);
    let image = |species: usize| {
        let near = |pixel: usize| {
            let (y, x) = ((pixel / width) as f64 / 2.0, (pixel % width) as f64 / 2.0);
            truth.distance_px(species, y, x) <= 0.9
        };
        (0..height * width).map(|pixel| f32::from(u8::from(near(pixel)))).collect::<Vec<f32>>()
    };
    let planes: Vec<Vec<f32>> = (0..3).map(image).collect();
    let planes: Vec<&[f32]> = planes.iter().map(Vec::as_slice).collect();
    let channels = NAMES.map(str::to_owned).to_vec();
    let header = ResultHeader { channels, height, width, ..ResultHeader::default() };
    write_result(&folder.path().join("result/linearized.ome.tif"), &header, &planes).unwrap();
    let output = score(&folder, &["--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let found = json(&output);
    assert_eq!(found["measure"], "patches");
    assert_eq!(found["separation"]["linearized"]["correct_fraction"], 1.0);
    assert_eq!(found["crosstalk_percent"]["linearized"][1], serde_json::json!([0.0, 100.0, 0.0]));
    assert!(found["crosstalk_percent"]["flattened"].is_null());
    assert!(found["notes"][0].as_str().unwrap().ends_with("unmixed.ome.tif is not there"));
    assert!(stdout(&score(&folder, &[])).contains("Patches that are brightest"));
}
