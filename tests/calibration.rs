//! Calibrations of cameras and dyes against the simulated truth, and what analyses make of them.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[path = "calibration/bench.rs"]
mod bench;
#[path = "calibration/camera.rs"]
mod camera;
#[path = "calibration/response.rs"]
mod response;
#[path = "calibration/same_bits.rs"]
mod same_bits;
