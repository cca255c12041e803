//! The process of the window: draws what the instrument's process shows, and passes on what is wanted.
//!
//! In: the wire on its standard input, the line of STOP on its standard output. Out: a window until it is closed.
//! Never: holds anything that a run needs. Fails: it tells the instrument why there is no window.

use super::remote::RemoteBench;
use super::wire::FromWindow;
use crate::app::AppError;
use crate::app::data_path::be_nice;
use crate::viewer::bench::{Activity, Bench, Gravity};
use crate::viewer::{Presets, Window, WindowSettings};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

/// Where the window keeps how it is arranged.
const STORED: &str = "window";
/// Where it keeps presets.
const STORED_PRESETS: &str = "presets";
/// What draws gives way to what acquires and analyzes: at 5, a hand was answered twice as fast where all cores are
/// busy, and pairs were left out of the analysis for it.
const NICE: i32 = 10;
/// A second wish to close within this time is meant.
const TWICE: Duration = Duration::from_secs(5);

/// Shows the window until it is closed, or until the instrument is gone.
///
/// # Errors
/// [`AppError::Usage`] when it was not started by an instrument.
pub(in crate::app) fn run() -> Result<(), AppError> {
    let begun = Instant::now();
    // Threads that are started from here on inherit it.
    be_nice(NICE);
    let (wire, stop) = lines()?;
    let (bench, exchange) = RemoteBench::start(wire, stop)?;
    let options = eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title("sofiscope")
            .with_inner_size([1280.0, 800.0])
            .with_min_inner_size([900.0, 600.0]),
        ..eframe::NativeOptions::default()
    };
    let shown = bench.clone();
    let done = eframe::run_native(
        "sofiscope",
        options,
        Box::new(move |context| {
            shown.wake(context.egui_ctx.clone());
            let settings = context.storage.and_then(|storage| eframe::get_value(storage, STORED));
            let settings: WindowSettings = settings.unwrap_or_default();
            let presets = context.storage.and_then(|storage| eframe::get_value(storage, STORED_PRESETS));
            let presets: Presets = presets.unwrap_or_default();
            let window = Window::new(Box::new(shown.clone()), settings).with_presets(presets);
            Ok(Box::new(App { window, bench: shown, begun, times: Times::default(), wished: None }))
        }),
    );
    bench.leave(match done {
        Ok(()) => FromWindow::Closed,
        Err(error) => FromWindow::Failed(error.to_string()),
    });
    // The farewell is on the wire when its thread ends; what it ends with is of no use any more.
    let _ = exchange.join();
    Ok(())
}

/// The wire and the line of STOP.
fn lines() -> Result<(UnixStream, UnixStream), AppError> {
    let by_hand = || AppError::usage("`sofiscope window` is started by `sofiscope live`, never by hand");
    let owned = |line: std::os::fd::BorrowedFd<'_>| {
        let line = UnixStream::from(line.try_clone_to_owned().ok()?);
        line.peer_addr().is_ok().then_some(line)
    };
    let wire = owned(std::io::stdin().as_fd()).ok_or_else(by_hand)?;
    let stop = owned(std::io::stdout().as_fd()).ok_or_else(by_hand)?;
    Ok((wire, stop))
}

/// The window in its frame.
struct App {
    window: Window,
    bench: RemoteBench,
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
        let quits = ui.ctx().input_mut(|input| input.consume_key(egui::Modifiers::COMMAND, egui::Key::Q));
        if quits || self.bench.is_gone() {
            ui.ctx().send_viewport_cmd(egui::ViewportCommand::Close);
        }
        if let Some(seconds) = frame.info().cpu_usage {
            self.times.frames.push(seconds);
            self.window.drawn_in(Duration::from_secs_f32(seconds.clamp(0.0, 1.0)));
        }
        let is_closing = ui.ctx().input(|input| input.viewport().close_requested());
        let is_running = matches!(self.bench.status().activity, Activity::Run | Activity::Paused);
        if is_closing
            && is_running
            && !self.bench.is_gone()
            && self.wished.is_none_or(|wished| wished.elapsed() > TWICE)
        {
            self.wished = Some(Instant::now());
            ui.ctx().send_viewport_cmd(egui::ViewportCommand::CancelClose);
            let text = "a run is under way: close once more within 5 s to finish it and leave";
            self.bench.tell(Gravity::Warning, text);
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
