//! The result in one sentence.
//!
//! In: a report. Out: what was done, how well, and what is missing, in numbers.
//! Never: praises; leaves lost frames unsaid. Fails: never.

use super::model::{AnalysisReport, Crosstalk};
use super::text::{count, number, percent, plural};

/// One sentence that says what was done and how well it went, plain text.
#[must_use]
pub fn verdict(report: &AnalysisReport) -> String {
    let mut facts = vec![subject(report)];
    if let Some(worst) =
        report.crosstalk.as_ref().and_then(|crosstalk| Crosstalk::worst(&crosstalk.linearized))
    {
        facts.push(format!("worst crosstalk {} % after linearization", percent(worst)));
    }
    facts.extend(signal_to_noise(report));
    facts.push(missing(report));
    if !report.warnings.is_empty() {
        facts.push(plural(report.warnings.len(), "warning"));
    }
    facts.join("; ") + "."
}

fn subject(report: &AnalysisReport) -> String {
    let used = count(report.frames.used as f64);
    let order = report.settings.order;
    match report.species.len() {
        0 => format!("Order-{order} image from {used} frames"),
        1 => format!("One species imaged at order {order} from {used} frames"),
        num => format!("{num} species unmixed at order {order} from {used} frame pairs"),
    }
}

fn signal_to_noise(report: &AnalysisReport) -> Option<String> {
    let values =
        || report.species.iter().filter_map(|species| species.signal_to_noise).filter(|snr| snr.is_finite());
    let (low, high) = (values().min_by(f64::total_cmp)?, values().max_by(f64::total_cmp)?);
    let (low, high) = (number(low), number(high));
    Some(if low == high {
        format!("signal-to-noise {low}")
    } else {
        format!("signal-to-noise {low} to {high}")
    })
}

fn missing(report: &AnalysisReport) -> String {
    let (lost, excluded) = (report.frames.num_lost(), report.frames.num_excluded());
    let (num_lost, num_excluded) = (count(lost as f64), count(excluded as f64));
    match (lost, excluded) {
        (0, 0) => "no frame lost or left out".to_owned(),
        (_, 0) => format!("frames lost: {num_lost}"),
        (0, _) => format!("no frame lost, {num_excluded} left out"),
        _ => format!("frames lost: {num_lost}, left out: {num_excluded}"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::*;

    #[test]
    fn the_sentence_has_the_numbers() {
        let mut report = example::report();
        let sentence = verdict(&report);
        assert!(
            sentence.starts_with("3 species unmixed at order 2 from 3984 frame pairs; worst crosstalk 2.6 %")
        );
        assert!(sentence.contains("frames lost: 3, left out: 13; 2 warnings."), "{sentence}");
        report.frames = super::super::FrameAccount::default();
        report.warnings.clear();
        assert!(verdict(&report).ends_with("no frame lost or left out."));
        assert!(verdict(&AnalysisReport::default()).starts_with("Order-0 image from 0 frames"));
    }
}
