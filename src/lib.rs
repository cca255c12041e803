//! Live multicolor super-resolution imaging with two cameras.

pub mod files;
pub mod report;
pub mod sofi;
