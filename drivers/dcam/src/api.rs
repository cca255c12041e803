//! The library and one open camera, safe: what was opened is closed, in the right order.
//!
//! In: a path, a serial number. Out: [`Dcam`], [`Device`]. Never: opens a camera by its place in the list.
//! Fails: [`DeviceError`] that names the library, the function or the camera, and what to do next.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sofiscope_hal::{DeviceError, ErrorKind};

use crate::ffi::ids::{Id, StringId};
use crate::ffi::{self, Attribute, Failure, Functions, Hdcam, LoadError};

/// The library of the maker where no path is configured.
pub const DEFAULT_LIBRARY: &str = if cfg!(windows) { "dcamapi.dll" } else { "libdcamapi.so" };

/// DCAM-API, started. It is started once for a process and ends with its last user.
#[derive(Debug)]
pub struct Dcam {
    path: PathBuf,
    functions: Held,
    cameras: i32,
}

/// Functions of a library that stays.
#[derive(Clone, Copy)]
struct Held(&'static Functions);

impl std::fmt::Debug for Held {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("Functions")
    }
}

/// A library that is started, with its users.
struct Started {
    path: PathBuf,
    users: usize,
    cameras: i32,
}

fn started() -> MutexGuard<'static, Vec<Started>> {
    static STARTED: Mutex<Vec<Started>> = Mutex::new(Vec::new());
    STARTED.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Dcam {
    /// Opens the library at `path`, or [`DEFAULT_LIBRARY`] where the system finds it, and starts it.
    ///
    /// # Errors
    /// [`Lost`](ErrorKind::Lost) when the library is not there or no camera answers;
    /// [`Protocol`](ErrorKind::Protocol) when it is another library.
    pub fn open(path: Option<&Path>) -> Result<Arc<Self>, DeviceError> {
        let path = path.unwrap_or(Path::new(DEFAULT_LIBRARY)).to_owned();
        let functions = ffi::load(&path).map_err(|error| cannot_load(&path, error))?;
        let mut started = started();
        if let Some(known) = started.iter_mut().find(|known| known.path == path) {
            known.users += 1;
            return Ok(Arc::new(Self { cameras: known.cameras, functions: Held(functions), path }));
        }
        let cameras = functions.init().map_err(|failure| {
            DeviceError::new(failure.kind(), library_name(&path), format!("cannot be started: {failure}"))
        })?;
        started.push(Started { path: path.clone(), users: 1, cameras });
        Ok(Arc::new(Self { cameras, functions: Held(functions), path }))
    }

    /// Serial numbers of all cameras that answer, in the order of the list, which may change.
    #[must_use]
    pub fn serials(&self) -> Vec<String> {
        (0..self.cameras).filter_map(|index| self.serial_at(index)).collect()
    }

    fn serial_at(&self, index: i32) -> Option<String> {
        self.functions.0.string_at(index, StringId::CAMERA_ID).ok().map(|text| bare_serial(&text))
    }

    /// Opens the camera with a serial number, written `100123` or `S/N: 100123`.
    pub(crate) fn device(self: &Arc<Self>, serial: &str) -> Result<Device, DeviceError> {
        let wanted = bare_serial(serial);
        let name = format!("camera S/N {wanted}");
        let found = (0..self.cameras).find(|index| self.serial_at(*index).as_ref() == Some(&wanted));
        let Some(index) = found else {
            let there = self.serials().join(", ");
            let message = format!(
                "is not among the cameras that answer ({there}); check its power and cable, and the serial \
                 number in the configuration",
            );
            return Err(DeviceError::new(ErrorKind::Identity, name, message));
        };
        let handle = self.functions.0.open(index).map_err(|failure| {
            DeviceError::new(failure.kind(), &name, format!("cannot be opened: {failure}"))
        })?;
        let device = Device { dcam: self.clone(), handle, name };
        // The list may have changed between looking and opening.
        let opened = bare_serial(&device.string(StringId::CAMERA_ID)?);
        if opened == wanted {
            Ok(device)
        } else {
            let message = format!("another camera, S/N {opened}, was opened in its place; try again");
            Err(DeviceError::new(ErrorKind::Identity, device.name(), message))
        }
    }
}

impl Drop for Dcam {
    fn drop(&mut self) {
        let mut started = started();
        let Some(place) = started.iter().position(|known| known.path == self.path) else { return };
        started[place].users -= 1;
        if started[place].users == 0 {
            started.remove(place);
            if let Err(failure) = self.functions.0.uninit() {
                tracing::warn!("{}: cannot be ended: {failure}", library_name(&self.path));
            }
        }
    }
}

/// A camera that is open, and closed when nobody needs it any more.
#[derive(Debug)]
pub(crate) struct Device {
    dcam: Arc<Dcam>,
    handle: Hdcam,
    name: String,
}

impl Device {
    /// The camera as the person knows it.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn rename(&mut self, name: String) {
        self.name = name;
    }

    pub(crate) fn functions(&self) -> &'static Functions {
        self.dcam.functions.0
    }

    pub(crate) fn handle(&self) -> Hdcam {
        self.handle
    }

    /// An error of this camera: what could not be done, and why.
    pub(crate) fn error(&self, what: &str, failure: Failure) -> DeviceError {
        DeviceError::new(failure.kind(), &self.name, format!("{what}: {failure}"))
    }

    pub(crate) fn string(&self, which: StringId) -> Result<String, DeviceError> {
        let found = self.functions().string(self.handle, which);
        found.map_err(|failure| self.error("does not tell who it is", failure))
    }

    pub(crate) fn value(&self, id: Id) -> Result<f64, DeviceError> {
        let found = self.functions().value(self.handle, id);
        found.map_err(|failure| self.error(&format!("{} cannot be read", self.label(id)), failure))
    }

    /// The value of a property that not every model has.
    pub(crate) fn value_if_any(&self, id: Id) -> Result<Option<f64>, DeviceError> {
        match self.functions().value(self.handle, id) {
            Ok(value) => Ok(Some(value)),
            Err(failure) if failure.is_absence() => Ok(None),
            Err(failure) => Err(self.error(&format!("{} cannot be read", self.label(id)), failure)),
        }
    }

    pub(crate) fn set(&self, id: Id, value: f64) -> Result<(), DeviceError> {
        self.functions().set(self.handle, id, value).map_err(|failure| self.refused(id, value, failure))
    }

    /// Sets a property that not every model has.
    pub(crate) fn set_if_any(&self, id: Id, value: f64) -> Result<(), DeviceError> {
        match self.functions().set(self.handle, id, value) {
            Err(failure) if !failure.is_absence() => Err(self.refused(id, value, failure)),
            _ => Ok(()),
        }
    }

    pub(crate) fn set_and_get(&self, id: Id, value: f64) -> Result<f64, DeviceError> {
        let set = self.functions().set_and_get(self.handle, id, value);
        set.map_err(|failure| self.refused(id, value, failure))
    }

    pub(crate) fn attribute(&self, id: Id) -> Result<Attribute, DeviceError> {
        let found = self.functions().attribute(self.handle, id);
        found.map_err(|failure| self.error(&format!("{} is not described", self.label(id)), failure))
    }

    fn refused(&self, id: Id, value: f64, failure: Failure) -> DeviceError {
        self.error(&format!("{} cannot be set to {value}", self.label(id)), failure)
    }

    /// Name of a property, or its number.
    fn label(&self, id: Id) -> String {
        let name = self.functions().property_name(self.handle, id);
        name.unwrap_or_else(|_| format!("property 0x{:08X}", id.0))
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        if let Err(failure) = self.functions().close(self.handle) {
            tracing::warn!("{}: cannot be closed: {failure}", self.name);
        }
    }
}

/// The serial number without the words that the library puts before it.
fn bare_serial(text: &str) -> String {
    text.trim().trim_start_matches("S/N").trim_start_matches(':').trim().to_owned()
}

fn library_name(path: &Path) -> String {
    format!("DCAM-API ({})", path.display())
}

fn cannot_load(path: &Path, error: LoadError) -> DeviceError {
    let (kind, message) = match error {
        LoadError::Library(why) => (
            ErrorKind::Lost,
            format!(
                "cannot be opened: {why}; install DCAM-API (on Linux 'DCAM-API Lite for Linux' of Hamamatsu) \
                 or give the path of the library in the configuration"
            ),
        ),
        LoadError::Symbol { symbol, why } => (
            ErrorKind::Protocol,
            format!("has no function '{symbol}' ({why}); this is no DCAM-API 4, install a newer one"),
        ),
    };
    DeviceError::new(kind, library_name(path), message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn serial_numbers_are_the_same_with_and_without_their_words() {
        for text in ["100123", "S/N: 100123", "S/N:100123 ", "S/N 100123"] {
            assert_eq!(bare_serial(text), "100123", "{text}");
        }
    }

    #[test]
    fn a_missing_library_is_named_with_what_to_install() {
        let error = Dcam::open(Some(Path::new("/nowhere/libdcamapi.so"))).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Lost);
        let text = error.to_string();
        assert!(text.contains("/nowhere/libdcamapi.so") && text.contains("install DCAM-API"), "{text}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_missing_function_is_named() {
        let error = Dcam::open(Some(Path::new("libc.so.6"))).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Protocol);
        let first = ffi::SYMBOLS[0];
        assert!(error.to_string().contains(&format!("'{first}'")), "{error}");
    }
}
