//! Reads the keys of a TOML table and notes every fault instead of stopping at one.
//!
//! In: a parsed table with its positions in the text. Out: values within their limits.
//! Never: leaves an unknown key unsaid; `finish` names the nearest known one.
//! Fails: never at once. (The derived reader of serde would stop at the first fault.)

use std::cell::RefCell;
use std::ops::RangeInclusive;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::{Faults, nearest};

/// Parses a text and reads its top table; errors of syntax are faults like others, and then nothing is read.
pub fn read<T>(faults: &Faults<'_>, read: impl FnOnce(&Form<'_>) -> T) -> Option<T> {
    let (document, errors) = DeTable::parse_recoverable(faults.text);
    for error in &errors {
        let line = error.span().map(|span| faults.line_of(span.start));
        faults.note(line, "", error.message(), "correct the TOML syntax");
    }
    if !errors.is_empty() {
        return None;
    }
    let asked = RefCell::default();
    let form = Form { table: document.get_ref(), path: String::new(), byte: None, asked, faults };
    let value = read(&form);
    form.finish();
    Some(value)
}

/// One table of the file being read.
#[derive(Debug)]
pub struct Form<'t> {
    table: &'t DeTable<'t>,
    path: String,
    byte: Option<usize>,
    asked: RefCell<Vec<&'static str>>,
    faults: &'t Faults<'t>,
}

impl<'t> Form<'t> {
    /// Line where this table or one of its keys stands.
    #[must_use]
    pub fn line(&self, key: &str) -> Option<usize> {
        let found = self.table.iter().find(|(name, _)| name.get_ref() == key);
        let byte = found.map(|(name, _)| name.span().start).or(self.byte);
        byte.map(|byte| self.faults.line_of(byte))
    }

    /// The dotted name of a key of this table.
    #[must_use]
    pub fn name(&self, key: &str) -> String {
        if self.path.is_empty() { key.into() } else { format!("{}.{key}", self.path) }
    }

    fn find(&self, key: &'static str) -> Option<&'t Spanned<DeValue<'t>>> {
        self.asked.borrow_mut().push(key);
        self.table.iter().find(|(name, _)| name.get_ref() == key).map(|(_, value)| value)
    }

    /// Whether the key is there.
    pub fn has(&self, key: &'static str) -> bool {
        self.find(key).is_some()
    }

    /// Notes a fault of a key of this table.
    pub fn fault(&self, key: &str, message: impl Into<String>, remedy: impl Into<String>) {
        self.faults.note(self.line(key), &self.name(key), message, remedy);
    }

    fn missing(&self, key: &str, wanted: &str) {
        self.fault(key, "is missing", format!("add `{key} = ...`, {wanted}"));
    }

    fn wrong_kind(&self, key: &str, found: &DeValue<'_>, wanted: &str) {
        self.fault(key, format!("is of the kind {}", found.type_str()), format!("give {wanted}"));
    }

    /// A number within limits, or a fault.
    pub fn number(&self, key: &'static str, limits: RangeInclusive<f64>) -> f64 {
        let wanted = within(&limits);
        match self.find(key) {
            Some(value) => self.checked_number(key, value.get_ref(), &limits),
            None => {
                self.missing(key, &wanted);
                *limits.start()
            }
        }
    }

    /// A number within limits if the key is there.
    pub fn number_if_any(&self, key: &'static str, limits: RangeInclusive<f64>) -> Option<f64> {
        self.find(key).map(|value| self.checked_number(key, value.get_ref(), &limits))
    }

    /// A number within limits, or the default if the key is absent.
    pub fn number_or(&self, key: &'static str, default: f64, limits: RangeInclusive<f64>) -> f64 {
        self.number_if_any(key, limits).unwrap_or(default)
    }

    fn checked_number(&self, key: &str, value: &DeValue<'_>, limits: &RangeInclusive<f64>) -> f64 {
        let Some(number) = as_number(value) else {
            self.wrong_kind(key, value, &within(limits));
            return *limits.start();
        };
        if limits.contains(&number) {
            return number;
        }
        self.fault(key, format!("is {number}"), format!("give {}", within(limits)));
        *limits.start()
    }

    /// A whole number within limits, or a fault.
    pub fn whole(&self, key: &'static str, limits: RangeInclusive<u64>) -> u64 {
        let wanted = format!("a whole number from {} to {}", limits.start(), limits.end());
        let Some(value) = self.find(key) else {
            self.missing(key, &wanted);
            return *limits.start();
        };
        self.checked_whole(key, value.get_ref(), &limits)
    }

    /// A whole number within limits if the key is there.
    pub fn whole_if_any(&self, key: &'static str, limits: RangeInclusive<u64>) -> Option<u64> {
        self.find(key).map(|value| self.checked_whole(key, value.get_ref(), &limits))
    }

    /// A whole number or a list of them, in order, if the key is there.
    pub fn wholes_if_any(&self, key: &'static str, limits: RangeInclusive<u64>) -> Option<Vec<u64>> {
        let value = self.find(key)?.get_ref();
        let Some(items) = value.as_array() else {
            return Some(vec![self.checked_whole(key, value, &limits)]);
        };
        let mut numbers: Vec<u64> =
            items.iter().map(|item| self.checked_whole(key, item.get_ref(), &limits)).collect();
        numbers.sort_unstable();
        numbers.dedup();
        Some(numbers)
    }

    fn checked_whole(&self, key: &str, value: &DeValue<'_>, limits: &RangeInclusive<u64>) -> u64 {
        let wanted = format!("give a whole number from {} to {}", limits.start(), limits.end());
        match as_whole(value) {
            Some(number) if limits.contains(&number) => return number,
            Some(number) => self.fault(key, format!("is {number}"), wanted),
            None => self.fault(key, "is no such number", wanted),
        }
        *limits.start()
    }

    /// A text of 1 to 80 characters, or a fault.
    pub fn text(&self, key: &'static str) -> String {
        let wanted = "a text of 1 to 80 characters";
        match self.find(key).map(Spanned::get_ref) {
            None => self.missing(key, wanted),
            Some(DeValue::String(text)) if (1..=80).contains(&text.chars().count()) => {
                return text.to_string();
            }
            Some(DeValue::String(_)) => {
                self.fault(key, "is empty or too long", format!("give {wanted}"));
            }
            Some(other) => self.wrong_kind(key, other, wanted),
        }
        String::new()
    }

    /// A text of any length if the key is there.
    pub fn prose(&self, key: &'static str) -> String {
        match self.find(key).map(Spanned::get_ref) {
            None => String::new(),
            Some(DeValue::String(text)) => text.to_string(),
            Some(other) => {
                self.wrong_kind(key, other, "a text");
                String::new()
            }
        }
    }

    /// True or false; false if the key is absent.
    pub fn flag(&self, key: &'static str) -> bool {
        match self.find(key).map(Spanned::get_ref) {
            None => false,
            Some(DeValue::Boolean(flag)) => *flag,
            Some(other) => {
                self.wrong_kind(key, other, "true or false");
                false
            }
        }
    }

    /// One of some words; the first if the key is absent.
    pub fn word<T: Copy>(&self, key: &'static str, words: &[(&str, T)]) -> T {
        let names: Vec<&str> = words.iter().map(|(name, _)| *name).collect();
        let wanted = format!("one of {}", names.join(", "));
        match self.find(key).map(Spanned::get_ref) {
            None => {}
            Some(DeValue::String(text)) => match words.iter().find(|(name, _)| name == text) {
                Some(&(_, value)) => return value,
                None => self.fault(key, format!("is \"{text}\""), format!("give {wanted}")),
            },
            Some(other) => self.wrong_kind(key, other, &wanted),
        }
        words[0].1
    }

    /// Two numbers within limits, or a fault.
    pub fn pair(&self, key: &'static str, limits: RangeInclusive<f64>) -> [f64; 2] {
        let Some(value) = self.find(key) else {
            self.missing(key, &format!("two numbers, each {}", within(&limits)));
            return [*limits.start(); 2];
        };
        self.checked_pair(key, value.get_ref(), &limits)
    }

    /// Two numbers within limits if the key is there.
    pub fn pair_if_any(&self, key: &'static str, limits: RangeInclusive<f64>) -> Option<[f64; 2]> {
        self.find(key).map(|value| self.checked_pair(key, value.get_ref(), &limits))
    }

    fn checked_pair(&self, key: &str, value: &DeValue<'_>, limits: &RangeInclusive<f64>) -> [f64; 2] {
        let numbers: Vec<f64> = match value.as_array() {
            Some(array) => array.iter().filter_map(|item| as_number(item.get_ref())).collect(),
            None => Vec::new(),
        };
        let complete = value.as_array().is_some_and(|array| array.len() == numbers.len());
        match numbers[..] {
            [a, b] if complete && limits.contains(&a) && limits.contains(&b) => [a, b],
            _ => {
                let wanted = format!("give two numbers, each {}", within(limits));
                self.fault(key, "is no such pair", wanted);
                [*limits.start(); 2]
            }
        }
    }

    /// A list of at least two points, or a fault.
    pub fn points(&self, key: &'static str, limits: RangeInclusive<f64>) -> Vec<[f64; 2]> {
        let wanted = format!("a list of 2 to 1000 points [y, x], each number {}", within(&limits));
        match self.find(key).map(Spanned::get_ref) {
            None => self.missing(key, &wanted),
            Some(DeValue::Array(items)) if (2..=1000).contains(&items.len()) => {
                return items.iter().map(|item| self.checked_pair(key, item.get_ref(), &limits)).collect();
            }
            Some(DeValue::Array(_)) => {
                self.fault(key, "has too few or too many points", format!("give {wanted}"));
            }
            Some(other) => self.wrong_kind(key, other, &wanted),
        }
        Vec::new()
    }

    /// A list of texts, or a fault.
    pub fn texts(&self, key: &'static str, limits: RangeInclusive<usize>) -> Vec<String> {
        if !self.has(key) {
            self.missing(key, &list_of(&limits));
        }
        self.texts_if_any(key, limits)
    }

    /// A list of texts; empty if the key is absent.
    pub fn texts_if_any(&self, key: &'static str, limits: RangeInclusive<usize>) -> Vec<String> {
        let Some(value) = self.find(key) else {
            return Vec::new();
        };
        let items = value.get_ref().as_array();
        let texts: Vec<String> = items
            .into_iter()
            .flatten()
            .filter_map(|item| item.get_ref().as_str().map(str::to_owned))
            .collect();
        let complete = items.is_some_and(|items| items.len() == texts.len());
        if !complete || !limits.contains(&texts.len()) {
            self.fault(key, "is no such list", format!("give {}", list_of(&limits)));
        }
        texts
    }

    /// The table at a key if it is there.
    pub fn table(&self, key: &'static str) -> Option<Self> {
        let value = self.find(key)?;
        match value.get_ref() {
            DeValue::Table(table) => Some(self.inner(table, value.span().start, self.name(key))),
            other => {
                self.wrong_kind(key, other, &format!("a table `[{}]`", self.name(key)));
                None
            }
        }
    }

    /// The list of tables at a key, at least one.
    pub fn some_tables(&self, key: &'static str) -> Vec<Self> {
        let wanted = format!("one table `[[{}]]` or more", self.name(key));
        match self.find(key).map(Spanned::get_ref) {
            None => self.fault(key, "is missing", format!("add {wanted}")),
            Some(DeValue::Array(items)) if items.is_empty() => {
                self.fault(key, "is empty", format!("give {wanted}"));
            }
            Some(_) => {}
        }
        self.tables(key)
    }

    /// The list of tables at a key; empty if it is absent.
    pub fn tables(&self, key: &'static str) -> Vec<Self> {
        let Some(value) = self.find(key) else {
            return Vec::new();
        };
        let wanted = format!("tables `[[{}]]`", self.name(key));
        let DeValue::Array(items) = value.get_ref() else {
            self.wrong_kind(key, value.get_ref(), &wanted);
            return Vec::new();
        };
        let mut forms = Vec::new();
        for (index, item) in items.iter().enumerate() {
            match item.get_ref() {
                DeValue::Table(table) => {
                    let path = format!("{}[{index}]", self.name(key));
                    forms.push(self.inner(table, item.span().start, path));
                }
                other => self.wrong_kind(key, other, &wanted),
            }
        }
        forms
    }

    fn inner(&self, table: &'t DeTable<'t>, byte: usize, path: String) -> Self {
        Self { table, path, byte: Some(byte), asked: RefCell::default(), faults: self.faults }
    }

    /// Takes these keys as known without reading them.
    pub fn know(&self, keys: &[&'static str]) {
        self.asked.borrow_mut().extend(keys);
    }

    /// Notes every key that no one asked for, with the nearest known one.
    pub fn finish(&self) {
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

fn list_of(limits: &RangeInclusive<usize>) -> String {
    match limits.end() {
        &usize::MAX => "a list of texts".to_owned(),
        most => format!("a list of {} to {most} texts", limits.start()),
    }
}

fn within(limits: &RangeInclusive<f64>) -> String {
    format!("a number from {} to {}", limits.start(), limits.end())
}

fn as_number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Float(float) => float.as_str().parse().ok(),
        DeValue::Integer(_) => as_integer(value).map(|integer| integer as f64),
        _ => None,
    }
}

fn as_whole(value: &DeValue<'_>) -> Option<u64> {
    as_integer(value).and_then(|integer| u64::try_from(integer).ok())
}

fn as_integer(value: &DeValue<'_>) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}
