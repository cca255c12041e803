//! A score as aligned tables, the paper's beside them.

use super::{Matrix, Measure, PaperTable, Score, Stage};

/// Fluorophores of a table of the supporting information, and its numbers.
type Printed = (&'static str, [&'static str; 3], [[f64; 3]; 3]);

/// Crosstalk as printed in the supporting information, read line by line.
const PRINTED: [Printed; 2] = [
    (
        "Table 2",
        ["Alexa Fluor 488", "Atto 565", "Alexa Fluor 647"],
        [[100.0, 5.0, 1.0], [2.0, 100.0, 2.0], [2.0, 4.0, 100.0]],
    ),
    (
        "Table 3",
        ["Alexa Fluor 568", "Abberior Flip 565", "Atto 565"],
        [[100.0, 12.0, 14.0], [6.0, 100.0, 14.0], [9.0, 12.0, 100.0]],
    ),
];

/// The table of the paper for these fluorophores, rows and columns in their order.
pub(super) fn paper(species: &[String]) -> Option<PaperTable> {
    PRINTED.into_iter().find_map(|(table, names, printed)| {
        let places: Vec<usize> =
            species.iter().filter_map(|name| names.iter().position(|known| known == name)).collect();
        if species.len() != names.len() || places.len() != names.len() {
            return None;
        }
        let row = |&i: &usize| places.iter().map(|&j| printed[i][j]).collect();
        Some(PaperTable { table, crosstalk_percent: places.iter().map(row).collect() })
    })
}

/// The score for a person to read.
#[must_use]
pub fn text(score: &Score) -> String {
    let mut lines = vec![
        format!(
            "{}, seed {}, {} frames, {} fine pixels per camera pixel along each side",
            score.scene, score.seed, score.frames, score.fold
        ),
        String::new(),
        match score.measure {
            Measure::Structures => {
                "Crosstalk in percent, background subtracted, where no other species is near."
            }
            Measure::Patches => "Crosstalk in percent at the centers of the patches.",
        }
        .to_owned(),
        "Read line by line: the species on the left as seen in the image of the species above.".to_owned(),
    ];
    for stage in Stage::ALL {
        if let Some(matrix) = score.crosstalk_percent.get(stage) {
            lines.push(String::new());
            lines.extend(crosstalk(score, stage, matrix));
        }
    }
    lines.extend(separation(score));
    lines.extend(per_species(score));
    if !score.notes.is_empty() {
        lines.push(String::new());
        lines.extend(score.notes.iter().map(|note| format!("note: {note}")));
    }
    lines.join("\n") + "\n"
}

/// One table per stage; the paper's numbers are of linearized images and stand beside these.
fn crosstalk(score: &Score, stage: Stage, matrix: &Matrix) -> Vec<String> {
    let paper = score.paper.as_ref().filter(|_| stage == Stage::Linearized);
    let own = matrix_lines(&score.species, matrix, 1);
    let worst = score.worst_crosstalk_percent.get(stage).map(|worst| format!(", worst {worst:.1} %"));
    let title = format!("{}{}", stage.name(), worst.unwrap_or_default());
    let Some(paper) = paper else {
        return [title].into_iter().chain(own).collect();
    };
    let printed = matrix_lines(&score.species, &paper.crosstalk_percent, 0);
    let left = [title].into_iter().chain(own);
    let right = [format!("the paper, {} (linearized)", paper.table)].into_iter().chain(printed);
    beside(&left.collect::<Vec<_>>(), &right.collect::<Vec<_>>())
}

fn matrix_lines(species: &[String], matrix: &Matrix, decimals: usize) -> Vec<String> {
    let heading = [String::new()].into_iter().chain(species.iter().cloned()).collect();
    let rows = species.iter().zip(matrix).map(|(name, row)| {
        let cells = row.iter().map(|entry| format!("{entry:.decimals$}"));
        [name.clone()].into_iter().chain(cells).collect()
    });
    aligned(&[heading].into_iter().chain(rows).collect::<Vec<Vec<String>>>())
}

fn separation(score: &Score) -> Vec<String> {
    let rows = Stage::ALL.into_iter().filter_map(|stage| {
        let separation = score.separation.get(stage)?;
        let percent = |share: f64| format!("{:.1}", 100.0 * share);
        let each = separation.correct_fraction_by_species.iter();
        let each = each.map(|share| share.map_or_else(|| "-".to_owned(), percent));
        Some(
            [stage.name().to_owned(), percent(separation.correct_fraction)]
                .into_iter()
                .chain(each)
                .chain([separation.num_patches.to_string()])
                .collect(),
        )
    });
    let heading: Vec<String> = ["", "all"]
        .into_iter()
        .map(str::to_owned)
        .chain(score.species.iter().cloned())
        .chain(["patches".to_owned()])
        .collect();
    titled("Patches that are brightest in the image of their own species, percent", &heading, rows.collect())
}

fn per_species(score: &Score) -> Vec<String> {
    let heading: Vec<String> = [String::new()].into_iter().chain(score.species.iter().cloned()).collect();
    let row = |stage: Stage, cells: Vec<String>| {
        [stage.name().to_owned()].into_iter().chain(cells).collect::<Vec<String>>()
    };
    let widths = Stage::ALL.into_iter().filter_map(|stage| {
        let widths = score.resolution_nm.get(stage)?;
        Some(row(stage, widths.iter().map(|width| or_words(width, 0, "no peak")).collect()))
    });
    let ratios = Stage::ALL.into_iter().filter_map(|stage| {
        let ratios = score.snr.get(stage)?;
        Some(row(stage, ratios.iter().map(|ratio| or_words(ratio, 1, "no noise")).collect()))
    });
    let mut lines = titled(
        "Resolution: full width at half maximum of the filaments, nanometers",
        &heading,
        widths.collect(),
    );
    lines.extend(titled(
        "Signal-to-noise: signal above background over the spread of the background",
        &heading,
        ratios.collect(),
    ));
    lines
}

fn or_words(value: &Option<f64>, decimals: usize, words: &str) -> String {
    value.map_or_else(|| words.to_owned(), |value| format!("{value:.decimals$}"))
}

/// A table with an empty line and its title above; nothing without rows.
fn titled(title: &str, heading: &[String], rows: Vec<Vec<String>>) -> Vec<String> {
    if rows.is_empty() {
        return Vec::new();
    }
    let all: Vec<Vec<String>> = [heading.to_vec()].into_iter().chain(rows).collect();
    [String::new(), title.to_owned()].into_iter().chain(aligned(&all)).collect()
}

/// Lines of two tables side by side.
fn beside(left: &[String], right: &[String]) -> Vec<String> {
    let width = left.iter().map(|line| line.chars().count()).max().unwrap_or(0) + 4;
    left.iter().zip(right).map(|(left, right)| format!("{left:width$}{right}")).collect()
}

/// Rows as lines: the first column flush left, all others flush right.
fn aligned(rows: &[Vec<String>]) -> Vec<String> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| match column {
            0 => format!("  {cell:width$}"),
            _ => format!("  {cell:>width$}"),
        });
        cells.collect::<String>()
    };
    rows.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_is_read_in_the_order_of_the_species() {
        let names = ["Atto 565", "Alexa Fluor 568", "Abberior Flip 565"].map(str::to_owned);
        let paper = paper(&names).unwrap();
        assert_eq!(paper.table, "Table 3");
        let expected = [[100.0, 9.0, 12.0], [14.0, 100.0, 12.0], [14.0, 6.0, 100.0]];
        assert_eq!(paper.crosstalk_percent, expected.map(Vec::from));
        assert!(super::paper(&names[..2]).is_none());
    }
}
