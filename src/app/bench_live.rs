//! `bench --live`: whether this computer keeps up with two cameras: a film loop through the whole pipeline.

use super::AppError;
use super::analysis::{Prepared, Source};
use super::data_path::{AnalysisPart, DataPathSettings, PreviewPart};
use super::live_run::{self, Devices, RunRequest};
use super::preview_picture::compose;
use crate::acquisition::{LeaveOut, Patience};
use crate::config::{AnalysisSettings, RawAnalysis};
use crate::sofi::cumulant::CumulantEngine;
use serde::Serialize;
use sofiscope_hal::{CameraSettings, Region, TriggerMode};
use sofiscope_sim::instrument::Pace;
use sofiscope_sim::{Film, InstrumentSettings, SimulatedInstrument};
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
}

/// What came out.
#[derive(Debug, Clone, Serialize)]
struct LiveMeasurement {
    width: u32,
    height: u32,
    rate_per_second: f64,
    pairs: u64,
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
    if !(64..=8192).contains(&side) || !(arguments.rate.is_finite() && arguments.rate > 0.0) {
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
    let pixels = (side * side) as usize;
    let film = Film::noise(side as usize, side as usize, FILM_FRAMES, 1);
    let pace = Pace::RealTime { speed: 1.0 };
    let settings =
        InstrumentSettings { pace, exposures: Some(arguments.pairs), ..InstrumentSettings::default() };
    let instrument = SimulatedInstrument::new(film, settings);
    let [reflected, transmitted] = instrument.cameras();
    let mut devices = Devices {
        cameras: [Box::new(reflected), Box::new(transmitted)],
        trigger: Some(Box::new(instrument.trigger())),
    };
    let prepared = prepared(side, arguments.pairs, order)?;
    let engine = CumulantEngine::new(prepared.engine.clone(), side as usize, side as usize);
    let period = Duration::from_secs_f64(1.0 / arguments.rate);
    let region = Region { left: 0, top: 0, width: side, height: side };
    let painter = prepared.clone();
    let request = RunRequest {
        camera: CameraSettings { region, exposure: period, period, trigger: TriggerMode::External },
        exposures: Some(arguments.pairs),
        data_path: DataPathSettings {
            pixels,
            period,
            patience: Patience::Live,
            leave_out: LeaveOut::new(),
            pool_frames: None,
        },
        analysis: Some(AnalysisPart {
            engine: engine.map_err(AppError::usage)?,
            trace_every: u64::MAX,
            preview: Some(PreviewPart {
                every: Duration::from_millis(300),
                fine_pixels: pixels * order * order,
                compose: Box::new(move |snapshot| compose(&painter, snapshot)),
            }),
        }),
        recorder: None,
        watch_silence: true,
    };
    let cpu = cpu_seconds();
    let (report, reason, took) = live_run::run(&mut devices, request, |_| None)?;
    if !report.defects.is_empty() || reason != live_run::FinishReason::Completed {
        eprintln!("{reason:?}; {}", report.defects.join("; "));
    }
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
        pairs_analyzed: accounts.pairs_analyzed,
        frames_lost: accounts.lost_by_reason().values().sum(),
        pairs_left_out: accounts.analysis_left_out.values().sum(),
        pictures_per_second: report.preview.pictures as f64 / took.as_secs_f64(),
        picture_binning: report.preview.binning.map_or(0, crate::sofi::cumulant::Binning::side),
        latency_median_s: quantile(0.5),
        latency_p99_s: quantile(0.99),
        cpu_seconds_per_second: (cpu_seconds() - cpu) / took.as_secs_f64(),
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
    let source = Source {
        inputs: vec![input("camera R"), input("camera T")],
        height: side as usize,
        width: side as usize,
        frames,
        pixel_pitch_nm: Some(108.0),
        exposure_ms: None,
        simulated: true,
        species: None,
    };
    Prepared::new(AnalysisSettings::try_from(raw).map_err(AppError::usage)?, source)
}

/// Processor time of this program so far, all threads.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
