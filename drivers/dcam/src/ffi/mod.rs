//! The vendor's library: the only place that calls it, and the only `unsafe` code of this driver.
//!
//! In: handles, numbers and the caller's memory. Out: what the library answered, or its [`Failure`].
//! Never: unloads a library (threads of its own may still run), calls it with a structure of the wrong size.
//! Fails: [`LoadError`] when the library or one of its functions is missing; [`Failure`].

pub(crate) mod codes;
pub(crate) mod ids;
mod layout;

use std::ffi::{CStr, c_char};
use std::mem::ManuallyDrop;
use std::path::{Path, PathBuf};
use std::ptr;
use std::sync::{Mutex, PoisonError};

pub(crate) use codes::Failure;
use ids::{Id, MONO16, SEQUENCE, StringId};
use libloading::Library;

/// A camera that is open; the library checks it, nobody looks behind it.
#[repr(transparent)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Hdcam(usize);

/// A wait for events of a camera.
#[repr(transparent)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Hdcamwait(usize);

/// Why a library cannot be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum LoadError {
    /// The file is not there or is no library.
    Library(String),
    /// The library does not have a function.
    Symbol { symbol: &'static str, why: String },
}

/// What a property is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Attribute {
    pub(crate) flags: u32,
    pub(crate) unit: i32,
    pub(crate) least: f64,
    pub(crate) greatest: f64,
    pub(crate) step: f64,
}

/// What the library says of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct FrameHeader {
    pub(crate) frame_stamp: u32,
    pub(crate) seconds: u32,
    pub(crate) microseconds: i32,
    /// Whether the frame had the expected size and its pixels were copied.
    pub(crate) copied: bool,
}

/// Newest frame of a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Newest {
    /// Buffer of the newest frame; below 0 before the first.
    pub(crate) slot: i32,
    /// Frames since the start, modulo 2^32.
    pub(crate) count: u32,
}

macro_rules! functions {
    ($($name:ident ($($type:ty),*);)*) => {
        /// The functions of the library that are used.
        pub(crate) struct Functions {
            $($name: unsafe extern "C" fn($($type),*) -> i32,)*
        }

        impl Functions {
            fn of(library: &Library) -> Result<Self, LoadError> {
                Ok(Self { $($name: symbol(library, stringify!($name))?,)* })
            }
        }

        /// Their names, as the library must export them.
        #[cfg(test)]
        pub(crate) const SYMBOLS: &[&str] = &[$(stringify!($name)),*];
    };
}

functions! {
    dcamapi_init(*mut layout::Init);
    dcamapi_uninit();
    dcamdev_open(*mut layout::DeviceOpen);
    dcamdev_close(Hdcam);
    dcamdev_getstring(Hdcam, *mut layout::DeviceString);
    dcamprop_getattr(Hdcam, *mut layout::Attribute);
    dcamprop_getvalue(Hdcam, i32, *mut f64);
    dcamprop_setvalue(Hdcam, i32, f64);
    dcamprop_setgetvalue(Hdcam, i32, *mut f64, i32);
    dcamprop_getnextid(Hdcam, *mut i32, i32);
    dcamprop_getname(Hdcam, i32, *mut c_char, i32);
    dcamprop_getvaluetext(Hdcam, *mut layout::ValueText);
    dcambuf_alloc(Hdcam, i32);
    dcambuf_release(Hdcam, i32);
    dcambuf_lockframe(Hdcam, *mut layout::Frame);
    dcamcap_start(Hdcam, i32);
    dcamcap_stop(Hdcam);
    dcamcap_status(Hdcam, *mut i32);
    dcamcap_transferinfo(Hdcam, *mut layout::TransferInfo);
    dcamwait_open(*mut layout::WaitOpen);
    dcamwait_close(Hdcamwait);
    dcamwait_start(Hdcamwait, *mut layout::WaitStart);
    dcamwait_abort(Hdcamwait);
}

#[expect(unsafe_code, reason = "a function is taken from a library by its name")]
fn symbol<F: Copy>(library: &Library, name: &'static str) -> Result<F, LoadError> {
    // SAFETY: `F` is the type of the function of that name in dcamapi4.h; the library is never unloaded, so the
    // pointer stays valid.
    let found = unsafe { library.get::<F>(name) };
    found.map(|symbol| *symbol).map_err(|error| LoadError::Symbol { symbol: name, why: error.to_string() })
}

/// Opens a library, once for each path in the life of this process.
///
/// Libraries are never closed: they keep threads, and closing one under its threads ends the process.
#[expect(unsafe_code, reason = "opening a library runs its code")]
pub(crate) fn load(path: &Path) -> Result<&'static Functions, LoadError> {
    static LOADED: Mutex<Vec<(PathBuf, &'static Functions)>> = Mutex::new(Vec::new());
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, functions)) = loaded.iter().find(|(known, _)| known == path) {
        return Ok(functions);
    }
    // SAFETY: the person names the vendor's library; its initialization has no demands on the caller.
    let library = unsafe { Library::new(path) }.map_err(|error| LoadError::Library(error.to_string()))?;
    let functions: &'static Functions = Box::leak(Box::new(Functions::of(&ManuallyDrop::new(library))?));
    loaded.push((path.to_owned(), functions));
    Ok(functions)
}

/// Success is any number above zero.
fn checked(answer: i32) -> Result<(), Failure> {
    if answer > 0 { Ok(()) } else { Err(Failure(answer.cast_unsigned())) }
}

/// Text up to its end, whatever bytes it has.
fn text_of(bytes: &[u8]) -> String {
    CStr::from_bytes_until_nul(bytes)
        .map_or_else(|_| String::from_utf8_lossy(bytes), CStr::to_string_lossy)
        .trim()
        .to_owned()
}

const TEXT_BYTES: usize = 256;

#[expect(unsafe_code, reason = "calls of the vendor's library")]
impl Functions {
    /// Starts the library; gives the number of cameras.
    pub(crate) fn init(&self) -> Result<i32, Failure> {
        let mut init = layout::Init {
            size: layout::Init::BYTES,
            device_count: 0,
            reserved: 0,
            option_bytes: 0,
            options: ptr::null(),
            guid: ptr::null(),
        };
        // SAFETY: the structure has its size and lives through the call; no options is allowed.
        checked(unsafe { (self.dcamapi_init)(&raw mut init) })?;
        Ok(init.device_count)
    }

    pub(crate) fn uninit(&self) -> Result<(), Failure> {
        // SAFETY: takes nothing.
        checked(unsafe { (self.dcamapi_uninit)() })
    }

    pub(crate) fn open(&self, index: i32) -> Result<Hdcam, Failure> {
        let mut open = layout::DeviceOpen { size: layout::DeviceOpen::BYTES, index, handle: Hdcam(0) };
        // SAFETY: the structure has its size and lives through the call.
        checked(unsafe { (self.dcamdev_open)(&raw mut open) })?;
        if open.handle.0 == 0 { Err(Failure::FAILOPENCAMERA) } else { Ok(open.handle) }
    }

    pub(crate) fn close(&self, camera: Hdcam) -> Result<(), Failure> {
        // SAFETY: takes a number; the library checks it.
        checked(unsafe { (self.dcamdev_close)(camera) })
    }

    /// A text of a camera that is not open, by its place in the list: the library takes it in place of a handle.
    pub(crate) fn string_at(&self, index: i32, which: StringId) -> Result<String, Failure> {
        self.string(Hdcam(usize::try_from(index).map_err(|_| Failure::INVALIDPARAM)?), which)
    }

    pub(crate) fn string(&self, camera: Hdcam, which: StringId) -> Result<String, Failure> {
        let mut bytes = [0_u8; TEXT_BYTES];
        let mut string = layout::DeviceString {
            size: layout::DeviceString::BYTES,
            which: which.0,
            text: bytes.as_mut_ptr().cast(),
            text_bytes: TEXT_BYTES as i32,
        };
        // SAFETY: the text has as many bytes as the structure says and lives through the call.
        checked(unsafe { (self.dcamdev_getstring)(camera, &raw mut string) })?;
        Ok(text_of(&bytes))
    }

    pub(crate) fn attribute(&self, camera: Hdcam, id: Id) -> Result<Attribute, Failure> {
        let mut found = layout::Attribute {
            size: layout::Attribute::BYTES,
            property: id.0,
            option: 0,
            reserved: 0,
            flags: 0,
            group: 0,
            unit: 0,
            flags_2: 0,
            least: 0.0,
            greatest: 0.0,
            step: 0.0,
            default: 0.0,
            most_channels: 0,
            reserved_2: 0,
            most_views: 0,
            number_of_elements: 0,
            array_base: 0,
            array_step: 0,
        };
        // SAFETY: the structure has its size and lives through the call.
        checked(unsafe { (self.dcamprop_getattr)(camera, &raw mut found) })?;
        let layout::Attribute { flags, unit, least, greatest, step, .. } = found;
        Ok(Attribute { flags, unit, least, greatest, step })
    }

    pub(crate) fn value(&self, camera: Hdcam, id: Id) -> Result<f64, Failure> {
        let mut value = 0.0;
        // SAFETY: the number lives through the call.
        checked(unsafe { (self.dcamprop_getvalue)(camera, id.0, &raw mut value) })?;
        Ok(value)
    }

    pub(crate) fn set(&self, camera: Hdcam, id: Id, value: f64) -> Result<(), Failure> {
        // SAFETY: takes numbers.
        checked(unsafe { (self.dcamprop_setvalue)(camera, id.0, value) })
    }

    /// Sets a value and gives what the camera made of it.
    pub(crate) fn set_and_get(&self, camera: Hdcam, id: Id, mut value: f64) -> Result<f64, Failure> {
        // SAFETY: the number lives through the call.
        checked(unsafe { (self.dcamprop_setgetvalue)(camera, id.0, &raw mut value, 0) })?;
        Ok(value)
    }

    /// The property after `id`; none after the last.
    pub(crate) fn next_property(&self, camera: Hdcam, id: Id) -> Result<Option<Id>, Failure> {
        let mut next = id.0;
        // SAFETY: the number lives through the call.
        match checked(unsafe { (self.dcamprop_getnextid)(camera, &raw mut next, 0) }) {
            Ok(()) if next == 0 || next == id.0 => Ok(None),
            Ok(()) => Ok(Some(Id(next))),
            Err(Failure::NOPROPERTY) => Ok(None),
            Err(failure) => Err(failure),
        }
    }

    pub(crate) fn property_name(&self, camera: Hdcam, id: Id) -> Result<String, Failure> {
        let mut bytes = [0_u8; TEXT_BYTES];
        let text = bytes.as_mut_ptr().cast();
        // SAFETY: the text has as many bytes as are told and lives through the call.
        checked(unsafe { (self.dcamprop_getname)(camera, id.0, text, TEXT_BYTES as i32) })?;
        Ok(text_of(&bytes))
    }

    pub(crate) fn value_text(&self, camera: Hdcam, id: Id, value: f64) -> Result<String, Failure> {
        let mut bytes = [0_u8; TEXT_BYTES];
        let mut text = layout::ValueText {
            size: layout::ValueText::BYTES,
            property: id.0,
            value,
            text: bytes.as_mut_ptr().cast(),
            text_bytes: TEXT_BYTES as i32,
        };
        // SAFETY: the text has as many bytes as the structure says and lives through the call.
        checked(unsafe { (self.dcamprop_getvaluetext)(camera, &raw mut text) })?;
        Ok(text_of(&bytes))
    }

    pub(crate) fn allocate(&self, camera: Hdcam, frames: u32) -> Result<(), Failure> {
        let frames = i32::try_from(frames).map_err(|_| Failure::NOMEMORY)?;
        // SAFETY: takes numbers.
        checked(unsafe { (self.dcambuf_alloc)(camera, frames) })
    }

    pub(crate) fn release(&self, camera: Hdcam) -> Result<(), Failure> {
        // SAFETY: takes numbers; nobody holds a pointer into the buffers, `copy_frame` keeps none.
        checked(unsafe { (self.dcambuf_release)(camera, 0) })
    }

    /// Copies the pixels of a buffer, row by row, if the frame has `width` columns of 16-bit pixels and fills
    /// `counts`.
    ///
    /// The caller keeps the buffers from being released meanwhile; the library may write a newer frame into
    /// this one, which the caller finds out by asking for the newest frame afterwards.
    pub(crate) fn copy_frame(
        &self,
        camera: Hdcam,
        slot: i32,
        width: usize,
        counts: &mut [u16],
    ) -> Result<FrameHeader, Failure> {
        let mut frame = layout::Frame {
            size: layout::Frame::BYTES,
            kind: 0,
            option: 0,
            slot,
            pixels: ptr::null(),
            row_bytes: 0,
            pixel_type: 0,
            width: 0,
            height: 0,
            left: 0,
            top: 0,
            timestamp: layout::Timestamp { seconds: 0, microseconds: 0 },
            frame_stamp: 0,
            camera_stamp: 0,
        };
        // SAFETY: the structure has its size and lives through the call.
        checked(unsafe { (self.dcambuf_lockframe)(camera, &raw mut frame) })?;
        let row_bytes = usize::try_from(frame.row_bytes).unwrap_or(0);
        let rows = counts.len().checked_div(width).unwrap_or(0);
        let copied = !frame.pixels.is_null()
            && frame.pixel_type == MONO16
            && usize::try_from(frame.width) == Ok(width)
            && usize::try_from(frame.height) == Ok(rows)
            && rows * width == counts.len()
            && row_bytes >= 2 * width;
        if copied {
            for (row, counts) in counts.chunks_exact_mut(width).enumerate() {
                // SAFETY: the buffer has `height` rows of `row_bytes` bytes, of which each has `width` pixels of
                // 2 bytes; copied as bytes, so no alignment is needed and any value is a number.
                unsafe {
                    let from = frame.pixels.add(row * row_bytes);
                    ptr::copy_nonoverlapping(from, counts.as_mut_ptr().cast::<u8>(), 2 * width);
                }
            }
        }
        Ok(FrameHeader {
            frame_stamp: frame.frame_stamp.cast_unsigned(),
            seconds: frame.timestamp.seconds,
            microseconds: frame.timestamp.microseconds,
            copied,
        })
    }

    pub(crate) fn start(&self, camera: Hdcam) -> Result<(), Failure> {
        // SAFETY: takes numbers.
        checked(unsafe { (self.dcamcap_start)(camera, SEQUENCE) })
    }

    pub(crate) fn stop(&self, camera: Hdcam) -> Result<(), Failure> {
        // SAFETY: takes a number; may be called while another thread waits or copies.
        checked(unsafe { (self.dcamcap_stop)(camera) })
    }

    pub(crate) fn status(&self, camera: Hdcam) -> Result<i32, Failure> {
        let mut status = 0;
        // SAFETY: the number lives through the call.
        checked(unsafe { (self.dcamcap_status)(camera, &raw mut status) })?;
        Ok(status)
    }

    pub(crate) fn newest(&self, camera: Hdcam) -> Result<Newest, Failure> {
        let mut info = layout::TransferInfo {
            size: layout::TransferInfo::BYTES,
            kind: 0,
            newest_slot: -1,
            frame_count: 0,
        };
        // SAFETY: the structure has its size and lives through the call.
        checked(unsafe { (self.dcamcap_transferinfo)(camera, &raw mut info) })?;
        Ok(Newest { slot: info.newest_slot, count: info.frame_count.cast_unsigned() })
    }

    pub(crate) fn open_wait(&self, camera: Hdcam) -> Result<Hdcamwait, Failure> {
        let mut open = layout::WaitOpen {
            size: layout::WaitOpen::BYTES,
            supported: 0,
            wait: Hdcamwait(0),
            handle: camera,
        };
        // SAFETY: the structure has its size and lives through the call.
        checked(unsafe { (self.dcamwait_open)(&raw mut open) })?;
        Ok(open.wait)
    }

    pub(crate) fn close_wait(&self, wait: Hdcamwait) -> Result<(), Failure> {
        // SAFETY: takes a number.
        checked(unsafe { (self.dcamwait_close)(wait) })
    }

    /// Waits for events; gives those that happened.
    pub(crate) fn wait(&self, wait: Hdcamwait, mask: i32, timeout_ms: i32) -> Result<i32, Failure> {
        let mut start = layout::WaitStart { size: layout::WaitStart::BYTES, happened: 0, mask, timeout_ms };
        // SAFETY: the structure has its size and lives through the call.
        checked(unsafe { (self.dcamwait_start)(wait, &raw mut start) })?;
        Ok(start.happened)
    }

    pub(crate) fn abort(&self, wait: Hdcamwait) -> Result<(), Failure> {
        // SAFETY: takes a number; made to be called while another thread waits.
        checked(unsafe { (self.dcamwait_abort)(wait) })
    }
}
