//! Lasers without a data link, through gate and level of a trigger controller.
//!
//! | module | what |
//! |---|---|
//! | [`calibration`] | [`Calibration`], a measured table from volts to milliwatts |
//! | [`output`] | [`Output`], the gate and the level of one laser; [`Permitting`], a controller that grants them |
//! | [`driver`] | [`GatedLaser`], the laser behind the contract |
//!
//! In: a calibration, a cap, the wiring of the configuration, and an [`Output`]. Out: [`GatedLaser`].
//! Never: extrapolates a calibration; lets a gate open for a laser that is off; takes an inverted input.
//! Fails: `DeviceError` of the laser, or of the controller.
//!
//! These lasers say nothing: "on" means that the level is applied and the gate may open, and the power is that of
//! the calibration. Key, interlock and emission light of the supply are the only ones who know.

pub mod calibration;
pub mod driver;
pub mod output;

pub use calibration::{Calibration, CalibrationError, CalibrationPoint};
pub use driver::{Drive, GatedLaser, GatedLaserSettings, Polarity};
pub use output::{Output, OutputState, Permission, Permitting, Wiring};
