//! What happened during a recording, one JSON object per line.
//!
//! In: events. Out: `events.jsonl`, each line in the file when `append` returns; the last one is the stop record.
//! Never: keeps a line back. Fails: [`RecordingError`]; the line is then not there.

use super::RecordingError;
use super::appended::Appended;
use super::gate::Gate;
use super::sync::SyncFile;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Name of the file.
pub(super) const EVENTS: &str = "events.jsonl";
/// Room kept so that the last line can be written to a full disk.
const RESERVE: u64 = 64 << 10;
/// Events are read up to this size.
const MAX_EVENTS_BYTES: u64 = 16 << 20;

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StopStatus {
    /// As planned.
    Success,
    /// A person or a rule stopped it.
    Abort,
    /// A fault stopped it.
    Fail,
    /// The program was gone; the end was written by recovery.
    CrashRecovered,
}

/// The last word of a recording.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StopRecord {
    /// How it ended.
    pub status: StopStatus,
    /// Why, for people.
    pub reason: String,
}

/// One line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// When, in UTC.
    pub time: jiff::Timestamp,
    /// What, as one word or two with a hyphen; `stop` ends the recording.
    pub event: String,
    /// Everything else.
    #[serde(flatten)]
    pub details: serde_json::Map<String, serde_json::Value>,
}

impl Event {
    /// An event of this moment.
    #[must_use]
    pub fn now(event: &str, details: serde_json::Map<String, serde_json::Value>) -> Self {
        Self { time: jiff::Timestamp::now(), event: event.to_owned(), details }
    }

    pub(super) fn stop(stop: &StopRecord) -> Self {
        let details = match serde_json::to_value(stop) {
            Ok(serde_json::Value::Object(details)) => details,
            _ => serde_json::Map::new(),
        };
        Self::now("stop", details)
    }

    /// The stop record, if this is one.
    #[must_use]
    pub fn as_stop(&self) -> Option<StopRecord> {
        let details = serde_json::Value::Object(self.details.clone());
        (self.event == "stop").then(|| serde_json::from_value(details).ok()).flatten()
    }
}

/// The open file.
#[derive(Debug)]
pub(super) struct EventLog(Appended);

impl EventLog {
    pub(super) fn create(directory: &Path, gate: Gate) -> Result<Self, RecordingError> {
        let file = Appended::create(directory.join(EVENTS), gate)?;
        file.reserve(RESERVE);
        Ok(Self(file))
    }

    /// Opens the log of a crashed recording behind its last whole line; without a file, a new one.
    pub(super) fn reopen(directory: &Path, end: u64) -> Result<Self, RecordingError> {
        Appended::reopen(directory.join(EVENTS), end).map(Self)
    }

    /// Appends one line.
    pub(super) fn append(&mut self, event: &Event) -> Result<(), RecordingError> {
        let line = serde_json::to_string(event)
            .map_err(|error| RecordingError::storage(Path::new(EVENTS), "write", error.into()))?;
        self.0.append((line + "\n").as_bytes())
    }

    /// For syncing while events are written.
    pub(super) fn sync_file(&self) -> Result<SyncFile, RecordingError> {
        self.0.sync_file()
    }

    /// Gives back what was reserved and makes the log durable.
    pub(super) fn close(self) -> Result<(), RecordingError> {
        self.0.close()
    }
}

/// The lines of a log up to the first that is no event.
struct Lines {
    events: Vec<Event>,
    /// Bytes that they take.
    end: usize,
    /// The line behind them, if it is whole and no event, and whether it is the last.
    fault: Option<(RecordingError, bool)>,
}

/// All whole lines, and the bytes that they take.
pub(super) fn read(directory: &Path) -> Result<(Vec<Event>, u64), RecordingError> {
    let lines = read_lines(directory)?;
    lines.fault.map_or(Ok((lines.events, lines.end as u64)), |(error, _)| Err(error))
}

/// As [`read`], without a last line that a crash left half written.
pub(super) fn read_torn(directory: &Path) -> Result<(Vec<Event>, u64), RecordingError> {
    let lines = read_lines(directory)?;
    match lines.fault {
        Some((error, false)) => Err(error),
        _ => Ok((lines.events, lines.end as u64)),
    }
}

fn read_lines(directory: &Path) -> Result<Lines, RecordingError> {
    let path = directory.join(EVENTS);
    let text = super::metadata::read_text(&path, MAX_EVENTS_BYTES)?;
    let mut lines = Lines { events: Vec::new(), end: 0, fault: None };
    for line in text.split_inclusive('\n').filter(|line| line.ends_with('\n')) {
        match serde_json::from_str(line) {
            Ok(event) => lines.events.push(event),
            Err(error) => {
                let field = format!("line {}", lines.events.len() + 1);
                let is_last = lines.end + line.len() == text.len();
                lines.fault = Some((RecordingError::damaged(&path, field, error.to_string()), is_last));
                break;
            }
        }
        lines.end += line.len();
    }
    Ok(lines)
}
