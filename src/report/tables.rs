//! Tables of the page: species, crosstalk, mixing matrix.
//!
//! In: parts of the report. Out: `<table>` elements.
//! Never: shows a missing number as zero. Fails: never.

use super::figure::chip;
use super::model::{Crosstalk, Matrix, Species, Unmixing};
use super::text::{escape, number, optional, percent};

/// Species with their spectral response and quality.
pub(super) fn species(list: &[Species]) -> String {
    let rows = list.iter().map(|species| {
        [
            chip(species.display_color(), &species.name),
            optional(species.emission_nm),
            format!("{:.2}", species.transmission),
            format!("{:.2}", species.reflection),
            optional(species.noise_gain),
            optional(species.signal_to_noise),
        ]
    });
    let head = [
        "species",
        "emission (nm)",
        "T (share)",
        "R (share)",
        "noise gain (×)",
        "signal-to-noise (per pixel)",
    ];
    table(&head.map(str::to_owned), rows)
}

/// Crosstalk of one step, cells tinted by size; `names` are rows and columns.
pub(super) fn crosstalk(title: &str, names: &[String], matrix: &Matrix) -> String {
    let head: String = names.iter().map(|name| format!("<th>{}</th>", escape(name))).collect();
    let body: String =
        matrix.iter().enumerate().map(|(row, values)| crosstalk_row(row, names, values)).collect();
    let worst = Crosstalk::worst(matrix).map_or_else(|| "–".to_owned(), percent);
    format!(
        "<div><h3>{}</h3><table class=\"crosstalk\"><thead><tr><th>from \\ into (%)</th>{head}</tr></thead>\
         <tbody>{body}</tbody></table><p class=\"note\">worst: {worst} %</p></div>\n",
        escape(title)
    )
}

fn crosstalk_row(row: usize, names: &[String], values: &[f64]) -> String {
    let cells: String = values
        .iter()
        .enumerate()
        .map(|(column, &value)| match () {
            () if row == column => format!("<td class=\"own\">{}</td>", percent(value)),
            () => format!("<td style=\"--heat:{:.0}%\">{}</td>", heat(value), percent(value)),
        })
        .collect();
    format!("<tr><th>{}</th>{cells}</tr>", escape(names.get(row).map_or("", String::as_str)))
}

/// How strongly a cell is tinted, in percent: fully at 20 % crosstalk.
fn heat(percent: f64) -> f64 {
    if percent.is_finite() { (percent.abs() / 20.0).min(1.0) * 60.0 } else { 0.0 }
}

/// The mixing matrix with its singular values.
pub(super) fn mixing(unmixing: &Unmixing, species: &[Species]) -> String {
    let head =
        [vec!["channel".to_owned()], species.iter().map(|species| escape(&species.name)).collect()].concat();
    let rows = unmixing.spectral_channels.iter().zip(&unmixing.matrix).map(|(channel, row)| {
        let numbers = row.iter().map(|&value| format!("{value:.4}"));
        std::iter::once(escape(channel)).chain(numbers).collect::<Vec<_>>()
    });
    let singular: Vec<_> = unmixing.singular_values.iter().map(|&value| number(value)).collect();
    let (singular, condition) = (singular.join(", "), number(unmixing.condition_number));
    table(&head, rows)
        + &format!("<p class=\"note\">singular values {singular}; condition number {condition}</p>\n")
}

/// A table whose cells are markup already.
pub(super) fn table<Row: IntoIterator<Item = String>>(
    head: &[String],
    rows: impl Iterator<Item = Row>,
) -> String {
    let head: String = head.iter().map(|cell| format!("<th>{cell}</th>")).collect();
    let body: String = rows.map(|row| format!("<tr>{}</tr>\n", cells(row))).collect();
    format!(
        "<div class=\"wide\"><table><thead><tr>{head}</tr></thead><tbody>\n{body}</tbody></table></div>\n"
    )
}

fn cells(row: impl IntoIterator<Item = String>) -> String {
    row.into_iter().map(|cell| format!("<td>{cell}</td>")).collect()
}
