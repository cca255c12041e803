//! What `dyes` found, as people read it.
//!
//! In: [`Findings`]. Out: text. Never: hides that a spectrum is parametric. Fails: not at all.

use super::findings::{Choice, Findings};

/// Choices that are shown.
const MOST_ROWS: usize = 12;

pub(super) fn text(findings: &Findings) -> String {
    let sets = findings.choices.iter().any(|choice| choice.species != findings.species);
    let mut text = heading(findings);
    let header = ["", "dichroic", if sets { "dyes" } else { "" }, "T of each dye", "eigenvalues"];
    let numbers = ["product", "smallest", "condition", "noise", "crosstalk"];
    let header: Vec<String> = header.iter().chain(&numbers).map(ToString::to_string).collect();
    let rows = findings.choices.iter().take(MOST_ROWS).enumerate();
    let mut table = vec![header];
    table.extend(rows.map(|(place, choice)| row(place + 1, choice, sets)));
    text += &aligned(&table, 5);
    if findings.choices.len() > MOST_ROWS {
        text += &format!("({} more choices; --json has them)\n", findings.choices.len() - MOST_ROWS);
    }
    text += &legend(findings);
    text += &crosstalk(findings);
    text += &provenance(findings);
    for note in &findings.notes {
        text += &format!("Note: {note}\n");
    }
    text
}

fn heading(findings: &Findings) -> String {
    let Findings { order, channels, spectral_channels, .. } = findings;
    let is_best_of_many = findings.choices.iter().any(|choice| choice.species != findings.species);
    let mut text = if is_best_of_many { "best set: " } else { "" }.to_owned();
    text += &format!(
        "{}\norder {order}, {channels} physical channels, {spectral_channels} spectral channels\n",
        findings.species.join(", ")
    );
    match (&findings.best_edges_nm[..], findings.good_edges_nm) {
        ([], _) => {}
        ([edge], Some([low, high])) => {
            text += &format!(
                "best ideal edge: {edge:.1} nm; from {low:.0} to {high:.0} nm the product is at least 90 % of its best\n"
            );
        }
        (edges, _) => {
            let edges: Vec<String> = edges.iter().map(|edge| format!("{edge:.1}")).collect();
            text += &format!("best ideal edges: {} nm\n", edges.join(", "));
        }
    }
    text + "\n"
}

fn row(place: usize, choice: &Choice, sets: bool) -> Vec<String> {
    let edges: Vec<String> = choice.edges_nm.iter().map(|edge| format!("{edge:.1}")).collect();
    let dichroic = if edges.is_empty() {
        choice.dichroic.clone()
    } else {
        format!("{} {} nm", choice.dichroic, edges.join(", "))
    };
    let transmission = match &choice.shares[..] {
        [_, transmission] => spaced(transmission, 2),
        _ => "-".to_owned(),
    };
    let merit = &choice.merit;
    let noise = merit.noise_gain.as_ref().map(|gains| gains.iter().copied().fold(0.0, f64::max));
    vec![
        format!("{place}."),
        dichroic,
        if sets { choice.species.join(", ") } else { String::new() },
        transmission,
        merit.eigenvalues.as_ref().map_or_else(|| "-".to_owned(), |values| spaced(values, 3)),
        short(merit.product),
        short(merit.smallest_singular_value),
        short(merit.condition),
        noise.map_or_else(|| "-".to_owned(), short),
        choice
            .worst_crosstalk_percent
            .map_or_else(|| "-".to_owned(), |worst| format!("{:.1} %", worst.abs())),
    ]
}

fn legend(findings: &Findings) -> String {
    format!(
        "\nproduct: of the singular values, |det M| where M is square (best possible for three dyes at order 2: 0.25); \
         smallest: singular value;\nnoise: of the worst dye, for unit noise in every spectral channel; crosstalk: worst, \
         of cumulants, if T of one dye is wrong by {}\n",
        findings.t_error
    )
}

/// The whole table of crosstalk of the best dichroic there is, else of the best edge.
fn crosstalk(findings: &Findings) -> String {
    let real = findings.choices.iter().find(|choice| choice.kind != "ideal-edge");
    let Some(choice) = real.or(findings.choices.first()) else { return String::new() };
    let mut table = vec![[vec![String::new()], choice.species.clone()].concat()];
    for (name, row) in choice.species.iter().zip(&choice.crosstalk_percent) {
        let entry = |value: &f64| if value.is_finite() { format!("{value:.1}") } else { "-".to_owned() };
        table.push([vec![name.clone()], row.iter().map(entry).collect()].concat());
    }
    format!(
        "\nCrosstalk behind {} if {} of the dye of the line is wrong by {}, percent (column: image):\n{}",
        choice.dichroic,
        if findings.channels == 2 { "T" } else { "a share" },
        findings.t_error,
        aligned(&table, 1)
    )
}

fn provenance(findings: &Findings) -> String {
    let mut text = "\n".to_owned();
    let mut sources: Vec<&str> = Vec::new();
    for source in findings.spectra.iter().filter_map(|spectrum| spectrum.emission.as_deref()) {
        if !sources.contains(&source) {
            sources.push(source);
        }
    }
    for source in sources {
        let of_source =
            findings.spectra.iter().filter(|spectrum| spectrum.emission.as_deref() == Some(source));
        let names: Vec<&str> = of_source.map(|spectrum| spectrum.species.as_str()).collect();
        text += &format!("Emission ({source}): {}\n", names.join(", "));
    }
    text
}

fn spaced(values: &[f64], decimals: usize) -> String {
    values.iter().map(|value| format!("{value:.decimals$}")).collect::<Vec<_>>().join(" ")
}

/// Three significant digits.
fn short(value: f64) -> String {
    match value.abs() {
        size if !size.is_finite() => "-".to_owned(),
        size if size >= 99.5 => format!("{value:.0}"),
        size if size >= 9.95 => format!("{value:.1}"),
        size if size >= 0.995 => format!("{value:.2}"),
        size if size >= 5e-4 || size == 0.0 => format!("{value:.3}"),
        _ => format!("{value:.1e}"),
    }
}

/// Columns under each other, the first `words` to the left, the others to the right; empty ones left out.
fn aligned(table: &[Vec<String>], words: usize) -> String {
    let columns = table.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &Vec<String>, column: usize| row.get(column).cloned().unwrap_or_default();
    let width = |column| table.iter().map(|row| cell(row, column).chars().count()).max().unwrap_or(0);
    let mut text = String::new();
    for row in table {
        let mut line = String::new();
        for column in (0..columns).filter(|&column| width(column) > 0) {
            let (cell, width) = (cell(row, column), width(column));
            line += &if column < words { format!("{cell:<width$}  ") } else { format!("{cell:>width$}  ") };
        }
        text += line.trim_end();
        text.push('\n');
    }
    text
}
