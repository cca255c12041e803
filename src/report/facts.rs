//! Settings, frames, files and timing as lists of names and values.
//!
//! In: the report. Out: `<section>` elements.
//! Never: leaves text unescaped; shows a line without a value. Fails: never.

use super::model::{AnalysisReport, SubsequenceFate};
use super::sections::section;
use super::text::{count, escape, number, plural};

/// Settings, frames, files, timing.
pub(super) fn facts(report: &AnalysisReport) -> String {
    section("Settings", &list(&settings(report))) + &section("Frames and files", &list(&bookkeeping(report)))
}

fn settings(report: &AnalysisReport) -> Vec<(String, String)> {
    let used = &report.settings;
    let lags: Vec<_> = used.lags.iter().map(u32::to_string).collect();
    let mut lines = vec![
        ("Cumulant order", used.order.to_string()),
        ("Exposures per subsequence", count(used.subsequence_length as f64)),
        ("Pixel combinations", used.combinations.clone()),
        ("Lags (frames)", lags.join(", ")),
        ("Dichroic", used.dichroic.clone().unwrap_or_default()),
        ("Registration", used.registration.clone().unwrap_or_default()),
        ("Unmixing", used.unmixing.clone()),
        ("Flattening", used.flattening.clone()),
        (
            "Linearization",
            used.linearization_iterations.map(|n| plural(n as usize, "iteration")).unwrap_or_default(),
        ),
        (
            "Point-spread function",
            used.psf
                .as_ref()
                .map(|p| format!("σ = {} camera pixels ({})", number(p.sigma_px), p.source))
                .unwrap_or_default(),
        ),
        (
            "Camera pixel pitch",
            used.camera_pixel_pitch_nm.map(|nm| format!("{} nm", number(nm))).unwrap_or_default(),
        ),
        ("Exposure time", used.exposure_ms.map(|ms| format!("{} ms", number(ms))).unwrap_or_default()),
    ]
    .into_iter()
    .map(|(name, value)| (name.to_owned(), value))
    .collect::<Vec<_>>();
    lines.extend(used.other.iter().cloned());
    lines
}

fn bookkeeping(report: &AnalysisReport) -> Vec<(String, String)> {
    let mut lines = vec![
        ("Frames received".to_owned(), count(report.frames.received as f64)),
        ("Frames used".to_owned(), count(report.frames.used as f64)),
    ];
    lines.extend(report.frames.lost.iter().map(|c| (format!("Lost: {}", c.reason), count(c.frames as f64))));
    lines.extend(
        report.frames.excluded.iter().map(|c| (format!("Left out: {}", c.reason), count(c.frames as f64))),
    );
    lines.extend(subsequences(report));
    lines.extend(report.inputs.iter().map(|input| {
        let size = format!("{} × {} px, {}", input.width, input.height, input.sample_type);
        (
            format!("Input {}", input.role),
            format!("{} ({} frames, {size})", input.path, count(input.frames as f64)),
        )
    }));
    lines.extend(
        report.outputs.iter().map(|output| (format!("Output: {}", output.content), output.path.clone())),
    );
    if let Some(timing) = &report.timing {
        let speed = format!(
            "{} s, {} frame pairs per second",
            number(timing.seconds),
            number(timing.pairs_per_second)
        );
        lines.push(("Time taken".to_owned(), speed));
        lines.extend(
            timing
                .steps
                .iter()
                .map(|(name, seconds)| (format!("– {name}"), format!("{} s", number(*seconds)))),
        );
    }
    lines.push(("Command".to_owned(), report.command.clone()));
    lines
}

fn subsequences(report: &AnalysisReport) -> Vec<(String, String)> {
    if report.subsequences.is_empty() {
        return Vec::new();
    }
    let used = report.subsequences.iter().filter(|s| matches!(s.fate, SubsequenceFate::Used { .. })).count();
    let mut lines =
        vec![("Subsequences used".to_owned(), format!("{used} of {}", report.subsequences.len()))];
    for subsequence in &report.subsequences {
        if let SubsequenceFate::Skipped { reason } = &subsequence.fate {
            let name =
                format!("Subsequence at exposure {} not used", count(subsequence.first_exposure as f64));
            lines.push((name, format!("{reason} ({} frames)", count(subsequence.frames as f64))));
        }
    }
    lines
}

/// Names and values; lines without value are left away.
fn list(lines: &[(String, String)]) -> String {
    let shown = lines.iter().filter(|(_, value)| !value.is_empty());
    let lines: String = shown
        .map(|(name, value)| format!("<div><dt>{}</dt><dd>{}</dd></div>\n", escape(name), escape(value)))
        .collect();
    if lines.is_empty() { lines } else { format!("<dl>{lines}</dl>") }
}
