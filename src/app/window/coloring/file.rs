//! The response file of shares that were measured in the live view.
//!
//! In: the measured share, what was in use before. Out: text as `calibrate response` writes it.
//! Never: overwrites a file, forgets a share that was in use. Fails: [`AppError`].

use crate::app::AppError;
use crate::app::window::session::Known;
use crate::config::{Catalogue, Dichroic, Fluorophore};
use crate::sofi::spectra::SpectralResponse;
use crate::viewer::bench::MarkedRegions;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use toml::{Table, Value};

/// One measured share with where it comes from.
#[derive(Debug, Clone)]
pub(super) struct Entry {
    pub(super) dye: String,
    /// 0 to 1.
    pub(super) transmission: f64,
    /// Of 95 %.
    pub(super) uncertainty: f64,
    pub(super) marked: MarkedRegions,
    pub(super) exposures: String,
    pub(super) registration: String,
    pub(super) date: String,
}

impl Entry {
    fn table(&self) -> Table {
        let rounded = |value: f64| Value::Float((value * 1e6).round() / 1e6);
        let regions: Vec<String> = self.marked.dye.iter().map(in_words).collect();
        let background = self.marked.background.as_ref().map_or("surroundings".to_owned(), in_words);
        let entries = [
            ("fluorophore", Value::from(self.dye.as_str())),
            ("transmission", rounded(self.transmission)),
            ("transmission_uncertainty", rounded(self.uncertainty)),
            ("recording", Value::from("live view")),
            ("date", Value::from(self.date.as_str())),
            ("regions", Value::from(regions.join("; "))),
            ("background", Value::from(background)),
            ("exposures", Value::from(self.exposures.as_str())),
            ("registration", Value::from(self.registration.as_str())),
        ];
        entries.map(|(key, value)| (key.to_owned(), value)).into_iter().collect()
    }
}

fn in_words([left, top, width, height]: &[u32; 4]) -> String {
    format!("{width} x {height} px from column {left} and row {top} on")
}

/// The text of the file: the shares in use until now, with the measured one in its place.
pub(super) fn text(entry: &Entry, base: Option<&str>, known: &Known) -> Result<String, AppError> {
    let catalogue = match base {
        Some(base) => Catalogue::with_dichroics(base).map_err(AppError::data)?,
        None => Catalogue::built_in(),
    };
    let named = known.instrument.dichroic();
    let asked = named.or_else(|| catalogue.measured());
    let name = asked.map_or(Ok("measured"), |name| catalogue.dichroic(name).map(Dichroic::name));
    let name = name.map_err(AppError::usage)?.to_owned();
    let tables = base.map(str::parse::<Table>).transpose().map_err(AppError::data)?;
    let dichroics = tables.as_ref().and_then(|table| table.get("dichroic")).and_then(Value::as_array);
    let dichroics: Vec<&Table> = dichroics.into_iter().flatten().filter_map(Value::as_table).collect();
    let (own, others): (Vec<&Table>, Vec<&Table>) =
        dichroics.into_iter().partition(|table| table.get("name").and_then(Value::as_str) == Some(&name));
    let mut coefficients = match own.first() {
        Some(own) => carried(own, &entry.dye, &catalogue),
        None => from_catalogue(&catalogue, asked, &entry.dye),
    };
    coefficients.push(entry.table());
    let mut text = "# Shares of the light of each dye on camera T, measured in regions of the live view; R = 1 - T.\n\
         # They are shares of counts, as the unmixing takes them. Uncertainties are those of 95 %; shares without one were\n\
         # in use before and are carried over. Regions are in pixels of the sensor of camera R.\n"
        .to_owned();
    let mut head = Table::new();
    head.insert("name".to_owned(), Value::from(name.as_str()));
    let mut aliases: Vec<Value> =
        own.first().and_then(|own| own.get("aliases")).and_then(Value::as_array).cloned().unwrap_or_default();
    if let Some(named) =
        named.filter(|named| *named != name && !aliases.iter().any(|alias| alias.as_str() == Some(named)))
    {
        aliases.push(Value::from(named));
    }
    if !aliases.is_empty() {
        head.insert("aliases".to_owned(), Value::Array(aliases));
    }
    let [r, t] = known.serials();
    let facts = [
        ("about", Some("measured in regions of the live view, beside what was in use before".to_owned())),
        ("date", Some(entry.date.clone())),
        ("instrument", Some(known.instrument.name().to_owned())),
        ("reflected_serial", r),
        ("transmitted_serial", t),
        ("registration", Some(entry.registration.clone())),
    ];
    for (key, value) in facts {
        if let Some(value) = value {
            head.insert(key.to_owned(), Value::from(value));
        }
    }
    write_dichroic(&mut text, &head, &coefficients);
    for other in others {
        write_dichroic(&mut text, other, &coefficients_of(other));
    }
    Catalogue::with_dichroics(&text).map_err(AppError::data)?;
    Ok(text)
}

fn coefficients_of(dichroic: &Table) -> Vec<Table> {
    let list = dichroic.get("coefficients").and_then(Value::as_array);
    list.into_iter().flatten().filter_map(Value::as_table).cloned().collect()
}

/// The coefficients of a file but that of one dye, with all that is said of them.
fn carried(dichroic: &Table, dye: &str, catalogue: &Catalogue) -> Vec<Table> {
    let is_other = |table: &Table| {
        let name = table.get("fluorophore").and_then(Value::as_str).unwrap_or_default();
        catalogue.fluorophore(name).is_ok_and(|found| found.name() != dye)
    };
    coefficients_of(dichroic).into_iter().filter(is_other).collect()
}

/// The coefficients of the catalogue but that of one dye.
fn from_catalogue(catalogue: &Catalogue, dichroic: Option<&str>, dye: &str) -> Vec<Table> {
    let Some(dichroic) = dichroic else { return Vec::new() };
    let of = |name: &str| -> Option<SpectralResponse> { catalogue.response(name, dichroic).ok().flatten() };
    let others = catalogue.fluorophores().iter().map(Fluorophore::name).filter(|name| *name != dye);
    let tables = others.filter_map(|name| {
        let response = of(name)?;
        let mut table = Table::new();
        table.insert("fluorophore".to_owned(), Value::from(name));
        table.insert("transmission".to_owned(), Value::Float(response.transmission()));
        if (response.transmission() + response.reflection() - 1.0).abs() > 1e-9 {
            table.insert("reflection".to_owned(), Value::Float(response.reflection()));
        }
        table.insert("recording".to_owned(), Value::from("carried over from the catalogue"));
        Some(table)
    });
    tables.collect()
}

/// In the shape of `calibrate response`: one line for each coefficient.
fn write_dichroic(text: &mut String, head: &Table, coefficients: &[Table]) {
    text.push_str("[[dichroic]]\n");
    for (key, value) in head.iter().filter(|(key, _)| *key != "coefficients") {
        let _ = writeln!(text, "{key} = {value}");
    }
    text.push_str("coefficients = [\n");
    for table in coefficients {
        let first = ["fluorophore", "transmission", "transmission_uncertainty"];
        let begin = first.iter().filter_map(|key| table.get_key_value(*key));
        let rest = table.iter().filter(|(key, _)| !first.contains(&key.as_str()));
        let pairs: Vec<String> = begin.chain(rest).map(|(key, value)| format!("{key} = {value}")).collect();
        let _ = writeln!(text, "  {{ {} }},", pairs.join(", "));
    }
    text.push_str("]\n");
}

/// Writes a file that must not exist yet.
pub(super) fn write_new(path: &Path, text: &str) -> Result<(), AppError> {
    let opened = std::fs::File::options().write(true).create_new(true).open(path);
    let mut file = opened.map_err(|error| match error.kind() {
        std::io::ErrorKind::AlreadyExists => {
            AppError::Usage(format!("{} exists; give the response file another name", path.display()))
        }
        _ => AppError::Usage(format!("{}: {error}", path.display())),
    })?;
    file.write_all(text.as_bytes()).map_err(|error| AppError::Usage(format!("{}: {error}", path.display())))
}
