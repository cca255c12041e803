//! A simulated GigE Vision camera on an address of this computer, for every driver that speaks the protocol.
//!
//! | file | what |
//! |---|---|
//! | `gvcp` | the control protocol: commands and acknowledgements |
//! | `registers`, `camera.xml` | the camera's memory, and its GenICam description |
//! | `setup` | what the registers ask the camera to do |
//! | `control` | answers commands, knows who has control and for how long |
//! | `exposures` | what starts exposures: the camera's own rate, pulses on the optical table, commands |
//! | `gvsp`, `sending` | frames as packets, with everything that can happen to packets on their way |
//! | `record` | what the camera did to its own frames: the judge in tests |
//!
//! In: commands over UDP, pulses of the [`OpticalTable`], light from a [`FrameSource`]. Out: frames over UDP.
//! Never: pretends to be real: its model says that it is simulated. Fails: when the address is not one of this
//! computer, or taken.
//!
//! Protocol as in GigE Vision 1.2: 16-bit block ids that wrap to 1, no chunks, one stream.

mod control;
mod exposures;
mod gvcp;
mod gvsp;
mod record;
mod registers;
mod sending;
mod setup;
#[cfg(test)]
mod tests;

use std::io;
use std::net::Ipv4Addr;
use std::ops::Range;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

pub use control::GigeCamera;
pub use record::{Damage, Fate, GigeRecord};

use crate::OpticalTable;

/// One exposure that the light is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exposure {
    /// Exposures since the acquisition began; with an external trigger, pulses.
    pub index: u64,
    /// First column of the region that is read.
    pub left: u32,
    /// First row.
    pub top: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Time of the exposure.
    pub time: Duration,
}

/// What the camera sees.
pub trait FrameSource: Send {
    /// Counts of one exposure, row by row; every pixel must be written.
    fn expose(&mut self, exposure: &Exposure, counts: &mut [u16]);
}

impl<F: FnMut(&Exposure, &mut [u16]) + Send> FrameSource for F {
    fn expose(&mut self, exposure: &Exposure, counts: &mut [u16]) {
        self(exposure, counts);
    }
}

/// What goes wrong with a camera; exposures count from the begin of each acquisition.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct GigeFaults {
    /// Packets of a thousand that are lost.
    pub lost_packets_per_thousand: u32,
    /// Packets of a thousand that are sent twice.
    pub doubled_packets_per_thousand: u32,
    /// Packets are shuffled in windows of this many; 0 and 1 leave them in order.
    pub shuffled_packets: usize,
    /// Exposures of which no packet is sent.
    pub lost_frames: Vec<u64>,
    /// Runs of exposures of which no packet is sent.
    pub lost_bursts: Vec<Range<u64>>,
    /// Exposures whose trigger pulse is not seen: no frame, and the counter stays.
    pub missed_triggers: Vec<u64>,
    /// From this exposure on nothing is sent, while the control channel answers.
    pub stall_at: Option<u64>,
    /// From this exposure on neither frames nor answers are sent.
    pub silent_at: Option<u64>,
    /// At this exposure the camera takes control away, as after a heartbeat that was missed, and stops.
    pub control_lost_at: Option<u64>,
    /// At this exposure the counter begins with 1 again.
    pub restart_ids_at: Option<u64>,
    /// The camera does not send packets again.
    pub no_resend: bool,
}

/// Which camera stands on which address.
#[derive(Debug, Clone)]
pub struct GigeSettings {
    /// An address of this computer, one for each camera.
    pub address: Ipv4Addr,
    /// Serial number, at most 15 characters.
    pub serial: String,
    /// Columns and rows of the sensor, multiples of 4.
    pub sensor: (u32, u32),
    /// Time to read one row, which limits the frame rate.
    pub row_readout: Duration,
    /// Block id of the first frame of each acquisition; the default wraps soon.
    pub first_block_id: u16,
    /// Where pulses come from; without it, `Line0` stays silent.
    pub table: Option<OpticalTable>,
    /// What goes wrong.
    pub faults: GigeFaults,
    /// Seed of the chances of `faults`.
    pub seed: u64,
}

impl GigeSettings {
    /// A camera of 256 x 256 pixels without faults.
    #[must_use]
    pub fn new(address: Ipv4Addr, serial: impl Into<String>) -> Self {
        Self {
            address,
            serial: serial.into(),
            sensor: (256, 256),
            row_readout: Duration::from_micros(5),
            first_block_id: 65_400,
            table: None,
            faults: GigeFaults::default(),
            seed: 0,
        }
    }
}

/// Lets a camera live on its address until `over` is raised.
///
/// # Errors
/// When the address is not one of this computer, or taken.
pub fn serve(
    settings: GigeSettings,
    source: impl FrameSource + 'static,
    over: &AtomicBool,
) -> io::Result<()> {
    GigeCamera::open(settings, source)?.serve(over)
}
