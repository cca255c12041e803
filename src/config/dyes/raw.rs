//! The catalogue as typed: keys, kinds and limits are checked here, what belongs together is not.
//!
//! In: text in TOML. Out: entries with their places in the text. Never: compares two entries.
//! Fails: never at once; all faults are noted.

use sofiscope_form::{Faults, Form, read};

/// Emission maxima that microscopes see.
const EMISSION_NM: std::ops::RangeInclusive<f64> = 300.0..=2000.0;

/// Where an entry stands.
#[derive(Debug)]
pub(super) struct Place {
    /// Line in the text.
    pub(super) line: Option<usize>,
    /// Dotted key.
    pub(super) key: String,
}

/// An entry of `fluorophores.toml`.
#[derive(Debug)]
pub(super) struct RawFluorophore {
    pub(super) at: Place,
    pub(super) name: String,
    pub(super) aliases: Vec<String>,
    pub(super) emission_nm: Option<f64>,
}

/// An entry of `dichroics.toml`.
#[derive(Debug)]
pub(super) struct RawDichroic {
    pub(super) at: Place,
    pub(super) name: String,
    pub(super) aliases: Vec<String>,
    pub(super) about: String,
    pub(super) coefficients: Vec<RawCoefficient>,
}

/// One coefficient of a dichroic.
#[derive(Debug)]
pub(super) struct RawCoefficient {
    pub(super) at: Place,
    pub(super) fluorophore: String,
    pub(super) transmission: f64,
    pub(super) reflection: Option<f64>,
}

pub(super) fn fluorophores(faults: &Faults<'_>) -> Vec<RawFluorophore> {
    read(faults, |form| each(form, "fluorophore", fluorophore)).unwrap_or_default()
}

pub(super) fn dichroics(faults: &Faults<'_>) -> Vec<RawDichroic> {
    read(faults, |form| each(form, "dichroic", dichroic)).unwrap_or_default()
}

fn each<T>(form: &Form<'_>, key: &'static str, entry: impl Fn(&Form<'_>) -> T) -> Vec<T> {
    let entries = form.some_tables(key).into_iter().map(|inner| {
        let value = entry(&inner);
        inner.finish();
        value
    });
    entries.collect()
}

fn fluorophore(form: &Form<'_>) -> RawFluorophore {
    RawFluorophore {
        at: place(form, "name"),
        name: form.text("name"),
        aliases: form.texts_if_any("aliases", 0..=usize::MAX),
        emission_nm: form.number_if_any("emission_nm", EMISSION_NM),
    }
}

fn dichroic(form: &Form<'_>) -> RawDichroic {
    // Where measured coefficients come from is for people.
    for key in ["date", "instrument", "reflected_serial", "transmitted_serial", "registration", "blank"] {
        form.prose(key);
    }
    RawDichroic {
        at: place(form, "name"),
        name: form.text("name"),
        aliases: form.texts_if_any("aliases", 0..=usize::MAX),
        about: form.prose("about"),
        coefficients: each(form, "coefficients", coefficient),
    }
}

fn coefficient(form: &Form<'_>) -> RawCoefficient {
    form.number_if_any("transmission_uncertainty", 0.0..=1.0);
    for key in ["recording", "date", "regions", "background", "exposures", "registration"] {
        form.prose(key);
    }
    RawCoefficient {
        at: place(form, "fluorophore"),
        fluorophore: form.text("fluorophore"),
        transmission: form.number("transmission", 0.0..=1.0),
        reflection: form.number_if_any("reflection", 0.0..=1.0),
    }
}

fn place(form: &Form<'_>, key: &str) -> Place {
    Place { line: form.line(key), key: form.name(key) }
}
