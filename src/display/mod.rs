//! Numbers become pictures: colormaps, contrast, composites, scale bars, PNG files.
//!
//! In: images `(y, x)` as float32 (NaN where nothing could be computed) and raw counts as uint16.
//! Out: 8-bit RGB pictures and the numbers a legend needs.
//! Never: changes data, judges saturation on display values, hides a NaN.
//! Fails: [`DisplayError`] for pictures of unequal shape, unknown names and files that cannot be written.

mod color;
mod colormap;
mod composite;
mod contrast;
mod error;
mod font;
mod picture;
mod png_file;
mod render;
mod scale_bar;
mod viridis;

pub use color::{CYAN, GREEN, MAGENTA, NAN_COLOR, Rgb, SATURATED_COLOR, WHITE, YELLOW};
pub use color::{default_colors, hex};
pub use colormap::{Colormap, Table};
pub use composite::{Layer, composite};
pub use contrast::{Contrast, Limits, percentile};
pub use error::DisplayError;
pub use picture::RgbImage;
pub use png_file::PngNotes;
pub use render::{mark_saturated, render, render_raw};
pub use scale_bar::{ScaleBar, nice_length_at_most};
