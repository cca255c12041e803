//! Which camera, and what the contract of cameras has no words for.

use std::net::Ipv4Addr;
use std::time::Duration;

/// Where a camera is looked for; its serial number decides in any case.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Find {
    /// Among all cameras that answer on this computer's networks and USB ports.
    BySerial,
    /// At this address; the way for computers with several networks.
    At(Ipv4Addr),
}

/// Which camera to open, and how.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GenicamSettings {
    /// The camera as the person knows it, for example `camera R`.
    pub name: String,
    /// The serial number that it must have.
    pub serial: String,
    /// Where it is looked for.
    pub find: Find,
    /// Format of pixels by its SFNC name; `None` for the one with the most bits.
    pub pixel_format: Option<String>,
    /// What external triggers arrive on: `Line0`, `Line1`, ..., or `Software`.
    pub trigger_source: String,
    /// Bytes of a packet on the network; `None` for the largest that gets through.
    pub packet_size: Option<u32>,
    /// Pause between two packets of the camera, for switches that lose packets.
    pub packet_delay: Duration,
    /// Id of the first frame after arming, where the camera is known to begin with the same one each time.
    /// A lost first frame is then noticed.
    pub first_block_id: Option<u64>,
    /// Whether lost packets are asked for again.
    pub resend: bool,
}

impl GenicamSettings {
    /// The camera with this serial number, wherever it is.
    #[must_use]
    pub fn new(name: impl Into<String>, serial: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            serial: serial.into(),
            find: Find::BySerial,
            pixel_format: None,
            trigger_source: "Line0".to_owned(),
            packet_size: None,
            packet_delay: Duration::ZERO,
            first_block_id: None,
            resend: true,
        }
    }

    /// The same camera, looked for at one address.
    #[must_use]
    pub fn at(self, address: Ipv4Addr) -> Self {
        Self { find: Find::At(address), ..self }
    }
}
