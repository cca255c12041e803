//! Answers, properties and flags of DCAM-API 4, as a library has them.
//!
//! Written down a second time on purpose: a wrong number in the driver is not wrong here as well.

/// An answer that is not success.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Code(pub(crate) u32);

impl Code {
    pub(crate) const BUSY: Self = Self(0x8000_0101);
    pub(crate) const ABORT: Self = Self(0x8000_0102);
    pub(crate) const NOTREADY: Self = Self(0x8000_0103);
    pub(crate) const TIMEOUT: Self = Self(0x8000_0106);
    pub(crate) const NOMEMORY: Self = Self(0x8000_0203);
    pub(crate) const NOCAMERA: Self = Self(0x8000_0206);
    pub(crate) const LOSTFRAME: Self = Self(0x8000_0301);
    pub(crate) const TOOFREQUENTTRIGGER: Self = Self(0x8000_0305);
    pub(crate) const INVALIDCAMERA: Self = Self(0x8000_0806);
    pub(crate) const INVALIDHANDLE: Self = Self(0x8000_0807);
    pub(crate) const INVALIDPARAM: Self = Self(0x8000_0808);
    pub(crate) const INVALIDVALUE: Self = Self(0x8000_0821);
    pub(crate) const OUTOFRANGE: Self = Self(0x8000_0822);
    pub(crate) const NOTWRITABLE: Self = Self(0x8000_0823);
    pub(crate) const INVALIDPROPERTYID: Self = Self(0x8000_0825);
    pub(crate) const NOPROPERTY: Self = Self(0x8000_0828);
    pub(crate) const NOVALUETEXT: Self = Self(0x8000_082D);
    pub(crate) const INVALIDFRAMEINDEX: Self = Self(0x8000_0833);
    pub(crate) const FAILREADCAMERA: Self = Self(0x8300_1002);
    pub(crate) const ALREADYOPENED: Self = Self(0xE100_0002);
}

/// What a capture status can be.
pub(crate) mod status {
    pub(crate) const BUSY: i32 = 1;
    pub(crate) const READY: i32 = 2;
    pub(crate) const STABLE: i32 = 3;
}

/// Events.
pub(crate) mod event {
    pub(crate) const FRAME_READY: i32 = 0x02;
    pub(crate) const STOPPED: i32 = 0x10;
}

/// Properties that do something here; the others of the table only keep their value.
pub(crate) mod id {
    pub(crate) const TRIGGER_SOURCE: i32 = 0x0010_0110;
    pub(crate) const TRIGGER_ACTIVE: i32 = 0x0010_0120;
    pub(crate) const TRIGGER_MODE: i32 = 0x0010_0210;
    pub(crate) const OUTPUT_SOURCE: i32 = 0x001C_0110;
    pub(crate) const OUTPUT_KIND: i32 = 0x001C_0160;
    pub(crate) const EXPOSURE: i32 = 0x001F_0110;
    pub(crate) const READOUT_SPEED: i32 = 0x0040_0110;
    pub(crate) const BINNING: i32 = 0x0040_1110;
    pub(crate) const LEFT: i32 = 0x0040_2110;
    pub(crate) const WIDTH: i32 = 0x0040_2120;
    pub(crate) const TOP: i32 = 0x0040_2130;
    pub(crate) const HEIGHT: i32 = 0x0040_2140;
    pub(crate) const SUBARRAY: i32 = 0x0040_2150;
    pub(crate) const READOUT_TIME: i32 = 0x0040_3010;
    pub(crate) const CYCLIC_PERIOD: i32 = 0x0040_3020;
    pub(crate) const MIN_INTERVAL: i32 = 0x0040_3050;
    pub(crate) const FRAME_RATE: i32 = 0x0040_3810;
    pub(crate) const FRAME_INTERVAL: i32 = 0x0040_3820;
    pub(crate) const IMAGE_WIDTH: i32 = 0x0042_0210;
    pub(crate) const IMAGE_HEIGHT: i32 = 0x0042_0220;
    pub(crate) const ROW_BYTES: i32 = 0x0042_0230;
    pub(crate) const FRAME_BYTES: i32 = 0x0042_0240;
}
