//! Which shares of the dyes' light the next live view and run go by.
//!
//! In: the source of frames, measured shares. Out: [`Measured`], [`DyeInUse`]. Never: changes what is under way.
//! Fails: [`AppError`].

use super::file::{self, Entry};
use crate::app::AppError;
use crate::app::analysis::Source;
use crate::app::window::session::Known;
use crate::config::Catalogue;
use crate::sofi::spectra::SpectralResponse;
use crate::viewer::bench::DyeInUse;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Shares that the next live view and run go by.
#[derive(Debug, Clone)]
pub(in crate::app::window) struct Measured {
    /// The text of their file.
    pub(in crate::app::window) text: String,
    /// For the window.
    pub(in crate::app::window) dyes: Arc<Vec<DyeInUse>>,
    /// Those that were measured in this session, by the dye's name.
    shares: BTreeMap<String, f64>,
}

impl Measured {
    /// What is in use now, with another measured share.
    pub(super) fn with(entry: &Entry, known: &Known) -> Result<Self, AppError> {
        let before = known.measured.load_full();
        let own = known.own_response();
        let base = before.as_ref().map(|before| before.text.as_str()).or(own.as_deref());
        let text = file::text(entry, base, known)?;
        let mut shares = before.map(|before| before.shares.clone()).unwrap_or_default();
        // As it stands in the file, digit by digit.
        shares.insert(entry.dye.clone(), (entry.transmission * 1e6).round() / 1e6);
        let mut dyes = known.dyes().as_ref().clone();
        dyes.retain(|dye| dye.dye != entry.dye);
        dyes.push(DyeInUse {
            dye: entry.dye.clone(),
            transmission: shares[&entry.dye],
            from: format!("measured in the live view, +/- {:.4}", entry.uncertainty),
        });
        Ok(Self { text, dyes: Arc::new(dyes), shares })
    }

    /// The source with these shares.
    pub(in crate::app::window) fn applied(&self, mut source: Source) -> Source {
        for species in source.species.iter_mut().flatten() {
            let share = self.shares.get(&species.name);
            let response = share.and_then(|&share| SpectralResponse::from_transmission(share).ok());
            species.response = response.unwrap_or(species.response);
        }
        source.calibrations.response = Some(self.text.clone());
        source
    }
}

/// The instrument's own shares, of every dye that has one.
pub(in crate::app::window) fn dyes_in_use(source: &Source, dichroic: Option<&str>) -> Vec<DyeInUse> {
    let text = source.calibrations.response.as_deref();
    let catalogue = text.and_then(|text| Catalogue::with_dichroics(text).ok());
    let catalogue = catalogue.unwrap_or_else(Catalogue::built_in);
    let dichroic = dichroic.or_else(|| catalogue.measured());
    let mut dyes = Vec::new();
    for dye in catalogue.fluorophores() {
        let sample = source.species.iter().flatten().find(|species| species.name == dye.name());
        let of_catalogue = dichroic.and_then(|name| catalogue.response(dye.name(), name).ok().flatten());
        let from = match (sample, text, dichroic) {
            (Some(_), ..) => "the simulated sample".to_owned(),
            (None, Some(_), _) => "the response file of the instrument, or the catalogue".to_owned(),
            (None, None, name) => format!("the catalogue, {}", name.unwrap_or_default()),
        };
        if let Some(response) = sample.map(|species| species.response).or(of_catalogue) {
            let (dye, transmission) = (dye.name().to_owned(), response.transmission());
            dyes.push(DyeInUse { dye, transmission, from });
        }
    }
    dyes
}
