//! `calibrate`: what must be known of an instrument before its images can be believed, one file per procedure.
//!
//! | what | file |
//! |---|---|
//! | where camera R sees what camera T sees | `registration.rs`, `found.rs`, `correlated.rs`, `statistics.rs`, `frames.rs` |
//! | offset, gain, read noise and faults of every pixel | `camera.rs` |
//! | shares of each dye's light in both cameras | `response.rs` |
//!
//! In: frames. Out: a file with provenance. Never: overwrites a file.
//! Fails: [`AppError`] with what to change; then nothing is written.

mod camera;
mod correlated;
pub(super) mod found;
pub(super) mod frames;
mod registration;
mod response;
mod source;
mod statistics;

use super::AppError;
use super::analyze::open_stacks;
use super::text_file::read_text;
use crate::config::Instrument;
use crate::files::ImageStack;
use std::path::{Path, PathBuf};

/// Longest instrument file that is read.
const MOST_BYTES: u64 = 4 << 20;

/// Arguments of `calibrate`.
#[derive(Debug, clap::Args)]
#[command(arg_required_else_help = true)]
pub(super) struct CalibrateArguments {
    #[command(subcommand)]
    what: Calibration,
}

#[derive(Debug, clap::Subcommand)]
enum Calibration {
    /// Where camera R sees what camera T sees
    Registration(registration::RegistrationArguments),
    /// Offset, gain, read noise and faults of every pixel of a camera
    Camera(camera::CameraArguments),
    /// Shares of each dye's light that reach both cameras
    Response(response::ResponseArguments),
}

/// Runs `calibrate`.
///
/// # Errors
/// [`AppError`]: what is wrong with the arguments, the frames or the disk; then nothing is written.
pub(super) fn run(arguments: &CalibrateArguments) -> Result<(), AppError> {
    match &arguments.what {
        Calibration::Registration(arguments) => registration::run(arguments),
        Calibration::Camera(arguments) => camera::run(arguments),
        Calibration::Response(arguments) => response::run(arguments),
    }
}

fn instrument(path: &Path) -> Result<Instrument, AppError> {
    let text = read_text(path, MOST_BYTES)?;
    Instrument::from_toml(&text).map_err(|faults| AppError::Usage(format!("{}: {faults}", path.display())))
}

/// Refuses to write over files.
fn vacant<'a>(paths: impl IntoIterator<Item = &'a PathBuf>) -> Result<(), AppError> {
    match paths.into_iter().find(|path| path.exists()) {
        Some(path) => Err(AppError::Usage(format!("{} exists; give --out another name", path.display()))),
        None => Ok(()),
    }
}

/// The stacks of the cameras of two files, of one file with both, or of a recording or a simulated measurement.
fn open(reflection: &Path, transmission: Option<&Path>) -> Result<Vec<ImageStack>, AppError> {
    if transmission.is_none() && reflection.is_dir() {
        let [r, t] = ["reflection.ome.tif", "transmission.ome.tif"].map(|name| reflection.join(name));
        return open_stacks(&r, Some(&t));
    }
    open_stacks(reflection, transmission)
}
