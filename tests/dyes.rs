//! The command `dyes` as a person and a script see it: ranking, table, JSON, plot, and what it refuses.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;
use sofiscope::sofi::spectra::EmissionShape;
use tempfile::TempDir;

const USAGE: i32 = 2;
const THREE: &str = "AF488,Atto565,AF647";

/// A folder with spectra.
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

    /// Writes the emission of a rhodamine with this peak.
    fn emission(&self, name: &str, peak_nm: f64) {
        let shape = EmissionShape { peak_nm, short_half_width_nm: 16.0, long_half_width_nm: 27.0 };
        let rows = (400..900).map(|nm| format!("{nm},{:.6}\n", shape.at(f64::from(nm))));
        self.text(name, &format!("Wavelength (nm),Emission\n{}", rows.collect::<String>()));
    }

    fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sofiscope"));
        command.current_dir(self.folder.path()).arg("dyes").args(arguments).output().unwrap()
    }

    fn json(&self, arguments: &[&str]) -> Value {
        let output = self.run(&[arguments, &["--json"]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    }

    fn table(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// One line with every part, exit code 2, nothing on stdout and nothing written.
    fn refuses(&self, arguments: &[&str], parts: &[&str]) {
        let files = || fs::read_dir(self.folder.path()).unwrap().count();
        let before = files();
        let output = self.run(arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        println!("{}", said.trim_end());
        assert_eq!(output.status.code(), Some(USAGE), "{said}");
        assert!(output.stdout.is_empty() && said.lines().count() == 1 && said.len() < 600, "{said}");
        for part in parts {
            assert!(said.contains(part), "{part}: {said}");
        }
        assert_eq!(files(), before);
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

fn choice<'a>(found: &'a Value, dichroic: &str) -> &'a Value {
    let choices = found["choices"].as_array().unwrap();
    choices.iter().find(|choice| choice["dichroic"] == dichroic).unwrap()
}

fn close(found: &[f64], expected: &[f64], within: f64) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() <= within, "{found} for {expected}");
    }
}

#[test]
fn the_dyes_of_the_paper_have_their_best_edge_and_eigenvalues() {
    let found = Bench::new().json(&[THREE]);
    let [edge] = numbers(&found["best_edges_nm"])[..] else { panic!("{found}") };
    assert!((590.0..=610.0).contains(&edge), "{edge}");
    let table_s1 = choice(&found, "zt 594 RDC");
    close(&numbers(&table_s1["eigenvalues"]), &[0.975, 0.960, 0.213], 5e-4);
    close(&numbers(&table_s1["shares"][1]), &[0.02, 0.35, 0.98], 1e-12);
    assert!((table_s1["product"].as_f64().unwrap() - 0.200).abs() < 5e-4);
    assert!(
        found["choices"]
            .as_array()
            .unwrap()
            .is_sorted_by(|a, b| a["product"].as_f64() >= b["product"].as_f64())
    );
    assert_eq!(found["choices"][0]["kind"], "ideal-edge");
    let [low, high] = numbers(&found["good_edges_nm"])[..] else { panic!("{found}") };
    assert!(low < edge && edge < high && high - low < 60.0, "{low} {high}");
}

#[test]
fn the_parametric_edge_reproduces_table_s1() {
    let dyes = "AF488,JF549,Flip565,Atto565,AF568,AF647";
    let found = Bench::new().json(&[dyes, "--order", "5", "--dichroic", "zt 594 edge (parametric)"]);
    let shares = numbers(&choice(&found, "zt 594 edge (parametric)")["shares"][1]);
    close(&shares, &[0.02, 0.16, 0.26, 0.35, 0.47, 0.98], 0.03);
}

#[test]
fn close_dyes_suffer_more_from_a_wrong_share() {
    let bench = Bench::new();
    let worst = |dyes: &str| {
        let found = bench.json(&[dyes, "--dichroic", "zt 594"]);
        choice(&found, "zt 594 RDC")["worst_crosstalk_percent"].as_f64().unwrap().abs()
    };
    assert!(worst("Flip 565,Atto 565,AF568") > 3.0 * worst(THREE));
}

#[test]
fn sets_are_chosen_among_all_dyes_by_any_criterion() {
    let bench = Bench::new();
    for by in ["product", "smallest-singular-value", "noise"] {
        let found = bench.json(&["--choose", "3", "--dichroic", "zt 594 RDC", "--by", by]);
        let sets: Vec<&Value> =
            found["choices"].as_array().unwrap().iter().filter(|c| c["kind"] == "coefficients").collect();
        assert_eq!(sets.len(), 20);
        assert_eq!(found["by"], by);
        // Table S1 has its most even spread with Alexa Fluor 568 or Atto 565 in the middle.
        let best = sets[0]["species"].to_string();
        assert!(best.contains("Alexa Fluor 488") && best.contains("Alexa Fluor 647"), "{best}");
    }
}

#[test]
fn more_channels_and_orders_take_more_dyes() {
    let bench = Bench::new();
    let five = "AF488,JF549,Atto565,AF568,AF647";
    let found = bench.json(&[five, "--channels", "3"]);
    assert_eq!((found["spectral_channels"].as_u64(), numbers(&found["best_edges_nm"]).len()), (Some(6), 2));
    let [best] = &found["choices"].as_array().unwrap()[..] else { panic!("{found}") };
    assert_eq!(best["shares"].as_array().unwrap().len(), 3);
    assert!(best["eigenvalues"].is_null() && best["product"].as_f64().unwrap() > 0.0);
    let found = bench.json(&[five, "--order", "4"]);
    assert_eq!(numbers(&choice(&found, "zt 594 RDC")["eigenvalues"]).len(), 5);
}

#[test]
fn measured_spectra_take_the_place_of_parametric_ones() {
    let bench = Bench::new();
    bench.emission("mine.csv", 640.0);
    bench.text("edge.csv", "nm;percent\n300;0\n599,99;0\n600,01;100\n1000;100\n");
    bench.text("half.csv", "300 0.5\n1000 0.5\n");
    let arguments = [
        "AF488,Mine",
        "--emission",
        "Mine=mine.csv",
        "--dichroic-curve",
        "T600=edge.csv",
        "--filter-t",
        "half.csv",
    ];
    let found = bench.json(&arguments);
    let curve = choice(&found, "T600");
    let shape = EmissionShape { peak_nm: 640.0, short_half_width_nm: 16.0, long_half_width_nm: 27.0 };
    let sum = |from: u32| (from..900).map(|nm| shape.at(f64::from(nm))).sum::<f64>();
    let above = (sum(600) - 0.5 * shape.at(600.0)) / sum(400);
    let expected = 0.5 * above / (0.5 * above + 1.0 - above);
    assert!((numbers(&curve["shares"][1])[1] - expected).abs() < 1e-3, "{curve}");
    let sources: Vec<&Value> = found["spectra"].as_array().unwrap().iter().map(|s| &s["emission"]).collect();
    assert_eq!(sources, ["parametric, for planning", "mine.csv"]);
    let notes = found["notes"].to_string();
    assert!(notes.contains("edge.csv was read as percent"), "{notes}");
    assert!(!found["choices"].as_array().unwrap().iter().any(|choice| choice["dichroic"] == "zt 594 RDC"));
}

#[test]
fn the_table_says_what_is_parametric() {
    let table = Bench::new().table(&[THREE]);
    println!("{table}");
    for part in [
        "best ideal edge: ",
        "zt 594 RDC",
        "0.975 0.960 0.213",
        "0.02 0.35 0.98",
        "Emission (parametric, for planning): Alexa Fluor 488",
        "zt 594 edge (parametric)",
        "Crosstalk behind",
    ] {
        assert!(table.contains(part), "{part}: {table}");
    }
    println!("{}", Bench::new().table(&[]));
}

#[test]
fn a_plot_is_one_well_formed_picture_of_two_panels() {
    let bench = Bench::new();
    for (name, arguments) in [
        ("two.svg", &[THREE][..]),
        ("three.svg", &["AF488,JF549,Atto565,AF568,AF647", "--channels", "3"]),
        ("rectangular.svg", &["AF488,AF647", "--order", "3"]),
    ] {
        let table = bench.table(&[arguments, &["--plot", name]].concat());
        assert!(table.contains(name));
        let svg = fs::read_to_string(bench.path(name)).unwrap();
        let document = roxmltree::Document::parse(&svg).unwrap();
        let texts: Vec<_> = document.descendants().filter_map(|node| node.text()).collect();
        for wanted in ["Alexa Fluor 488", "wavelength (nm)", "edge of an ideal dichroic (nm)"] {
            assert!(texts.contains(&wanted), "{wanted}: {texts:?}");
        }
        assert!(!svg.contains("NaN"));
    }
    bench.refuses(&[THREE, "--plot", "two.svg"], &["two.svg exists", "another name"]);
}

#[test]
fn what_cannot_be_judged_is_refused_with_what_to_do() {
    let bench = Bench::new();
    bench.emission("mine.csv", 640.0);
    for (arguments, parts) in [
        (&["AF488,Atto 655"][..], &["\"Atto 655\"", "Did you mean Atto 565", "--emission"][..]),
        (&["AF488,Mne", "--emission", "Mine=mine.csv"], &["\"Mne\"", "Did you mean Mine"]),
        (&["AF488,alexa 488"], &["Alexa Fluor 488 was given twice"]),
        (&["AF488,,AF647"], &["empty", "commas"]),
        (
            &["AF488,JF549,Atto565,AF647"],
            &["4 dyes", "3 spectral channels", "--order 3", "--channels 3", "at most 3"],
        ),
        (&[THREE, "--dichroic", "zt 549"], &["zt 549", "Did you mean zt 594"]),
        (&["Flip 565,AF647", "--dichroic", "HC BS 640"], &["Abberior Flip 565", "behind: zt 594 RDC"]),
        (&[THREE, "--order", "1"], &["order 1", "2 to 6"]),
        (&[THREE, "--channels", "1"], &["1 physical", "2 to 8"]),
        (&[THREE, "--channels", "3", "--dichroic", "zt 594"], &["--dichroic", "leave it out"]),
        (&[THREE, "--t-error", "0"], &["--t-error", "0.5"]),
        (&[THREE, "--from-nm", "700", "--to-nm", "600"], &["700", "--from-nm below --to-nm"]),
        (&["--choose", "9"], &["9 of 6", "--choose 1 to 6"]),
    ] {
        bench.refuses(arguments, parts);
    }
}

#[test]
fn spectra_that_are_none_are_refused_with_their_line() {
    let bench = Bench::new();
    bench.text("words.csv", "Wavelength,Emission\n500,0.1\n510,much\n520,0.2\n");
    bench.text("order.csv", "500,0.1\n490,0.2\n");
    bench.text("dark.csv", "400,0\n900,0\n");
    bench.text("od.csv", "400,0.1\n500,6000\n");
    fs::write(bench.path("bytes.csv"), [0x35, 0x0a, 0xff, 0xfe]).unwrap();
    for (arguments, parts) in [
        (
            &["AF488,Mine", "--emission", "Mine=words.csv"][..],
            &["words.csv", "line 3", "\"much\"", "520.5,0.83"][..],
        ),
        (&["AF488,Mine", "--emission", "Mine=order.csv"], &["order.csv", "line 2", "490", "sort"]),
        (&["AF488,Mine", "--emission", "Mine=none.csv"], &["none.csv", "does not exist"]),
        (&["AF488,Mine", "--emission", "mine.csv"], &["--emission mine.csv", "NAME=FILE"]),
        (&["AF488,Mine", "--emission", "Mine=bytes.csv"], &["bytes.csv", "line 2", "UTF-8"]),
        (&["AF488,Mine", "--emission", "Mine=dark.csv"], &["Mine", "no light"]),
        (&[THREE, "--filter", "dark.csv"], &["no light"]),
        (&[THREE, "--filter", "od.csv"], &["od.csv", "line 2", "optical density"]),
        (&[THREE, "--dichroic-curve", "zt 594 RDC=dark.csv"], &["zt 594 RDC", "already", "another name"]),
    ] {
        bench.refuses(arguments, parts);
    }
}
