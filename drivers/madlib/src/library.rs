//! Madlib, opened at run time.
//!
//! In: a path. Out: [`Madlib`]. Never: links against it. Fails: [`DeviceError`] that names the path or the function.

use std::path::{Path, PathBuf};

use sofiscope_hal::{DeviceError, ErrorKind};

use crate::ffi::{self, Functions, LoadError};

/// The library of the maker where no path is configured.
pub const DEFAULT_LIBRARY: &str = if cfg!(windows) { "Madlib.dll" } else { "libmadlib.so" };

/// The library of Mad City Labs; stays open as long as this process lives.
#[derive(Clone)]
pub struct Madlib {
    functions: &'static Functions,
    path: PathBuf,
}

impl std::fmt::Debug for Madlib {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Madlib").field("path", &self.path).finish_non_exhaustive()
    }
}

impl Madlib {
    /// Opens the library at `path`, or [`DEFAULT_LIBRARY`] where the system finds it.
    ///
    /// # Errors
    /// [`Lost`](ErrorKind::Lost) when it is not there, [`Protocol`](ErrorKind::Protocol) when it is another library.
    pub fn open(path: Option<&Path>) -> Result<Self, DeviceError> {
        let path = path.unwrap_or(Path::new(DEFAULT_LIBRARY)).to_owned();
        let functions = ffi::load(&path).map_err(|error| cannot_load(&path, error))?;
        Ok(Self { functions, path })
    }

    pub(crate) fn functions(&self) -> &'static Functions {
        self.functions
    }
}

fn cannot_load(path: &Path, error: LoadError) -> DeviceError {
    let (kind, message) = match error {
        LoadError::Library(why) => (
            ErrorKind::Lost,
            format!(
                "cannot be opened: {why}; install Madlib of Mad City Labs (on Linux libmadlib.so and libusb-1.0) or \
                 give its path in the configuration"
            ),
        ),
        LoadError::Symbol { symbol, why } => (
            ErrorKind::Protocol,
            format!(
                "has no function '{symbol}' ({why}); this is no Madlib, or an old one: install a newer one"
            ),
        ),
    };
    DeviceError::new(kind, format!("Madlib ({})", path.display()), message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_library_is_named_with_what_to_install() {
        let error = Madlib::open(Some(Path::new("/nowhere/libmadlib.so"))).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Lost);
        let text = error.to_string();
        assert!(text.contains("/nowhere/libmadlib.so") && text.contains("install Madlib"), "{text}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_missing_function_is_named() {
        let error = Madlib::open(Some(Path::new("libc.so.6"))).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Protocol);
        assert!(error.to_string().contains("'MCL_InitHandleOrGetExisting'"), "{error}");
    }
}
