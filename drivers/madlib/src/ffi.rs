//! The vendor's library: the only place that calls it, and the only `unsafe` code of this driver.
//!
//! In: handles, micrometers. Out: what the library answered, or its [`Failure`].
//! Never: unloads the library. Fails: [`LoadError`] when the library or one of its functions is missing.
//!
//! Functions as in Madlib.h, which the BSD-licensed Micro-Manager adapter MCL_NanoDrive includes.

use std::mem::{ManuallyDrop, offset_of};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use libloading::Library;

/// Axis numbers of Madlib: X is 1, Y is 2.
const AXIS_Z: u32 = 3;

/// A device that this process owns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Handle(i32);

/// Why a library cannot be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum LoadError {
    Library(String),
    Symbol { symbol: &'static str, why: String },
}

/// An answer below 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Failure(pub(crate) i32);

/// ProductInformation of Madlib.h, packed to single bytes.
#[repr(C, packed)]
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ProductInformation {
    pub(crate) axes: u8,
    pub(crate) adc_bits: i16,
    pub(crate) dac_bits: i16,
    pub(crate) product_id: i16,
    pub(crate) firmware_version: i16,
    pub(crate) firmware_profile: i16,
}

const _: () = {
    assert!(size_of::<ProductInformation>() == 11);
    assert!(offset_of!(ProductInformation, axes) == 0);
    assert!(offset_of!(ProductInformation, adc_bits) == 1);
    assert!(offset_of!(ProductInformation, dac_bits) == 3);
    assert!(offset_of!(ProductInformation, product_id) == 5);
    assert!(offset_of!(ProductInformation, firmware_version) == 7);
    assert!(offset_of!(ProductInformation, firmware_profile) == 9);
};

macro_rules! functions {
    ($($name:ident = $symbol:ident ($($type:ty),*) $(-> $answer:ty)?;)*) => {
        /// The functions of the library that are used.
        pub(crate) struct Functions {
            $($name: unsafe extern "C" fn($($type),*) $(-> $answer)?,)*
            /// Whether the library is a stand-in, which has a function that Madlib does not have.
            pub(crate) simulated: bool,
        }

        impl Functions {
            fn of(library: &Library) -> Result<Self, LoadError> {
                Ok(Self {
                    $($name: symbol(library, stringify!($symbol))?,)*
                    simulated: symbol::<*const ()>(library, "sofiscope_madlib_bench").is_ok(),
                })
            }
        }
    };
}

functions! {
    init_or_existing = MCL_InitHandleOrGetExisting() -> i32;
    grab_all = MCL_GrabAllHandles() -> i32;
    all_handles = MCL_GetAllHandles(*mut i32, i32) -> i32;
    by_serial = MCL_GetHandleBySerial(i16) -> i32;
    release = MCL_ReleaseHandle(i32);
    read = MCL_SingleReadN(u32, i32) -> f64;
    write = MCL_SingleWriteN(f64, u32, i32) -> i32;
    calibration = MCL_GetCalibration(u32, i32) -> f64;
    serial = MCL_GetSerialNumber(i32) -> i32;
    product = MCL_GetProductInfo(*mut ProductInformation, i32) -> i32;
    attached = MCL_DeviceAttached(i32, i32) -> u8;
    commanded = MCL_GetCommandedPosition(*mut f64, *mut f64, *mut f64, i32) -> i32;
    library_version = MCL_DLLVersion(*mut i16, *mut i16);
}

#[expect(unsafe_code, reason = "a function is taken from a library by its name")]
fn symbol<F: Copy>(library: &Library, name: &'static str) -> Result<F, LoadError> {
    // SAFETY: `F` is the type of the function of that name in Madlib.h; the library is never unloaded.
    let found = unsafe { library.get::<F>(name) };
    found.map(|symbol| *symbol).map_err(|error| LoadError::Symbol { symbol: name, why: error.to_string() })
}

/// Opens a library, once for each path in the life of this process.
#[expect(unsafe_code, reason = "opening a library runs its code")]
pub(crate) fn load(path: &Path) -> Result<&'static Functions, LoadError> {
    static LOADED: Mutex<Vec<(PathBuf, &'static Functions)>> = Mutex::new(Vec::new());
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, functions)) = loaded.iter().find(|(known, _)| known == path) {
        return Ok(functions);
    }
    open_cpp_library();
    // SAFETY: the person names the vendor's library; its initialization has no demands on the caller.
    let library = unsafe { Library::new(path) }.map_err(|error| LoadError::Library(error.to_string()))?;
    let functions: &'static Functions = Box::leak(Box::new(Functions::of(&ManuallyDrop::new(library))?));
    loaded.push((path.to_owned(), functions));
    Ok(functions)
}

/// Madlib for Linux is C++ but does not name its library: it has to be there for everyone before Madlib comes.
#[cfg(unix)]
#[expect(unsafe_code, reason = "opening a library runs its code")]
fn open_cpp_library() {
    use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_NOW};
    // SAFETY: the C++ library has no demands on the caller.
    match unsafe { Library::open(Some("libstdc++.so.6"), RTLD_NOW | RTLD_GLOBAL) } {
        // Stays open as long as this process lives.
        Ok(library) => {
            let _open = ManuallyDrop::new(library);
        }
        Err(error) => tracing::debug!("libstdc++.so.6 is not there: {error}"),
    }
}

#[cfg(not(unix))]
fn open_cpp_library() {}

fn checked(answer: i32) -> Result<(), Failure> {
    if answer == 0 { Ok(()) } else { Err(Failure(answer)) }
}

/// A number, or an error code in its place.
///
/// Sensors of 20-bit units read a little below 0 near their end (-0.0003 µm), so that an error is what is below 0
/// after its fraction is cut off.
pub(crate) fn number(value: f64) -> Result<f64, Failure> {
    if value > -1.0 { Ok(value) } else { Err(Failure(value.max(-1e3) as i32)) }
}

const MOST_DEVICES: usize = 32;

#[expect(unsafe_code, reason = "calls of the vendor's library")]
impl Functions {
    /// The first device that nobody else owns, or one left over in this process.
    pub(crate) fn any(&self) -> Option<Handle> {
        // SAFETY: takes nothing.
        handle(unsafe { (self.init_or_existing)() })
    }

    /// The device with a serial number; other devices that had to be taken to find it are given back.
    pub(crate) fn with_serial(&self, serial: i16) -> Option<Handle> {
        let before = self.handles();
        // SAFETY: takes nothing.
        unsafe { (self.grab_all)() };
        // SAFETY: takes a number.
        let found = handle(unsafe { (self.by_serial)(serial) });
        for taken in self.handles() {
            if !before.contains(&taken) && Some(taken) != found {
                self.release(taken);
            }
        }
        found
    }

    fn handles(&self) -> Vec<Handle> {
        let mut handles = [0; MOST_DEVICES];
        // SAFETY: the array has as many places as are told.
        let number = unsafe { (self.all_handles)(handles.as_mut_ptr(), MOST_DEVICES as i32) };
        let number = usize::try_from(number).unwrap_or(0).min(MOST_DEVICES);
        handles[..number].iter().copied().filter_map(handle).collect()
    }

    pub(crate) fn release(&self, device: Handle) {
        // SAFETY: takes a number.
        unsafe { (self.release)(device.0) }
    }

    /// Measured position, micrometers.
    pub(crate) fn position(&self, device: Handle) -> Result<f64, Failure> {
        // SAFETY: takes numbers.
        number(unsafe { (self.read)(AXIS_Z, device.0) })
    }

    pub(crate) fn set_position(&self, device: Handle, micrometers: f64) -> Result<(), Failure> {
        // SAFETY: takes numbers.
        checked(unsafe { (self.write)(micrometers, AXIS_Z, device.0) })
    }

    /// Travel, micrometers.
    pub(crate) fn travel(&self, device: Handle) -> Result<f64, Failure> {
        // SAFETY: takes numbers.
        number(unsafe { (self.calibration)(AXIS_Z, device.0) })
    }

    pub(crate) fn serial(&self, device: Handle) -> Result<i32, Failure> {
        // SAFETY: takes a number.
        let serial = unsafe { (self.serial)(device.0) };
        if serial < 0 { Err(Failure(serial)) } else { Ok(serial) }
    }

    pub(crate) fn product(&self, device: Handle) -> Result<ProductInformation, Failure> {
        let mut product = ProductInformation::default();
        // SAFETY: the structure has the layout of Madlib.h and lives through the call.
        checked(unsafe { (self.product)(&raw mut product, device.0) })?;
        Ok(product)
    }

    pub(crate) fn is_attached(&self, device: Handle) -> bool {
        // SAFETY: takes numbers; a C++ bool is one byte, of which any but 0 is true.
        unsafe { (self.attached)(0, device.0) != 0 }
    }

    /// Last target, micrometers.
    pub(crate) fn commanded(&self, device: Handle) -> Result<f64, Failure> {
        let (mut x, mut y, mut z) = (0.0, 0.0, 0.0);
        // SAFETY: the numbers live through the call.
        checked(unsafe { (self.commanded)(&raw mut x, &raw mut y, &raw mut z, device.0) })?;
        Ok(z)
    }

    pub(crate) fn version(&self) -> [i16; 2] {
        let (mut version, mut revision) = (0, 0);
        // SAFETY: the numbers live through the call.
        unsafe { (self.library_version)(&raw mut version, &raw mut revision) };
        [version, revision]
    }
}

/// A handle is above 0.
fn handle(answer: i32) -> Option<Handle> {
    (answer > 0).then_some(Handle(answer))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_a_little_below_zero_are_no_errors() {
        for value in [-0.0003, -0.999, 0.0, 299.9] {
            assert_eq!(number(value), Ok(value));
        }
        for (value, code) in [(-1.0, -1), (-2.0, -2), (-11.0, -11)] {
            assert_eq!(number(value), Err(Failure(code)));
        }
        assert!(number(f64::NAN).is_err());
    }
}
