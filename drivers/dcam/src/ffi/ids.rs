//! Numbers of DCAM-API 4: properties, their values, strings, events.
//!
//! Values as in the public dcamapi4 headers that open drivers mirror.

/// A property of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Id(pub(crate) i32);

impl Id {
    pub(crate) const TRIGGER_SOURCE: Self = Self(0x0010_0110);
    pub(crate) const TRIGGER_ACTIVE: Self = Self(0x0010_0120);
    pub(crate) const TRIGGER_MODE: Self = Self(0x0010_0210);
    pub(crate) const TRIGGER_POLARITY: Self = Self(0x0010_0220);
    pub(crate) const OUTPUT_SOURCE: Self = Self(0x001C_0110);
    pub(crate) const OUTPUT_POLARITY: Self = Self(0x001C_0120);
    pub(crate) const OUTPUT_PERIOD: Self = Self(0x001C_0150);
    pub(crate) const OUTPUT_KIND: Self = Self(0x001C_0160);
    pub(crate) const EXPOSURE_TIME: Self = Self(0x001F_0110);
    pub(crate) const READOUT_SPEED: Self = Self(0x0040_0110);
    pub(crate) const SENSOR_MODE: Self = Self(0x0040_0210);
    pub(crate) const BINNING: Self = Self(0x0040_1110);
    pub(crate) const SUBARRAY_LEFT: Self = Self(0x0040_2110);
    pub(crate) const SUBARRAY_WIDTH: Self = Self(0x0040_2120);
    pub(crate) const SUBARRAY_TOP: Self = Self(0x0040_2130);
    pub(crate) const SUBARRAY_HEIGHT: Self = Self(0x0040_2140);
    pub(crate) const SUBARRAY_MODE: Self = Self(0x0040_2150);
    pub(crate) const READOUT_TIME: Self = Self(0x0040_3010);
    pub(crate) const MIN_TRIGGER_INTERVAL: Self = Self(0x0040_3050);
    pub(crate) const INTERNAL_FRAME_INTERVAL: Self = Self(0x0040_3820);
    pub(crate) const PIXEL_TYPE: Self = Self(0x0042_0270);
    pub(crate) const DEFECT_CORRECT: Self = Self(0x0047_0010);

    /// Distance of the properties of one output connector from those of the next.
    pub(crate) const OUTPUT_STEP: i32 = 0x100;

    /// The same property of the `element`th connector.
    pub(crate) fn element(self, element: u32) -> Self {
        Self(self.0 + Self::OUTPUT_STEP * i32::try_from(element).unwrap_or(0))
    }

    /// What [`Camera::configure`](sofiscope_hal::Camera::configure) sets, and nobody else.
    pub(crate) const MANAGED: [Self; 14] = [
        Self::TRIGGER_SOURCE,
        Self::TRIGGER_ACTIVE,
        Self::TRIGGER_MODE,
        Self::TRIGGER_POLARITY,
        Self::EXPOSURE_TIME,
        Self::READOUT_SPEED,
        Self::SENSOR_MODE,
        Self::BINNING,
        Self::SUBARRAY_LEFT,
        Self::SUBARRAY_WIDTH,
        Self::SUBARRAY_TOP,
        Self::SUBARRAY_HEIGHT,
        Self::SUBARRAY_MODE,
        Self::PIXEL_TYPE,
    ];
}

/// Values of modes.
pub(crate) mod mode {
    pub(crate) const OFF: f64 = 1.0;
    pub(crate) const ON: f64 = 2.0;
    pub(crate) const INTERNAL: f64 = 1.0;
    pub(crate) const EXTERNAL: f64 = 2.0;
    pub(crate) const EDGE: f64 = 1.0;
    pub(crate) const SYNCHRONOUS_READOUT: f64 = 3.0;
    pub(crate) const TRIGGER_NORMAL: f64 = 1.0;
    pub(crate) const TRIGGER_START: f64 = 6.0;
    pub(crate) const NEGATIVE: f64 = 1.0;
    pub(crate) const POSITIVE: f64 = 2.0;
    pub(crate) const AREA: f64 = 1.0;
    pub(crate) const SLOW: f64 = 1.0;
    pub(crate) const FAST: f64 = 2.0;
    pub(crate) const OUTPUT_VSYNC: f64 = 3.0;
    pub(crate) const OUTPUT_PROGRAMMABLE: f64 = 3.0;
}

/// A text that the camera tells of itself.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StringId(pub(crate) i32);

impl StringId {
    pub(crate) const CAMERA_ID: Self = Self(0x0400_0102);
    pub(crate) const VENDOR: Self = Self(0x0400_0103);
    pub(crate) const MODEL: Self = Self(0x0400_0104);
    pub(crate) const CAMERA_VERSION: Self = Self(0x0400_0105);
    pub(crate) const DRIVER_VERSION: Self = Self(0x0400_0106);
}

/// What a wait can be for.
pub(crate) mod event {
    pub(crate) const FRAME_READY: i32 = 0x02;
    pub(crate) const STOPPED: i32 = 0x10;
}

/// Attribute flags of a property.
pub(crate) mod flag {
    pub(crate) const HAS_RANGE: u32 = 0x8000_0000;
    pub(crate) const WRITABLE: u32 = 0x0002_0000;
    pub(crate) const READABLE: u32 = 0x0001_0000;
    pub(crate) const ACCESS_BUSY: u32 = 0x1000;
    pub(crate) const TYPE: u32 = 0xF;
    pub(crate) const TYPE_MODE: u32 = 1;
    pub(crate) const TYPE_LONG: u32 = 2;
}

/// Capturing until stopped.
pub(crate) const SEQUENCE: i32 = -1;
/// 16 bits per pixel.
pub(crate) const MONO16: i32 = 2;
