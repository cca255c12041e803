//! What can go wrong when pictures are made.

use std::path::PathBuf;

/// A picture could not be made or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DisplayError {
    /// Layers or masks of unequal size cannot lie on top of each other.
    #[error("the {what} is {found_height} x {found_width} pixels, the picture {height} x {width}")]
    Shape {
        /// What did not fit.
        what: &'static str,
        /// Height of the thing that did not fit, in pixels.
        found_height: usize,
        /// Width of the thing that did not fit, in pixels.
        found_width: usize,
        /// Height of the picture, in pixels.
        height: usize,
        /// Width of the picture, in pixels.
        width: usize,
    },
    /// A picture without pixels, or with more than a PNG file can hold.
    #[error("a picture of {height} x {width} pixels cannot be made")]
    Size {
        /// Height, in pixels.
        height: usize,
        /// Width, in pixels.
        width: usize,
    },
    /// No colormap has this name.
    #[error("there is no colormap \"{name}\"; there are: {known}")]
    UnknownColormap {
        /// The name as given.
        name: String,
        /// All names, separated by commas.
        known: String,
    },
    /// The PNG encoder refused.
    #[error("the picture could not be encoded as PNG")]
    Encode(#[from] png::EncodingError),
    /// The file could not be written.
    #[error("{} could not be written", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}
