//! `demo`: the simulated two-camera microscope, frame by frame through the engine, scored against the truth.

use super::AppError;
use super::analysis::{self, Analysis, Prepared};
use super::analysis_note::AnalysisNote;
use super::instrument::species_of;
use super::live_path::PathOptions;
use super::results::{Scores, species_names};
use super::run::free_name;
use super::score::{Images, Score, Stage, StageImages, score_images, text};
use super::session::{Ended, acquire, analysis_of, write, write_preview};
use super::simulated;
use crate::acquisition::LeaveOut;
use crate::config::{AnalysisSettings, RawAnalysis, TriggerKind};
use crate::control::plan::RecordingFormat;
use crate::report::{Crosstalk, CrosstalkReference, Resolution, ResolutionValue};
use serde::Serialize;
use sofiscope_sim::instrument::Pace;
use sofiscope_sim::{InstrumentSettings, Scene, Source, World};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// The scene that the demo plays: three crossing filaments (paper, Fig. S4).
const SCENE: &str = "figure-s4";

/// Arguments of `demo`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope demo
  sofiscope demo --frames 1000 --seed 7 --out my-demo --json")]
pub(super) struct DemoArguments {
    /// Frames of each camera [default: those of the scene, 4000]
    #[arg(long)]
    frames: Option<u64>,
    /// Seed of the simulated sample and its noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Directory for recording and results [default: sofiscope-demo, or the next free sofiscope-demo-N]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Speed of the simulated microscope; 1 is real time
    #[arg(long, default_value_t = 2.0)]
    speed: f64,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// What scripts are told at the end.
#[derive(Debug, Serialize)]
struct Scored {
    #[serde(flatten)]
    ended: Ended,
    score: Score,
}

/// Runs `demo`.
///
/// # Errors
/// [`AppError`]: a scene that cannot be used, an output that exists, a full disk.
pub(super) fn run(arguments: &DemoArguments) -> Result<(), AppError> {
    let world = Arc::new(World::new(&scene(arguments)?, arguments.seed));
    let out = arguments.out.clone().unwrap_or_else(|| free_name("sofiscope-demo"));
    eprintln!("simulated microscope: {} seen by two cameras; no hardware is involved", world.scene().name());
    let prepared = Prepared::new(settings()?, source(&world)?)?;
    let pace = if arguments.speed > 0.0 && arguments.speed.is_finite() {
        Pace::RealTime { speed: arguments.speed }
    } else {
        Pace::Unpaced
    };
    let simulation = InstrumentSettings { pace, ..InstrumentSettings::default() };
    let rig = simulated::rig(Source::World(Arc::clone(&world)), simulation, TriggerKind::Simulated);
    let options = PathOptions {
        analysis: Some(prepared.clone()),
        preview_every: Some(Duration::from_millis(250)),
        patience: simulated::patience_of(pace),
        leave_out: LeaveOut::default(),
        focus: rig.facts.focus,
        recording: Some(out.clone()),
        identities: rig.facts.identities,
        pixel_pitch_nm: Some(prepared.pixel_pitch_nm),
        provenance: vec![AnalysisNote::of(&RawAnalysis::default(), &prepared).file()?],
        pool_frames: None,
        onlooker: None,
    };
    let period = Duration::from_secs_f64(world.scene().exposure_ms() / 1e3);
    let event = simulated::series(period, world.scene().frames(), RecordingFormat::OmeTiff);
    let mut acquired = acquire(rig.devices, options, vec![event])?;
    if let Some(failure) = acquired.failure() {
        return Err(failure);
    }
    let mut ended = acquired.ended(true);
    let series = acquired.results.first_mut().ok_or_else(|| AppError::data("the demo made no series"))?;
    write_preview(series, &out)?;
    let analysis = analysis_of(series, prepared)?;
    let score = score(&world, &analysis)?;
    let (results, summary) = write(&analysis, &out.join("results"), Some(scores(&score)))?;
    if !arguments.json {
        println!("{}", text(&score));
        println!("{}", ended.line());
        return summary.print(&results, false);
    }
    ended.results = Some(results);
    println!("{}", serde_json::to_string(&Scored { ended, score }).map_err(AppError::data)?);
    Ok(())
}

fn scene(arguments: &DemoArguments) -> Result<Scene, AppError> {
    let text = Scene::built_in(SCENE).unwrap_or_default();
    let scene = Scene::from_toml(text).map_err(AppError::usage)?;
    match arguments.frames {
        Some(frames) => scene.with_frames(frames).map_err(AppError::usage),
        None => Ok(scene),
    }
}

fn settings() -> Result<AnalysisSettings, AppError> {
    AnalysisSettings::try_from(RawAnalysis::default()).map_err(AppError::usage)
}

fn source(world: &World) -> Result<analysis::Source, AppError> {
    let scene = world.scene();
    let input = |role: &str| (role.to_owned(), format!("simulated: {}", scene.name()), "uint16".to_owned());
    Ok(analysis::Source {
        inputs: vec![input("camera R"), input("camera T")],
        height: scene.height_px(),
        width: scene.width_px(),
        frames: scene.frames(),
        pixel_pitch_nm: Some(scene.optics().pixel_pitch_nm),
        exposure_ms: Some(scene.exposure_ms()),
        simulated: true,
        species: Some(species_of(world)?),
        serials: [None, None],
        registration: None,
        calibrations: analysis::Calibrations::default(),
    })
}

fn score(world: &World, analysis: &Analysis) -> Result<Score, AppError> {
    let Some(stages) = &analysis.stages else {
        return Err(AppError::data("the demo has no species images to score"));
    };
    let planes = |images: &'_ [ndarray::Array2<f32>]| -> Vec<Vec<f32>> {
        images.iter().map(|image| image.iter().copied().collect()).collect()
    };
    let all = [
        (Stage::Unmixed, planes(&stages.unmixed)),
        (Stage::Flattened, planes(&stages.flattened)),
        (Stage::Linearized, planes(&stages.linearized)),
    ];
    let borrowed: Vec<(Stage, Vec<&[f32]>)> =
        all.iter().map(|(stage, planes)| (*stage, planes.iter().map(Vec::as_slice).collect())).collect();
    let stages: Vec<StageImages<'_>> =
        borrowed.iter().map(|(stage, planes)| StageImages { stage: *stage, planes }).collect();
    let n = analysis.prepared.grid.order();
    let species = species_names(analysis);
    let images = Images {
        species: &species,
        height: analysis.prepared.source.height * n,
        width: analysis.prepared.source.width * n,
        stages: &stages,
    };
    score_images(&world.truth(), &images)
}

/// The score as the report shows it.
fn scores(score: &Score) -> Scores {
    let matrix = |stage| score.crosstalk_percent.get(stage).cloned().unwrap_or_default();
    let reference = score.paper.as_ref().map(|paper| CrosstalkReference {
        source: format!("paper, {}", paper.table),
        linearized: paper.crosstalk_percent.clone(),
    });
    let widths = score.resolution_nm.get(Stage::Linearized).into_iter().flatten();
    let values = score
        .species
        .iter()
        .zip(widths)
        .map(|(species, width)| ResolutionValue {
            image: species.clone(),
            method: "width of the filament at half maximum".to_owned(),
            nanometers: width.unwrap_or(f64::NAN),
        })
        .collect();
    Scores {
        crosstalk: Some(Crosstalk {
            species: score.species.clone(),
            flattened: matrix(Stage::Flattened),
            linearized: matrix(Stage::Linearized),
            reference,
        }),
        resolution: Some(Resolution { values, curves: Vec::new() }),
    }
}
