//! Hamamatsu ORCA-Flash4.0 through DCAM-API 4, opened at run time.
//!
//! ```text
//! libdcamapi.so ─► ffi (unsafe) ─► api: Dcam, Device ─► DcamCamera ─ arm ─► DcamStream ─► frames
//!                                                          └─ properties for the browser
//! ```
//!
//! In: the path of the library, a serial number, settings. Out: cameras behind the contracts of `sofiscope_hal`.
//! Never: links against the library, so that the program runs without it; opens a camera by its place in the
//! list; loses a frame unsaid. Fails: [`DeviceError`](sofiscope_hal::DeviceError) with what to do next.
//!
//! What the code knows of DCAM-API is that on which storm-control, pyLabLib, PYME, python-microscope and
//! areaDetector agree. It was never tried on a camera; the README says what to try first.

mod api;
mod camera;
mod capture;
mod ffi;
mod pair;
mod properties;
mod ring;
mod settings;
mod stream;

pub use api::{DEFAULT_LIBRARY, Dcam};
pub use camera::DcamCamera;
pub use capture::Losses;
pub use pair::{READY_AFTER, arm_both, arm_slave_then_master, give_frame_pulses};
pub use settings::{DcamOptions, Polarity, PulseInput, ReadoutSpeed};
pub use stream::DcamStream;
