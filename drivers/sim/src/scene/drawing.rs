//! Emitters placed by a small image that is drawn in the scene file.
//!
//! In: rows of text, one character per cell: a digit is a density in ninths, a dot or a space is nothing.
//! Out: cells with their weights. Never: draws random numbers.

use super::shape::{COORDINATE_PX, DENSITY_PER_UM2, Shape};
use sofiscope_form::Form;

const MAX_SIDE: usize = 512;

/// A filled cell: row, column and weight in ninths.
pub(crate) type Cell = (usize, usize, f64);

/// The filled cells of a drawing.
pub(crate) fn cells(rows: &[String]) -> impl Iterator<Item = Cell> {
    rows.iter().enumerate().flat_map(|(row, text)| {
        text.chars().enumerate().filter_map(move |(column, letter)| {
            let ninths = letter.to_digit(10).filter(|&digit| digit > 0)?;
            Some((row, column, f64::from(ninths)))
        })
    })
}

/// Area of a drawing in cells of the full density.
pub(super) fn full_cells(rows: &[String]) -> f64 {
    cells(rows).map(|(_, _, ninths)| ninths / 9.0).sum()
}

/// Distance of a point from the nearest filled cell, in cells; the point counts from the corner of the first one.
pub(super) fn distance_in_cells(rows: &[String], point: [f64; 2]) -> f64 {
    let beyond = |first: usize, place: f64| (first as f64 - place).max(place - first as f64 - 1.0).max(0.0);
    cells(rows)
        .map(|(row, column, _)| beyond(row, point[0]).hypot(beyond(column, point[1])))
        .fold(f64::INFINITY, f64::min)
}

pub(super) fn read_drawing(form: &Form<'_>) -> Shape {
    let rows = form.texts("rows", 1..=MAX_SIDE);
    let is_known = |letter: char| letter.is_ascii_digit() || letter == '.' || letter == ' ';
    let is_drawn = |row: &String| row.len() <= MAX_SIDE && row.chars().all(is_known);
    if !rows.iter().all(is_drawn) || (!rows.is_empty() && cells(&rows).next().is_none()) {
        form.fault(
            "rows",
            "is no drawing",
            "give rows of at most 512 digits, dots and spaces, with a digit above 0",
        );
    }
    Shape::Drawing {
        from_px: form.pair("from_px", COORDINATE_PX),
        cell_px: form.number("cell_px", 0.01..=1000.0),
        rows,
        density_per_um2: form.number("density_per_um2", DENSITY_PER_UM2),
    }
}
