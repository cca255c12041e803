//! A library like DCAM-API with two simulated ORCA-Flash4.0 behind it, for programs and tests without a camera.
//!
//! ```text
//! dcam… functions ─► exports ─► bench ─► camera 0 (R), camera 1 (T) ─► view of one World
//! commands ───────► remote ────►  └─► trigger line: train, optical table, or the output of camera 0
//! ```
//!
//! In: calls as of DCAM-API 4; `SOFISCOPE_DCAM_SCENE` (what the cameras look at), `SOFISCOPE_DCAM_TABLE` (optical
//! table that gives the pulses), `SOFISCOPE_DCAM_CONTROL` (commands at the start). Out: frames and answers.
//! Never: pretends to be real: vendor, model and versions say that they are simulated.
//! Fails: as the library would; with no camera when an environment variable makes no sense.
//!
//! | module | what |
//! |---|---|
//! | `exports` | the C functions; the only `unsafe` code beside `remote` |
//! | `bench` | handles, waits, both cameras |
//! | `camera`, `capture`, `line` | states and rolling shutter, pure |
//! | `spec`, `settings` | properties as data, their values |
//! | `view` | pixels |
//! | `command`, `remote` | faults and pulses for tests |

mod bench;
mod camera;
mod capture;
mod codes;
mod command;
mod exports;
mod layout;
mod line;
mod remote;
mod settings;
mod spec;
mod view;

pub use remote::{Remote, library};
