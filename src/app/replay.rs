//! `replay`: a recording or foreign files through mock cameras into the very same pipeline.

use super::AppError;
use super::analysis::{self, Prepared};
use super::analysis_arguments::AnalysisArguments;
use super::analysis_note::{self, AnalysisNote};
use super::camera_maps::MapsPlace;
use super::live_path::PathOptions;
use super::run::free_name;
use super::session::{Ended, acquire, analysis_of, write};
use super::simulated;
use crate::acquisition::{FocusGauge, LeaveOut, Loss, Patience};
use crate::config::{AnalysisSettings, RawAnalysis};
use crate::control::contracts::NoLasers;
use crate::control::plan::{AcquisitionEvent, RecordingFormat};
use crate::control::sequencer::{CameraStation, Devices};
use crate::files::ImageStack;
use crate::replay::{Replay, ReplayControl, ReplayOptions, ReplaySpeed, open};
use serde::Serialize;
use sofiscope_hal::{Camera, Channel};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Result files that must come out the same.
const COMPARED: [&str; 6] = ["mean", "variance", "cumulants", "unmixed", "flattened", "linearized"];

/// Arguments of `replay`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope replay cell-3
  sofiscope replay cell-3 --speed max --verify
  sofiscope replay r.tif t.tif --period-ms 20 --species \"Alexa Fluor 488,Atto 565\" --dichroic \"zt 594 RDC\"
  sofiscope replay cell.dcimg other.dcimg --speed 4

Exit codes: 0 as recorded, 2 usage, 3 the replay failed on its way, 4 damaged files or results that differ.")]
pub(super) struct ReplayArguments {
    /// A recording, or the stack of camera R, or one stack with both cameras
    recording: PathBuf,
    /// The stack of camera T
    transmission: Option<PathBuf>,
    /// 1 for the original timing, a multiple of it, or max for as fast as possible
    #[arg(long, default_value = "1")]
    speed: String,
    /// First exposure to play
    #[arg(long, default_value_t = 0)]
    start: u64,
    /// Time from exposure to exposure of files that do not say it, milliseconds
    #[arg(long)]
    period_ms: Option<f64>,
    /// Prove that the results equal the recorded ones, bit by bit; plays as fast as possible
    #[arg(long, conflicts_with_all = ["start", "transmission"])]
    verify: bool,
    #[command(flatten)]
    analysis: AnalysisArguments,
    /// Directory for the results; must not exist [default: sofiscope-replay, or the next free one]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// What scripts are told at the end.
#[derive(Debug, Serialize)]
struct Replayed {
    #[serde(flatten)]
    ended: Ended,
    /// Whether every result has the same bits; missing without `--verify`.
    #[serde(skip_serializing_if = "Option::is_none")]
    verified: Option<bool>,
}

/// What to play and how to analyze it.
pub(super) struct ReplayRequest<'a> {
    pub(super) paths: &'a [PathBuf],
    pub(super) options: ReplayOptions,
    /// Settings that win over those of the recording.
    pub(super) settings: RawAnalysis,
    /// Whether the analysis leaves out what the live analysis had to leave out.
    pub(super) as_live: bool,
}

/// Runs `replay`.
///
/// # Errors
/// [`AppError`]: files that cannot be read, settings that do not fit, results that differ.
pub(super) fn run(arguments: &ReplayArguments) -> Result<(), AppError> {
    let paths: Vec<PathBuf> =
        std::iter::once(&arguments.recording).chain(&arguments.transmission).cloned().collect();
    let out = match (&arguments.out, arguments.verify) {
        (Some(out), _) => out.clone(),
        (None, _) => free_name("sofiscope-replay"),
    };
    let speed = if arguments.verify { ReplaySpeed::Max } else { speed_of(&arguments.speed)? };
    let request = ReplayRequest {
        paths: &paths,
        options: ReplayOptions {
            speed,
            start: arguments.start,
            period: period_of(arguments.period_ms)?,
            ..ReplayOptions::default()
        },
        settings: arguments.analysis.raw(),
        as_live: true,
    };
    let (mut ended, results, summary) = play(request, &out)?;
    let differences = if arguments.verify { Some(compare(&arguments.recording, &results)?) } else { None };
    ended.results = Some(results.clone());
    let verified = differences.as_ref().map(Vec::is_empty);
    if arguments.json {
        println!("{}", serde_json::to_string(&Replayed { ended, verified }).map_err(AppError::data)?);
    } else {
        println!("{}; {}", ended.line(), ended.ended);
        summary.print(&results, false)?;
        if verified == Some(true) {
            println!("verified: every result has the same bits as the recorded one");
        }
    }
    match differences {
        Some(differences) if !differences.is_empty() => Err(AppError::Data(format!(
            "the replay differs from the recorded results: {}; the files were changed, or another version made them",
            differences.join("; ")
        ))),
        _ => Ok(()),
    }
}

/// Files that are ready to be played.
pub(super) struct Playable {
    pub(super) devices: Devices,
    pub(super) options: PathOptions,
    pub(super) event: AcquisitionEvent,
    pub(super) prepared: Prepared,
    /// Whether the frames were simulated.
    pub(super) simulated: bool,
    /// What is played, for people.
    pub(super) description: String,
    /// Play, pause and speed.
    pub(super) control: ReplayControl,
}

/// Opens files as cameras.
///
/// # Errors
/// [`AppError`]: files that cannot be read, settings that do not fit.
pub(super) fn playable(request: ReplayRequest<'_>) -> Result<Playable, AppError> {
    let ReplayRequest { paths, options, settings, as_live } = request;
    let (speed, start) = (options.speed, options.start);
    let replay = open(paths, options).map_err(AppError::data)?;
    let prepared = prepare(&replay, settings, start, &paths[0])?;
    let mut left_out = replay.info.left_out_from(start);
    // What the live analysis had no time for can be analyzed now; what is out of focus stays out.
    left_out.retain(|_, reason| as_live || *reason == Loss::OutOfFocus);
    let leave_out = LeaveOut { exposures: left_out, focus_gate_nm: None };
    let (exposures, simulated) = (replay.info.exposures.saturating_sub(start), replay.info.simulated);
    let description = replay.info.description.clone();
    let recorded = replay.cameras.each_ref().map(crate::replay::ReplayCamera::recorded_settings);
    let options = PathOptions {
        analysis: Some(prepared.clone()),
        preview_every: None,
        patience: if speed == ReplaySpeed::Max { Patience::Patient } else { Patience::Live },
        leave_out,
        focus: FocusGauge::default(),
        recording: None,
        identities: replay.cameras.each_ref().map(|camera| camera.identity().clone()),
        pixel_pitch_nm: Some(prepared.pixel_pitch_nm),
        provenance: Vec::new(),
        pool_frames: None,
        onlooker: None,
    };
    let stations = Channel::BOTH.into_iter().zip(replay.cameras).map(|(channel, camera)| CameraStation {
        channel,
        region: recorded[channel.index()].region,
        camera: Box::new(camera),
    });
    let devices = Devices::new(stations.collect(), None, Box::new(NoLasers), None)
        .with_pacer(Box::new(replay.control.clone()));
    let mut event = simulated::series(recorded[0].period, exposures, RecordingFormat::None);
    event.cameras.exposure = recorded[0].exposure;
    event.cameras.trigger = Some(sofiscope_hal::TriggerMode::FreeRunning);
    let control = replay.control;
    Ok(Playable { devices, options, event, prepared, simulated, description, control })
}

/// Plays files through the pipeline and writes the results into a directory that must not exist.
pub(super) fn play(
    request: ReplayRequest<'_>,
    out: &Path,
) -> Result<(Ended, PathBuf, super::results::Summary), AppError> {
    let Playable { devices, options, event, prepared, simulated, description, .. } = playable(request)?;
    eprintln!("replay: {description}");
    let mut acquired = acquire(devices, options, vec![event])?;
    if let Some(failure) = acquired.failure() {
        return Err(failure);
    }
    let ended = acquired.ended(simulated);
    let series = acquired.results.first_mut().ok_or_else(|| AppError::data("nothing was replayed"))?;
    let analysis = analysis_of(series, prepared)?;
    let (results, summary) = write(&analysis, out, None)?;
    Ok((ended, results, summary))
}

/// Settings as given, else as the recording was analyzed.
fn prepare(replay: &Replay, given: RawAnalysis, start: u64, folder: &Path) -> Result<Prepared, AppError> {
    let info = &replay.info;
    let note = info.provenance.iter().find(|(name, _)| name == analysis_note::FILE);
    let note = note.map(|(_, text)| AnalysisNote::read(text)).transpose()?;
    let raw = match &note {
        Some(note) => given.or(note.settings.clone()),
        None => given,
    };
    let settings = AnalysisSettings::try_from(raw).map_err(AppError::usage)?;
    let input = |role: &str| (role.to_owned(), info.description.clone(), "uint16".to_owned());
    // Foreign files do not know where on the sensor their frames lie.
    let regions =
        replay.cameras.each_ref().map(|camera| note.as_ref().map(|_| camera.recorded_settings().region));
    let kept_maps = |text: &Option<String>| {
        let text = text.clone()?;
        let name = format!("the camera maps of {}", folder.display());
        Some(MapsPlace { text, folder: folder.to_owned(), name })
    };
    let source = analysis::Source {
        inputs: vec![input("camera R"), input("camera T")],
        height: info.height as usize,
        width: info.width as usize,
        frames: info.exposures.saturating_sub(start),
        pixel_pitch_nm: info.pixel_size_nm,
        exposure_ms: (!info.is_period_assumed).then_some(info.period.as_secs_f64() * 1e3),
        simulated: info.simulated,
        species: note.as_ref().map(AnalysisNote::species).transpose()?.flatten(),
        serials: [None, None],
        registration: note.as_ref().and_then(|note| note.registration.clone()),
        calibrations: analysis::Calibrations {
            camera_maps: note.iter().flat_map(|note| &note.camera_maps).map(kept_maps).collect(),
            regions,
            response: note.and_then(|note| note.response),
        },
    };
    Prepared::new(settings, source)
}

fn speed_of(text: &str) -> Result<ReplaySpeed, AppError> {
    if text == "max" {
        return Ok(ReplaySpeed::Max);
    }
    let times = text.parse::<f64>().ok().filter(|times| times.is_finite() && *times > 0.0);
    let refused = || AppError::Usage(format!("--speed {text:?}: give 1, another multiple above 0, or max"));
    times.map(ReplaySpeed::Times).ok_or_else(refused)
}

fn period_of(milliseconds: Option<f64>) -> Result<Option<Duration>, AppError> {
    let seconds = milliseconds.map(|milliseconds| milliseconds / 1e3);
    let duration = seconds.map(Duration::try_from_secs_f64).transpose();
    duration
        .ok()
        .filter(|period| period.is_none_or(|period| !period.is_zero()))
        .ok_or_else(|| AppError::usage("--period-ms needs a time above 0"))
}

/// What differs between the results of a recording and those of its replay.
pub(super) fn compare(recording: &Path, replayed: &Path) -> Result<Vec<String>, AppError> {
    let recorded = recording.join("results");
    if !recorded.is_dir() {
        return Err(AppError::Data(format!(
            "{} has no results to compare with; replay it without --verify",
            recording.display()
        )));
    }
    let mut differences = Vec::new();
    for name in COMPARED {
        let file = format!("{name}.ome.tif");
        let paths = [recorded.join(&file), replayed.join(&file)];
        match paths.each_ref().map(|path| path.exists()) {
            [true, true] => {
                let [before, after] = paths.each_ref().map(|path| pixels(path));
                let (before, after) = (before?, after?);
                let unequal = before.iter().zip(&after).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
                if before.len() != after.len() {
                    differences.push(format!("{file} has another size"));
                } else if unequal > 0 {
                    differences.push(format!("{file}: {unequal} of {} pixels", before.len()));
                }
            }
            [false, false] => {}
            _ => differences.push(format!("{file} is there only once")),
        }
    }
    Ok(differences)
}

/// All pixels of all pages of a result.
fn pixels(path: &Path) -> Result<Vec<f32>, AppError> {
    let mut stack = ImageStack::open(path)?;
    let info = stack.info().clone();
    let mut all = Vec::new();
    for channel in 0..info.channels {
        stack.select_channel(channel)?;
        stack.seek(0)?;
        let mut page = vec![0.0; info.height * info.width];
        while stack.read_values(&mut page)? {
            all.extend_from_slice(&page);
        }
    }
    Ok(all)
}
