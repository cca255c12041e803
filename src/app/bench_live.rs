//! `bench --live`: whether this computer keeps up with two cameras: a film loop through the whole pipeline.

use super::AppError;
use super::analysis::{self, Prepared};
use super::live_path::{PathOptions, reason_text};
use super::session::acquire;
use super::simulated;
use crate::acquisition::{LeaveOut, Patience};
use crate::config::{AnalysisSettings, RawAnalysis, TriggerKind};
use crate::control::plan::RecordingFormat;
use serde::Serialize;
use sofiscope_sim::instrument::Pace;
use sofiscope_sim::{Film, InstrumentSettings, Source};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Frames of the film; more than a block, so that nothing stays in a cache from one to the next.
const FILM_FRAMES: usize = 48;

/// What is tried.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct LiveArguments {
    /// Measure the whole pipeline with simulated cameras of this many pixels per side, instead of the engine alone
    #[arg(long, value_name = "SIDE")]
    live: Option<u32>,
    /// Frames per second of each simulated camera
    #[arg(long, default_value_t = 50.0, requires = "live")]
    rate: f64,
    /// Pairs to measure
    #[arg(long, default_value_t = 2000, requires = "live")]
    pairs: u64,
    /// Record into this directory, which must not exist
    #[arg(long, requires = "live")]
    record: Option<PathBuf>,
}

/// What came out.
#[derive(Debug, Clone, Serialize)]
struct LiveMeasurement {
    width: u32,
    height: u32,
    rate_per_second: f64,
    pairs: u64,
    frames_recorded: u64,
    frames_not_recorded: u64,
    pairs_analyzed: u64,
    frames_lost: u64,
    pairs_left_out: u64,
    pictures_per_second: f64,
    picture_binning: usize,
    latency_median_s: Option<f64>,
    latency_p99_s: Option<f64>,
    cpu_seconds_per_second: f64,
}

impl LiveArguments {
    /// Whether the pipeline is to be measured.
    pub(super) fn is_wanted(&self) -> bool {
        self.live.is_some()
    }
}

/// Runs the film loop and says what was lost.
///
/// # Errors
/// [`AppError`] for sizes and rates that make no sense, and defects.
pub(super) fn run(arguments: &LiveArguments, order: usize, json: bool) -> Result<(), AppError> {
    let side = arguments.live.unwrap_or(2048);
    if !((64..=8192).contains(&side) && arguments.rate.is_finite() && arguments.rate > 0.0) {
        return Err(AppError::usage("choose 64 to 8192 pixels per side and a rate above 0"));
    }
    eprintln!(
        "film loop of {FILM_FRAMES} simulated frames of {side} x {side} pixels; no hardware is involved"
    );
    let measurement = measure(side, arguments, order)?;
    if json {
        println!("{}", serde_json::to_string_pretty(&measurement).map_err(AppError::data)?);
        return Ok(());
    }
    let m = &measurement;
    println!(
        "2 x {side} x {side} at {} per second, order {order}: {} pairs, {} frames lost, {} pairs not analyzed, \
         {:.1} pictures per second (binning {}), {:.2} cores used",
        m.rate_per_second,
        m.pairs,
        m.frames_lost,
        m.pairs_left_out,
        m.pictures_per_second,
        m.picture_binning,
        m.cpu_seconds_per_second
    );
    if let (Some(median), Some(p99)) = (m.latency_median_s, m.latency_p99_s) {
        println!(
            "last frame of a subsequence to its picture: median {median:.3} s, 99th percentile {p99:.3} s"
        );
    }
    Ok(())
}

fn measure(side: u32, arguments: &LiveArguments, order: usize) -> Result<LiveMeasurement, AppError> {
    let film = Film::noise(side as usize, side as usize, FILM_FRAMES, 1);
    let prepared = prepared(side, arguments.pairs, order)?;
    let simulation =
        InstrumentSettings { pace: Pace::RealTime { speed: 1.0 }, ..InstrumentSettings::default() };
    let rig = simulated::rig(Source::Film(Arc::new(film)), simulation, TriggerKind::Simulated);
    let recording = arguments.record.as_ref().map(|_| RecordingFormat::OmeTiff);
    let options = PathOptions {
        analysis: Some(prepared),
        preview_every: Some(Duration::from_millis(300)),
        patience: Patience::Live,
        leave_out: LeaveOut::default(),
        focus: rig.facts.focus,
        recording: arguments.record.clone(),
        identities: rig.facts.identities,
        pixel_pitch_nm: None,
        provenance: Vec::new(),
        pool_frames: None,
        onlooker: None,
    };
    let period = Duration::from_secs_f64(1.0 / arguments.rate);
    let event = simulated::series(period, arguments.pairs, recording.unwrap_or(RecordingFormat::None));
    let cpu = cpu_seconds();
    let acquired = acquire(rig.devices, options, vec![event])?;
    for record in acquired.records.iter().filter(|record| !record.reason.is_success()) {
        eprintln!("the run ended early: {}", reason_text(&record.reason));
    }
    let result =
        acquired.results.first().ok_or_else(|| AppError::Device("the run did not begin".to_owned()))?;
    let (report, took) = (&result.report, result.report.seconds.max(1e-3));
    let accounts = &report.dispatch.accounts;
    let mut latencies = report.preview.latencies_s.clone();
    latencies.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let last = latencies.len().checked_sub(1)?;
        latencies.get((share * last as f64).round() as usize).copied()
    };
    Ok(LiveMeasurement {
        width: side,
        height: side,
        rate_per_second: arguments.rate,
        pairs: accounts.pairs,
        frames_recorded: result.recording.as_ref().map_or(0, |recording| recording.recorded.iter().sum()),
        pairs_analyzed: accounts.pairs_analyzed,
        frames_not_recorded: accounts.cameras.iter().flat_map(|camera| camera.unrecorded.values()).sum(),
        frames_lost: accounts.lost_by_reason().values().sum(),
        pairs_left_out: accounts.analysis_left_out.values().sum(),
        pictures_per_second: report.preview.pictures as f64 / took,
        picture_binning: report.preview.binning.map_or(0, crate::sofi::cumulant::Binning::side),
        latency_median_s: quantile(0.5),
        latency_p99_s: quantile(0.99),
        cpu_seconds_per_second: (cpu_seconds() - cpu) / took,
    })
}

fn prepared(side: u32, frames: u64, order: usize) -> Result<Prepared, AppError> {
    let raw = RawAnalysis {
        order: Some(order),
        species: Some(["Alexa Fluor 488", "Atto 565", "Alexa Fluor 647"].map(str::to_owned).to_vec()),
        dichroic: Some("zt 594 RDC".to_owned()),
        ..RawAnalysis::default()
    };
    let input = |role: &str| (role.to_owned(), "simulated: film loop".to_owned(), "uint16".to_owned());
    let source = analysis::Source {
        inputs: vec![input("camera R"), input("camera T")],
        height: side as usize,
        width: side as usize,
        frames,
        pixel_pitch_nm: Some(108.0),
        exposure_ms: None,
        simulated: true,
        species: None,
        serials: [None, None],
        registration: None,
        calibrations: analysis::Calibrations::default(),
    };
    Prepared::new(AnalysisSettings::try_from(raw).map_err(AppError::usage)?, source)
}

/// Processor time of this program so far, all threads.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
