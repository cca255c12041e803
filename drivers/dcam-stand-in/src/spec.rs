//! The properties of a simulated C11440-22CU as data: names, limits, choices, when they can be changed.
//!
//! Camera facts as in the ORCA-Flash4.0 V2 manual; which properties there are as in the public drivers that list them.

use crate::codes::id;

/// Readout of one pair of rows at fast scan, seconds (ORCA-Flash4.0 V2 manual).
pub(crate) const LINE_FAST_S: f64 = 9.744_36e-6;
/// The same at slow scan.
pub(crate) const LINE_SLOW_S: f64 = 32.48e-6;
/// Rows and columns of the sensor.
pub(crate) const SIDE: u32 = 2048;
/// Bytes in a second over USB 3: 30 full frames (ORCA-Flash4.0 V2 manual).
pub(crate) const USB_BYTES_PER_S: f64 = 30.0 * 2.0 * (SIDE as f64) * (SIDE as f64);
/// Lines between a trigger and the next that is heard, beside exposure and readout: edge, synchronous readout.
pub(crate) const EDGE_BLANK_LINES: f64 = 10.0;
pub(crate) const SYNCHRONOUS_BLANK_LINES: f64 = 5.0;
/// Output connectors.
pub(crate) const OUTPUTS: i32 = 3;

/// What a property holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Kind {
    /// One of these.
    Mode(&'static [(i32, &'static str)]),
    Long,
    Real,
}

/// When a property can be changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Access {
    Never,
    Stopped,
    /// Also while capturing.
    Always,
}

/// One property.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Spec {
    pub(crate) id: i32,
    pub(crate) name: &'static str,
    pub(crate) kind: Kind,
    pub(crate) unit: i32,
    pub(crate) least: f64,
    pub(crate) greatest: f64,
    pub(crate) step: f64,
    pub(crate) default: f64,
    pub(crate) access: Access,
}

const OFF_ON: &[(i32, &str)] = &[(1, "OFF"), (2, "ON")];

const fn mode(id: i32, name: &'static str, choices: &'static [(i32, &'static str)], access: Access) -> Spec {
    let (least, greatest) = (choices[0].0 as f64, choices[choices.len() - 1].0 as f64);
    Spec { id, name, kind: Kind::Mode(choices), unit: 0, least, greatest, step: 0.0, default: least, access }
}

const fn long(id: i32, name: &'static str, range: [f64; 2], step: f64, default: f64, access: Access) -> Spec {
    let [least, greatest] = range;
    Spec { id, name, kind: Kind::Long, unit: 0, least, greatest, step, default, access }
}

const fn real(id: i32, name: &'static str, unit: i32, range: [f64; 2], default: f64, access: Access) -> Spec {
    let [least, greatest] = range;
    Spec { id, name, kind: Kind::Real, unit, least, greatest, step: 0.0, default, access }
}

const SIDE_PX: f64 = SIDE as f64;
const SECOND: i32 = 1;

/// All properties, in the order of their numbers.
pub(crate) const PROPERTIES: &[Spec] = &[
    mode(
        id::TRIGGER_SOURCE,
        "TRIGGER SOURCE",
        &[(1, "INTERNAL"), (2, "EXTERNAL"), (3, "SOFTWARE")],
        Access::Stopped,
    ),
    mode(
        id::TRIGGER_ACTIVE,
        "TRIGGER ACTIVE",
        &[(1, "EDGE"), (2, "LEVEL"), (3, "SYNCREADOUT")],
        Access::Stopped,
    ),
    mode(id::TRIGGER_MODE, "TRIGGER MODE", &[(1, "NORMAL"), (6, "START")], Access::Stopped),
    mode(0x0010_0220, "TRIGGER POLARITY", &[(1, "NEGATIVE"), (2, "POSITIVE")], Access::Stopped),
    mode(0x0010_0230, "TRIGGER CONNECTOR", &[(2, "BNC")], Access::Stopped),
    real(0x0010_0260, "TRIGGER DELAY", SECOND, [0.0, 10.0], 0.0, Access::Stopped),
    long(0x001C_0010, "NUMBER OF OUTPUT TRIGGER CONNECTOR", [0.0, 3.0], 1.0, 3.0, Access::Never),
    mode(
        id::OUTPUT_SOURCE,
        "OUTPUT TRIGGER SOURCE",
        &[(2, "READOUT END"), (3, "VSYNC"), (4, "HSYNC")],
        Access::Stopped,
    ),
    mode(0x001C_0120, "OUTPUT TRIGGER POLARITY", &[(1, "NEGATIVE"), (2, "POSITIVE")], Access::Stopped),
    real(0x001C_0140, "OUTPUT TRIGGER DELAY", SECOND, [0.0, 10.0], 0.0, Access::Stopped),
    real(0x001C_0150, "OUTPUT TRIGGER PERIOD", SECOND, [1e-6, 10.0], 1e-3, Access::Stopped),
    mode(
        id::OUTPUT_KIND,
        "OUTPUT TRIGGER KIND",
        &[(1, "LOW"), (2, "EXPOSURE"), (3, "PROGRAMABLE"), (4, "TRIGGER READY"), (5, "HIGH")],
        Access::Stopped,
    ),
    Spec {
        step: LINE_FAST_S,
        ..real(
            id::EXPOSURE,
            "EXPOSURE TIME",
            SECOND,
            [103.0 * LINE_FAST_S, 1_026_234.0 * LINE_FAST_S],
            1026.0 * LINE_FAST_S,
            Access::Always,
        )
    },
    real(0x0020_0310, "SENSOR TEMPERATURE", 2, [-100.0, 100.0], -9.6, Access::Never),
    mode(0x0020_0320, "SENSOR COOLER", &[(1, "OFF"), (2, "ON"), (4, "MAX")], Access::Stopped),
    mode(id::READOUT_SPEED, "READOUT SPEED", &[(1, "SLOWEST"), (2, "FASTEST")], Access::Stopped),
    mode(0x0040_0210, "SENSOR MODE", &[(1, "AREA"), (12, "PROGRESSIVE")], Access::Stopped),
    mode(id::BINNING, "BINNING", &[(1, "1X1"), (2, "2X2"), (4, "4X4")], Access::Stopped),
    long(id::LEFT, "SUBARRAY HPOS", [0.0, SIDE_PX - 4.0], 4.0, 0.0, Access::Stopped),
    long(id::WIDTH, "SUBARRAY HSIZE", [4.0, SIDE_PX], 4.0, SIDE_PX, Access::Stopped),
    long(id::TOP, "SUBARRAY VPOS", [0.0, SIDE_PX - 4.0], 4.0, 0.0, Access::Stopped),
    long(id::HEIGHT, "SUBARRAY VSIZE", [4.0, SIDE_PX], 4.0, SIDE_PX, Access::Stopped),
    mode(id::SUBARRAY, "SUBARRAY MODE", OFF_ON, Access::Stopped),
    real(id::READOUT_TIME, "TIMING READOUT TIME", SECOND, [0.0, 1.0], 0.0, Access::Never),
    real(id::CYCLIC_PERIOD, "TIMING CYCLIC TRIGGER PERIOD", SECOND, [0.0, 20.0], 0.0, Access::Never),
    real(id::MIN_INTERVAL, "TIMING MIN TRIGGER INTERVAL", SECOND, [0.0, 20.0], 0.0, Access::Never),
    real(id::FRAME_RATE, "INTERNAL FRAME RATE", 5, [0.0, 1e5], 0.0, Access::Never),
    real(id::FRAME_INTERVAL, "INTERNAL FRAME INTERVAL", SECOND, [0.0, 20.0], 0.0, Access::Never),
    long(id::IMAGE_WIDTH, "IMAGE WIDTH", [4.0, SIDE_PX], 4.0, SIDE_PX, Access::Never),
    long(id::IMAGE_HEIGHT, "IMAGE HEIGHT", [4.0, SIDE_PX], 4.0, SIDE_PX, Access::Never),
    long(id::ROW_BYTES, "IMAGE ROWBYTES", [8.0, 2.0 * SIDE_PX], 8.0, 0.0, Access::Never),
    long(id::FRAME_BYTES, "IMAGE FRAMEBYTES", [32.0, 2.0 * SIDE_PX * SIDE_PX], 8.0, 0.0, Access::Never),
    mode(0x0042_0270, "IMAGE PIXEL TYPE", &[(2, "MONO16")], Access::Never),
    mode(0x0047_0010, "DEFECT CORRECT MODE", OFF_ON, Access::Stopped),
    mode(0x00FF_0010, "SYSTEM ALIVE", &[(2, "ONLINE")], Access::Never),
    real(0x00FF_E010, "CONVERSION FACTOR COEFF", 0, [0.0, 10.0], 0.46, Access::Never),
    real(0x00FF_E020, "CONVERSION FACTOR OFFSET", 0, [0.0, 1000.0], 100.0, Access::Never),
];

/// The property with a number, that of the first connector for those of further ones.
pub(crate) fn find(id: i32) -> Option<&'static Spec> {
    let of = |id| PROPERTIES.iter().find(|spec| spec.id == id);
    let first = id - (id & 0xFF00) + 0x0100;
    let connector = ((id >> 8) & 0xFF) - 1;
    let is_output = |spec: &&Spec| (0x001C_0110..=0x001C_01FF).contains(&spec.id);
    of(id).or_else(|| {
        let further = (1..OUTPUTS).contains(&connector) && id & !0xFFFF == 0x001C_0000;
        if further { of(first).filter(is_output) } else { None }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn properties_are_in_order_and_each_is_once() {
        assert!(PROPERTIES.windows(2).all(|pair| pair[0].id < pair[1].id));
    }

    #[test]
    fn each_output_has_its_properties() {
        assert_eq!(find(0x001C_0160).unwrap().name, "OUTPUT TRIGGER KIND");
        assert_eq!(find(0x001C_0360).unwrap().name, "OUTPUT TRIGGER KIND");
        assert_eq!(find(0x001C_0460), None);
        assert_eq!(find(0x0010_0310), None);
    }
}
