//! Opens the cameras.

use sofiscope_dcam::{Dcam, DcamCamera, DcamOptions};
use sofiscope_hal::Camera;
#[cfg(feature = "aravis")]
use std::net::Ipv4Addr;
use std::path::Path;

use super::super::AppError;
use crate::config::{CameraEntry, CameraKind};

/// Opens one camera; its serial number decides, wherever it is found.
///
/// # Errors
/// [`AppError::Device`] with what was looked for and what was found.
pub(super) fn open(entry: &CameraEntry) -> Result<Box<dyn Camera>, AppError> {
    let serial = entry.serial.clone().unwrap_or_default();
    match entry.kind {
        CameraKind::Genicam => genicam(&entry.channel.to_string(), &serial, entry.address.as_deref()),
        CameraKind::Dcam => {
            let library = Dcam::open(entry.library.as_deref().map(Path::new))?;
            Ok(Box::new(DcamCamera::open(&library, &serial, DcamOptions::default())?))
        }
        CameraKind::Simulated => Err(AppError::Usage(format!(
            "{} is simulated and the other is not; name two simulated cameras, or none",
            entry.channel
        ))),
    }
}

/// Opens a GenICam camera.
///
/// # Errors
/// [`AppError::Device`]; always, in a program that was built without Aravis.
#[cfg(feature = "aravis")]
pub(super) fn genicam(name: &str, serial: &str, address: Option<&str>) -> Result<Box<dyn Camera>, AppError> {
    use sofiscope_genicam::{GenicamCamera, GenicamSettings};
    let settings = GenicamSettings::new(name, serial);
    let settings = match address {
        None => settings,
        Some(address) => settings.at(address.parse::<Ipv4Addr>().map_err(|_| {
            AppError::Usage(format!("{name}: address {address} is no IPv4 address such as 192.168.0.2"))
        })?),
    };
    let camera = GenicamCamera::open(settings)?;
    for advice in camera.advice() {
        tracing::warn!("{name}: {advice}");
    }
    Ok(Box::new(camera))
}

#[cfg(not(feature = "aravis"))]
pub(super) fn genicam(name: &str, serial: &str, _address: Option<&str>) -> Result<Box<dyn Camera>, AppError> {
    Err(AppError::Device(format!(
        "{name} (GenICam, S/N {serial}): this program was built without GenICam; install libaravis-dev and build \
         it with `cargo build --release --features aravis`"
    )))
}
