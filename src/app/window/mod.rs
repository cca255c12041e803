//! `live`: the window, and the session with the instrument behind it, in a process each.
//!
//! ```text
//! window ─► RemoteBench ═ wire ═► serve ─► LocalBench ─► session thread ─► sequencer ─► devices
//!    ▲          ║                                └─ STOP, past every queue ─► stage, lasers, sequencer
//!    └─ newest values ◄══ wire ══ Shared ◄─ Board ◄─ data path: look, preview, numbers
//! ```
//!
//! In: arguments. Out: a window until it is closed. Never: lets drawing hold up the instrument, ends a run because
//! its window is gone. Fails: [`AppError`](super::AppError) where there is no display.

mod bench;
pub(super) mod board;
mod card;
mod coloring;
mod keeper;
mod numbers;
mod recent;
mod registering;
mod remote;
mod save;
mod screen;
mod serve;
mod session;
mod shared;
#[cfg(test)]
mod tests;
mod wire;

pub(super) use screen::run as run_window;

use super::AppError;
use crate::viewer::bench::{Bench, BenchCommand};
use bench::LocalBench;
use std::path::PathBuf;

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
    let bench = LocalBench::start()?;
    let first = match &arguments.instrument {
        Some(path) => Some(BenchCommand::OpenInstrument(path.clone())),
        None => arguments.simulated.then_some(BenchCommand::OpenSimulated),
    };
    if let Some(command) = first {
        bench.ask(command).map_err(AppError::usage)?;
    }
    keeper::keep(&bench)
}
