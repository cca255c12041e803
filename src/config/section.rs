//! Reads the tables of a file of settings into plain records, and notes every fault instead of stopping at one.
//!
//! In: a [`Node`] and records with serde's derived readers. Out: the records, as far as they could be read.
//! Never: leaves an unknown key unsaid. Fails: never at once; a faulty key is left out of the record and noted.
//!
//! (The derived reader alone would stop at the first fault. Here it is asked for each key by itself.)

use std::cell::RefCell;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use super::analysis::in_words;
use super::tree::{Content, Entry, Node, joined};
use super::{Fault, nearest};

/// The faults found so far in one file.
#[derive(Debug, Default)]
pub(crate) struct Findings(RefCell<Vec<Fault>>);

impl Findings {
    /// Notes a fault.
    pub(crate) fn note(&self, line: Option<usize>, key: &str, message: String, remedy: String) {
        self.0.borrow_mut().push(Fault { line, key: key.to_owned(), message, remedy });
    }

    /// All faults in the order of lines.
    pub(crate) fn into_list(self) -> Vec<Fault> {
        let mut list = self.0.into_inner();
        list.sort_by_key(|fault| fault.line.unwrap_or(usize::MAX));
        list
    }
}

/// One table of the file.
#[derive(Debug)]
pub(crate) struct Section<'n> {
    entries: &'n [Entry],
    path: String,
    known: RefCell<Vec<String>>,
    findings: &'n Findings,
}

impl<'n> Section<'n> {
    /// The top table; anything else is a fault and reads like an empty table.
    pub(crate) fn root(node: &'n Node, findings: &'n Findings) -> Self {
        Self::of(node, String::new(), findings)
    }

    fn of(node: &'n Node, path: String, findings: &'n Findings) -> Self {
        let entries = match &node.content {
            Content::Table(entries) => entries.as_slice(),
            Content::Empty => &[],
            _ => {
                let message = format!("is {}", node.kind());
                let message = if path.is_empty() { format!("the file {message}") } else { message };
                findings.note(Some(node.line), &path, message, "give a table of keys and values".to_owned());
                &[]
            }
        };
        Self { entries, path, known: RefCell::default(), findings }
    }

    fn entry(&self, key: &str) -> Option<&'n Entry> {
        self.known.borrow_mut().push(key.to_owned());
        self.entries.iter().find(|entry| entry.key == key)
    }

    fn fault(&self, entry: &Entry, message: String, remedy: &str) {
        self.findings.note(Some(entry.line), &joined(&self.path, &entry.key), message, remedy.to_owned());
    }

    /// The value of a key, taken as known; `None` where it is absent or empty.
    pub(crate) fn node(&self, key: &str) -> Option<&'n Node> {
        self.entry(key).map(|entry| &entry.node).filter(|node| node.content != Content::Empty)
    }

    /// The table at a key; `None` where it is absent or empty.
    pub(crate) fn table(&self, key: &str) -> Option<Section<'n>> {
        Some(Self::of(self.node(key)?, joined(&self.path, key), self.findings))
    }

    /// The items of the list at a key with their names; empty where it is absent.
    pub(crate) fn items(&self, key: &str) -> Vec<(String, &'n Node)> {
        let Some(entry) = self.entry(key) else {
            return Vec::new();
        };
        let name = |index| format!("{}[{index}]", joined(&self.path, key));
        match &entry.node.content {
            Content::Empty => Vec::new(),
            Content::List(items) => {
                items.iter().enumerate().map(|(index, item)| (name(index), item)).collect()
            }
            _ => {
                self.fault(entry, format!("is {}", entry.node.kind()), "give a list");
                Vec::new()
            }
        }
    }

    /// The table that is one item of a list.
    pub(crate) fn item(&self, name: String, node: &'n Node) -> Section<'n> {
        Self::of(node, name, self.findings)
    }

    /// Refuses a key that other programs know and this one does not.
    pub(crate) fn refuse(&self, key: &str, reason: &str) {
        let is_idle = |node: &Node| match &node.content {
            Content::Empty => true,
            Content::List(items) => items.is_empty(),
            Content::Table(entries) => entries.is_empty(),
            Content::Single(_) => false,
        };
        if let Some(entry) = self.entry(key).filter(|entry| !is_idle(&entry.node)) {
            self.fault(entry, format!("is not supported yet: {reason}"), "remove it");
        }
    }

    /// The keys of one record; a record has a default for every key.
    pub(crate) fn fields<T: Default + Serialize + DeserializeOwned>(&self) -> T {
        let mut read = Map::new();
        for key in keys_of::<T>() {
            let Some(entry) = self.entry(&key).filter(|entry| entry.node.content != Content::Empty) else {
                continue;
            };
            let value = entry.node.to_json();
            let alone: Map<String, Value> = [(key.clone(), value.clone())].into_iter().collect();
            match serde_json::from_value::<T>(Value::Object(alone)) {
                Ok(_) => {
                    read.insert(key, value);
                }
                Err(error) => {
                    let message = in_words(&error.to_string());
                    self.fault(entry, format!("cannot be read: {message}"), "give a value of that kind");
                }
            }
        }
        serde_json::from_value(Value::Object(read)).unwrap_or_default()
    }

    /// Every key that no one asked for, with its value; these count as known from here.
    pub(crate) fn others(&self) -> Map<String, Value> {
        let known = self.known.borrow().clone();
        let others = self.entries.iter().filter(|entry| !known.contains(&entry.key));
        others.map(|entry| (entry.key.clone(), entry.node.to_json())).collect()
    }

    /// Notes every key that no one asked for, with the nearest known one.
    pub(crate) fn finish(&self) {
        let known = self.known.borrow();
        for entry in self.entries.iter().filter(|entry| !known.contains(&entry.key)) {
            let remedy = match nearest(&entry.key, known.iter().map(String::as_str)).first() {
                Some(near) => format!("remove it, or write `{near}` if that was meant"),
                None => format!("remove it; known here: {}", known.join(", ")),
            };
            self.fault(entry, "is not a known key".to_owned(), &remedy);
        }
    }
}

/// The keys of a record that writes all of them.
fn keys_of<T: Default + Serialize>() -> Vec<String> {
    match serde_json::to_value(T::default()) {
        Ok(Value::Object(record)) => record.into_iter().map(|(key, _)| key).collect(),
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
    #[serde(default)]
    struct Lens {
        aperture: Option<f64>,
        pitch_nm: Option<f64>,
        frames: Option<u64>,
    }

    fn read(text: &str) -> (Lens, Vec<Fault>) {
        let node = Node::from_yaml(text).unwrap();
        let findings = Findings::default();
        let section = Section::root(&node, &findings);
        let lens = section.fields();
        section.refuse("z_plan", "focus does not move");
        section.finish();
        (lens, findings.into_list())
    }

    #[test]
    fn every_fault_is_noted_and_the_rest_is_read() {
        let (lens, faults) =
            read("aperture: wide\npitch: 3\nframes: -1\npitch_nm: 108\nz_plan: {range: 3}\n");
        assert_eq!(lens, Lens { pitch_nm: Some(108.0), ..Lens::default() });
        let lines: Vec<_> = faults.iter().map(|fault| fault.line.unwrap()).collect();
        assert_eq!(lines, [1, 2, 3, 5], "{faults:?}");
        assert!(faults[0].message.contains("expected a number"), "{faults:?}");
        assert!(faults[1].remedy.contains("`pitch_nm`"), "{faults:?}");
        assert!(faults[3].message.contains("not supported yet: focus"), "{faults:?}");
    }

    #[test]
    fn empty_values_are_absent() {
        let (lens, faults) = read("aperture:\nframes: null\nz_plan: {}\n");
        assert_eq!((lens, faults), (Lens::default(), Vec::new()));
    }

    #[test]
    fn other_things_than_a_table_are_a_fault() {
        assert!(read("[1, 2]").1[0].message.contains("is a list"));
        assert!(read("hello").1[0].message.contains("is a text"));
    }
}
