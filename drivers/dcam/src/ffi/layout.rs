//! Memory layout of the structures of DCAM-API 4 on 64-bit systems, checked when this is compiled.
//!
//! Offsets and sizes as in the public dcamapi4 headers that open drivers mirror (pyLabLib, python-microscope,
//! areaDetector); a line that does not fit its structure does not compile.

use std::ffi::{c_char, c_void};
use std::mem::offset_of;

use super::{Hdcam, Hdcamwait};

/// A structure with the offset of each field and the size of the whole.
macro_rules! layout {
    ($($(#[$doc:meta])* $name:ident: $bytes:literal bytes { $($at:literal $field:ident: $type:ty,)* })*) => {
        $(
            $(#[$doc])*
            #[repr(C)]
            #[derive(Debug, Clone, Copy)]
            pub(super) struct $name {
                $(pub(super) $field: $type,)*
            }

            const _: () = {
                assert!(size_of::<$name>() == $name::BYTES as usize);
                $(assert!(offset_of!($name, $field) == $at);)*
            };

            impl $name {
                /// The size that the structure begins with.
                pub(super) const BYTES: i32 = $bytes;
            }
        )*

        #[cfg(test)]
        pub(super) const SIZES: &[(&str, usize)] = &[$((stringify!($name), size_of::<$name>())),*];
    };
}

layout! {
    /// DCAMAPI_INIT
    Init: 32 bytes {
        0 size: i32,
        4 device_count: i32,
        8 reserved: i32,
        12 option_bytes: i32,
        16 options: *const i32,
        24 guid: *const c_void,
    }
    /// DCAMDEV_OPEN
    DeviceOpen: 16 bytes {
        0 size: i32,
        4 index: i32,
        8 handle: Hdcam,
    }
    /// DCAMDEV_STRING
    DeviceString: 24 bytes {
        0 size: i32,
        4 which: i32,
        8 text: *mut c_char,
        16 text_bytes: i32,
    }
    /// DCAMPROP_ATTR
    Attribute: 88 bytes {
        0 size: i32,
        4 property: i32,
        8 option: i32,
        12 reserved: i32,
        16 flags: u32,
        20 group: i32,
        24 unit: i32,
        28 flags_2: i32,
        32 least: f64,
        40 greatest: f64,
        48 step: f64,
        56 default: f64,
        64 most_channels: i32,
        68 reserved_2: i32,
        72 most_views: i32,
        76 number_of_elements: i32,
        80 array_base: i32,
        84 array_step: i32,
    }
    /// DCAMPROP_VALUETEXT
    ValueText: 32 bytes {
        0 size: i32,
        4 property: i32,
        8 value: f64,
        16 text: *mut c_char,
        24 text_bytes: i32,
    }
    /// DCAM_TIMESTAMP
    Timestamp: 8 bytes {
        0 seconds: u32,
        4 microseconds: i32,
    }
    /// DCAMBUF_FRAME
    Frame: 64 bytes {
        0 size: i32,
        4 kind: i32,
        8 option: i32,
        12 slot: i32,
        16 pixels: *const u8,
        24 row_bytes: i32,
        28 pixel_type: i32,
        32 width: i32,
        36 height: i32,
        40 left: i32,
        44 top: i32,
        48 timestamp: Timestamp,
        56 frame_stamp: i32,
        60 camera_stamp: i32,
    }
    /// DCAMWAIT_OPEN
    WaitOpen: 24 bytes {
        0 size: i32,
        4 supported: i32,
        8 wait: Hdcamwait,
        16 handle: Hdcam,
    }
    /// DCAMWAIT_START
    WaitStart: 16 bytes {
        0 size: i32,
        4 happened: i32,
        8 mask: i32,
        12 timeout_ms: i32,
    }
    /// DCAMCAP_TRANSFERINFO
    TransferInfo: 16 bytes {
        0 size: i32,
        4 kind: i32,
        8 newest_slot: i32,
        12 frame_count: i32,
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn structures_have_the_sizes_of_the_headers() {
        let expected = [
            ("Init", 32),
            ("DeviceOpen", 16),
            ("DeviceString", 24),
            ("Attribute", 88),
            ("ValueText", 32),
            ("Timestamp", 8),
            ("Frame", 64),
            ("WaitOpen", 24),
            ("WaitStart", 16),
            ("TransferInfo", 16),
        ];
        assert_eq!(super::SIZES, expected);
    }
}
