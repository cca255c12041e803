//! Sections of the page below the large picture.
//!
//! In: the report and the pictures. Out: `<section>` elements, empty where there is nothing to show.
//! Never: leaves text unescaped. Fails: [`ReportError::Picture`].

use super::error::ReportError;
use super::figure::{Picture, Step};
use super::model::{AnalysisReport, BleachingCurve, CurveUnit, Resolution};
use super::plot::{Axis, AxisRange, LinePlot, Series};
use super::tables;
use super::text::{escape, number};

/// The steps with the words of the paper's Figure 2.
const STEPS: [(Step, &str, &str); 5] = [
    (Step::Cameras, "Cameras", "Time average of reflection (R) and transmission (T)."),
    (
        Step::Cumulants,
        "Spectral cumulants",
        "Auto- and cross-cumulants of both channels; the cross terms are virtual color channels.",
    ),
    (Step::Unmixed, "Unmixed", "The mixing matrix inverted in every virtual pixel: one image per species."),
    (Step::Flattened, "Flattened", "Sub-grids of the virtual pixels brought to equal weight."),
    (
        Step::Linearized,
        "Linearized",
        "Deconvolved, root taken, reconvolved: brightness is proportional again.",
    ),
];

/// Rows of panels in the order the light travels.
pub(super) fn light_path(pictures: &[Picture]) -> Result<String, ReportError> {
    let mut rows = String::new();
    for (index, (step, name, words)) in STEPS.into_iter().enumerate() {
        let panels: Result<String, _> =
            pictures.iter().filter(|p| p.step == step).map(Picture::figure).collect();
        let panels = panels?;
        if !panels.is_empty() {
            let place = index + 1;
            rows += &format!(
                "<div class=\"step\"><div class=\"about\"><h3><b class=\"place\">{place}</b> {name}</h3><p>{words}</p></div>\
                 <div class=\"panels\">{panels}</div></div>\n"
            );
        }
    }
    Ok(section("From cameras to species", &rows))
}

/// Species table and crosstalk.
pub(super) fn species(report: &AnalysisReport) -> String {
    let table = if report.species.is_empty() { String::new() } else { tables::species(&report.species) };
    section("Species", &(table + &flattening(report)))
}

fn flattening(report: &AnalysisReport) -> String {
    let mut notes = String::new();
    for species in &report.species {
        for fallback in species.flattening.iter().flat_map(|notes| &notes.fallbacks) {
            notes += &format!("<li>{}: {}</li>\n", escape(&species.name), escape(fallback));
        }
    }
    if notes.is_empty() {
        notes
    } else {
        format!("<p class=\"note\">Flattening:</p><ul class=\"note\">{notes}</ul>\n")
    }
}

/// Crosstalk tables, side by side.
pub(super) fn crosstalk(report: &AnalysisReport) -> String {
    let Some(crosstalk) = &report.crosstalk else {
        return String::new();
    };
    let names = &crosstalk.species;
    let mut all = tables::crosstalk("Flattened", names, &crosstalk.flattened);
    all += &tables::crosstalk("Linearized", names, &crosstalk.linearized);
    if let Some(reference) = &crosstalk.reference {
        all += &tables::crosstalk(
            &format!("For comparison: {}", reference.source),
            names,
            &reference.linearized,
        );
    }
    let words = "<p>Share of a species that shows in the image of another, measured where only one of them is, \
                 background subtracted. Read line by line.</p>";
    section("Crosstalk against the truth", &format!("{words}<div class=\"columns\">{all}</div>"))
}

/// Bleaching curve.
pub(super) fn bleaching(report: &AnalysisReport) -> String {
    let Some(curve) = &report.bleaching else {
        return String::new();
    };
    let words = "<p>Mean intensity of each camera while the frames came in; steps and spikes point at focus, \
                 bubbles or the shutter.</p>";
    section(
        "Intensity over time",
        &format!("{words}{}", bleaching_plot(curve, report.settings.exposure_ms).to_svg()),
    )
}

fn bleaching_plot(curve: &BleachingCurve, exposure_ms: Option<f64>) -> LinePlot {
    let (x, factor) = match exposure_ms {
        Some(exposure) => (Axis::new("exposure time so far", "s"), exposure / 1000.0),
        None => (Axis::new("exposure", "number"), 1.0),
    };
    let unit = match curve.unit {
        CurveUnit::Counts => "counts",
        CurveUnit::Photons => "photons",
    };
    let series = |label: &str, values: &[f64]| Series {
        label: label.to_owned(),
        points: curve
            .exposures
            .iter()
            .map(|exposure| exposure * factor)
            .zip(values.iter().copied())
            .collect(),
    };
    let mut all = vec![series("R, reflection", &curve.reflected)];
    all.extend(curve.transmitted.iter().map(|values| series("T, transmission", values)));
    LinePlot {
        title: "Mean intensity of each camera over time".to_owned(),
        x: x.with_range(AxisRange::FromZero),
        y: Axis::new("mean per pixel", unit).with_range(AxisRange::FromZero),
        series: all,
    }
}

/// Resolution: numbers and Fourier ring correlation.
pub(super) fn resolution(report: &AnalysisReport) -> String {
    let Some(resolution) = &report.resolution else {
        return String::new();
    };
    let rows = resolution
        .values
        .iter()
        .map(|value| [escape(&value.image), number(value.nanometers), escape(&value.method)]);
    let head = ["image", "resolution (nm)", "method"].map(str::to_owned);
    let values = if resolution.values.is_empty() { String::new() } else { tables::table(&head, rows) };
    section("Resolution", &(values + &correlation_plot(resolution)))
}

fn correlation_plot(resolution: &Resolution) -> String {
    if resolution.curves.is_empty() {
        return String::new();
    }
    let series = resolution.curves.iter().map(|curve| Series {
        label: curve.image.clone(),
        points: curve.frequency_per_um.iter().copied().zip(curve.correlation.iter().copied()).collect(),
    });
    let plot = LinePlot {
        title: "Fourier ring correlation".to_owned(),
        x: Axis::new("spatial frequency", "1/µm").with_range(AxisRange::FromZero),
        y: Axis::new("Fourier ring correlation", "").with_range(AxisRange::FromZero),
        series: series.collect(),
    };
    plot.to_svg()
}

/// Mixing matrix.
pub(super) fn mixing(report: &AnalysisReport) -> String {
    let matrix = report.unmixing.as_ref().map(|unmixing| tables::mixing(unmixing, &report.species));
    section("Mixing matrix", &matrix.unwrap_or_default())
}

/// A section, or nothing if it has no content.
pub(super) fn section(title: &str, content: &str) -> String {
    if content.is_empty() {
        String::new()
    } else {
        format!("<section><h2>{title}</h2>\n{content}</section>\n")
    }
}
