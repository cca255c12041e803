//! A file of settings as a tree whose every key knows its line, whether it was TOML, YAML or JSON.
//!
//! In: text. Out: [`Node`]. Never: decides what a key means. Fails: [`Fault`]s of syntax with their lines.

use std::collections::BTreeMap;
use std::fmt;

use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::Value;
use serde_saphyr::Spanned;
use toml::de::{DeTable, DeValue};

use super::Fault;

/// A value and the line where it stands.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Node {
    /// Line in the file, from 1.
    pub(crate) line: usize,
    /// What stands there.
    pub(crate) content: Content,
}

/// What can stand in a file of settings.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Content {
    /// Nothing, as YAML's `null` or an empty value.
    Empty,
    /// True or false, a number or a text.
    Single(Value),
    /// Several values.
    List(Vec<Node>),
    /// Keys and values in the order of the file.
    Table(Vec<Entry>),
}

/// A key and its value.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Entry {
    /// The key as written.
    pub(crate) key: String,
    /// Line of the key, from 1.
    pub(crate) line: usize,
    /// The value.
    pub(crate) node: Node,
}

/// Lines of all keys of a file.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Places(BTreeMap<String, usize>);

impl Node {
    /// Reads TOML.
    pub(crate) fn from_toml(text: &str) -> Result<Self, Vec<Fault>> {
        let (document, errors) = DeTable::parse_recoverable(text);
        if errors.is_empty() {
            return Ok(Self { line: 1, content: toml_table(text, document.get_ref()) });
        }
        let fault = |error: &toml::de::Error| {
            let line = error.span().map(|span| line_of(text, span.start));
            syntax(line, error.message().to_owned(), "correct the TOML syntax")
        };
        let mut faults: Vec<Fault> = errors.iter().map(fault).collect();
        // One slip of syntax is several errors to the parser.
        faults.dedup_by_key(|fault| fault.line);
        Err(faults)
    }

    /// Reads YAML, of which JSON is a part.
    pub(crate) fn from_yaml(text: &str) -> Result<Self, Vec<Fault>> {
        serde_saphyr::from_str(text).map_err(|error| {
            let line = error.location().map(|location| location.line() as usize);
            let said = error.without_snippet().to_string();
            let message = said.split(" at line ").next().unwrap_or_default().replace('\n', " ");
            vec![syntax(line, message, "correct the YAML or JSON syntax")]
        })
    }

    /// The same without lines.
    pub(crate) fn to_json(&self) -> Value {
        match &self.content {
            Content::Empty => Value::Null,
            Content::Single(value) => value.clone(),
            Content::List(items) => items.iter().map(Self::to_json).collect(),
            Content::Table(entries) => {
                entries.iter().map(|entry| (entry.key.clone(), entry.node.to_json())).collect()
            }
        }
    }

    /// What stands here, for messages.
    pub(crate) fn kind(&self) -> &'static str {
        match &self.content {
            Content::Empty => "empty",
            Content::Single(Value::Bool(_)) => "true or false",
            Content::Single(Value::Number(_)) => "a number",
            Content::Single(_) => "a text",
            Content::List(_) => "a list",
            Content::Table(_) => "a table",
        }
    }

    fn note_places(&self, path: &str, places: &mut Places) {
        match &self.content {
            Content::Empty | Content::Single(_) => {}
            Content::List(items) => {
                for (index, item) in items.iter().enumerate() {
                    let path = format!("{path}[{index}]");
                    places.0.insert(path.clone(), item.line);
                    item.note_places(&path, places);
                }
            }
            Content::Table(entries) => {
                for entry in entries {
                    let path = joined(path, &entry.key);
                    places.0.insert(path.clone(), entry.line);
                    entry.node.note_places(&path, places);
                }
            }
        }
    }
}

impl Places {
    /// The lines of all keys below a node.
    pub(crate) fn of(node: &Node) -> Self {
        let mut places = Self::default();
        node.note_places("", &mut places);
        places
    }

    /// Line of a key, or of the nearest table around it that is there.
    pub(crate) fn line(&self, key: &str) -> Option<usize> {
        let mut key = key;
        loop {
            if let Some(&line) = self.0.get(key) {
                return Some(line);
            }
            key = &key[..key.rfind(['.', '['])?];
        }
    }
}

/// The dotted name of a key.
pub(crate) fn joined(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

fn syntax(line: Option<usize>, message: String, remedy: &str) -> Fault {
    Fault { line, key: String::new(), message, remedy: remedy.to_owned() }
}

fn line_of(text: &str, byte: usize) -> usize {
    1 + text.as_bytes()[..byte.min(text.len())].iter().filter(|&&letter| letter == b'\n').count()
}

fn toml_table(text: &str, table: &DeTable<'_>) -> Content {
    let mut entries: Vec<(usize, Entry)> = table
        .iter()
        .map(|(key, value)| {
            let line = line_of(text, key.span().start);
            let node =
                Node { line: line_of(text, value.span().start), content: toml_value(text, value.get_ref()) };
            (key.span().start, Entry { key: key.get_ref().to_string(), line, node })
        })
        .collect();
    entries.sort_by_key(|(byte, _)| *byte);
    Content::Table(entries.into_iter().map(|(_, entry)| entry).collect())
}

fn toml_value(text: &str, value: &DeValue<'_>) -> Content {
    match value {
        DeValue::String(said) => Content::Single(Value::from(said.as_ref())),
        DeValue::Boolean(flag) => Content::Single(Value::from(*flag)),
        DeValue::Integer(integer) => {
            let parsed = i128::from_str_radix(integer.as_str(), integer.radix());
            parsed.map_or_else(|_| said(integer.as_str()), whole)
        }
        DeValue::Float(float) => float.as_str().parse().map_or_else(|_| said(float.as_str()), real),
        DeValue::Datetime(moment) => said(&moment.to_string()),
        DeValue::Array(items) => {
            let item = |item: &toml::Spanned<DeValue<'_>>| Node {
                line: line_of(text, item.span().start),
                content: toml_value(text, item.get_ref()),
            };
            Content::List(items.iter().map(item).collect())
        }
        DeValue::Table(table) => toml_table(text, table),
    }
}

fn said(text: &str) -> Content {
    Content::Single(Value::from(text))
}

/// A whole number; beyond 64 bits it stays a text, which no number accepts.
fn whole(number: i128) -> Content {
    let signed = i64::try_from(number).map(Value::from);
    let value = signed.or_else(|_| u64::try_from(number).map(Value::from));
    value.map_or_else(|_| said(&number.to_string()), Content::Single)
}

/// A finite number; infinity and NaN stay texts, which no number accepts.
fn real(number: f64) -> Content {
    if number.is_finite() { Content::Single(Value::from(number)) } else { said(&number.to_string()) }
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let spanned = Spanned::<Content>::deserialize(deserializer)?;
        Ok(Self { line: spanned.referenced.line() as usize, content: spanned.value })
    }
}

impl<'de> Deserialize<'de> for Content {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ContentVisitor)
    }
}

struct ContentVisitor;

impl<'de> Visitor<'de> for ContentVisitor {
    type Value = Content;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a table, a list, a text, a number, true or false")
    }

    fn visit_unit<E>(self) -> Result<Content, E> {
        Ok(Content::Empty)
    }

    fn visit_none<E>(self) -> Result<Content, E> {
        Ok(Content::Empty)
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<Content, D::Error> {
        Content::deserialize(deserializer)
    }

    fn visit_bool<E>(self, flag: bool) -> Result<Content, E> {
        Ok(Content::Single(Value::from(flag)))
    }

    fn visit_i64<E>(self, number: i64) -> Result<Content, E> {
        Ok(whole(number.into()))
    }

    fn visit_u64<E>(self, number: u64) -> Result<Content, E> {
        Ok(whole(number.into()))
    }

    fn visit_i128<E>(self, number: i128) -> Result<Content, E> {
        Ok(whole(number))
    }

    fn visit_u128<E>(self, number: u128) -> Result<Content, E> {
        Ok(i128::try_from(number).map_or_else(|_| said(&number.to_string()), whole))
    }

    fn visit_f64<E>(self, number: f64) -> Result<Content, E> {
        Ok(real(number))
    }

    fn visit_str<E>(self, text: &str) -> Result<Content, E> {
        Ok(said(text))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Content, A::Error> {
        let mut list = Vec::new();
        while let Some(item) = items.next_element()? {
            list.push(item);
        }
        Ok(Content::List(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Content, A::Error> {
        let mut entries = Vec::new();
        while let Some(key) = map.next_key::<Spanned<String>>()? {
            let line = key.referenced.line() as usize;
            entries.push(Entry { key: key.value, line, node: map.next_value()? });
        }
        Ok(Content::Table(entries))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn yaml_json_and_toml_are_the_same_tree() {
        let yaml = "a: 1\nb:\n  c: [x, 2.5]\n  488: true\nd:\n";
        let json = "{\"a\": 1,\n \"b\": {\"c\": [\"x\", 2.5], \"488\": true},\n \"d\": null}";
        let toml = "a = 1\n[b]\nc = [\"x\", 2.5]\n488 = true\n";
        let (yaml, json) = (Node::from_yaml(yaml).unwrap(), Node::from_yaml(json).unwrap());
        assert_eq!(yaml.to_json(), json.to_json());
        let mut toml = Node::from_toml(toml).unwrap().to_json();
        toml["d"] = Value::Null;
        assert_eq!(yaml.to_json(), toml);
        let places = Places::of(&yaml);
        let lines =
            ["a", "b", "b.c", "b.c[1]", "b.488", "d", "b.missing.key", "z"].map(|key| places.line(key));
        assert_eq!(lines, [Some(1), Some(2), Some(3), Some(3), Some(4), Some(5), Some(2), None]);
    }

    #[test]
    fn what_is_no_number_never_becomes_one() {
        assert_eq!(Node::from_yaml("a: 1\nb: .inf").unwrap_err()[0].line, Some(2));
        assert!(Node::from_toml("a = inf").unwrap().to_json()["a"].is_string());
        let json = Node::from_yaml("c: 99999999999999999999999\nd: 18446744073709551615").unwrap().to_json();
        assert!(!json["c"].is_u64() && json["d"] == u64::MAX);
    }

    #[test]
    fn faults_of_syntax_have_a_line() {
        for text in ["a: [1, 2\nb: 3", "a: 1\na: 2", "a: b: c"] {
            let faults = Node::from_yaml(text).unwrap_err();
            assert!(faults.len() == 1 && faults[0].line.is_some(), "{text:?} {faults:?}");
            assert!(!faults[0].message.contains('\n'), "{faults:?}");
        }
        assert_eq!(Node::from_toml("a = 1\nb = = 2").unwrap_err()[0].line, Some(2));
    }

    #[test]
    fn hostile_yaml_ends_in_a_fault() {
        let bomb = "a: &a [x,x,x,x,x,x,x,x,x]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b,*b,*b,*b]\n\
                    d: &d [*c,*c,*c,*c,*c,*c,*c,*c,*c]\ne: &e [*d,*d,*d,*d,*d,*d,*d,*d,*d]\nf: &f [*e,*e,*e,*e,*e,*e,*e,*e,*e]\n\
                    g: &g [*f,*f,*f,*f,*f,*f,*f,*f,*f]\nh: [*g,*g,*g,*g,*g,*g,*g,*g,*g]\n";
        assert!(Node::from_yaml(bomb).is_err());
        assert!(Node::from_yaml(&"[".repeat(100_000)).is_err());
        assert!(Node::from_yaml(&format!("{}1", "a: {".repeat(50_000))).is_err());
    }
}
