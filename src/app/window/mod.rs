//! `live`: the window, and the session with the instrument behind it.
//!
//! ```text
//! window ─ commands ─► LocalBench ─► session thread ─► sequencer ─► devices
//!    ▲                     └─ STOP, past every queue ─► stage, lasers, sequencer
//!    └─ newest values ◄─ Shared ◄─ Board ◄─ data path: look, preview, numbers
//! ```
//!
//! In: arguments. Out: a window until it is closed. Never: lets drawing hold up the instrument.
//! Fails: [`AppError`](super::AppError) where there is no display.

mod bench;
pub(super) mod board;
mod card;
mod coloring;
mod numbers;
mod recent;
mod registering;
mod save;
mod session;
mod shared;
#[cfg(test)]
mod tests;

use super::AppError;
use super::data_path::yield_to_others;
use crate::viewer::bench::{Activity, Bench, BenchCommand};
use crate::viewer::{Presets, Window, WindowSettings};
use bench::LocalBench;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Where the window keeps how it is arranged.
const STORED: &str = "window";
/// Where it keeps presets.
const STORED_PRESETS: &str = "presets";
/// A window that is closed waits this long for its run to end.
const PATIENCE: Duration = Duration::from_secs(60);
/// A second wish to close within this time is meant.
const TWICE: Duration = Duration::from_secs(5);

/// Arguments of `live`.
#[derive(Debug, Default, clap::Args)]
#[command(after_help = "Examples:
  sofiscope
  sofiscope live --simulated
  sofiscope live --instrument my-microscope.toml

Keys: F1 in the window lists them. STOP is Ctrl+. or Esc twice.")]
pub(super) struct LiveArguments {
    /// Instrument file to open at once
    #[arg(long)]
    instrument: Option<PathBuf>,
    /// Open the simulated microscope at once
    #[arg(long, conflicts_with = "instrument")]
    simulated: bool,
}

/// Opens the window; comes back when it is closed and nothing is under way any more.
///
/// # Errors
/// [`AppError::Device`] where there is no display or no OpenGL.
pub(super) fn run(arguments: &LiveArguments) -> Result<(), AppError> {
    let begun = Instant::now();
    let bench = LocalBench::start()?;
    let first = match &arguments.instrument {
        Some(path) => Some(BenchCommand::OpenInstrument(path.clone())),
        None => arguments.simulated.then_some(BenchCommand::OpenSimulated),
    };
    if let Some(command) = first {
        bench.ask(command).map_err(AppError::usage)?;
    }
    let options = eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title("sofiscope")
            .with_inner_size([1280.0, 800.0])
            .with_min_inner_size([900.0, 600.0]),
        ..eframe::NativeOptions::default()
    };
    let shown = bench.another();
    let done = eframe::run_native(
        "sofiscope",
        options,
        Box::new(move |context| {
            // Instrument and session have their threads already: what draws gives way to them.
            yield_to_others();
            let settings = context.storage.and_then(|storage| eframe::get_value(storage, STORED));
            let settings: WindowSettings = settings.unwrap_or_default();
            let presets = context.storage.and_then(|storage| eframe::get_value(storage, STORED_PRESETS));
            let presets: Presets = presets.unwrap_or_default();
            let bench = shown.another();
            Ok(Box::new(App {
                window: Window::new(Box::new(shown), settings).with_presets(presets),
                bench,
                begun,
                times: Times::default(),
                wished: None,
            }))
        }),
    );
    bench.end();
    wait_for_end(&bench);
    done.map_err(|error| {
        AppError::Device(format!(
            "the window cannot be shown: {error}; it needs a display and OpenGL 2.1. Without them use `sofiscope run`"
        ))
    })
}

/// Frames on their way are still worked on, and files closed, after the window is gone.
fn wait_for_end(bench: &LocalBench) {
    let begun = Instant::now();
    while !matches!(bench.status().activity, Activity::Idle | Activity::Closed) && begun.elapsed() < PATIENCE
    {
        // Nothing will ever come: this is a pause between two looks.
        let _ = crossbeam_channel::after(Duration::from_millis(20)).recv();
    }
}

/// The window in its frame.
struct App {
    window: Window,
    bench: LocalBench,
    begun: Instant,
    times: Times,
    /// When somebody wished to close it during a run.
    wished: Option<Instant>,
}

/// How long the window takes.
#[derive(Debug, Default)]
struct Times {
    /// Seconds of each look.
    looks: Vec<f32>,
    /// The same with the drawing by OpenGL.
    frames: Vec<f32>,
    has_cameras: bool,
    has_result: bool,
}

impl Times {
    fn take(&mut self, window: &Window, since: Duration) {
        self.looks.push(window.took().as_secs_f32());
        // A day at the bench needs no more than the newest hour.
        if self.looks.len() > 200_000 {
            self.looks.drain(..100_000);
            self.frames.drain(..self.frames.len().min(100_000));
        }
        let (result, cameras) = window.has_pictures();
        if cameras && !self.has_cameras {
            tracing::info!("the cameras are in the window {:.2} s after the start", since.as_secs_f64());
        }
        if result && !self.has_result {
            tracing::info!("the result is in the window {:.2} s after the start", since.as_secs_f64());
        }
        (self.has_cameras, self.has_result) = (self.has_cameras | cameras, self.has_result | result);
    }

    fn tell(&mut self) {
        for (what, times) in [("window's thread", &mut self.looks), ("with OpenGL", &mut self.frames)] {
            times.sort_by(f32::total_cmp);
            let at = |share: f64| {
                let place = (times.len().saturating_sub(1) as f64 * share) as usize;
                times.get(place).copied().unwrap_or(0.0) * 1e3
            };
            let (median, slow, number) = (at(0.5), at(0.99), times.len());
            tracing::info!("{number} looks, {what}: median {median:.2} ms, 99th percentile {slow:.2} ms");
        }
    }
}

impl eframe::App for App {
    fn ui(&mut self, ui: &mut egui::Ui, frame: &mut eframe::Frame) {
        if ui.ctx().input_mut(|input| input.consume_key(egui::Modifiers::COMMAND, egui::Key::Q)) {
            ui.ctx().send_viewport_cmd(egui::ViewportCommand::Close);
        }
        if let Some(seconds) = frame.info().cpu_usage {
            self.times.frames.push(seconds);
            self.window.drawn_in(Duration::from_secs_f32(seconds.clamp(0.0, 1.0)));
        }
        let is_closing = ui.ctx().input(|input| input.viewport().close_requested());
        let is_running = matches!(self.bench.status().activity, Activity::Run | Activity::Paused);
        if is_closing && is_running && self.wished.is_none_or(|wished| wished.elapsed() > TWICE) {
            self.wished = Some(Instant::now());
            ui.ctx().send_viewport_cmd(egui::ViewportCommand::CancelClose);
            self.bench.warn("a run is under way: close once more within 5 s to finish it and leave");
        }
        self.window.ui(ui);
        self.times.take(&self.window, self.begun.elapsed());
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        eframe::set_value(storage, STORED, self.window.settings());
        eframe::set_value(storage, STORED_PRESETS, self.window.presets());
    }

    fn on_exit(&mut self, _context: Option<&eframe::glow::Context>) {
        self.times.tell();
    }
}
