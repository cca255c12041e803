//! A measured spectrum from a table of two columns: wavelength in nanometers, value.
//!
//! In: the text of a CSV file; columns apart by comma, semicolon, tab or spaces; words at the top and lines that begin
//! with `#` are passed over. Out: [`CsvSpectrum`]. Never: sorts, smooths or fills in.
//! Fails: [`SpectrumFaults`], each with its line and the remedy.

use super::SpectrumFaults;
use crate::sofi::spectra::Spectrum;
use sofiscope_form::Faults;

/// Wavelengths that a microscope sees, nanometers.
const WAVELENGTHS_NM: std::ops::RangeInclusive<f64> = 200.0..=3000.0;
/// Longest table.
const MOST_POINTS: usize = 100_000;
/// Percentages may pass a hundred by this much: calibrations do.
const PERCENT_SLACK: f64 = 2.0;

/// What the values of a spectrum are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueUnit {
    /// Any unit: an emission.
    Any,
    /// A share of the light: a filter, a dichroic, a quantum efficiency; `0..=1`, or percent where one is above 1.
    Share,
}

/// A spectrum and how its values were understood.
#[derive(Debug, Clone, PartialEq)]
pub struct CsvSpectrum {
    /// The curve; shares are in `0..=1`.
    pub spectrum: Spectrum,
    /// Whether the values were percent.
    pub was_percent: bool,
}

/// Reads a spectrum.
///
/// # Errors
/// All faults at once: lines that are no two numbers, wavelengths that do not increase or are no nanometers,
/// negative values, shares above 100 %, fewer than two points.
pub fn read_spectrum(text: &str, unit: ValueUnit) -> Result<CsvSpectrum, SpectrumFaults> {
    let faults = Faults::new(text);
    let points = points(text, &faults);
    check_points(&points, &faults);
    let most = points.iter().map(|point| point.value).fold(0.0, f64::max);
    let was_percent = unit == ValueUnit::Share && most > 1.0;
    if was_percent && let Some(over) = points.iter().find(|point| point.value > 100.0 + PERCENT_SLACK) {
        let message = format!("the share {} is neither 0 to 1 nor 0 to 100 percent", over.value);
        faults.note(
            Some(over.line),
            "",
            message,
            "give the share of light that passes, not an optical density",
        );
    }
    let list = faults.into_list();
    if !list.is_empty() {
        return Err(SpectrumFaults { faults: list });
    }
    let value = |point: &Point| if was_percent { (point.value / 100.0).min(1.0) } else { point.value };
    let (wavelengths, values) = points.iter().map(|point| (point.wavelength_nm, value(point))).unzip();
    match Spectrum::new(wavelengths, values) {
        Ok(spectrum) => Ok(CsvSpectrum { spectrum, was_percent }),
        Err(error) => {
            let faults = Faults::new(text);
            faults.note(None, "", error.to_string(), "correct the table");
            Err(SpectrumFaults { faults: faults.into_list() })
        }
    }
}

struct Point {
    line: usize,
    wavelength_nm: f64,
    value: f64,
}

fn points(text: &str, faults: &Faults<'_>) -> Vec<Point> {
    let text = text.trim_start_matches('\u{feff}');
    let mut points = Vec::new();
    let mut is_top = true;
    for (line, row) in (1..).zip(text.lines()) {
        let row = row.trim();
        if row.is_empty() || row.starts_with('#') {
            continue;
        }
        let cells = cells(row);
        let numbers: Vec<Option<f64>> = cells.iter().map(|cell| number(cell, row)).collect();
        if is_top && numbers.iter().all(Option::is_none) {
            continue;
        }
        is_top = false;
        match numbers[..] {
            [Some(wavelength_nm), Some(value)] => points.push(Point { line, wavelength_nm, value }),
            [_, _] => {
                let bad = cells.iter().zip(&numbers).find(|(_, number)| number.is_none());
                let cell: String = bad.map_or("", |(cell, _)| *cell).chars().take(30).collect();
                faults.note(
                    Some(line),
                    "",
                    format!("\"{cell}\" is not a number"),
                    "give the wavelength in nm and the value, as in 520.5,0.83",
                );
            }
            _ => faults.note(
                Some(line),
                "",
                format!("{} where two are needed", columns(cells.len())),
                "keep the wavelength in nm and one value, as in 520.5,0.83",
            ),
        }
        if points.len() > MOST_POINTS {
            faults.note(Some(line), "", "the table has too many points", "keep at most 100000");
            break;
        }
    }
    if points.is_empty() {
        faults.note(None, "", "no line has two numbers", "give one line per wavelength, as in 520.5,0.83");
    } else if points.len() == 1 {
        faults.note(None, "", "a spectrum of one point", "give at least two wavelengths");
    }
    points
}

fn columns(number: usize) -> String {
    if number == 1 { "1 column".to_owned() } else { format!("{number} columns") }
}

/// Cells of a row; empty ones at its end do not count.
fn cells(row: &str) -> Vec<&str> {
    let by =
        |separator: char| row.split(separator).map(|cell| cell.trim().trim_matches('"')).collect::<Vec<_>>();
    let mut cells = match [';', '\t', ','].into_iter().find(|separator| row.contains(*separator)) {
        Some(separator) => by(separator),
        None => row.split_whitespace().map(|cell| cell.trim_matches('"')).collect(),
    };
    while cells.len() > 2 && cells.last().is_some_and(|cell| cell.is_empty()) {
        cells.pop();
    }
    cells
}

/// A finite number; a comma is a decimal point where it does not part the columns.
fn number(cell: &str, row: &str) -> Option<f64> {
    let has_decimal_commas = row.contains([';', '\t']) && !cell.contains('.');
    let cell = if has_decimal_commas { cell.replace(',', ".") } else { cell.to_owned() };
    let cell = cell.strip_suffix('%').map_or(cell.as_str(), str::trim_end);
    cell.parse().ok().filter(|number: &f64| number.is_finite())
}

fn check_points(points: &[Point], faults: &Faults<'_>) {
    for (index, point) in points.iter().enumerate() {
        let wavelength = point.wavelength_nm;
        if !WAVELENGTHS_NM.contains(&wavelength) {
            faults.note(
                Some(point.line),
                "",
                format!("the wavelength {wavelength} is not between 200 and 3000 nm"),
                "give wavelengths in nanometers, in the first column",
            );
        } else if index > 0 && wavelength <= points[index - 1].wavelength_nm {
            faults.note(
                Some(point.line),
                "",
                format!("the wavelength {wavelength} does not follow {}", points[index - 1].wavelength_nm),
                "sort the lines by wavelength, each wavelength once",
            );
        }
        if point.value < 0.0 {
            faults.note(
                Some(point.line),
                "",
                format!("the value {} is negative", point.value),
                "set noise below zero to 0, and give no optical densities",
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(text: &str, unit: ValueUnit) -> String {
        read_spectrum(text, unit).unwrap_err().to_string()
    }

    #[test]
    fn tables_are_read_however_they_are_written() {
        for text in [
            "500,0.1\n510,0.9\n",
            "Wavelength (nm),Emission\n500,0.1\n510,0.9",
            "\u{feff}# from the maker\n\n500\t0.1\r\n510\t0.9\r\n",
            "nm;value\n500,0;0,1\n510,0;0,9\n",
            "  500  0.1\n  510  0.9\n",
            "\"500\",\"0.1\",\n\"510\",\"0.9\",,\n",
        ] {
            let read = read_spectrum(text, ValueUnit::Any).unwrap();
            assert_eq!(read.spectrum.wavelengths_nm(), [500.0, 510.0], "{text}");
            assert_eq!(read.spectrum.values(), [0.1, 0.9], "{text}");
        }
    }

    #[test]
    fn percent_is_understood_for_shares_only() {
        let text = "500,2\n510,100.4\n";
        let share = read_spectrum(text, ValueUnit::Share).unwrap();
        assert!(share.was_percent);
        assert_eq!(share.spectrum.values(), [0.02, 1.0]);
        let emission = read_spectrum(text, ValueUnit::Any).unwrap();
        assert_eq!((emission.was_percent, emission.spectrum.values()[1]), (false, 100.4));
        assert!(said("500,2\n510,5000\n", ValueUnit::Share).contains("line 2: the share 5000"));
    }

    #[test]
    fn faults_have_their_line_and_a_remedy() {
        for (text, parts) in [
            ("500,0.1\n510,x\n520,0.3\n", ["line 2", "\"x\" is not a number", "520.5,0.83"]),
            ("500,0.1\n510\n", ["line 2", "1 column", "keep the wavelength"]),
            ("500,0.1,7\n510,0.2\n", ["line 1", "3 columns", "one value"]),
            ("500,0.1\n490,0.2\n", ["line 2", "does not follow 500", "sort"]),
            ("nm,v\n500,0.1\n500,0.2\n", ["line 3", "does not follow", "once"]),
            ("500,0.1\n510,-0.2\n", ["line 2", "negative", "0"]),
            ("0.5,0.1\n0.6,0.2\n", ["line 1", "200", "nanometers"]),
            ("500,0.1\n510,NaN\n", ["line 2", "\"NaN\"", "number"]),
            ("nothing here\n", ["no line", "two numbers", "one line per wavelength"]),
            ("", ["no line", "two numbers", "one line"]),
            ("500,1\n", ["one point", "at least two", "wavelengths"]),
        ] {
            let said = said(text, ValueUnit::Any);
            for part in parts {
                assert!(said.contains(part), "{text:?}: {said}");
            }
            assert!(!said.contains('\n'));
        }
    }

    #[test]
    fn all_faults_are_found_and_the_first_are_written() {
        let text = "500,a\n510,b\n520,c\n530,d\n540,1\n550,2\n";
        let faults = read_spectrum(text, ValueUnit::Any).unwrap_err();
        assert_eq!(faults.faults.len(), 4);
        assert!(faults.to_string().ends_with("and 1 more"), "{faults}");
    }
}
