//! The files room against files of every kind: written here byte by byte, by other programs, and damaged.

#[cfg(test)]
#[path = "files/builder.rs"]
mod builder;
#[cfg(test)]
#[path = "files/common.rs"]
mod common;
#[cfg(test)]
#[path = "files/hostile.rs"]
mod hostile;
#[cfg(test)]
#[path = "files/reading.rs"]
mod reading;
#[cfg(test)]
#[path = "files/writing.rs"]
mod writing;
