//! Reads the keys of a TOML table and notes every fault instead of stopping at one.
//!
//! In: a parsed table with its positions in the text. Out: values within their limits.
//! Never: leaves an unknown key unsaid; `finish` names the nearest known one.
//! Fails: never at once. A faulty key yields a stand-in that no one sees, as a file with any fault gives no settings.
//! (The derived reader of serde would stop at the first fault.)

use std::cell::RefCell;
use std::ops::RangeInclusive;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::Fault;
use super::names::nearest;

/// The faults found so far in one text.
#[derive(Debug)]
pub(super) struct Faults<'t> {
    text: &'t str,
    list: RefCell<Vec<Fault>>,
}

impl<'t> Faults<'t> {
    pub(super) fn new(text: &'t str) -> Self {
        Self { text, list: RefCell::default() }
    }

    /// Notes a fault at a line of the text.
    pub(super) fn note(&self, line: Option<usize>, key: &str, message: String, remedy: String) {
        self.list.borrow_mut().push(Fault { line, key: key.to_owned(), message, remedy });
    }

    fn line_of(&self, byte: usize) -> usize {
        let before = &self.text.as_bytes()[..byte.min(self.text.len())];
        1 + before.iter().filter(|&&letter| letter == b'\n').count()
    }

    /// All faults in the order of lines.
    pub(super) fn into_list(self) -> Vec<Fault> {
        let mut list = self.list.into_inner();
        list.sort_by_key(|fault| fault.line.unwrap_or(usize::MAX));
        list
    }
}

/// Parses a text and reads its top table; errors of syntax are faults like others, and then nothing is read.
pub(super) fn read<T: Default>(text: &str, faults: &Faults<'_>, read: impl FnOnce(&Form<'_>) -> T) -> T {
    let (document, errors) = DeTable::parse_recoverable(text);
    for error in &errors {
        let line = error.span().map(|span| faults.line_of(span.start));
        faults.note(line, "", error.message().to_owned(), "correct the TOML syntax".to_owned());
    }
    if !errors.is_empty() {
        return T::default();
    }
    let form = Form {
        table: document.get_ref(),
        path: String::new(),
        byte: None,
        asked: RefCell::default(),
        faults,
    };
    let value = read(&form);
    form.finish();
    value
}

/// One table of the file being read.
#[derive(Debug)]
pub(super) struct Form<'t> {
    table: &'t DeTable<'t>,
    path: String,
    byte: Option<usize>,
    asked: RefCell<Vec<&'static str>>,
    faults: &'t Faults<'t>,
}

impl<'t> Form<'t> {
    /// Line where this table or one of its keys stands.
    pub(super) fn line(&self, key: &str) -> Option<usize> {
        let found = self.table.iter().find(|(name, _)| name.get_ref() == key);
        let byte = found.map(|(name, _)| name.span().start).or(self.byte);
        byte.map(|byte| self.faults.line_of(byte))
    }

    /// The dotted name of a key of this table.
    pub(super) fn name(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    fn fault(&self, key: &str, message: impl Into<String>, remedy: impl Into<String>) {
        self.faults.note(self.line(key), &self.name(key), message.into(), remedy.into());
    }

    fn find(&self, key: &'static str) -> Option<&'t DeValue<'t>> {
        self.asked.borrow_mut().push(key);
        self.table.iter().find(|(name, _)| name.get_ref() == key).map(|(_, value)| value.get_ref())
    }

    fn wrong_kind(&self, key: &str, found: &DeValue<'_>, wanted: &str) {
        self.fault(key, format!("is of the kind {}", found.type_str()), format!("give {wanted}"));
    }

    /// A number within limits, or a fault.
    pub(super) fn number(&self, key: &'static str, limits: RangeInclusive<f64>) -> f64 {
        let given = self.number_if_any(key, limits.clone());
        if given.is_none() && self.find(key).is_none() {
            self.fault(key, "is missing", format!("add `{key} = ...`, {}", within(&limits)));
        }
        given.unwrap_or(*limits.start())
    }

    /// A number within limits if the key is there.
    pub(super) fn number_if_any(&self, key: &'static str, limits: RangeInclusive<f64>) -> Option<f64> {
        let value = self.find(key)?;
        match as_number(value) {
            Some(number) if limits.contains(&number) => return Some(number),
            Some(number) => self.fault(key, format!("is {number}"), format!("give {}", within(&limits))),
            None => self.wrong_kind(key, value, &within(&limits)),
        }
        None
    }

    /// A text of 1 to 80 characters, or a fault.
    pub(super) fn text(&self, key: &'static str) -> String {
        let wanted = "a text of 1 to 80 characters";
        match self.find(key) {
            None => self.fault(key, "is missing", format!("add `{key} = ...`, {wanted}")),
            Some(DeValue::String(text)) if (1..=80).contains(&text.chars().count()) => {
                return text.to_string();
            }
            Some(DeValue::String(_)) => self.fault(key, "is empty or too long", format!("give {wanted}")),
            Some(other) => self.wrong_kind(key, other, wanted),
        }
        String::new()
    }

    /// A text of any length if the key is there.
    pub(super) fn prose(&self, key: &'static str) -> String {
        match self.find(key) {
            None => String::new(),
            Some(DeValue::String(text)) => text.to_string(),
            Some(other) => {
                self.wrong_kind(key, other, "a text");
                String::new()
            }
        }
    }

    /// A list of texts, empty if the key is absent.
    pub(super) fn texts(&self, key: &'static str) -> Vec<String> {
        let Some(value) = self.find(key) else {
            return Vec::new();
        };
        let items = value.as_array();
        let texts: Vec<String> = items
            .into_iter()
            .flatten()
            .filter_map(|item| item.get_ref().as_str().map(str::to_owned))
            .collect();
        if items.is_none_or(|items| items.len() != texts.len()) {
            self.fault(key, "is no list of texts", format!("give `{key} = [\"...\", \"...\"]`"));
        }
        texts
    }

    /// The list of tables at a key, at least one.
    pub(super) fn tables(&self, key: &'static str) -> Vec<Self> {
        let wanted = format!("one table `{}` or more", self.name(key));
        let items = match self.find(key) {
            None => {
                self.fault(key, "is missing", format!("add {wanted}"));
                return Vec::new();
            }
            Some(DeValue::Array(items)) => items,
            Some(other) => {
                self.wrong_kind(key, other, &wanted);
                return Vec::new();
            }
        };
        if items.is_empty() {
            self.fault(key, "is empty", format!("give {wanted}"));
        }
        items.iter().enumerate().filter_map(|(index, item)| self.inner(key, index, item, &wanted)).collect()
    }

    fn inner(
        &self,
        key: &'static str,
        index: usize,
        item: &'t Spanned<DeValue<'t>>,
        wanted: &str,
    ) -> Option<Self> {
        let DeValue::Table(table) = item.get_ref() else {
            self.wrong_kind(key, item.get_ref(), wanted);
            return None;
        };
        Some(Self {
            table,
            path: format!("{}[{index}]", self.name(key)),
            byte: Some(item.span().start),
            asked: RefCell::default(),
            faults: self.faults,
        })
    }

    /// Takes these keys as known without reading them.
    pub(super) fn know(&self, keys: &[&'static str]) {
        self.asked.borrow_mut().extend(keys);
    }

    /// Notes every key that no one asked for, with the nearest known one.
    pub(super) fn finish(&self) {
        let asked = self.asked.borrow();
        for (name, _) in self.table {
            let name = name.get_ref().as_ref();
            if !asked.contains(&name) {
                let remedy = match nearest(name, asked.iter().copied()).first() {
                    Some(known) => format!("remove it, or write `{known}` if that was meant"),
                    None => format!("remove it; known here: {}", known(&asked)),
                };
                self.fault(name, "is not a known key", remedy);
            }
        }
    }
}

fn known(asked: &[&'static str]) -> String {
    let mut keys = asked.to_vec();
    keys.dedup();
    keys.join(", ")
}

fn within(limits: &RangeInclusive<f64>) -> String {
    format!("a number from {} to {}", limits.start(), limits.end())
}

fn as_number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Float(float) => float.as_str().parse().ok(),
        DeValue::Integer(integer) => {
            i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|integer| integer as f64)
        }
        _ => None,
    }
}
