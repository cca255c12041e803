//! Judges every set of dyes behind every dichroic and behind the best ideal edges.
//!
//! In: a [`Bench`]. Out: [`Findings`], the best choice first. Never: leaves out a dichroic that was named.
//! Fails: [`AppError`] for systems with too many dyes, with what to change.

use super::findings::{Choice, Findings, Provenance, SweepPoint, Worth, rows, worst};
use super::sources::{Bench, Dye, How, Splitter};
use super::{By, CHANNELS, DyesArguments, ORDERS};
use crate::app::AppError;
use crate::config::DyeError;
use crate::sofi::dye_choice::{
    BestEdges, ChoiceError, EdgeSplit, Merit, crosstalk_percent, spectral_channels,
};
use ndarray::Array2;

/// Sets of dyes that are ranked at most.
const MOST_SETS: usize = 2000;
/// Choices that are told of at most.
const MOST_CHOICES: usize = 100;
/// Distance of the points of an emission behind filters, nanometers.
const STEP_NM: f64 = 0.5;
/// Distance of the edges of a sweep, nanometers.
const SWEEP_NM: f64 = 1.0;
/// Edges as good as this share of the best are good.
const GOOD: f64 = 0.9;

/// A choice with what it is ranked by.
struct Ranked {
    value: f64,
    choice: Choice,
}

pub(super) fn judge(arguments: &DyesArguments, bench: &Bench) -> Result<Findings, AppError> {
    let DyesArguments { order, channels, .. } = *arguments;
    check_number(order, channels, bench.set_size)?;
    let sets = sets(bench)?;
    let mut ranked = Vec::new();
    let mut notes = bench.notes.clone();
    for set in &sets {
        let dyes: Vec<&Dye> = set.iter().map(|&place| &bench.dyes[place]).collect();
        for splitter in &bench.splitters {
            match shares(bench, &dyes, splitter)? {
                Some(shares) => ranked.push(choice(arguments, &dyes, described(splitter), &shares)?),
                None if bench.are_named && sets.len() == 1 => return Err(without(bench, &dyes, splitter)),
                None => {}
            }
        }
        if let Some(split) = split(arguments, bench, &dyes)? {
            let BestEdges { edges_nm, shares, .. } = split
                .best(order, arguments.range(), arguments.criterion())
                .map_err(|e| in_words(&e, &dyes))?;
            let edge = ("ideal edge".to_owned(), "ideal-edge", String::new(), edges_nm);
            ranked.push(choice(arguments, &dyes, edge, &shares)?);
        }
    }
    ranked.sort_by(|a, b| b.value.total_cmp(&a.value));
    let Some(best) = ranked.first() else {
        return Err(AppError::usage(
            "none of these dyes has an emission or a coefficient together; give --emission DYE=FILE",
        ));
    };
    let species = best.choice.species.clone();
    let dyes: Vec<&Dye> =
        species.iter().filter_map(|name| bench.dyes.iter().find(|dye| dye.name == *name)).collect();
    let lacking: Vec<&str> =
        dyes.iter().filter(|dye| dye.emission.is_none()).map(|dye| dye.name.as_str()).collect();
    if !lacking.is_empty() {
        notes.push(format!(
            "No emission of {} is known, so no edge was searched; give --emission DYE=FILE.",
            lacking.join(", ")
        ));
    }
    let best_edges_nm = ranked
        .iter()
        .find(|ranked| ranked.choice.kind == "ideal-edge" && ranked.choice.species == species)
        .map_or_else(Vec::new, |ranked| ranked.choice.edges_nm.clone());
    let sweep = match split(arguments, bench, &dyes)? {
        Some(split) if channels == 2 => {
            split.sweep(order, arguments.range(), SWEEP_NM).map_err(|error| in_words(&error, &dyes))?
        }
        _ => Vec::new(),
    };
    if ranked.len() > MOST_CHOICES {
        notes.push(format!("{} choices were ranked; the best {MOST_CHOICES} are told of.", ranked.len()));
        ranked.truncate(MOST_CHOICES);
    }
    Ok(Findings {
        order,
        channels,
        spectral_channels: spectral_channels(order, channels),
        by: match arguments.by {
            By::Product => "product",
            By::SmallestSingularValue => "smallest-singular-value",
            By::Noise => "noise",
        },
        t_error: arguments.t_error,
        good_edges_nm: good_edges(&sweep, &best_edges_nm),
        spectra: bench
            .dyes
            .iter()
            .map(|dye| Provenance { species: dye.name.clone(), emission: dye.source.clone() })
            .collect(),
        species,
        best_edges_nm,
        choices: ranked.into_iter().map(|ranked| ranked.choice).collect(),
        sweep: sweep
            .into_iter()
            .map(|(edge_nm, merit)| SweepPoint { edge_nm, merit: Worth::from(&merit) })
            .collect(),
        notes,
    })
}

/// Ideal edges for these dyes; nothing where an emission is missing.
pub(super) fn split(
    arguments: &DyesArguments,
    bench: &Bench,
    dyes: &[&Dye],
) -> Result<Option<EdgeSplit>, AppError> {
    let Some(emissions) = dyes.iter().map(|dye| dye.emission.as_ref()).collect::<Option<Vec<_>>>() else {
        return Ok(None);
    };
    let of_dye = |emission| {
        let [reflected, transmitted] = bench.path.weights(emission, STEP_NM).map_err(AppError::usage)?;
        // More than two channels have common filters only.
        let others = vec![reflected.clone(); arguments.channels - 2];
        Ok([vec![reflected], others, vec![transmitted]].concat())
    };
    let weights = emissions.into_iter().map(of_dye).collect::<Result<Vec<_>, AppError>>()?;
    EdgeSplit::weighted(weights).map(Some).map_err(|error| in_words(&error, dyes))
}

fn check_number(order: usize, channels: usize, dyes: usize) -> Result<(), AppError> {
    let available = spectral_channels(order, channels);
    if dyes <= available {
        return Ok(());
    }
    let higher = ORDERS.filter(|&order| spectral_channels(order, channels) >= dyes).min();
    let more = CHANNELS.filter(|&channels| spectral_channels(order, channels) >= dyes).min();
    let ways: Vec<String> = [("--order", higher), ("--channels", more)]
        .into_iter()
        .filter_map(|(name, number)| number.map(|number| format!("{name} {number}")))
        .chain([format!("at most {available} dyes")])
        .collect();
    let error = ChoiceError::TooManyDyes { dyes, spectral_channels: available, order, channels };
    Err(AppError::Usage(format!("{error}; choose {}", ways.join(" or "))))
}

/// All sets of dyes of the size asked for, as places in the list of dyes.
fn sets(bench: &Bench) -> Result<Vec<Vec<usize>>, AppError> {
    let mut sets: Vec<Vec<usize>> = vec![Vec::new()];
    for _ in 0..bench.set_size {
        let longer = sets.iter().flat_map(|set| {
            let next = set.last().map_or(0, |last| last + 1);
            (next..bench.dyes.len()).map(move |place| [&set[..], &[place]].concat())
        });
        sets = longer.take(MOST_SETS * bench.dyes.len()).collect();
    }
    if sets.len() > MOST_SETS {
        return Err(AppError::Usage(format!(
            "{} dyes make more than {MOST_SETS} sets of {}; name fewer dyes",
            bench.dyes.len(),
            bench.set_size
        )));
    }
    Ok(sets)
}

fn described(splitter: &Splitter) -> (String, &'static str, String, Vec<f64>) {
    let kind = match splitter.how {
        How::Coefficients => "coefficients",
        How::Curve(_) => "curve",
    };
    (splitter.name.clone(), kind, splitter.about.clone(), Vec::new())
}

/// Shares `[channel, dye]` behind a splitter; nothing where one is not known.
fn shares(bench: &Bench, dyes: &[&Dye], splitter: &Splitter) -> Result<Option<Array2<f64>>, AppError> {
    let responses =
        dyes.iter().map(|dye| bench.response(dye, splitter)).collect::<Result<Option<Vec<_>>, _>>()?;
    Ok(responses.map(|responses| {
        Array2::from_shape_fn((2, dyes.len()), |(channel, dye)| match channel {
            0 => responses[dye].reflection(),
            _ => responses[dye].transmission(),
        })
    }))
}

fn choice(
    arguments: &DyesArguments,
    dyes: &[&Dye],
    (dichroic, kind, about, edges_nm): (String, &'static str, String, Vec<f64>),
    shares: &Array2<f64>,
) -> Result<Ranked, AppError> {
    let merit = Merit::of(arguments.order, shares).map_err(|error| in_words(&error, dyes))?;
    let crosstalk = crosstalk_percent(arguments.order, shares, arguments.t_error)
        .map_err(|error| in_words(&error, dyes))?;
    let choice = Choice {
        species: dyes.iter().map(|dye| dye.name.clone()).collect(),
        dichroic,
        kind,
        about,
        edges_nm,
        shares: rows(shares),
        merit: Worth::from(&merit),
        worst_crosstalk_percent: worst(&crosstalk),
        crosstalk_percent: rows(&crosstalk),
    };
    Ok(Ranked { value: merit.by(arguments.criterion()), choice })
}

/// Why a dichroic that was named does not serve.
fn without(bench: &Bench, dyes: &[&Dye], splitter: &Splitter) -> AppError {
    if let How::Coefficients = splitter.how {
        let names: Vec<&str> = dyes.iter().map(|dye| dye.name.as_str()).collect();
        match bench.catalogue.species(&names, &splitter.name) {
            Err(DyeError::UnknownFluorophore { name, .. }) => AppError::Usage(format!(
                "{name} has no coefficient behind {}; give its curve with --dichroic-curve NAME=FILE",
                splitter.name
            )),
            Err(error) => AppError::usage(error),
            Ok(_) => AppError::Usage(format!("{} does not serve these dyes", splitter.name)),
        }
    } else {
        let lacking = dyes.iter().find(|dye| dye.emission.is_none()).map_or("a dye", |dye| dye.name.as_str());
        AppError::Usage(format!("no emission of {lacking} is known; give --emission \"{lacking}=FILE\""))
    }
}

/// The edges around the best one whose product is nearly as large.
fn good_edges(sweep: &[(f64, Merit)], best: &[f64]) -> Option<[f64; 2]> {
    let &[best] = best else { return None };
    let nearest =
        (0..sweep.len()).min_by(|&a, &b| (sweep[a].0 - best).abs().total_cmp(&(sweep[b].0 - best).abs()))?;
    let enough = GOOD * sweep[nearest].1.product;
    let is_good = |place: &usize| sweep[*place].1.product >= enough;
    let low = (0..=nearest).rev().take_while(is_good).last()?;
    let high = (nearest..sweep.len()).take_while(is_good).last()?;
    Some([sweep[low].0, sweep[high].0])
}

fn in_words(error: &ChoiceError, dyes: &[&Dye]) -> AppError {
    AppError::Usage(match *error {
        ChoiceError::Dark { dye } => {
            let name = dyes.get(dye).map_or("a dye", |dye| dye.name.as_str());
            format!("{name} sends no light through the filters; leave it out or change the filters")
        }
        _ => error.to_string(),
    })
}
