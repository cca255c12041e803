//! `recover` and `export`: recordings after a crash, and in the other format.

use super::AppError;
use super::camera_maps::copy_kept;
use crate::recording::{Format, export, recover};
use std::path::PathBuf;

/// Arguments of `recover`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope recover 2026-11-22-cell-3

Pixels are never changed. Exit codes: 0 nothing to do, 3 repaired, 1 frames are damaged.")]
pub(super) struct RecoverArguments {
    /// Directory of the recording
    recording: PathBuf,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// Arguments of `export`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope export cell-3 --format ome-zarr --out cell-3-zarr")]
pub(super) struct ExportArguments {
    /// Directory of the recording
    recording: PathBuf,
    /// ome-tiff or ome-zarr
    #[arg(long)]
    format: String,
    /// Directory to create
    #[arg(long)]
    out: PathBuf,
}

/// Runs `recover`; says how it went by the exit code.
///
/// # Errors
/// [`AppError`] when the recording cannot be read at all.
pub(super) fn run_recover(arguments: &RecoverArguments) -> Result<u8, AppError> {
    let report = recover(&arguments.recording).map_err(AppError::data)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&report).map_err(AppError::data)?);
    } else {
        println!("{report}");
    }
    Ok(report.exit_status())
}

/// Runs `export`.
///
/// # Errors
/// [`AppError`]: an unknown format, a recording that cannot be read, a full disk.
pub(super) fn run_export(arguments: &ExportArguments) -> Result<(), AppError> {
    let format = match arguments.format.as_str() {
        "ome-tiff" => Format::OmeTiff,
        "ome-zarr" => Format::OmeZarr,
        other => return Err(AppError::Usage(format!("--format {other:?}: choose ome-tiff or ome-zarr"))),
    };
    let summary = export(&arguments.recording, format, &arguments.out).map_err(AppError::data)?;
    copy_kept(&arguments.recording, &arguments.out)?;
    let [reflected, transmitted] = summary.recorded;
    println!("{}: {reflected} frames of camera R, {transmitted} of camera T", summary.directory.display());
    Ok(())
}
