//! What is known before anything is judged: dyes with their emissions, dichroics, filters.
//!
//! In: the arguments. Out: [`Bench`]. Never: mixes a coefficient with a curve. Fails: [`AppError`] with nearest names.

use super::curves::{Curve, filters, named, note_cut, note_uncovered};
use super::{DyesArguments, USUAL_SET};
use crate::app::AppError;
use crate::config::{Catalogue, DyeError, ParametricSpectra, ValueUnit, nearest, plain};
use crate::sofi::spectra::{DichroicCurve, LightPath, SpectralResponse, Spectrum};

/// Where parametric curves come from.
const PARAMETRIC: &str = "parametric, for planning";

/// A dye that may be chosen.
#[derive(Debug, Clone)]
pub(super) struct Dye {
    pub(super) name: String,
    pub(super) emission: Option<Spectrum>,
    /// Where the emission comes from.
    pub(super) source: Option<String>,
}

/// Something that divides the light between R and T.
#[derive(Debug, Clone)]
pub(super) struct Splitter {
    pub(super) name: String,
    pub(super) about: String,
    pub(super) how: How,
}

/// How a splitter is known.
#[derive(Debug, Clone)]
pub(super) enum How {
    /// By coefficients of the catalogue.
    Coefficients,
    /// By a curve, and what its light passes besides.
    Curve(Box<(DichroicCurve, LightPath)>),
}

/// Everything that is known.
#[derive(Debug)]
pub(super) struct Bench {
    pub(super) catalogue: Catalogue,
    /// The dyes asked for, or all.
    pub(super) dyes: Vec<Dye>,
    /// Dyes in a set.
    pub(super) set_size: usize,
    pub(super) splitters: Vec<Splitter>,
    /// Whether the splitters were named, so that each must serve.
    pub(super) are_named: bool,
    pub(super) path: LightPath,
    pub(super) notes: Vec<String>,
}

impl Bench {
    pub(super) fn lay_out(arguments: &DyesArguments) -> Result<Self, AppError> {
        let (catalogue, parametric) = (Catalogue::built_in(), ParametricSpectra::built_in());
        let mut notes = Vec::new();
        let mut emissions = named("--emission", &arguments.emission, ValueUnit::Any, &mut notes)?;
        for emission in &mut emissions {
            if let Ok(known) = catalogue.fluorophore(&emission.name) {
                known.name().clone_into(&mut emission.name);
            }
            note_cut(emission, &mut notes);
        }
        let curves = named("--dichroic-curve", &arguments.dichroic_curve, ValueUnit::Share, &mut notes)?;
        let mut filters = |given| filters(given, &parametric, &mut notes);
        let common = filters(&arguments.filter)?;
        let (reflected, transmitted) = (filters(&arguments.filter_r)?, filters(&arguments.filter_t)?);
        let dyes = dyes(arguments, &catalogue, &parametric, &emissions)?;
        for dye in &dyes {
            for curve in [&common, &reflected, &transmitted, &curves].into_iter().flatten() {
                if let Some(emission) = &dye.emission {
                    note_uncovered(curve, &dye.name, emission, &mut notes);
                }
            }
        }
        let spectra = |curves: Vec<Curve>| curves.into_iter().map(|curve| curve.spectrum).collect();
        let path = LightPath {
            common: spectra(common),
            reflected: spectra(reflected),
            transmitted: spectra(transmitted),
        };
        if !path.is_free() && arguments.channels == 2 {
            notes.push(
                "The filters given act on curves and ideal edges, not on coefficients of the catalogue."
                    .to_owned(),
            );
        }
        let known = splitters(&catalogue, &parametric, curves, &path)?;
        let are_named = !arguments.dichroic.is_empty();
        let splitters = match (arguments.channels, are_named) {
            (2, false) => known,
            (2, true) => arguments
                .dichroic
                .iter()
                .map(|name| pick(&known, &catalogue, name))
                .collect::<Result<_, _>>()?,
            _ => Vec::new(),
        };
        let set_size = set_size(arguments, dyes.len())?;
        Ok(Self { catalogue, dyes, set_size, splitters, are_named, path, notes })
    }

    /// The response of a dye behind a splitter; nothing where none is known.
    pub(super) fn response(
        &self,
        dye: &Dye,
        splitter: &Splitter,
    ) -> Result<Option<SpectralResponse>, AppError> {
        match (&splitter.how, &dye.emission) {
            (How::Coefficients, _) => Ok(self.catalogue.response(&dye.name, &splitter.name).ok().flatten()),
            (How::Curve(_), None) => Ok(None),
            (How::Curve(curve), Some(emission)) => {
                let (curve, path) = &**curve;
                let detected = path.detected(emission, curve);
                let refused =
                    |error| AppError::Usage(format!("{} behind {}: {error}", dye.name, splitter.name));
                Ok(Some(detected.map_err(refused)?.response))
            }
        }
    }
}

fn set_size(arguments: &DyesArguments, dyes: usize) -> Result<usize, AppError> {
    let is_asked = !arguments.names.is_empty() || !arguments.species.is_empty();
    match arguments.choose {
        Some(size) if (1..=dyes).contains(&size) => Ok(size),
        Some(size) => Err(AppError::Usage(format!(
            "{size} of {dyes} dyes cannot be chosen; give --choose 1 to {dyes}, or more dyes"
        ))),
        None if is_asked => Ok(dyes),
        None => Ok(USUAL_SET.min(dyes)),
    }
}

fn dyes(
    arguments: &DyesArguments,
    catalogue: &Catalogue,
    parametric: &ParametricSpectra,
    emissions: &[Curve],
) -> Result<Vec<Dye>, AppError> {
    let asked: Vec<&str> = arguments.names.iter().chain(&arguments.species).map(|name| name.trim()).collect();
    if asked.iter().any(|name| name.is_empty()) {
        return Err(AppError::usage("a name of a dye is empty; write dyes apart by single commas"));
    }
    let mut names: Vec<String> = if asked.is_empty() {
        let known = catalogue.fluorophores().iter().map(|dye| dye.name().to_owned());
        let new = emissions.iter().map(|emission| emission.name.clone());
        known.chain(new).collect()
    } else {
        asked.iter().map(|name| full_name(name, catalogue, emissions)).collect::<Result<_, _>>()?
    };
    if asked.is_empty() {
        let mut seen: Vec<String> = Vec::new();
        names.retain(|name| {
            !seen.contains(name) && {
                seen.push(name.clone());
                true
            }
        });
    } else if let Some(again) = (1..names.len()).find(|&i| names[..i].contains(&names[i])) {
        return Err(AppError::usage(DyeError::Repeated(names[again].clone())));
    }
    let dye = |name: String| {
        let measured = emissions.iter().find(|emission| emission.name == name);
        let (emission, source) = match measured {
            Some(curve) => (Some(curve.spectrum.clone()), Some(curve.source.clone())),
            None => {
                let emission = parametric.emission(&name).cloned();
                let source = emission.as_ref().map(|_| PARAMETRIC.to_owned());
                (emission, source)
            }
        };
        Dye { name, emission, source }
    };
    Ok(names.into_iter().map(dye).collect())
}

/// The full name of a dye of the catalogue or of a measured emission.
fn full_name(asked: &str, catalogue: &Catalogue, emissions: &[Curve]) -> Result<String, AppError> {
    if let Some(emission) = emissions.iter().find(|emission| plain(&emission.name) == plain(asked)) {
        return Ok(emission.name.clone());
    }
    match catalogue.fluorophore(asked) {
        Ok(dye) => Ok(dye.name().to_owned()),
        Err(DyeError::UnknownFluorophore { name, nearest: near, mut known }) => {
            let mut all: Vec<String> = nearest(asked, emissions.iter().map(|e| e.name.as_str()))
                .into_iter()
                .map(str::to_owned)
                .collect();
            all.extend(near);
            known.extend(emissions.iter().map(|emission| emission.name.clone()));
            let unknown = DyeError::UnknownFluorophore { name, nearest: all, known };
            Err(AppError::Usage(format!("{unknown} A new dye needs --emission \"{asked}=FILE\".")))
        }
        Err(other) => Err(AppError::usage(other)),
    }
}

fn splitters(
    catalogue: &Catalogue,
    parametric: &ParametricSpectra,
    curves: Vec<Curve>,
    path: &LightPath,
) -> Result<Vec<Splitter>, AppError> {
    let mut all: Vec<Splitter> = catalogue
        .dichroics()
        .iter()
        .map(|known| Splitter {
            name: known.name().to_owned(),
            about: known.about().to_owned(),
            how: How::Coefficients,
        })
        .collect();
    for known in parametric.dichroics() {
        // Filters that were given stand in place of those that the parametric dichroic comes with.
        let path = if path.is_free() { &known.path } else { path };
        all.push(Splitter {
            name: known.name.clone(),
            about: PARAMETRIC.to_owned(),
            how: How::Curve(Box::new((known.curve.clone(), path.clone()))),
        });
    }
    for Curve { name, source, spectrum } in curves {
        if all.iter().any(|known| plain(&known.name) == plain(&name)) {
            return Err(AppError::Usage(format!(
                "a dichroic is called \"{name}\" already; give --dichroic-curve another name"
            )));
        }
        let refused = |error| AppError::Usage(format!("{source}: {error}"));
        let curve = DichroicCurve::lossless(spectrum).map_err(refused)?;
        all.push(Splitter { name, about: source, how: How::Curve(Box::new((curve, path.clone()))) });
    }
    Ok(all)
}

fn pick(known: &[Splitter], catalogue: &Catalogue, asked: &str) -> Result<Splitter, AppError> {
    // The catalogue knows other names too, and which are near.
    let (full, near) = match catalogue.dichroic(asked) {
        Ok(dichroic) => (dichroic.name(), Vec::new()),
        Err(DyeError::UnknownDichroic { nearest, .. }) => (asked, nearest),
        Err(_) => (asked, Vec::new()),
    };
    if let Some(found) = known.iter().find(|splitter| plain(&splitter.name) == plain(full)) {
        return Ok(found.clone());
    }
    let names = || known.iter().map(|splitter| splitter.name.as_str());
    let mut all = near;
    all.extend(nearest(asked, names()).into_iter().map(str::to_owned));
    let mut seen: Vec<String> = Vec::new();
    for name in all {
        if !seen.contains(&name) {
            seen.push(name);
        }
    }
    Err(AppError::usage(DyeError::UnknownDichroic {
        name: asked.to_owned(),
        nearest: seen,
        known: names().map(str::to_owned).collect(),
    }))
}
