//! The firmware of the gatekeeper, compiled for this computer: what runs on the board runs here.
//!
//! In: [`Inputs`], one turn of the board's main loop at a time. Out: [`Outputs`]: pins, and bytes to send.
//! Never: reads a clock, waits, knows Rust's side of the protocol: the driver has its own, so that one checks the
//! other. Fails: never; the firmware answers what it does not like, or drops it.
//!
//! The virtual board runs on it, and the tests of the firmware.

mod firmware;
#[cfg(test)]
mod tests;

pub use firmware::Core;

/// Gates of the largest board.
pub const GATES: usize = 8;
/// Analog outputs of the largest board.
pub const LEVELS: usize = 4;
/// Greatest level of an analog output.
pub const LEVEL_MAX: u16 = 4095;
/// Longest line that the board sends.
const LINE: usize = 56;

/// What a board is, and how often it has been switched on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub struct Board {
    /// Number of its own.
    pub serial: u32,
    /// Another number after every reset, never 0.
    pub epoch: u16,
    /// Gates that it has, at most 8.
    pub gates: u8,
    /// Analog outputs that it has, at most 4.
    pub levels: u8,
    simulated: u8,
}

impl Board {
    /// A board that says of itself that it is simulated.
    #[must_use]
    pub fn simulated(serial: u32, epoch: u16, gates: u8, levels: u8) -> Self {
        Self { serial, epoch, gates, levels, simulated: 1 }
    }
}

/// What a board sees in one turn of its main loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Inputs {
    /// Its clock, which begins again after 2³² microseconds.
    pub now_us: u32,
    /// The next byte that has come, if there is one.
    pub byte: Option<u8>,
    /// Whether the interlock lets light out.
    pub interlock_closed: bool,
    /// Whether the camera says that it exposes.
    pub exposing: bool,
}

/// What a board does at the end of a turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub struct Outputs {
    /// Analog outputs, 0 to [`LEVEL_MAX`].
    pub levels: [u16; LEVELS],
    /// Gates that are high: bit 0 for gate 0.
    pub gates: u8,
    pulse: u8,
    num_bytes: u8,
    bytes: [u8; LINE],
}

impl Outputs {
    /// Whether the line that starts exposures is high.
    #[must_use]
    pub fn pulse(&self) -> bool {
        self.pulse != 0
    }

    /// Bytes that the board sends.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.num_bytes)).unwrap_or(&self.bytes)
    }
}
