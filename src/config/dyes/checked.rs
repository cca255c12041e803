//! The catalogue that can be believed: every name means one thing, every coefficient has its fluorophore.
//!
//! In: entries as typed. Out: [`Fluorophore`]s and [`Dichroic`]s. Never: stops at the first fault.
//! Fails: never at once; all faults are noted, and an entry with one is left out.

use std::collections::BTreeMap;

use super::super::names::suggestion;
use super::raw::{Place, RawCoefficient, RawDichroic, RawFluorophore};
use super::{Dichroic, Fluorophore, Named, nearest_names};
use crate::sofi::spectra::SpectralResponse;
use sofiscope_form::{Faults, plain};

pub(super) fn fluorophores(raw: Vec<RawFluorophore>, faults: &Faults<'_>) -> Vec<Fluorophore> {
    let mut names = Names::default();
    let entries = raw.into_iter().map(|raw| {
        names.claim(&raw.name, &raw.aliases, &raw.at, faults);
        Fluorophore { name: raw.name, aliases: raw.aliases, emission_nm: raw.emission_nm }
    });
    entries.collect()
}

pub(super) fn dichroics(
    raw: Vec<RawDichroic>,
    fluorophores: &[Fluorophore],
    faults: &Faults<'_>,
) -> Vec<Dichroic> {
    let mut names = Names::default();
    let entries = raw.into_iter().map(|raw| {
        names.claim(&raw.name, &raw.aliases, &raw.at, faults);
        let mut responses = BTreeMap::new();
        for coefficient in &raw.coefficients {
            let Some((index, response)) = response(coefficient, fluorophores, faults) else {
                continue;
            };
            if responses.insert(index, response).is_some() {
                let message = format!("is \"{}\" a second time", coefficient.fluorophore);
                note(faults, &coefficient.at, message, "remove one of the two entries".to_owned());
            }
        }
        Dichroic { name: raw.name, aliases: raw.aliases, about: raw.about, responses }
    });
    entries.collect()
}

fn response(
    raw: &RawCoefficient,
    fluorophores: &[Fluorophore],
    faults: &Faults<'_>,
) -> Option<(usize, SpectralResponse)> {
    if raw.fluorophore.is_empty() {
        return None;
    }
    let Some(index) = fluorophores.iter().position(|known| known.is_called(&raw.fluorophore)) else {
        let near = suggestion(&nearest_names(&raw.fluorophore, fluorophores));
        let remedy = format!("add it to fluorophores.toml or correct the name.{near}");
        note(faults, &raw.at, format!("is \"{}\", no known fluorophore", raw.fluorophore), remedy);
        return None;
    };
    let response = match raw.reflection {
        None => SpectralResponse::from_transmission(raw.transmission),
        Some(reflection) => SpectralResponse::measured(raw.transmission, reflection),
    };
    response.ok().map(|response| (index, response))
}

fn note(faults: &Faults<'_>, at: &Place, message: String, remedy: String) {
    faults.note(at.line, &at.key, message, remedy);
}

/// Names taken so far, by their plain form.
#[derive(Debug, Default)]
struct Names {
    taken: BTreeMap<String, String>,
}

impl Names {
    fn claim(&mut self, name: &str, aliases: &[String], at: &Place, faults: &Faults<'_>) {
        for called in aliases.iter().map(String::as_str).chain([name]).filter(|called| !called.is_empty()) {
            let is_taken = |owner: &String| owner != name || called == name;
            if let Some(owner) = self.taken.insert(plain(called), name.to_owned())
                && is_taken(&owner)
            {
                let message = format!("or an alias is \"{called}\", which {owner} is called already");
                note(faults, at, message, "give each its own names".to_owned());
            }
        }
    }
}
