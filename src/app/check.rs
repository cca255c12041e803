//! `check`: all faults of a file of settings at once, each with its line and what to do.
//!
//! In: a plan, an instrument, a registration, camera maps, a scene, a scenario of faults, a catalogue of fluorophores or one of dichroics, parametric spectra. Out: its kind and its faults.
//! Never: changes the file, stops at the first fault. Fails: [`AppError`] when there is a fault, so that scripts see it.

use std::path::{Path, PathBuf};

use serde::Serialize;
use sofiscope_sim::{Scenario, Scene};
use toml::de::DeTable;

use super::AppError;
use super::text_file::read_text;
use crate::config::{
    CameraCalibration, Catalogue, Fault, Instrument, ParametricSpectra, Registration, nearest,
};
use crate::control::plan::Plan;

/// A file of settings is refused unread above this size.
const MAX_BYTES: u64 = 4 << 20;

/// A kind of file that can be checked: new kinds are added to [`KINDS`].
struct Kind {
    name: &'static str,
    /// Top keys by which the kind is told.
    keys: &'static [&'static str],
    faults: fn(&Path, &str) -> Vec<Fault>,
}

const KINDS: [Kind; 8] = [
    Kind {
        name: "scene",
        keys: &[
            "species",
            "frames",
            "exposure_ms",
            "height_px",
            "width_px",
            "optics",
            "patch_grid",
            "camera",
        ],
        faults: |_, text| scene_faults(text),
    },
    Kind {
        name: "fluorophores",
        keys: &["fluorophore"],
        faults: |_, text| Catalogue::faults_of_fluorophores(text),
    },
    Kind { name: "dichroics", keys: &["dichroic"], faults: dichroic_faults },
    Kind {
        name: "instrument",
        keys: &["version", "name", "pixel_pitch_nm", "camera", "trigger", "limits", "simulation"],
        faults: |_, text| Instrument::from_toml(text).err().map_or_else(Vec::new, |error| error.faults),
    },
    Kind {
        name: "registration",
        keys: &["registration_version", "mirror", "matrix_y", "matrix_x", "shift_px", "residual_px"],
        faults: |_, text| Registration::from_toml(text).err().map_or_else(Vec::new, |error| error.faults),
    },
    Kind {
        name: "camera maps",
        keys: &["camera_maps_version", "maps_file", "saturation_counts", "dark_recording", "flat_recordings"],
        faults: |_, text| {
            CameraCalibration::from_toml(text).err().map_or_else(Vec::new, |error| error.faults)
        },
    },
    Kind {
        name: "parametric-spectra",
        keys: &["emission", "filter", "edge"],
        faults: |_, text| ParametricSpectra::faults(text),
    },
    Kind {
        name: "scenario",
        keys: &["faults", "pace", "speed", "exposures"],
        faults: |_, text| scenario_faults(text),
    },
];

/// Plans are YAML or JSON and told by the ending of their name.
const PLAN: Kind = Kind {
    name: "plan",
    keys: &[],
    faults: |_, text| Plan::from_text(text).err().map_or_else(Vec::new, |error| error.faults),
};

/// Arguments of `check`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope check config/scenes/cell.toml
  sofiscope check plan.yaml
  sofiscope check my-dichroics.toml --json

Exit code 0 without a fault, 2 with any. A file of dichroics is checked against the fluorophores.toml beside it,
or against the built-in fluorophores if there is none.")]
pub struct CheckArguments {
    /// Plan, instrument, registration, camera maps, scene, scenario, fluorophores or dichroics file
    file: PathBuf,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// What was found in a file.
#[derive(Debug, Clone, Serialize)]
pub struct Findings {
    /// The file.
    pub file: PathBuf,
    /// Its kind: `plan`, `instrument`, `registration`, `camera maps`, `scene`, `scenario`, `fluorophores`, `dichroics` or
    /// `parametric-spectra`; `None` if it cannot be told.
    pub kind: Option<&'static str>,
    /// True without any fault.
    pub valid: bool,
    /// All faults in the order of lines.
    pub faults: Vec<Fault>,
}

/// Checks a file.
///
/// # Errors
/// A usage error when it cannot be read as text; its faults are no error here.
pub fn check(file: &Path) -> Result<Findings, AppError> {
    let text = read_text(file, MAX_BYTES)?;
    let is_plan = file.extension().is_some_and(|ending| ["yaml", "yml", "json"].iter().any(|e| ending == *e));
    let kind = if is_plan { Some(&PLAN) } else { kind_of(&text) };
    let faults = match kind {
        Some(kind) => (kind.faults)(file, &text),
        None => unknown_kind(&text),
    };
    Ok(Findings {
        file: file.to_path_buf(),
        kind: kind.map(|kind| kind.name),
        valid: faults.is_empty(),
        faults,
    })
}

/// Runs `check`.
///
/// # Errors
/// A usage error with all faults when there are any.
pub fn run(arguments: &CheckArguments) -> Result<(), AppError> {
    let findings = check(&arguments.file)?;
    let file = findings.file.display();
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&findings).map_err(AppError::data)?);
    }
    let kind = findings.kind.unwrap_or("file");
    match findings.faults.len() {
        0 if arguments.json => Ok(()),
        0 => {
            println!("{file}: a {} without faults", noun(kind));
            Ok(())
        }
        number => {
            let list: String = findings.faults.iter().map(|fault| format!("\n  {fault}")).collect();
            let faults = if number == 1 { "a fault".to_owned() } else { format!("{number} faults") };
            let list = if arguments.json { "" } else { &list };
            Err(AppError::usage(format!("{file}: this {} has {faults}{list}", noun(kind))))
        }
    }
}

fn noun(kind: &str) -> &str {
    match kind {
        "fluorophores" => "list of fluorophores",
        "dichroics" => "list of dichroics",
        "parametric-spectra" => "list of parametric spectra",
        other => other,
    }
}

/// The kind with the most of its keys in the file.
fn kind_of(text: &str) -> Option<&'static Kind> {
    let keys = top_keys(text);
    let matches = |kind: &Kind| kind.keys.iter().filter(|key| keys.iter().any(|found| found == *key)).count();
    KINDS.iter().filter(|kind| matches(kind) > 0).max_by_key(|kind| matches(kind))
}

fn top_keys(text: &str) -> Vec<String> {
    let (document, _) = DeTable::parse_recoverable(text);
    document.get_ref().keys().map(|key| key.get_ref().to_string()).collect()
}

fn unknown_kind(text: &str) -> Vec<Fault> {
    let (_, errors) = DeTable::parse_recoverable(text);
    let line_of =
        |byte: usize| 1 + text.as_bytes()[..byte.min(text.len())].iter().filter(|b| **b == b'\n').count();
    let mut faults: Vec<Fault> = errors
        .iter()
        .map(|error| Fault {
            line: error.span().map(|span| line_of(span.start)),
            key: String::new(),
            message: error.message().to_owned(),
            remedy: "correct the TOML syntax".to_owned(),
        })
        .collect();
    if faults.is_empty() {
        let known = || KINDS.iter().flat_map(|kind| kind.keys.iter().copied());
        let near = top_keys(text).into_iter().find_map(|key| {
            let known = *nearest(&key, known()).first()?;
            Some(format!("write `{known}` for `{key}` if that was meant"))
        });
        faults.push(Fault {
            line: None,
            key: String::new(),
            message: "the file is no scene, instrument, scenario or list of fluorophores or dichroics"
                .to_owned(),
            remedy: near.unwrap_or_else(|| {
                "a scene has `[[species]]`, fluorophores `[[fluorophore]]`, dichroics `[[dichroic]]`"
                    .to_owned()
            }),
        });
    }
    faults
}

fn scene_faults(text: &str) -> Vec<Fault> {
    Scene::from_toml(text).err().map_or_else(Vec::new, |error| error.faults)
}

fn scenario_faults(text: &str) -> Vec<Fault> {
    Scenario::from_toml(text).err().map_or_else(Vec::new, |error| error.faults)
}

/// Checks dichroics against the fluorophores beside them, or the built-in ones; faults of these come first.
fn dichroic_faults(file: &Path, text: &str) -> Vec<Fault> {
    let beside = file.with_file_name("fluorophores.toml");
    let whole = |message: String, remedy: &str| {
        vec![Fault { line: None, key: String::new(), message, remedy: remedy.to_owned() }]
    };
    let fluorophores = match beside.is_file().then(|| read_text(&beside, MAX_BYTES)) {
        None => Catalogue::fluorophores_toml().to_owned(),
        Some(Ok(fluorophores)) => fluorophores,
        Some(Err(error)) => return whole(error.to_string(), "make that file readable or move it away"),
    };
    match Catalogue::from_toml(&fluorophores, text) {
        Ok(_) => Vec::new(),
        Err(error) if error.fluorophores.is_empty() => error.dichroics,
        Err(_) => whole(format!("{} beside it has faults", beside.display()), "check that file first"),
    }
}
