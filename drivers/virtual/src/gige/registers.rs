//! The camera's memory: bootstrap registers, features, and the file that describes them.
//!
//! In: reads and writes of the control channel. Out: bytes, and [`Setup`], what the registers ask the camera to do.
//! Never: takes a value that the description does not allow. Fails: with the [`Status`] that a camera answers.

use std::net::Ipv4Addr;
use std::time::Duration;

use super::GigeSettings;
use super::gvcp::{Status, word};
use super::setup::{PixelFormat, Region, Setup, Trigger};

const XML: &str = include_str!("camera.xml");
const XML_AT: usize = 0x1_0000;
/// What the first bytes of the bootstrap registers are, discovery answers with.
pub(super) const DISCOVERY_BYTES: usize = 0xF8;

/// Addresses of the bootstrap registers that do something (GigE Vision 1.2, section 28).
mod bootstrap {
    pub(super) const CURRENT_IP: usize = 0x24;
    pub(super) const XML_URL: usize = 0x200;
    pub(super) const CAPABILITIES: usize = 0x934;
    pub(super) const HEARTBEAT_MS: usize = 0x938;
    pub(super) const TICKS_PER_SECOND: usize = 0x940;
    pub(super) const CONTROL: usize = 0xA00;
    pub(super) const STREAM_PORT: usize = 0xD00;
    pub(super) const PACKET_SIZE: usize = 0xD04;
    pub(super) const PACKET_DELAY: usize = 0xD08;
    pub(super) const STREAM_ADDRESS: usize = 0xD18;
}

/// Addresses of the features, as in `camera.xml`.
mod feature {
    pub(super) const WIDTH: usize = 0x8000;
    pub(super) const HEIGHT: usize = 0x8004;
    pub(super) const LEFT: usize = 0x8008;
    pub(super) const TOP: usize = 0x800C;
    pub(super) const PIXEL_FORMAT: usize = 0x8010;
    pub(super) const MODE: usize = 0x8014;
    pub(super) const ACQUISITION: usize = 0x8018;
    pub(super) const RATE_ENABLE: usize = 0x801C;
    pub(super) const RATE: usize = 0x8020;
    pub(super) const EXPOSURE: usize = 0x8028;
    pub(super) const TRIGGER_MODE: usize = 0x8034;
    pub(super) const TRIGGER_SOURCE: usize = 0x8038;
    pub(super) const TRIGGER_SOFTWARE: usize = 0x8040;
    pub(super) const PAYLOAD: usize = 0x8044;
    pub(super) const EXPOSURE_MODE: usize = 0x8048;
    pub(super) const SENSOR_WIDTH: usize = 0x8050;
    pub(super) const SENSOR_HEIGHT: usize = 0x8054;
    pub(super) const TEMPERATURE: usize = 0x8060;
    pub(super) const PTP_ENABLE: usize = 0x8068;
    pub(super) const PTP_STATUS: usize = 0x806C;
    pub(super) const GREATEST_RATE: usize = 0x8070;
    pub(super) const BEGIN: usize = 0x8000;
    pub(super) const END: usize = 0x8078;
}

/// Bit of the packet size that asks for a test packet.
const FIRE_TEST_PACKET: u32 = 1 << 31;
/// Concatenation, writing of memory; the serial number is told.
const CAPABILITIES: u32 = 1 | 1 << 1 | 1 << 30;
const CAN_RESEND: u32 = 1 << 2;
const EXPOSURES_US: std::ops::RangeInclusive<f64> = 10.0..=1e7;
const SLOWEST_HZ: f64 = 0.1;

/// What a write makes the camera do beside remembering it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Effect {
    None,
    /// Exposures begin or end.
    Acquisition(bool),
    SoftwareTrigger,
    /// A packet of this size is sent once, without meaning.
    TestPacket(usize),
    /// Control is taken (non-zero) or left.
    Control(u32),
}

#[derive(Debug)]
pub(super) struct Registers {
    memory: Vec<u8>,
    row_readout: Duration,
    /// While exposing, the size of frames cannot change.
    pub(super) is_exposing: bool,
}

impl Registers {
    pub(super) fn new(settings: &GigeSettings) -> Self {
        let mut memory = vec![0; XML_AT];
        memory.extend(XML.as_bytes());
        memory.resize(memory.len().next_multiple_of(4), 0);
        let row_readout = settings.row_readout;
        let mut registers = Self { memory, row_readout, is_exposing: false };
        registers.set_up_bootstrap(settings);
        registers.set_up_features(settings);
        registers
    }

    fn set_up_bootstrap(&mut self, settings: &GigeSettings) {
        self.set(0, 0x0001_0002);
        self.set(0x4, 0x8000_0001);
        self.set(0x0C, u32::from(settings.address));
        self.set(0x10, 7);
        self.set(0x14, 5);
        self.set(bootstrap::CURRENT_IP, u32::from(settings.address));
        self.set(0x34, 0xFF00_0000);
        self.set_text(0x48, 32, "sofiscope");
        self.set_text(0x68, 32, "simulated GigE camera");
        self.set_text(0x88, 32, env!("CARGO_PKG_VERSION"));
        self.set_text(0xA8, 48, "simulated, no physical device");
        self.set_text(0xD8, 16, &settings.serial);
        let url = format!("Local:camera.xml;{XML_AT:x};{:x}", XML.len());
        self.set_text(bootstrap::XML_URL, 512, &url);
        self.set(0x600, 1);
        self.set(0x904, 1);
        let resend = if settings.faults.no_resend { 0 } else { CAN_RESEND };
        self.set(bootstrap::CAPABILITIES, CAPABILITIES | resend);
        self.set(bootstrap::HEARTBEAT_MS, 3000);
        self.set(bootstrap::TICKS_PER_SECOND, 1_000_000_000);
        self.set(bootstrap::PACKET_SIZE, 1500);
    }

    fn set_up_features(&mut self, settings: &GigeSettings) {
        let (width, height) = settings.sensor;
        for (at, value) in [
            (feature::SENSOR_WIDTH, width),
            (feature::SENSOR_HEIGHT, height),
            (feature::WIDTH, width),
            (feature::HEIGHT, height),
            (feature::PIXEL_FORMAT, PixelFormat::Mono16 as u32),
            (feature::MODE, 1),
            (feature::EXPOSURE_MODE, 1),
            (feature::PTP_STATUS, 3),
        ] {
            self.set(at, value);
        }
        self.set_float(feature::EXPOSURE, 10_000.0);
        self.set_float(feature::RATE, 25.0);
        self.set_float(feature::TEMPERATURE, 31.5);
        self.update();
    }

    /// What follows from the other registers.
    fn update(&mut self) {
        let num_bytes = self.format().num_bytes(self.region().num_pixels());
        self.set(feature::PAYLOAD, u32::try_from(num_bytes).unwrap_or(u32::MAX));
        let readout = self.row_readout * self.get(feature::HEIGHT);
        self.set_float(feature::GREATEST_RATE, 1.0 / readout.as_secs_f64().max(1e-6));
        let ptp = if self.get(feature::PTP_ENABLE) == 1 { 4 } else { 3 };
        self.set(feature::PTP_STATUS, ptp);
    }

    fn region(&self) -> Region {
        Region {
            left: self.get(feature::LEFT),
            top: self.get(feature::TOP),
            width: self.get(feature::WIDTH),
            height: self.get(feature::HEIGHT),
        }
    }

    fn format(&self) -> PixelFormat {
        PixelFormat::of(self.get(feature::PIXEL_FORMAT)).unwrap_or(PixelFormat::Mono16)
    }

    pub(super) fn setup(&self) -> Setup {
        let trigger = match (self.get(feature::TRIGGER_MODE), self.get(feature::TRIGGER_SOURCE)) {
            (0, _) => Trigger::Off,
            (_, 0) => Trigger::Line,
            _ => Trigger::Software,
        };
        let exposure = Duration::from_secs_f64(self.float(feature::EXPOSURE) * 1e-6);
        let limited = self.get(feature::RATE_ENABLE) == 1;
        let greatest = self.float(feature::GREATEST_RATE);
        let rate = if limited { self.float(feature::RATE).min(greatest) } else { greatest };
        let port = u16::try_from(self.get(bootstrap::STREAM_PORT) & 0xFFFF).unwrap_or(0);
        Setup {
            region: self.region(),
            format: self.format(),
            exposure,
            period: Duration::from_secs_f64(1.0 / rate).max(exposure),
            trigger,
            destination: (Ipv4Addr::from(self.get(bootstrap::STREAM_ADDRESS)), port),
            packet_size: (self.get(bootstrap::PACKET_SIZE) & 0xFFFF) as usize,
            packet_delay: Duration::from_nanos(self.get(bootstrap::PACKET_DELAY).into()),
        }
    }

    pub(super) fn heartbeat(&self) -> Duration {
        Duration::from_millis(self.get(bootstrap::HEARTBEAT_MS).into())
    }

    /// Who has control: 0 nobody.
    pub(super) fn set_control(&mut self, privilege: u32) {
        self.set(bootstrap::CONTROL, privilege);
    }

    pub(super) fn read(&self, address: u32, num_bytes: usize) -> Result<&[u8], Status> {
        let first = address as usize;
        if !first.is_multiple_of(4) {
            return Err(Status::BadAlignment);
        }
        self.memory.get(first..first + num_bytes).ok_or(Status::InvalidAddress)
    }

    /// Takes four or eight bytes, the latter for numbers with a fraction.
    pub(super) fn write(&mut self, address: u32, bytes: &[u8]) -> Result<Effect, Status> {
        let at = address as usize;
        if let Ok(bytes) = <[u8; 8]>::try_from(bytes) {
            self.write_float(at, f64::from_be_bytes(bytes))?;
            return Ok(Effect::None);
        }
        if bytes.len() != 4 {
            return Err(Status::InvalidParameter);
        }
        let value = word(bytes).ok_or(Status::InvalidParameter)?;
        let effect = self.effect(at, value)?;
        self.set(at, value);
        self.update();
        Ok(effect)
    }

    fn effect(&self, at: usize, value: u32) -> Result<Effect, Status> {
        let may = |allowed: bool| if allowed { Ok(Effect::None) } else { Err(Status::InvalidParameter) };
        let shapes_frames = matches!(
            at,
            feature::WIDTH | feature::HEIGHT | feature::LEFT | feature::TOP | feature::PIXEL_FORMAT
        );
        if self.is_exposing && shapes_frames {
            return Err(Status::WriteProtect);
        }
        let fits = |most: usize, beside: usize, least: u32| {
            let free = self.get(most).saturating_sub(self.get(beside));
            may((least..=free).contains(&value) && value.is_multiple_of(4))
        };
        match at {
            bootstrap::CONTROL => Ok(Effect::Control(value)),
            bootstrap::PACKET_SIZE if value & FIRE_TEST_PACKET != 0 => {
                Ok(Effect::TestPacket((value & 0xFFFF) as usize))
            }
            bootstrap::PACKET_SIZE => may((576..=16_000).contains(&(value & 0xFFFF))),
            bootstrap::HEARTBEAT_MS
            | bootstrap::STREAM_PORT
            | bootstrap::STREAM_ADDRESS
            | bootstrap::PACKET_DELAY
            | 0xD1C => Ok(Effect::None),
            feature::WIDTH => fits(feature::SENSOR_WIDTH, feature::LEFT, 4),
            feature::HEIGHT => fits(feature::SENSOR_HEIGHT, feature::TOP, 4),
            feature::LEFT => fits(feature::SENSOR_WIDTH, feature::WIDTH, 0),
            feature::TOP => fits(feature::SENSOR_HEIGHT, feature::HEIGHT, 0),
            feature::PIXEL_FORMAT => may(PixelFormat::of(value).is_some()),
            feature::ACQUISITION => Ok(Effect::Acquisition(value != 0)),
            feature::TRIGGER_SOFTWARE => Ok(Effect::SoftwareTrigger),
            feature::PAYLOAD
            | feature::SENSOR_WIDTH
            | feature::SENSOR_HEIGHT
            | feature::PTP_STATUS
            | feature::TEMPERATURE => Err(Status::WriteProtect),
            other if (feature::BEGIN..feature::END).contains(&other) => Ok(Effect::None),
            _ => Err(Status::WriteProtect),
        }
    }

    fn write_float(&mut self, at: usize, value: f64) -> Result<(), Status> {
        let allowed = match at {
            feature::EXPOSURE => EXPOSURES_US,
            feature::RATE => SLOWEST_HZ..=self.float(feature::GREATEST_RATE),
            _ => return Err(Status::WriteProtect),
        };
        if !allowed.contains(&value) {
            return Err(Status::InvalidParameter);
        }
        self.set_float(at, value);
        Ok(())
    }

    fn get(&self, at: usize) -> u32 {
        word(&self.memory[at..]).unwrap_or(0)
    }

    fn set(&mut self, at: usize, value: u32) {
        self.memory[at..at + 4].copy_from_slice(&value.to_be_bytes());
    }

    fn float(&self, at: usize) -> f64 {
        self.memory[at..].first_chunk().map_or(0.0, |bytes| f64::from_be_bytes(*bytes))
    }

    fn set_float(&mut self, at: usize, value: f64) {
        self.memory[at..at + 8].copy_from_slice(&value.to_be_bytes());
    }

    fn set_text(&mut self, at: usize, length: usize, text: &str) {
        let bytes = text.bytes().take(length - 1).chain(std::iter::repeat(0));
        for (cell, byte) in self.memory[at..at + length].iter_mut().zip(bytes) {
            *cell = byte;
        }
    }
}
