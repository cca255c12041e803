//! The devices that an instrument file names, opened: lasers and gates through their guard, everything else here.
//!
//! In: an [`Instrument`](crate::config::Instrument). Out: a [`Rig`](super::simulated::Rig) for the sequencer.
//! Never: takes another device for the one named, opens a laser in this process.
//! Fails: [`AppError`](super::AppError) with what was looked for, what was found and what to do.

mod cameras;
mod drive;
mod focus;
mod guarded;
mod lights;
mod open;
mod stage_thread;

pub(super) use focus::FOCUS_SWEEP_NM;
pub(super) use guarded::{GuardArguments, Guarded, run as run_guard};
pub(super) use open::{Opened, home, open, watch_lights};
pub(super) use stage_thread::StageHandle;
