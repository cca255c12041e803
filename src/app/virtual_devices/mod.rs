//! Virtual devices: each a program of its own behind a pseudo-terminal or a network address, all on one optical table.
//!
//! In: an instrument file with `[virtual]`. Out: devices that real drivers open. Never: answers for real hardware.
//! Fails: [`AppError`](super::AppError) with the port or address that could not be had.

mod device;
mod sample;
mod up;

pub(super) use device::{DeviceArguments, run};
pub(super) use up::VirtualInstrument;

use std::path::{Path, PathBuf};

use super::AppError;
use super::text_file::read_text;
use crate::config::{Instrument, VirtualEntry};

/// Longest instrument file that is read.
const MOST_BYTES: u64 = 1 << 20;

/// The file of the table that all devices of an instrument share.
fn table_path(directory: &Path) -> PathBuf {
    directory.join("table")
}

/// The log that is the judge of one device.
fn log_path(directory: &Path, device: &str) -> PathBuf {
    directory.join(format!("{device}.log"))
}

/// Reads an instrument file that names virtual devices.
fn read(path: &Path) -> Result<(Instrument, VirtualEntry), AppError> {
    let text = read_text(path, MOST_BYTES)?;
    let instrument = Instrument::from_toml(&text)
        .map_err(|faults| AppError::Usage(format!("{}: {faults}", path.display())))?;
    let entry = instrument.hardware().virtual_devices.clone().ok_or_else(|| {
        AppError::Usage(format!(
            "{}: has no `[virtual]` table; only virtual devices can be started, as in config/virtual.toml",
            path.display()
        ))
    })?;
    Ok((instrument, entry))
}

/// Names of the devices of an instrument, as `virtual-device` knows them.
fn names(instrument: &Instrument) -> Vec<String> {
    let hardware = instrument.hardware();
    let mut names = Vec::new();
    if hardware.gates.is_some() {
        names.push("gates".to_owned());
    }
    names.extend(hardware.lasers.iter().map(|laser| format!("laser-{}", laser.wavelength_nm)));
    if hardware.stage.is_some() {
        names.push("stage".to_owned());
    }
    names.extend(["camera-reflected", "camera-transmitted"].map(ToOwned::to_owned));
    if hardware.focus.is_some() {
        names.push("focus-camera".to_owned());
    }
    names
}
