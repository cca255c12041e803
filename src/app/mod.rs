//! The composition root: commands, and the only room that knows every other.
//!
//! In: arguments. Out: files, progress on stderr, results on stdout, an exit code.
//! Never: computes an image itself. Fails: [`AppError`], one or two sentences and an exit code.

mod analysis;
mod analysis_arguments;
mod analysis_note;
mod analyze;
pub mod bench;
mod bench_live;
mod calibrate;
mod camera_maps;
pub mod check;
mod cli;
mod data_path;
mod demo;
mod devices;
mod dyes;
mod error;
#[cfg(test)]
mod focus_gate_tests;
mod hardware;
mod instrument;
mod keeping;
mod live_path;
mod mixing;
mod preview_picture;
mod priority;
mod progress;
mod recorder;
mod registering;
mod replay;
mod residual_map;
mod results;
mod run;
pub mod score;
mod session;
pub mod simulate;
mod simulated;
mod simulated_pixels;
mod summary;
mod text_file;
mod virtual_devices;
mod widths;
mod window;

pub use cli::{Arguments, run};
pub use error::AppError;
pub use progress::Progress;
