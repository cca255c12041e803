//! What the registers ask the camera to do.

use std::net::Ipv4Addr;
use std::time::Duration;

/// Formats of pixels, with their numbers in PFNC 2.4.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub(super) enum PixelFormat {
    Mono8 = 0x0108_0001,
    Mono12 = 0x0110_0005,
    Mono16 = 0x0110_0007,
    Mono12Packed = 0x010C_0006,
    Mono12p = 0x010C_0047,
}

impl PixelFormat {
    pub(super) fn of(number: u32) -> Option<Self> {
        [Self::Mono8, Self::Mono12, Self::Mono16, Self::Mono12Packed, Self::Mono12p]
            .into_iter()
            .find(|format| *format as u32 == number)
    }

    pub(super) fn saturation(self) -> u16 {
        match self {
            Self::Mono8 => 0xFF,
            Self::Mono16 => u16::MAX,
            Self::Mono12 | Self::Mono12Packed | Self::Mono12p => 0xFFF,
        }
    }

    /// Bytes of so many pixels; bits 16 to 23 of the number are the bits of one.
    pub(super) fn num_bytes(self, num_pixels: usize) -> usize {
        let bits = (self as u32 >> 16) as usize & 0xFF;
        (num_pixels * bits).div_ceil(8)
    }
}

/// Part of the sensor that is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Region {
    pub(super) left: u32,
    pub(super) top: u32,
    pub(super) width: u32,
    pub(super) height: u32,
}

impl Region {
    pub(super) fn num_pixels(self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// What starts an exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trigger {
    Off,
    Line,
    Software,
}

/// What the registers ask the camera to do.
#[derive(Debug, Clone, Copy)]
pub(super) struct Setup {
    pub(super) region: Region,
    pub(super) format: PixelFormat,
    pub(super) exposure: Duration,
    pub(super) period: Duration,
    pub(super) trigger: Trigger,
    pub(super) destination: (Ipv4Addr, u16),
    pub(super) packet_size: usize,
    pub(super) packet_delay: Duration,
}
