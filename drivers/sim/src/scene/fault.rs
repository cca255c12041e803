//! What is wrong with a scene file or a scenario, and what to do about it.
//!
//! In: findings of the reader. Out: one error with all of them, in order of lines.
//! Never: stops at the first.

use std::fmt;

/// One fault of a scene file or a scenario.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// Line in the file, from 1; `None` where the text has no single place.
    pub line: Option<usize>,
    /// Dotted key, such as `species[1].filament[0].width_px`; empty for faults of the whole file.
    pub key: String,
    /// What is wrong.
    pub message: String,
    /// What to do.
    pub remedy: String,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(line) = self.line {
            write!(f, "line {line}: ")?;
        }
        if !self.key.is_empty() {
            write!(f, "`{}` ", self.key)?;
        }
        write!(f, "{}; {}", self.message, self.remedy)
    }
}

/// All faults of a scene file; never empty.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the scene has {}:{}", count(.faults), list(.faults))]
pub struct SceneError {
    /// The faults in order of lines.
    pub faults: Vec<Fault>,
}

impl SceneError {
    pub(crate) fn new(mut faults: Vec<Fault>) -> Self {
        faults.sort_by_key(|fault| fault.line.unwrap_or(usize::MAX));
        Self { faults }
    }

    /// An error of one fault that belongs to no line.
    pub(crate) fn single(key: &str, message: String, remedy: &str) -> Self {
        Self::new(vec![Fault { line: None, key: key.into(), message, remedy: remedy.into() }])
    }
}

pub(crate) fn count(faults: &[Fault]) -> String {
    match faults.len() {
        1 => "a fault".into(),
        many => format!("{many} faults"),
    }
}

pub(crate) fn list(faults: &[Fault]) -> String {
    faults.iter().map(|fault| format!("\n  {fault}")).collect()
}
