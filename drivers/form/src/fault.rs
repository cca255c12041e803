//! What is wrong with a file of settings, and what to do about it.
//!
//! In: a finding. Out: one line of text for it. Never: stops at the first. Fails: not at all.

use std::cell::RefCell;
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

/// "a fault" or "3 faults", then each on a line of its own.
#[must_use]
pub fn counted(faults: &[Fault]) -> String {
    let number = match faults.len() {
        1 => "a fault".to_owned(),
        many => format!("{many} faults"),
    };
    let lines: String = faults.iter().map(|fault| format!("\n  {fault}")).collect();
    format!("{number}:{lines}")
}

/// The faults found so far in one text.
#[derive(Debug)]
pub struct Faults<'t> {
    pub(crate) text: &'t str,
    list: RefCell<Vec<Fault>>,
}

impl<'t> Faults<'t> {
    /// None yet.
    #[must_use]
    pub fn new(text: &'t str) -> Self {
        Self { text, list: RefCell::default() }
    }

    /// Notes a fault at a line of the text.
    pub fn note(
        &self,
        line: Option<usize>,
        key: &str,
        message: impl Into<String>,
        remedy: impl Into<String>,
    ) {
        let fault = Fault { line, key: key.to_owned(), message: message.into(), remedy: remedy.into() };
        self.list.borrow_mut().push(fault);
    }

    /// The line in which a byte of the text stands, from 1.
    pub(crate) fn line_of(&self, byte: usize) -> usize {
        let before = &self.text.as_bytes()[..byte.min(self.text.len())];
        1 + before.iter().filter(|&&letter| letter == b'\n').count()
    }

    /// All faults in the order of lines.
    #[must_use]
    pub fn into_list(self) -> Vec<Fault> {
        let mut list = self.list.into_inner();
        list.sort_by_key(|fault| fault.line.unwrap_or(usize::MAX));
        list
    }
}
