//! Spectra from CSV files, and what must be said about them.
//!
//! In: arguments of the form `NAME=FILE` or `FILE`. Out: curves with their names. Never: fills in what a file lacks.
//! Fails: [`AppError`] with file, line and remedy.

use crate::app::AppError;
use crate::app::text_file::read_text;
use crate::config::{ParametricSpectra, ValueUnit, read_spectrum};
use crate::sofi::spectra::Spectrum;
use std::path::Path;

/// Longest file that is read.
const MOST_BYTES: u64 = 4 << 20;
/// Share of an emission outside a filter's table that is worth a note.
const OUTSIDE: f64 = 0.01;
/// An emission should have fallen to this share of its peak where its table ends.
const CUT: f64 = 0.05;

/// A curve and where it comes from.
#[derive(Debug, Clone)]
pub(super) struct Curve {
    pub(super) name: String,
    /// File, or the parametric spectra.
    pub(super) source: String,
    pub(super) spectrum: Spectrum,
}

/// Curves given as `NAME=FILE`.
pub(super) fn named(
    option: &str,
    given: &[String],
    unit: ValueUnit,
    notes: &mut Vec<String>,
) -> Result<Vec<Curve>, AppError> {
    let curve = |argument: &String| {
        let Some((name, file)) =
            argument.split_once('=').filter(|(name, file)| !name.is_empty() && !file.is_empty())
        else {
            return Err(AppError::Usage(format!(
                "{option} {argument} names no file; write {option} NAME=FILE, as in \"{option} Mine=mine.csv\""
            )));
        };
        from_file(name.trim(), file, unit, notes)
    };
    given.iter().map(curve).collect()
}

/// Filters given by file, or by the name of a parametric one.
pub(super) fn filters(
    given: &[String],
    parametric: &ParametricSpectra,
    notes: &mut Vec<String>,
) -> Result<Vec<Curve>, AppError> {
    let filter = |file: &String| match parametric.filter(file).filter(|_| !Path::new(file).exists()) {
        Some(spectrum) => {
            Ok(Curve { name: file.clone(), source: "parametric".to_owned(), spectrum: spectrum.clone() })
        }
        None => from_file(file, file, ValueUnit::Share, notes),
    };
    given.iter().map(filter).collect()
}

fn from_file(name: &str, file: &str, unit: ValueUnit, notes: &mut Vec<String>) -> Result<Curve, AppError> {
    let text = read_text(Path::new(file), MOST_BYTES)?;
    let read = read_spectrum(&text, unit).map_err(|faults| AppError::Usage(format!("{file}: {faults}")))?;
    if read.was_percent {
        notes.push(format!("{file} was read as percent."));
    }
    Ok(Curve { name: name.to_owned(), source: file.to_owned(), spectrum: read.spectrum })
}

/// Emissions whose table ends before their light does.
pub(super) fn note_cut(emission: &Curve, notes: &mut Vec<String>) {
    let spectrum = &emission.spectrum;
    let (first, last) = spectrum.range_nm();
    for (end, side) in [(first, "begins"), (last, "ends")] {
        let share = spectrum.at(end) / spectrum.peak();
        if share > CUT {
            notes.push(format!(
                "The emission of {} {side} at {end} nm with {:.0} % of its peak; light beyond does not count.",
                emission.name,
                100.0 * share
            ));
        }
    }
}

/// Filters whose table does not cover the light of a dye.
pub(super) fn note_uncovered(filter: &Curve, dye: &str, emission: &Spectrum, notes: &mut Vec<String>) {
    let (first, last) = filter.spectrum.range_nm();
    let whole = emission.integral_above(f64::NEG_INFINITY);
    let inside = emission.integral_above(first) - emission.integral_above(last);
    let outside = 1.0 - inside / whole;
    if outside > OUTSIDE {
        notes.push(format!(
            "{} covers {first} to {last} nm; {:.0} % of the light of {dye} lies outside, where its end values are kept.",
            filter.source,
            100.0 * outside
        ));
    }
}
