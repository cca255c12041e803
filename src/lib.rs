//! Live multicolor super-resolution imaging with two cameras.

pub mod display;
pub mod files;
pub mod report;
pub mod sofi;
