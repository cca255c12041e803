//! Image stacks in, result images out.
//!
//! In: paths and pixels. Out: frames of any stack that microscopes write, and files that any microscopy software opens.
//! Never: a whole stack in memory, a partial result that looks whole, a panic on damaged data.
//! Fails: [`FileError`], which says what, where and what to do next.

mod error;
mod ome_xml;
mod output;
mod result;
mod space;
mod stack;
mod stack_writer;
mod tiff_writer;

pub use self::error::{ErrorKind, FileError, Place, Space};
pub(crate) use self::ome_xml::{OmeImage, document as ome_document};
pub use self::output::OutputDirectory;
pub use self::result::{ResultHeader, Storage, write_result};
pub use self::space::{ensure_free, free_bytes};
pub use self::stack::{Dialect, FrameBuffer, ImageStack, SampleType, StackInfo, first_not_finite};
pub use self::stack_writer::{StackHeader, StackWriter};

/// Program and version, as written into every file.
const SOFTWARE: &str = concat!("sofiscope ", env!("CARGO_PKG_VERSION"));
