//! Names as people type them.
//!
//! In: a name and the known ones. Out: the nearest. Never: decides for the person. Fails: not at all.

/// How many suggestions are made at most.
const MOST: usize = 3;
/// Names less alike than this are no suggestion.
const ALIKE: f64 = 0.55;

/// A name without what people write differently: capitals, spaces, hyphens, brackets.
#[must_use]
pub fn plain(name: &str) -> String {
    name.chars().filter(|letter| letter.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// The known names most alike the one given, the best first, at most three; empty when none is alike.
///
/// ```
/// use sofiscope_form::nearest;
///
/// assert_eq!(nearest("figure-4s", ["figure-s4", "beads"]), ["figure-s4"]);
/// ```
#[must_use]
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
    let name = plain(name);
    let mut alike: Vec<(f64, &str)> = known
        .into_iter()
        .map(|known| (likeness(&name, &plain(known)), known))
        .filter(|(likeness, _)| *likeness >= ALIKE)
        .collect();
    alike.sort_by(|a, b| b.0.total_cmp(&a.0));
    alike.into_iter().take(MOST).map(|(_, known)| known).collect()
}

/// Edits with transpositions tell the numbers in dye names apart better than common prefixes do.
fn likeness(a: &str, b: &str) -> f64 {
    strsim::normalized_damerau_levenshtein(a, b)
}
