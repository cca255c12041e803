//! What came out of lasers and gates, written by the virtual device itself with the clock of the computer.
//!
//! One line per change: `<nanoseconds> <device> <quantity> <value>`. It is the judge in tests of laser safety.

use std::fs::{File, OpenOptions};
use std::io;
use std::io::Write;
use std::path::Path;
use std::time::Duration;

/// A log of changes; one process writes it.
#[derive(Debug)]
pub struct EmissionLog {
    file: Option<File>,
    device: String,
}

impl EmissionLog {
    /// Appends to the file at `path`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn append(path: &Path, device: impl Into<String>) -> io::Result<Self> {
        let file = OpenOptions::new().create(true).append(true).open(path)?;
        Ok(Self { file: Some(file), device: device.into() })
    }

    /// A log that nobody reads.
    #[must_use]
    pub fn none() -> Self {
        Self { file: None, device: String::new() }
    }

    /// Notes a change at `at`, the time of [`monotonic`](crate::monotonic).
    ///
    /// # Panics
    /// When the file cannot be written: a judge that cannot write must not be believed.
    pub fn note(&mut self, at: Duration, quantity: &str, value: f64) {
        if let Some(file) = &mut self.file {
            let line = format!("{} {} {quantity} {value}\n", at.as_nanos(), self.device);
            file.write_all(line.as_bytes()).expect("the emission log must be writable to be a judge");
        }
    }
}

/// One line of an emission log.
#[derive(Debug, Clone, PartialEq)]
pub struct Note {
    /// When, on the clock of [`monotonic`](crate::monotonic).
    pub at: Duration,
    /// Which device.
    pub device: String,
    /// What changed.
    pub quantity: String,
    /// To what.
    pub value: f64,
}

/// Reads a log back; a last line that is not finished is left out.
///
/// # Errors
/// When the file cannot be read, or a finished line is none of [`EmissionLog::note`].
pub fn read(path: &Path) -> io::Result<Vec<Note>> {
    let text = std::fs::read_to_string(path)?;
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    whole
        .lines()
        .map(|line| note_of(line).ok_or_else(|| io::Error::other(format!("no note: {line}"))))
        .collect()
}

fn note_of(line: &str) -> Option<Note> {
    let mut words = line.split(' ');
    let at = Duration::from_nanos(words.next()?.parse().ok()?);
    let (device, quantity) = (words.next()?.to_owned(), words.next()?.to_owned());
    let value = words.next()?.parse().ok()?;
    words.next().is_none().then_some(Note { at, device, quantity, value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_are_read_as_they_were_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("laser.log");
        let mut log = EmissionLog::append(&path, "laser-488").unwrap();
        log.note(Duration::from_nanos(17), "emission_mw", 2.5);
        OpenOptions::new().append(true).open(&path).unwrap().write_all(b"18 las").unwrap();
        let expected = Note {
            at: Duration::from_nanos(17),
            device: "laser-488".to_owned(),
            quantity: "emission_mw".to_owned(),
            value: 2.5,
        };
        assert_eq!(read(&path).unwrap(), [expected]);
    }
}
