//! Frame pairs to images.
mod workers;
pub use workers::AllCores;
