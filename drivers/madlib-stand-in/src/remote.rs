//! The bench as seen from a program that uses the library: where the library is, and words for its bench.
//!
//! In: a path, words of `bench.rs`. Out: answers. Never: shares memory with the library but through its functions.
//! Fails: with the words of the bench, or when the library was not built.

use std::ffi::{CString, c_char};
use std::mem::ManuallyDrop;
use std::path::{Path, PathBuf};

use libloading::Library;

type Tell = unsafe extern "C" fn(*const c_char, *mut c_char, i32) -> i32;

/// Where Cargo puts the library: beside the program, or in the folder `deps` there.
///
/// # Errors
/// With the folders that were looked at.
pub fn library() -> Result<PathBuf, String> {
    let name =
        format!("{}sofiscope_madlib_stand_in{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    let folder = program.parent().unwrap_or(Path::new("."));
    let folders = [folder.join("deps"), folder.to_owned(), folder.join("..").join("deps"), folder.join("..")];
    let found = folders.iter().map(|folder| folder.join(&name)).find(|path| path.is_file());
    found.ok_or_else(|| {
        format!("{name} is not in {folders:?}; run `cargo build -p sofiscope-madlib-stand-in`")
    })
}

/// The bench of a library that is open in this process.
#[derive(Debug, Clone, Copy)]
pub struct Remote {
    tell: Tell,
}

#[expect(unsafe_code, reason = "the bench is behind a function of a library")]
impl Remote {
    /// The bench of the library at `path`.
    ///
    /// # Errors
    /// When it is no stand-in.
    pub fn open(path: &Path) -> Result<Self, String> {
        // SAFETY: the stand-in does nothing when it is opened; it stays open, as its threads may go on.
        let library = unsafe { Library::new(path) }.map_err(|error| error.to_string())?;
        let library = ManuallyDrop::new(library);
        // SAFETY: the type is the one of `sofiscope_madlib_bench` in `exports.rs`.
        let tell = unsafe { library.get::<Tell>("sofiscope_madlib_bench") };
        Ok(Self { tell: *tell.map_err(|error| error.to_string())? })
    }

    /// Says something to the bench; gives its answer.
    ///
    /// # Errors
    /// With the answer, when it does not do it.
    pub fn say(self, words: &str) -> Result<String, String> {
        let command = CString::new(words).map_err(|error| error.to_string())?;
        let mut text = vec![0_u8; 1 << 16];
        // SAFETY: the command ends with 0 and the text has the room that is told.
        let done = unsafe { (self.tell)(command.as_ptr(), text.as_mut_ptr().cast(), 1 << 16) };
        let end = text.iter().position(|byte| *byte == 0).unwrap_or(0);
        let answer = String::from_utf8_lossy(&text[..end]).into_owned();
        if done == 1 { Ok(answer) } else { Err(answer) }
    }
}
