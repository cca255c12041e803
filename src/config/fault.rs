//! What is wrong with a file of settings, and what to do about it.
//!
//! In: a finding. Out: one line of text for it. Never: stops at the first. Fails: not at all.

use std::fmt;

use serde::Serialize;

/// One fault of a file of settings.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Fault {
    /// Line in the file, from 1; `None` where the text has no single place.
    pub line: Option<usize>,
    /// Dotted key, such as `dichroic[1].coefficients[0].transmission`; empty for faults of the whole file.
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
