//! Spectra and eigenvalues over wavelength, as in Figure S2.
//!
//! In: what was found. Out: one SVG of two panels over the same wavelengths: emissions and the shares of both cameras;
//! eigenvalues (singular values where the matrix is not square) and their product over the ideal edge.
//! Never: draws a curve that was not used. Fails: [`AppError`] without an emission.

use super::DyesArguments;
use super::findings::Findings;
use super::judging::split;
use super::sources::{Bench, Dye, How};
use crate::app::AppError;
use crate::report::{Axis, AxisRange, LinePlot, Series, stacked};
use crate::sofi::spectra::Spectrum;

/// Distance of the points of curves, nanometers.
const STEP_NM: f64 = 1.0;

pub(super) fn svg(arguments: &DyesArguments, bench: &Bench, findings: &Findings) -> Result<String, AppError> {
    let dyes: Vec<&Dye> =
        findings.species.iter().filter_map(|name| bench.dyes.iter().find(|dye| dye.name == *name)).collect();
    if dyes.iter().any(|dye| dye.emission.is_none()) {
        return Err(AppError::usage("a plot needs an emission of every dye; give --emission DYE=FILE"));
    }
    let title = format!("Choice of dyes: {}", findings.species.join(", "));
    Ok(stacked(
        &title,
        &[spectra(arguments, bench, findings, &dyes), merits(arguments, bench, findings, &dyes)?],
    ))
}

fn wavelengths(arguments: &DyesArguments) -> impl Iterator<Item = f64> {
    let count = ((arguments.to_nm - arguments.from_nm) / STEP_NM) as u32;
    let from_nm = arguments.from_nm;
    (0..=count).map(move |k| from_nm + f64::from(k) * STEP_NM)
}

fn axis(arguments: &DyesArguments, quantity: &str) -> Axis {
    let range = AxisRange::Fixed { low: arguments.from_nm, high: arguments.to_nm };
    Axis::new(quantity, "nm").with_range(range)
}

/// Emissions as they reach the dichroic, and what the dichroic does to them.
fn spectra(arguments: &DyesArguments, bench: &Bench, findings: &Findings, dyes: &[&Dye]) -> LinePlot {
    let curve = drawn(bench, findings);
    let path = curve.map_or(&bench.path, |(_, curve)| &curve.1);
    let passed = |nm: f64| path.common.iter().map(|filter| filter.at(nm)).product::<f64>();
    let mut series: Vec<Series> = dyes
        .iter()
        .filter_map(|dye| dye.emission.as_ref().map(|emission| (dye, emission)))
        .map(|(dye, emission)| {
            let within = |nm: f64| if inside(emission, nm) { emission.at(nm) / emission.peak() } else { 0.0 };
            let points = wavelengths(arguments).map(|nm| (nm, within(nm) * passed(nm))).collect();
            Series { label: dye.name.clone(), points }
        })
        .collect();
    let product = |side: &Spectrum, own: &[Spectrum], nm: f64| {
        side.at(nm) * passed(nm) * own.iter().map(|filter| filter.at(nm)).product::<f64>()
    };
    if let Some((name, curve)) = curve {
        let (dichroic, path) = &**curve;
        for (camera, side, own) in
            [("R", dichroic.reflection(), &path.reflected), ("T", dichroic.transmission(), &path.transmitted)]
        {
            let points = wavelengths(arguments).map(|nm| (nm, product(side, own, nm))).collect();
            series.push(Series { label: format!("{camera} ({name})"), points });
        }
    } else {
        series.extend(edge_lines(findings));
    }
    LinePlot {
        title: "Emission of the dyes and shares of the cameras".to_owned(),
        x: axis(arguments, "wavelength"),
        y: Axis::new("emission, transmission", "").with_range(AxisRange::Fixed { low: 0.0, high: 1.0 }),
        series,
    }
}

fn inside(emission: &Spectrum, nm: f64) -> bool {
    let (first, last) = emission.range_nm();
    (first..=last).contains(&nm)
}

type Drawn<'a> = (&'a str, &'a Box<(crate::sofi::spectra::DichroicCurve, crate::sofi::spectra::LightPath)>);

/// The best choice that is a curve.
fn drawn<'a>(bench: &'a Bench, findings: &Findings) -> Option<Drawn<'a>> {
    let best = findings
        .choices
        .iter()
        .find(|choice| choice.kind == "curve" && choice.species == findings.species)?;
    let splitter = bench.splitters.iter().find(|splitter| splitter.name == best.dichroic)?;
    match &splitter.how {
        How::Curve(curve) => Some((&splitter.name, curve)),
        How::Coefficients => None,
    }
}

/// A line from 0 to 1 at each of the best edges.
fn edge_lines(findings: &Findings) -> impl Iterator<Item = Series> {
    findings.best_edges_nm.iter().map(|&edge| Series {
        label: format!("best edge {edge:.1} nm"),
        points: vec![(edge, 0.0), (edge, 1.0)],
    })
}

/// Eigenvalues over the edge; for more channels the product over each edge, the others in their places.
fn merits(
    arguments: &DyesArguments,
    bench: &Bench,
    findings: &Findings,
    dyes: &[&Dye],
) -> Result<LinePlot, AppError> {
    let mut series = Vec::new();
    if findings.sweep.is_empty() {
        let Some(split) = split(arguments, bench, dyes)? else {
            return Err(AppError::usage("a plot needs an emission of every dye; give --emission DYE=FILE"));
        };
        for (place, best) in findings.best_edges_nm.iter().enumerate() {
            let mut points = Vec::new();
            for nm in wavelengths(arguments) {
                let mut edges = findings.best_edges_nm.clone();
                edges[place] = nm;
                if edges.is_sorted() {
                    let merit = split.merit(arguments.order, &edges).map_err(AppError::usage)?;
                    points.push((nm, merit.product));
                }
            }
            series.push(Series { label: format!("product over edge {} ({best:.1} nm)", place + 1), points });
        }
    } else {
        let is_square = findings.sweep.iter().all(|point| point.merit.eigenvalues.is_some());
        let what = if is_square { "eigenvalue" } else { "singular value" };
        for place in 0..dyes.len() {
            let value = |point: &super::findings::SweepPoint| match &point.merit.eigenvalues {
                Some(values) if is_square => values[place],
                _ => point.merit.singular_values[place],
            };
            let points = findings.sweep.iter().map(|point| (point.edge_nm, value(point))).collect();
            series.push(Series { label: format!("{what} {}", place + 1), points });
        }
        let points = findings.sweep.iter().map(|point| (point.edge_nm, point.merit.product)).collect();
        series.push(Series { label: "product".to_owned(), points });
        series.extend(edge_lines(findings));
    }
    let y = Axis::new(if findings.sweep.is_empty() { "product" } else { "magnitude" }, "");
    Ok(LinePlot {
        title: "Eigenvalues of the mixing matrix over the wavelength of an ideal edge".to_owned(),
        x: axis(arguments, "edge of an ideal dichroic"),
        y: y.with_range(AxisRange::FromZero),
        series,
    })
}
