//! `run`: a plan carried out without a window: pre-flight, acquisition, live analysis, recording, results.

use super::AppError;
use super::analysis::{self, Prepared};
use super::analysis_note::AnalysisNote;
use super::hardware;
use super::live_path::PathOptions;
use super::session::{acquire, analysis_of, write, write_preview};
use super::simulated::{self, Rig};
use super::text_file::read_text;
use crate::acquisition::{LeaveOut, Patience, Surroundings};
use crate::config::{AnalysisSettings, CameraKind, Instrument, RawAnalysis, Simulation};
use crate::control::plan::{Plan, RecordingFormat};
use crate::control::preflight::{
    AnalysisFacts, CameraFacts, Check, DiskFacts, Facts, MemoryFacts, may_begin, preflight,
};
use crate::files::free_bytes;
use crate::recording::disk_rate;
use crate::sofi::spectra::{Species, SpectralResponse};
use serde::Serialize;
use sofiscope_hal::{CameraIdentity, Channel, TriggerMode};
use sofiscope_sim::instrument::Pace;
use sofiscope_sim::{Film, InstrumentSettings, Scenario, Scene, Source, World};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Longest plan and instrument file that is read.
const MOST_BYTES: u64 = 1 << 20;

/// Exposures that an analysis without a certain end is prepared for.
const NO_CERTAIN_END: u64 = 1 << 40;

/// Bytes written to find out what the disk can take.
const DISK_TRIAL_BYTES: u64 = 128 << 20;

/// Bytes of running sums per camera pixel at order 2, from the tests of the engine; higher orders need more.
const STATE_BYTES_PER_PIXEL: u64 = 70;

/// Arguments of `run`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope run config/plans/quick-look.yaml --out look
  sofiscope run plan.yaml --instrument my-microscope.toml --dry-run
  sofiscope run plan.yaml --json > run.json

Ctrl-C ends the run in good order; Ctrl-C again ends it at once. Exit codes: 0 as planned, 2 a plan or instrument
file that cannot be used, 3 a device or the disk failed during the run, 4 too few data for images,
5 the lasers were taken away for safety.")]
pub(super) struct RunArguments {
    /// Plan (YAML or JSON)
    plan: PathBuf,
    /// Instrument file; without it the simulated microscope is used, and said so everywhere
    #[arg(long)]
    instrument: Option<PathBuf>,
    /// Directory for recording and results; must not exist [default: sofiscope-run, or the next free sofiscope-run-N]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Only check whether the run can work
    #[arg(long)]
    dry_run: bool,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// What a dry run tells scripts.
#[derive(Debug, Serialize)]
struct DryRun<'a> {
    may_begin: bool,
    exposures_per_series: Option<u64>,
    series: usize,
    seconds: Option<f64>,
    planned_bytes: Option<u64>,
    checks: &'a [Check],
}

/// A plan and an instrument that fit each other.
struct Setup {
    plan: Plan,
    texts: Vec<(String, String)>,
    rig: Rig,
    source: analysis::Source,
    patience: Patience,
}

/// Runs `run`.
///
/// # Errors
/// [`AppError`]: what is wrong with plan, instrument, devices, disk or data.
pub(super) fn run(arguments: &RunArguments) -> Result<(), AppError> {
    let out = arguments.out.clone().unwrap_or_else(|| free_name("sofiscope-run"));
    let setup = set_up(arguments)?;
    let prepared = prepare(&setup)?;
    let facts = facts(&setup, &prepared, &out)?;
    let checks = preflight(&facts);
    for check in &checks {
        eprintln!("{check}");
    }
    if arguments.dry_run {
        return tell_dry_run(&setup.plan, &facts, &checks, arguments.json);
    }
    if !may_begin(&checks) {
        return Err(AppError::usage("the run cannot begin; see the failed checks above"));
    }
    let Setup { plan, texts, rig, patience, source } = setup;
    let mut provenance = texts;
    provenance.push(AnalysisNote::of(plan.analysis(), &prepared).file()?);
    let options = PathOptions {
        analysis: Some(prepared.clone()),
        preview_every: Some(Duration::from_millis(300)),
        patience,
        leave_out: LeaveOut::default(),
        focus: rig.focus,
        recording: Some(out.clone()),
        identities: rig.identities,
        pixel_pitch_nm: Some(prepared.pixel_pitch_nm),
        provenance,
        pool_frames: None,
    };
    if plan.recording() == RecordingFormat::None {
        std::fs::create_dir(&out).map_err(|error| AppError::Usage(format!("{}: {error}", out.display())))?;
    }
    let mut acquired = acquire(rig.devices, options, plan.events().collect())?;
    let mut ended = acquired.ended(source.simulated);
    let failure = acquired.failure();
    let mut summaries = Vec::new();
    for (number, series) in acquired.results.iter_mut().enumerate() {
        write_preview(series, &out)?;
        let name = if number == 0 { "results".to_owned() } else { format!("results-{}", number + 1) };
        match analysis_of(series, prepared.clone()) {
            Ok(analysis) => summaries.push(write(&analysis, &out.join(name), None)?),
            // After a failure the recording matters more than images of its beginning.
            Err(error) if failure.is_some() => eprintln!("no images: {error}"),
            Err(error) => return Err(error),
        }
    }
    ended.results = summaries.first().map(|(directory, _)| directory.clone());
    if arguments.json {
        println!("{}", serde_json::to_string(&ended).map_err(AppError::data)?);
    } else {
        println!("{}; {}", ended.line(), ended.ended);
        for (directory, summary) in summaries {
            summary.print(&directory, false)?;
        }
    }
    failure.map_or(Ok(()), Err)
}

/// The first of `name`, `name-2`, … that is free.
pub(super) fn free_name(name: &str) -> PathBuf {
    let numbered = |number: u32| match number {
        1 => PathBuf::from(name),
        more => PathBuf::from(format!("{name}-{more}")),
    };
    (1..).map(numbered).find(|path| !path.exists()).unwrap_or_else(|| numbered(1))
}

fn set_up(arguments: &RunArguments) -> Result<Setup, AppError> {
    let refused = |path: &Path, faults: &dyn std::fmt::Display| {
        AppError::Usage(format!("{}: {faults}", path.display()))
    };
    let plan_text = read_text(&arguments.plan, MOST_BYTES)?;
    let plan = Plan::from_text(&plan_text).map_err(|faults| refused(&arguments.plan, &faults))?;
    let (instrument_text, instrument_path) = match &arguments.instrument {
        Some(path) => (read_text(path, MOST_BYTES)?, path.clone()),
        None => {
            eprintln!(
                "no instrument file was given: the SIMULATED microscope is used; no hardware is involved"
            );
            (Instrument::simulated_toml().to_owned(), PathBuf::from("the built-in simulated instrument"))
        }
    };
    let instrument =
        Instrument::from_toml(&instrument_text).map_err(|faults| refused(&instrument_path, &faults))?;
    let misfits = plan.misfits(&instrument);
    if !misfits.is_empty() {
        let list: Vec<String> = misfits.iter().map(ToString::to_string).collect();
        return Err(refused(&arguments.plan, &list.join("; ")));
    }
    let is_simulated = instrument.cameras().iter().any(|camera| camera.kind == CameraKind::Simulated);
    let (rig, mut source, patience) = if is_simulated {
        open(&plan, &instrument, &instrument_path)?
    } else {
        open_hardware(&plan, &instrument, &instrument_text)?
    };
    if let Some(file) = instrument.registration_file() {
        let beside = instrument_path.parent().unwrap_or(Path::new("")).join(file);
        source.registration = Some(read_text(&beside, MOST_BYTES)?);
    }
    let texts = vec![("plan.yaml".to_owned(), plan_text), ("instrument.toml".to_owned(), instrument_text)];
    Ok(Setup { plan, texts, rig, source, patience })
}

/// Opens the devices that the instrument file names, real or virtual.
fn open_hardware(
    plan: &Plan,
    instrument: &Instrument,
    text: &str,
) -> Result<(Rig, analysis::Source, Patience), AppError> {
    let hardware::Opened { rig, is_virtual, .. } = hardware::open(instrument, text)?;
    if is_virtual {
        eprintln!("all devices are VIRTUAL: no hardware is involved, and what the cameras show is simulated");
    }
    let region = plan
        .region(Channel::Reflected)
        .or(instrument.camera(Channel::Reflected).and_then(|camera| camera.region));
    let (width, height) = region.map_or(rig.sensors[0], |region| (region.width, region.height));
    let identities = rig.identities.clone();
    let input = |role: &str, index: usize| {
        let CameraIdentity { vendor, model, serial, .. } = &identities[index];
        (role.to_owned(), format!("{vendor} {model}, S/N {serial}"), "uint16".to_owned())
    };
    let source = analysis::Source {
        inputs: vec![input("camera R", 0), input("camera T", 1)],
        height: height as usize,
        width: width as usize,
        frames: plan.exposures_per_series().unwrap_or(NO_CERTAIN_END),
        pixel_pitch_nm: Some(instrument.pixel_pitch_nm()),
        exposure_ms: Some(plan.cameras().period.as_secs_f64() * 1e3),
        simulated: is_virtual,
        species: None,
        serials: identities.each_ref().map(|identity| Some(identity.serial.clone())),
        registration: None,
    };
    Ok((rig, source, Patience::Live))
}

/// Opens the simulated devices that the instrument file names.
fn open(
    plan: &Plan,
    instrument: &Instrument,
    path: &Path,
) -> Result<(Rig, analysis::Source, Patience), AppError> {
    let kinds = Channel::BOTH.map(|channel| instrument.camera(channel).map(|camera| camera.kind));
    let [Some(CameraKind::Simulated), Some(CameraKind::Simulated)] = kinds else {
        return Err(AppError::Device(format!(
            "{}: only cameras of kind \"simulated\", and two of them, can be opened by this version",
            path.display()
        )));
    };
    let simulation = instrument.simulation().ok_or_else(|| {
        AppError::Usage(format!("{}: simulated cameras need a [simulation] table", path.display()))
    })?;
    let exposures = plan.exposures_per_series().unwrap_or(NO_CERTAIN_END);
    let (source, scene, world) = sample(simulation, exposures)?;
    let pace =
        if simulation.speed > 0.0 { Pace::RealTime { speed: simulation.speed } } else { Pace::Unpaced };
    let seed = simulation.seed.unwrap_or_else(|| scene.seed());
    let settings = InstrumentSettings { pace, seed, ..faults(simulation, path)? };
    let rig = simulated::rig(source, settings, instrument.trigger());
    for channel in Channel::BOTH {
        let wanted = instrument.camera(channel).and_then(|camera| camera.serial.clone());
        let found = &rig.identities[channel.index()].serial;
        if let Some(wanted) = wanted.filter(|wanted| wanted != found) {
            return Err(AppError::Device(format!(
                "{channel}: serial {wanted} is expected and {found} was found; exchange the cables or correct {}",
                path.display()
            )));
        }
    }
    let region =
        plan.region(Channel::Reflected).or(instrument.camera(Channel::Reflected).and_then(|c| c.region));
    let input = |role: &str| (role.to_owned(), format!("simulated: {}", scene.name()), "uint16".to_owned());
    let source = analysis::Source {
        inputs: vec![input("camera R"), input("camera T")],
        height: region.map_or(scene.height_px(), |region| region.height as usize),
        width: region.map_or(scene.width_px(), |region| region.width as usize),
        frames: exposures,
        pixel_pitch_nm: Some(instrument.pixel_pitch_nm()),
        exposure_ms: Some(plan.cameras().period.as_secs_f64() * 1e3),
        simulated: true,
        species: Some(species_of(&world)?),
        serials: rig.identities.each_ref().map(|identity| Some(identity.serial.clone())),
        registration: None,
    };
    Ok((rig, source, simulated::patience_of(pace)))
}

/// The simulated sample: a world, or a film of its beginning that is played again and again.
fn sample(simulation: &Simulation, exposures: u64) -> Result<(Source, Scene, Arc<World>), AppError> {
    let text = match Scene::built_in(&simulation.scene) {
        Some(text) => text.to_owned(),
        None => read_text(Path::new(&simulation.scene), MOST_BYTES)?,
    };
    let scene = Scene::from_toml(&text).map_err(|e| AppError::Usage(format!("{}: {e}", simulation.scene)))?;
    let seed = simulation.seed.unwrap_or_else(|| scene.seed());
    let frames = simulation.film_frames.unwrap_or(exposures);
    let scene =
        if frames == NO_CERTAIN_END { scene } else { scene.with_frames(frames).map_err(AppError::usage)? };
    let world = Arc::new(World::new(&scene, seed));
    let source = match simulation.film_frames {
        Some(frames) => {
            Source::Film(Arc::new(Film::render(&world, frames as usize).map_err(AppError::usage)?))
        }
        None => Source::World(Arc::clone(&world)),
    };
    Ok((source, scene, world))
}

/// The faults that the simulated devices shall show.
fn faults(simulation: &Simulation, path: &Path) -> Result<InstrumentSettings, AppError> {
    let (text, place) = match (&simulation.fault_scenario, &simulation.faults) {
        (Some(file), _) => {
            let beside = path.parent().unwrap_or(Path::new("")).join(file);
            (read_text(&beside, MOST_BYTES)?, beside)
        }
        (None, Some(table)) => {
            let mut whole = toml::Table::new();
            whole.insert("faults".to_owned(), toml::Value::Table(table.clone()));
            (whole.to_string(), path.to_path_buf())
        }
        (None, None) => return Ok(InstrumentSettings::default()),
    };
    let scenario = Scenario::from_toml(&text);
    scenario
        .map(Scenario::into_settings)
        .map_err(|error| AppError::Usage(format!("{}: {error}", place.display())))
}

/// The species of a simulated sample, as their response was simulated.
pub(super) fn species_of(world: &World) -> Result<Vec<Species>, AppError> {
    let species = |truth: &sofiscope_sim::SpeciesTruth| {
        let response = SpectralResponse::measured(truth.transmission, truth.reflection);
        let response = response.map_err(AppError::usage)?;
        Ok(Species { name: truth.name.clone(), response, emission_nm: Some(truth.emission_nm) })
    };
    world.truth().species.iter().map(species).collect()
}

fn prepare(setup: &Setup) -> Result<Prepared, AppError> {
    let raw: RawAnalysis = setup.plan.analysis().clone();
    let settings = AnalysisSettings::try_from(raw).map_err(AppError::usage)?;
    Prepared::new(settings, setup.source.clone())
}

fn facts(setup: &Setup, prepared: &Prepared, out: &Path) -> Result<Facts, AppError> {
    let period = setup.plan.cameras().period;
    let (height, width) = (setup.source.height as u32, setup.source.width as u32);
    let camera = |channel: Channel| CameraFacts {
        channel,
        simulated: setup.rig.identities[channel.index()].simulated,
        region: setup.plan.region(channel).unwrap_or(sofiscope_hal::Region {
            left: 0,
            top: 0,
            width,
            height,
        }),
        sensor: setup.rig.sensors[channel.index()],
        exposure: setup.plan.cameras().exposure,
        period,
        shortest_period: setup.rig.shortest_periods[channel.index()],
        trigger: setup.plan.cameras().trigger.unwrap_or(TriggerMode::External),
        saturation_counts: setup.rig.saturation_counts[channel.index()],
        brightest_counts: None,
    };
    let disk = match setup.plan.recording() {
        RecordingFormat::None => None,
        _ => Some(DiskFacts {
            place: out.display().to_string(),
            free_bytes: free_bytes(out)?,
            bytes_per_second: disk_rate(out, DISK_TRIAL_BYTES).ok(),
        }),
    };
    let pixels = u64::from(height) * u64::from(width);
    let path = super::data_path::DataPathSettings {
        pixels: pixels as usize,
        period,
        patience: setup.patience,
        leave_out: LeaveOut::default(),
        surroundings: Surroundings::default(),
        pool_frames: None,
    };
    Ok(Facts {
        cameras: Channel::BOTH.map(camera).to_vec(),
        exposures: setup.plan.exposures_per_series(),
        disk,
        memory: MemoryFacts {
            available_bytes: available_memory(),
            pool_frames: path.frames() as u64,
            analysis_bytes: pixels * STATE_BYTES_PER_PIXEL * (prepared.grid.order() as u64).pow(2) / 4,
        },
        analysis: Some(AnalysisFacts {
            order: prepared.grid.order(),
            species: prepared.species.len(),
            condition: prepared.matrix.as_ref().map(crate::sofi::unmixing::UnmixingMatrix::condition),
            error: None,
            subsequence_exposures: prepared.engine.subsequence,
        }),
        dose_mj: setup.plan.dose_per_series_mj().zip(setup.plan.stop_rule().dose_mj),
    })
}

/// Memory that can be had without swapping, bytes; without an answer from the system, as much as one asks for.
fn available_memory() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let kibibytes = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kibibytes.map_or(u64::MAX, |kibibytes| kibibytes << 10)
}

fn tell_dry_run(plan: &Plan, facts: &Facts, checks: &[Check], json: bool) -> Result<(), AppError> {
    let told = DryRun {
        may_begin: may_begin(checks),
        exposures_per_series: plan.exposures_per_series(),
        series: plan.events().count(),
        seconds: plan.duration().map(|duration| duration.as_secs_f64()),
        planned_bytes: facts.planned_bytes(),
        checks,
    };
    if json {
        println!("{}", serde_json::to_string_pretty(&told).map_err(AppError::data)?);
    } else {
        let exposures =
            told.exposures_per_series.map_or("no certain number of".to_owned(), |n| n.to_string());
        let seconds = told.seconds.map_or(String::new(), |seconds| format!(", {seconds:.0} s"));
        println!("{} series of {exposures} exposures{seconds}", told.series);
    }
    if told.may_begin {
        Ok(())
    } else {
        Err(AppError::usage("the run could not begin; see the failed checks above"))
    }
}
