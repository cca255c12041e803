//! `run`: a plan carried out without a window: pre-flight, acquisition, live analysis, recording, results.

use super::AppError;
use super::analysis::{self, Prepared};
use super::analysis_note::AnalysisNote;
use super::instrument::{MOST_BYTES, OpenInstrument, Sample};
use super::live_path::PathOptions;
use super::results::Summary;
use super::session::{Acquired, Ended, acquire, analysis_of, write, write_preview};
use super::simulated::RigFacts;
use super::text_file::read_text;
use crate::acquisition::{LeaveOut, Patience};
use crate::config::{AnalysisSettings, Instrument, RawAnalysis};
use crate::control::plan::{Plan, RecordingFormat};
use crate::control::preflight::{Check, Facts, may_begin, preflight};
use crate::recording::disk_rate;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Bytes written to find out what the disk can take.
const DISK_TRIAL_BYTES: u64 = 128 << 20;

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
    opened: OpenInstrument,
    source: analysis::Source,
}

/// Runs `run`.
///
/// # Errors
/// [`AppError`]: what is wrong with plan, instrument, devices, disk or data.
pub(super) fn run(arguments: &RunArguments) -> Result<(), AppError> {
    let out = arguments.out.clone().unwrap_or_else(|| free_name("sofiscope-run"));
    let setup = set_up(arguments)?;
    let prepared = prepare(&setup)?;
    let rate = disk_rate(&out, DISK_TRIAL_BYTES).ok();
    let facts = setup.opened.about.facts(&setup.plan, &setup.source, &prepared, &out, rate)?;
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
    let Setup { plan, texts, opened, .. } = setup;
    let OpenInstrument { devices, about } = opened;
    let mut provenance = texts;
    provenance.push(AnalysisNote::of(plan.analysis(), &prepared).file()?);
    let options = PathOptions {
        recording: Some(out.clone()),
        provenance,
        ..path_options(&prepared, &about.facts, about.patience)
    };
    if plan.recording() == RecordingFormat::None {
        std::fs::create_dir(&out).map_err(|error| AppError::Usage(format!("{}: {error}", out.display())))?;
    }
    let mut acquired = acquire(devices, options, plan.events().collect())?;
    let Kept { ended, summaries, failure } = keep(&mut acquired, &prepared, &out)?;
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

/// The way of the frames of a run; nothing is recorded unless a directory is given.
pub(super) fn path_options(prepared: &Prepared, facts: &RigFacts, patience: Patience) -> PathOptions {
    PathOptions {
        analysis: Some(prepared.clone()),
        preview_every: Some(Duration::from_millis(300)),
        patience,
        leave_out: LeaveOut::default(),
        focus: facts.focus.clone(),
        recording: None,
        identities: facts.identities.clone(),
        pixel_pitch_nm: Some(prepared.pixel_pitch_nm),
        provenance: Vec::new(),
        pool_frames: None,
        onlooker: None,
    }
}

/// What is left of a run when its files are written.
pub(super) struct Kept {
    pub(super) ended: Ended,
    /// Directory and summary of the results of each series that has some.
    pub(super) summaries: Vec<(PathBuf, Summary)>,
    /// Why the run did not end as planned.
    pub(super) failure: Option<AppError>,
}

/// Writes the images of every series into the directory of the run.
///
/// # Errors
/// [`AppError`]: a full disk; too few exposures for an image in a run that ended as planned.
pub(super) fn keep(acquired: &mut Acquired, prepared: &Prepared, out: &Path) -> Result<Kept, AppError> {
    let mut ended = acquired.ended(prepared.source.simulated);
    let failure = acquired.failure();
    let mut summaries = Vec::new();
    for (number, series) in acquired.results.iter_mut().enumerate() {
        write_preview(series, out)?;
        let name = if number == 0 { "results".to_owned() } else { format!("results-{}", number + 1) };
        match analysis_of(series, prepared.clone()) {
            Ok(analysis) => summaries.push(write(&analysis, &out.join(name), None)?),
            // After a failure the recording matters more than images of its beginning.
            Err(error) if failure.is_some() => eprintln!("no images: {error}"),
            Err(error) => return Err(error),
        }
    }
    ended.results = summaries.first().map(|(directory, _)| directory.clone());
    Ok(Kept { ended, summaries, failure })
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
    let frames = plan.exposures_per_series();
    let opened = OpenInstrument::open(&instrument, &instrument_text, &instrument_path, Sample::Once(frames))?;
    for notice in
        opened.about.label.notice().into_iter().chain(opened.about.warnings.iter().map(String::as_str))
    {
        eprintln!("{notice}");
    }
    let source = opened.about.source(&plan);
    let texts = vec![("plan.yaml".to_owned(), plan_text), ("instrument.toml".to_owned(), instrument_text)];
    Ok(Setup { plan, texts, opened, source })
}

fn prepare(setup: &Setup) -> Result<Prepared, AppError> {
    let raw: RawAnalysis = setup.plan.analysis().clone();
    let settings = AnalysisSettings::try_from(raw).map_err(AppError::usage)?;
    Prepared::new(settings, setup.source.clone())
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
