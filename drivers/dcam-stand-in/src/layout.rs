//! The structures of DCAM-API 4, as a library has them.
//!
//! Written down a second time on purpose: a wrong field in the driver is not wrong here as well. `exports` asserts the
//! size of each.

use std::ffi::{c_char, c_void};

#[repr(C)]
pub(crate) struct Init {
    pub(crate) size: i32,
    pub(crate) device_count: i32,
    pub(crate) rest: [i32; 6],
}

#[repr(C)]
pub(crate) struct DeviceOpen {
    pub(crate) size: i32,
    pub(crate) index: i32,
    pub(crate) handle: usize,
}

#[repr(C)]
pub(crate) struct DeviceString {
    pub(crate) size: i32,
    pub(crate) which: i32,
    pub(crate) text: *mut c_char,
    pub(crate) text_bytes: i32,
}

#[repr(C)]
pub(crate) struct Attribute {
    pub(crate) size: i32,
    pub(crate) property: i32,
    pub(crate) option: i32,
    pub(crate) reserved: i32,
    pub(crate) flags: u32,
    pub(crate) group: i32,
    pub(crate) unit: i32,
    pub(crate) flags_2: i32,
    pub(crate) least: f64,
    pub(crate) greatest: f64,
    pub(crate) step: f64,
    pub(crate) default: f64,
    pub(crate) counts: [i32; 4],
    pub(crate) array_base: i32,
    pub(crate) array_step: i32,
}

#[repr(C)]
pub(crate) struct ValueText {
    pub(crate) size: i32,
    pub(crate) property: i32,
    pub(crate) value: f64,
    pub(crate) text: *mut c_char,
    pub(crate) text_bytes: i32,
}

#[repr(C)]
pub(crate) struct Frame {
    pub(crate) size: i32,
    pub(crate) kind: i32,
    pub(crate) option: i32,
    pub(crate) slot: i32,
    pub(crate) pixels: *const c_void,
    pub(crate) row_bytes: i32,
    pub(crate) pixel_type: i32,
    pub(crate) width: i32,
    pub(crate) height: i32,
    pub(crate) left: i32,
    pub(crate) top: i32,
    pub(crate) seconds: u32,
    pub(crate) microseconds: i32,
    pub(crate) frame_stamp: i32,
    pub(crate) camera_stamp: i32,
}

#[repr(C)]
pub(crate) struct WaitOpen {
    pub(crate) size: i32,
    pub(crate) supported: i32,
    pub(crate) wait: usize,
    pub(crate) handle: usize,
}

#[repr(C)]
pub(crate) struct WaitStart {
    pub(crate) size: i32,
    pub(crate) happened: i32,
    pub(crate) mask: i32,
    pub(crate) timeout_ms: i32,
}

#[repr(C)]
pub(crate) struct TransferInfo {
    pub(crate) size: i32,
    pub(crate) kind: i32,
    pub(crate) newest_slot: i32,
    pub(crate) frame_count: i32,
}
