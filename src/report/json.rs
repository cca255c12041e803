//! `report.json`: the report written and read.
//!
//! In: a report or a file. Out: the other one.
//! Never: leaves half a file behind under the final name. Fails: [`ReportError`].

use std::io::Write;
use std::path::Path;

use super::error::ReportError;
use super::model::AnalysisReport;

/// The report as indented JSON with a final line feed.
///
/// # Errors
/// [`ReportError::Encode`].
pub fn to_json(report: &AnalysisReport) -> Result<String, ReportError> {
    let mut text = serde_json::to_string_pretty(report).map_err(ReportError::Encode)?;
    text.push('\n');
    Ok(text)
}

/// Writes `report.json`.
///
/// # Errors
/// [`ReportError::Encode`], [`ReportError::File`].
pub fn write_json(report: &AnalysisReport, path: &Path) -> Result<(), ReportError> {
    write_whole(path, &to_json(report)?)
}

/// Reads `report.json`; unknown fields are ignored, missing ones get their defaults.
///
/// # Errors
/// [`ReportError::File`], [`ReportError::Decode`] with the line at fault.
pub fn read_json(path: &Path) -> Result<AnalysisReport, ReportError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| ReportError::File { path: path.to_owned(), source })?;
    serde_json::from_str(&text).map_err(|source| ReportError::Decode { path: path.to_owned(), source })
}

/// Writes a text under a temporary name in the same folder, then gives it its own.
pub(super) fn write_whole(path: &Path, text: &str) -> Result<(), ReportError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let written = new_file(folder).and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.persist(path).map_err(|failed| failed.error)
    });
    written.map(drop).map_err(|source| ReportError::File { path: path.to_owned(), source })
}

/// A temporary file that others may read, as far as the user's file mask lets them.
fn new_file(folder: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder)
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::super::model::{Subsequence, SubsequenceFate};
    use super::*;

    #[test]
    fn a_report_survives_the_round_trip() {
        let report = example::report();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.json");
        write_json(&report, &path).unwrap();
        assert!(read_json(&path).unwrap() == report);
    }

    #[test]
    fn numbers_that_are_not_finite_come_back_as_nan() {
        let mut report = example::report();
        let unmixing = report.unmixing.as_mut().unwrap();
        unmixing.condition_number = f64::INFINITY;
        unmixing.matrix[0][0] = f64::NAN;
        report.species[0].transmission = f64::NAN;
        report.subsequences[0].fate = SubsequenceFate::Used { weight: f64::NAN };
        let back: AnalysisReport = serde_json::from_str(&to_json(&report).unwrap()).unwrap();
        let unmixing = back.unmixing.unwrap();
        assert!(unmixing.condition_number.is_nan() && unmixing.matrix[0][0].is_nan());
    }

    #[test]
    fn missing_parts_get_defaults_and_faults_are_named() {
        let empty: AnalysisReport = serde_json::from_str("{}").unwrap();
        assert_eq!(empty, AnalysisReport::default());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("broken.json");
        std::fs::write(&path, "{\"title\": 3}").unwrap();
        assert!(read_json(&path).unwrap_err().to_string().contains("broken.json"));
        assert!(read_json(&folder.path().join("none.json")).is_err());
    }

    #[test]
    fn subsequences_are_flat_for_scripts() {
        let text = r#"{"first_exposure": 200, "frames": 90, "state": "skipped", "reason": "too short"}"#;
        let read: Subsequence = serde_json::from_str(text).unwrap();
        assert_eq!(
            serde_json::to_value(&read).unwrap(),
            serde_json::from_str::<serde_json::Value>(text).unwrap()
        );
    }
}
