//! `demo`: the simulated two-camera microscope, frame by frame through the engine, scored against the truth.

use super::AppError;
use super::analysis::{Analysis, Prepared, Source, TRACE_POINTS};
use super::data_path::{AnalysisPart, DataPathSettings, PreviewPart};
use super::live_run::{self, Devices, RunRequest};
use super::preview_picture::compose;
use super::progress::Progress;
use super::results::{Scores, ensure_space, species_names, write_results};
use super::score::{Images, Score, Stage, StageImages, score_images, text};
use crate::acquisition::{Accounts, LeaveOut, Patience};
use crate::config::{AnalysisSettings, RawAnalysis};
use crate::files::OutputDirectory;
use crate::report::{Crosstalk, CrosstalkReference, Resolution, ResolutionValue};
use crate::sofi::cumulant::CumulantEngine;
use crate::sofi::spectra::{Species, SpectralResponse};
use serde::Serialize;
use sofiscope_hal::{CameraSettings, Region, TriggerMode};
use sofiscope_sim::instrument::Pace;
use sofiscope_sim::{InstrumentSettings, Scene, SimulatedInstrument, World};
use std::collections::BTreeMap;
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
    /// Directory for the results [default: sofiscope-demo, or the next free sofiscope-demo-N]
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
struct Ended {
    frames_received: u64,
    frames_recorded: u64,
    frames_lost: BTreeMap<String, u64>,
    pairs: u64,
    pairs_analyzed: u64,
    simulated: bool,
    /// The demo does not record yet, it analyzes as the frames come.
    recording: Option<PathBuf>,
    results: PathBuf,
    score: Score,
}

/// Runs `demo`.
///
/// # Errors
/// [`AppError`]: a scene that cannot be used, an output that exists, a full disk.
pub(super) fn run(arguments: &DemoArguments) -> Result<(), AppError> {
    let world = Arc::new(World::new(&scene(arguments)?, arguments.seed));
    let out = OutputDirectory::create(&out_path(arguments))?;
    eprintln!("simulated microscope: {} seen by two cameras; no hardware is involved", world.scene().name());
    let prepared = Prepared::new(settings()?, source(&world)?)?;
    ensure_space(&prepared, &out)?;
    let (analysis, _accounts) = play(&world, prepared, arguments)?;
    let score = score(&world, &analysis)?;
    let command = std::env::args().collect::<Vec<_>>().join(" ");
    let summary = write_results(&analysis, &out, &command, Some(scores(&score)))?;
    let results = out.commit()?;
    if !arguments.json {
        println!("{}", text(&score));
        return summary.print(&results, false);
    }
    let ended = Ended {
        frames_received: 2 * analysis.feed.exposures,
        frames_recorded: 0,
        frames_lost: BTreeMap::new(),
        pairs: analysis.feed.exposures,
        pairs_analyzed: analysis.drawing.samples,
        simulated: true,
        recording: None,
        results,
        score,
    };
    println!("{}", serde_json::to_string(&ended).map_err(AppError::data)?);
    Ok(())
}

/// Plays the scene live: simulated cameras, the pipeline, the running cumulants.
fn play(
    world: &Arc<World>,
    prepared: Prepared,
    arguments: &DemoArguments,
) -> Result<(Analysis, Accounts), AppError> {
    let scene = world.scene();
    let frames = scene.frames();
    let pace = match arguments.speed {
        speed if speed.is_finite() && speed > 0.0 => Pace::RealTime { speed },
        _ => Pace::Unpaced,
    };
    let settings = InstrumentSettings { pace, exposures: Some(frames), ..InstrumentSettings::default() };
    let instrument = SimulatedInstrument::new(sofiscope_sim::Source::World(Arc::clone(world)), settings);
    let [reflected, transmitted] = instrument.cameras();
    let mut devices = Devices {
        cameras: [Box::new(reflected), Box::new(transmitted)],
        trigger: Some(Box::new(instrument.trigger())),
    };
    let period = Duration::from_secs_f64(scene.exposure_ms() / 1e3);
    let region = Region { left: 0, top: 0, width: scene.width_px() as u32, height: scene.height_px() as u32 };
    let engine = CumulantEngine::new(prepared.engine.clone(), scene.height_px(), scene.width_px())
        .map_err(AppError::usage)?;
    let painter = prepared.clone();
    let fine_pixels = scene.num_pixels() * prepared.grid.order().pow(2);
    let request = RunRequest {
        camera: CameraSettings { region, exposure: period, period, trigger: TriggerMode::External },
        exposures: Some(frames),
        data_path: DataPathSettings {
            pixels: scene.num_pixels(),
            period,
            patience: Patience::Live,
            leave_out: LeaveOut::new(),
            pool_frames: None,
        },
        analysis: Some(AnalysisPart {
            engine,
            trace_every: frames.div_ceil(TRACE_POINTS),
            preview: Some(PreviewPart {
                every: Duration::from_millis(250),
                fine_pixels,
                compose: Box::new(move |snapshot| compose(&painter, snapshot)),
            }),
        }),
        recorder: None,
        watch_silence: true,
    };
    let mut progress = Progress::begin("pairs", frames);
    let mut shown = 0;
    let (report, reason, took) = live_run::run(&mut devices, request, |path| {
        let exposures = path.progress().exposures;
        progress.advance(exposures - shown);
        shown = exposures;
        None
    })?;
    progress.finish();
    eprintln!("{reason:?} {:?} {:?} {:?}", report.preview, report.dispatch.accounts, report.defects);
    let live = report.analysis.ok_or_else(|| AppError::data("no analysis"))?;
    Ok((prepared.finish(&live.engine, live.feed, took)?, report.dispatch.accounts))
}

fn scene(arguments: &DemoArguments) -> Result<Scene, AppError> {
    let text = Scene::built_in(SCENE).unwrap_or_default();
    let scene = Scene::from_toml(text).map_err(AppError::usage)?;
    match arguments.frames {
        Some(frames) => scene.with_frames(frames).map_err(AppError::usage),
        None => Ok(scene),
    }
}

/// The directory asked for, or the first of `sofiscope-demo`, `sofiscope-demo-2`, … that is free.
fn out_path(arguments: &DemoArguments) -> PathBuf {
    let name = |number: u32| match number {
        1 => PathBuf::from("sofiscope-demo"),
        more => PathBuf::from(format!("sofiscope-demo-{more}")),
    };
    let free = || (1..).map(name).find(|path| !path.exists());
    arguments.out.clone().or_else(free).unwrap_or_else(|| name(1))
}

fn settings() -> Result<AnalysisSettings, AppError> {
    AnalysisSettings::try_from(RawAnalysis::default()).map_err(AppError::usage)
}

fn source(world: &World) -> Result<Source, AppError> {
    let scene = world.scene();
    let species = |truth: &sofiscope_sim::SpeciesTruth| {
        let response = SpectralResponse::measured(truth.transmission, truth.reflection);
        let response = response.map_err(AppError::usage)?;
        Ok(Species { name: truth.name.clone(), response, emission_nm: Some(truth.emission_nm) })
    };
    let input = |role: &str| (role.to_owned(), format!("simulated: {}", scene.name()), "uint16".to_owned());
    Ok(Source {
        inputs: vec![input("camera R"), input("camera T")],
        height: scene.height_px(),
        width: scene.width_px(),
        frames: scene.frames(),
        pixel_pitch_nm: Some(scene.optics().pixel_pitch_nm),
        exposure_ms: Some(scene.exposure_ms()),
        simulated: true,
        species: Some(world.truth().species.iter().map(species).collect::<Result<_, AppError>>()?),
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
