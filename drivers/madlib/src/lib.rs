//! Mad City Labs Nano-Drive through Madlib, opened at run time.
//!
//! ```text
//! libmadlib.so ─► ffi (unsafe) ─► Madlib ─► NanoDrive: FocusDrive, Properties
//! ```
//!
//! In: the path of the library, the configured travel, targets in nanometers. Out: a focus drive.
//! Never: links against the library; moves by itself. Fails: [`DeviceError`](sofiscope_hal::DeviceError).
//!
//! Functions and codes as in Madlib.h of the BSD-licensed Micro-Manager adapter MCL_NanoDrive. It was never tried on
//! a device; the README says what to try first.

mod drive;
mod ffi;
mod library;

pub use drive::{NanoDrive, NanoDriveOptions, SlowCalls};
pub use library::{DEFAULT_LIBRARY, Madlib};
