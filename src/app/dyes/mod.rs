//! `dyes`: which dyes and which dichroic, before anything is bought or stained (supporting information, Fig. S2).
//!
//! In: names of dyes and dichroics, spectra as CSV. Out: a table, one JSON object, a plot.
//! Never: takes a parametric spectrum for a measured one unsaid. Fails: [`AppError`] with what to change.

mod curves;
mod findings;
mod judging;
mod plot;
mod sources;
mod table;

use super::AppError;
use crate::sofi::dye_choice::{Criterion, EdgeRange};
use std::path::PathBuf;

/// Dyes of a set where none is asked for: the paper's three.
const USUAL_SET: usize = 3;
/// Orders that the analysis has.
const ORDERS: std::ops::RangeInclusive<usize> = 2..=6;
/// Physical channels that edges are searched for.
const CHANNELS: std::ops::RangeInclusive<usize> = 2..=8;

/// Arguments of `dyes`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  sofiscope dyes AF488 \"Atto 565\" AF647
  sofiscope dyes AF488,Atto565,AF647 --plot dyes.svg
  sofiscope dyes --choose 3 --dichroic \"zt 594 RDC\" --by noise
  sofiscope dyes AF488,JF549,AF568,AF647 --order 3
  sofiscope dyes AF488,JF549,Atto565,AF568,AF647 --channels 3 --json
  sofiscope dyes AF488 AF647 Mine --emission Mine=mine.csv --dichroic-curve T610=t610.csv --filter quad.csv \\
      --filter-t longpass.csv --filter qe.csv

Spectra are CSV files of two columns, wavelength in nm and value, on any grid; shares are 0 to 1 or percent.
Dyes without a measured emission have a parametric one, made for planning.")]
pub(super) struct DyesArguments {
    /// Dyes, apart by commas or spaces [default: the best sets of three of all known ones]
    #[arg(value_name = "DYE", value_delimiter = ',')]
    names: Vec<String>,
    /// The same, as `analyze` has it
    #[arg(long, value_name = "DYE,...", value_delimiter = ',')]
    species: Vec<String>,
    /// Rank all sets of so many of these dyes, or of all known ones
    #[arg(long, value_name = "NUMBER")]
    choose: Option<usize>,
    /// Dichroics, apart by commas [default: all that are known for these dyes]
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    dichroic: Vec<String>,
    /// Cumulant order, 2 to 6
    #[arg(long, default_value_t = 2)]
    order: usize,
    /// Physical channels, 2 to 8; from 3 on ideal edges are searched instead of dichroics
    #[arg(long, default_value_t = 2)]
    channels: usize,
    /// What is best: product of the eigenvalues, smallest singular value, or noise
    #[arg(long, value_enum, default_value_t = By::Product)]
    by: By,
    /// Error of T that crosstalk is predicted for
    #[arg(long, default_value_t = 0.02)]
    t_error: f64,
    /// Lowest wavelength of an edge, nm
    #[arg(long, default_value_t = 450.0)]
    from_nm: f64,
    /// Highest wavelength of an edge, nm
    #[arg(long, default_value_t = 800.0)]
    to_nm: f64,
    /// Measured emission of a dye, known or new
    #[arg(long, value_name = "DYE=FILE")]
    emission: Vec<String>,
    /// Transmission of a dichroic over wavelength
    #[arg(long, value_name = "NAME=FILE")]
    dichroic_curve: Vec<String>,
    /// Filter or quantum efficiency that all light passes
    #[arg(long, value_name = "FILE")]
    filter: Vec<String>,
    /// Filter or quantum efficiency of camera R
    #[arg(long, value_name = "FILE")]
    filter_r: Vec<String>,
    /// Filter or quantum efficiency of camera T
    #[arg(long, value_name = "FILE")]
    filter_t: Vec<String>,
    /// Draw spectra and eigenvalues over the edge, as in Figure S2, into this SVG file; must not exist
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Print one object on stdout
    #[arg(long)]
    json: bool,
}

/// What makes one choice better than another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum By {
    Product,
    SmallestSingularValue,
    Noise,
}

impl DyesArguments {
    fn criterion(&self) -> Criterion {
        match self.by {
            By::Product => Criterion::Product,
            By::SmallestSingularValue => Criterion::SmallestSingularValue,
            By::Noise => Criterion::Noise,
        }
    }

    fn range(&self) -> EdgeRange {
        EdgeRange { from_nm: self.from_nm, to_nm: self.to_nm }
    }
}

/// Runs `dyes`.
///
/// # Errors
/// [`AppError`]: what is wrong with the arguments or the spectra; then nothing is written.
pub(super) fn run(arguments: &DyesArguments) -> Result<(), AppError> {
    check(arguments)?;
    let bench = sources::Bench::lay_out(arguments)?;
    let findings = judging::judge(arguments, &bench)?;
    if let Some(path) = &arguments.plot {
        let svg = plot::svg(arguments, &bench, &findings)?;
        std::fs::write(path, svg).map_err(|error| {
            AppError::Usage(format!("{}: {error}; give --plot another name", path.display()))
        })?;
    }
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&findings).map_err(AppError::data)?);
    } else {
        print!("{}", table::text(&findings));
        if let Some(path) = &arguments.plot {
            println!("Plot: {}", path.display());
        }
    }
    Ok(())
}

fn check(arguments: &DyesArguments) -> Result<(), AppError> {
    let DyesArguments { order, channels, t_error, from_nm, to_nm, .. } = arguments;
    let refused = |said: String| Err(AppError::Usage(said));
    if !ORDERS.contains(order) {
        return refused(format!("order {order} is not available; choose --order 2 to 6"));
    }
    if !CHANNELS.contains(channels) {
        return refused(format!("{channels} physical channels are not available; choose --channels 2 to 8"));
    }
    if !(*t_error > 0.0 && *t_error <= 0.5) {
        return refused(format!(
            "an error of T of {t_error} makes no sense; give --t-error above 0 and up to 0.5"
        ));
    }
    if !(*from_nm >= 200.0 && *to_nm > *from_nm && *to_nm <= 3000.0) {
        return refused(format!(
            "edges from {from_nm} to {to_nm} nm are no range; give --from-nm below --to-nm, both 200 to 3000"
        ));
    }
    let is_two = *channels == 2;
    let needs_two = [
        ("--dichroic", !arguments.dichroic.is_empty()),
        ("--dichroic-curve", !arguments.dichroic_curve.is_empty()),
        ("--filter-r", !arguments.filter_r.is_empty()),
        ("--filter-t", !arguments.filter_t.is_empty()),
    ];
    if let Some((name, _)) = needs_two.iter().find(|(_, is_given)| *is_given && !is_two) {
        return refused(format!(
            "{name} is for the two cameras R and T; leave it out, or --channels {channels}"
        ));
    }
    match &arguments.plot {
        Some(path) if path.exists() => {
            refused(format!("{} exists; give --plot another name", path.display()))
        }
        _ => Ok(()),
    }
}
