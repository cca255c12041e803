//! Toptica iBEAM smart diode lasers over a serial line.
//!
//! | module | what |
//! |---|---|
//! | [`driver`] | [`IbeamSmart`], the laser behind the contract |
//! | `link` | one exchange at a time, in step with the laser, or none |
//! | `reply` | what an answer says, and whether it is one |
//!
//! In: a line, the wavelength, the serial number and the cap of the configuration. Out: [`IbeamSmart`].
//! Never: sends a power above its cap; believes an answer that may belong to another question; stays on after
//! three answers that were none, or when it is dropped. Fails: `DeviceError`; the laser has then been told to be dark.
//!
//! Protocol: manual as quoted in python-microscope, recorded exchanges of PyMeasure, adapters of Micro-Manager.

pub mod driver;
mod link;
mod properties;
mod reply;

pub use driver::{IbeamSettings, IbeamSmart, Modulation};

use sofiscope_serial_line::LineSettings;

/// The bytes that make it dark, for whoever holds the line when nothing else can: all channels, then the master switch.
pub const DARK: &[u8] = b"di 0\r\nla off\r\n";

/// The two commands of [`DARK`].
const CHANNELS_OFF: &[u8] = b"di 0\r\n";
const MASTER_OFF: &[u8] = b"la off\r\n";

/// How its bytes stand on the wire: 115200 8N1.
#[must_use]
pub fn line_settings() -> LineSettings {
    LineSettings::new(115_200)
}
