//! Which device this is: told by the device itself, never by the order in which ports were found.

use serde::{Deserialize, Serialize};

/// What a device says of itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceIdentity {
    /// Maker.
    pub vendor: String,
    /// Model as the maker names it.
    pub model: String,
    /// Serial number; empty where the device has none to tell.
    pub serial: String,
    /// Firmware or protocol version.
    pub firmware: String,
    /// True for anything that is not the physical device; shown in window, log and recording.
    pub simulated: bool,
}

impl std::fmt::Display for DeviceIdentity {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { vendor, model, serial, simulated, .. } = self;
        write!(formatter, "{vendor} {model}")?;
        if !serial.is_empty() {
            write!(formatter, ", S/N {serial}")?;
        }
        if *simulated { formatter.write_str(" (simulated)") } else { Ok(()) }
    }
}
