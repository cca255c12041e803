//! The composition root.
pub mod bench;
