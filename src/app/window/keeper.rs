//! Keeps a window before the instrument: starts its process, serves it, opens another one when it is lost.
//!
//! ```text
//! sofiscope (instrument) ── wire: stdin of the window ──► sofiscope window
//!                        ◄─ STOP: stdout of the window ──┘
//! ```
//!
//! In: a bench. Out: nothing, when the window was closed and nothing is under way any more.
//! Never: ends a run because its window is gone. Fails: [`AppError`] where there is no window to be had.

use super::bench::LocalBench;
use super::serve::{Left, serve};
use crate::app::AppError;
use crate::viewer::bench::{Activity, Bench, Gravity};
use std::io::Result;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// A run whose window was closed has so much time to end.
const PATIENCE: Duration = Duration::from_secs(60);
/// A window that is lost sooner than this will not do better the next time.
const SHORT_LIFE: Duration = Duration::from_secs(5);

/// Shows windows until a person closes one.
///
/// # Errors
/// [`AppError::Device`] where no window can be shown; a run that is under way is finished before.
pub(super) fn keep(bench: &LocalBench) -> std::result::Result<(), AppError> {
    loop {
        let begun = Instant::now();
        let (left, status) = match shown(bench) {
            Ok(gone) => gone,
            Err(error) => return without_window(bench, &format!("no process for it: {error}")),
        };
        match left {
            Left::Closed => {
                bench.end();
                wait_for_end(bench, Some(PATIENCE));
                return Ok(());
            }
            Left::Failed(why) => return without_window(bench, &why),
            Left::Lost { has_looked } if !has_looked || begun.elapsed() < SHORT_LIFE => {
                return without_window(bench, &format!("its process ended at once ({status})"));
            }
            Left::Lost { .. } => {
                end_live(bench);
                let text =
                    format!("the window was lost ({status}); a run goes on, and here is another window");
                bench.tell(Gravity::Error, &text);
            }
        }
    }
}

/// A window from its start to its end.
fn shown(bench: &LocalBench) -> Result<(Left, ExitStatus)> {
    let (mut window, wire, stop) = start()?;
    let left = serve(bench, &wire, stop);
    // A window that is served no more closes itself.
    drop(wire);
    Ok((left, window.wait()?))
}

fn start() -> Result<(Child, UnixStream, UnixStream)> {
    let (wire, of_window) = UnixStream::pair()?;
    let (stop, stop_of_window) = UnixStream::pair()?;
    let window = Command::new(std::env::current_exe()?)
        .arg("window")
        .stdin(Stdio::from(OwnedFd::from(of_window)))
        .stdout(Stdio::from(OwnedFd::from(stop_of_window)))
        .spawn()?;
    Ok((window, wire, stop))
}

/// A live view is there for somebody who looks.
fn end_live(bench: &LocalBench) {
    if bench.status().activity == Activity::Live {
        bench.end();
    }
}

/// A run needs no window: it is carried out to its end.
fn without_window(bench: &LocalBench, why: &str) -> std::result::Result<(), AppError> {
    end_live(bench);
    if matches!(bench.status().activity, Activity::Run | Activity::Ending) {
        tracing::error!("the window cannot be shown: {why}; the run goes on to its end, Ctrl+C ends it now");
    }
    // A run that is held would never end by itself.
    if bench.status().activity == Activity::Paused {
        bench.end();
    }
    wait_for_end(bench, None);
    Err(AppError::Device(format!(
        "the window cannot be shown: {why}; it needs a display and OpenGL 2.1. Without them use `sofiscope run`"
    )))
}

/// Frames on their way are still worked on, and files closed.
fn wait_for_end(bench: &LocalBench, patience: Option<Duration>) {
    let begun = Instant::now();
    let is_over = || matches!(bench.status().activity, Activity::Idle | Activity::Closed);
    while !is_over() && patience.is_none_or(|patience| begun.elapsed() < patience) {
        // Nothing will ever come: this is a pause between two looks.
        let _ = crossbeam_channel::after(Duration::from_millis(20)).recv();
    }
}
