//! What readers of instruments and plans ask of single values.
//!
//! In: a value and its key. Out: the value, believed or a stand-in that no one sees.
//! Never: stops at a fault. Fails: every fault is noted with the line of its key.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::time::Duration;

use super::nearest;
use super::section::Findings;
use super::tree::Places;

/// Notes what is wrong with the values of one file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Judge<'a> {
    /// Where faults are noted.
    pub(crate) findings: &'a Findings,
    /// Lines of the keys.
    pub(crate) places: &'a Places,
    /// What stands between a key and its value in such files, for remedies.
    pub(crate) assign: &'static str,
}

impl Judge<'_> {
    /// Notes a fault of a key.
    pub(crate) fn fault(&self, key: &str, message: impl Into<String>, remedy: impl Into<String>) {
        self.findings.note(self.places.line(key), key, message.into(), remedy.into());
    }

    /// A value that must be there; `example` is what could stand behind its key in the file.
    pub(crate) fn required<T>(&self, key: &str, value: Option<T>, example: &str) -> Option<T> {
        if value.is_none() {
            let name = key.rsplit('.').next().unwrap_or(key);
            self.fault(key, "is missing", format!("add `{name}{}{example}`", self.assign));
        }
        value
    }

    /// A number from `from` to `to`.
    pub(crate) fn within(&self, key: &str, value: f64, from: f64, to: f64) -> f64 {
        if !(from..=to).contains(&value) {
            self.fault(key, format!("is {value}"), format!("give a number from {from} to {to}"));
        }
        value
    }

    /// A time in milliseconds, from a microsecond to ten minutes.
    pub(crate) fn milliseconds(&self, key: &str, value: f64) -> Duration {
        let value = self.within(key, value, 0.001, 600_000.0);
        Duration::try_from_secs_f64(value / 1000.0).unwrap_or_default()
    }

    /// Width or height of a region in pixels.
    pub(crate) fn pixels(&self, key: &str, value: Option<u32>) -> u32 {
        let value = self.required(key, value, "512").unwrap_or(512);
        self.within(key, f64::from(value), 4.0, 65_536.0);
        value
    }

    /// One of some names.
    pub(crate) fn choice<T: Copy>(&self, key: &str, name: &str, known: &[(&str, T)]) -> Option<T> {
        let found = known.iter().find(|(known, _)| *known == name).map(|(_, value)| *value);
        if found.is_none() {
            let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
            let near = nearest(name, names.iter().copied()).first().map(|near| format!("write `{near}`"));
            let remedy = near.unwrap_or_else(|| format!("give one of {}", names.join(", ")));
            self.fault(key, format!("\"{name}\" is not known"), remedy);
        }
        found
    }

    /// The version of the file's form that this program reads.
    pub(crate) fn version<V: PartialEq + Display>(&self, key: &str, found: &V, known: &V) {
        if found != known {
            self.fault(
                key,
                format!("is {found}, and this program reads version {known}"),
                "convert the file, or use the program it was written for",
            );
        }
    }

    /// Powers in mW by laser line in nm; only finite ones of lines that can be told from each other.
    pub(crate) fn laser_power(&self, key: &str, lines: Option<&BTreeMap<String, f64>>) -> BTreeMap<u32, f64> {
        let mut known = BTreeMap::new();
        for (line, &power) in lines.into_iter().flatten() {
            let key = format!("{key}.{line}");
            let power = self.within(&key, power, 0.0, 100_000.0);
            match line.parse::<u32>() {
                Ok(line @ 200..=2000) => {
                    known.insert(line, power);
                }
                _ => self.fault(
                    &key,
                    "is no laser line",
                    format!("write the wavelength in nm, such as 488{}5.0", self.assign),
                ),
            }
        }
        known
    }
}
