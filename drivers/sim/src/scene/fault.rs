//! What is wrong with a scene file, and what to do about it.
//!
//! In: findings of the reader. Out: one error with all of them, in order of lines.
//! Never: stops at the first.

use sofiscope_form::{Fault, counted};

/// All faults of a scene file; never empty.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the scene has {}", counted(.faults))]
pub struct SceneError {
    /// The faults in order of lines.
    pub faults: Vec<Fault>,
}

impl SceneError {
    /// An error of one fault that belongs to no line.
    pub(crate) fn single(key: &str, message: String, remedy: &str) -> Self {
        Self { faults: vec![Fault { line: None, key: key.into(), message, remedy: remedy.into() }] }
    }
}
