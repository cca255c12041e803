//! Words of the command line: they may be shortened, and are echoed in full.

/// Every keyword with the fewest letters by which it is known.
const KEYWORDS: [(&str, usize); 44] = [
    ("on", 2),
    ("off", 3),
    ("echo", 4),
    ("prompt", 4),
    ("talk", 4),
    ("usual", 5),
    ("gabby", 5),
    ("quiet", 5),
    ("robot", 5),
    ("id", 2),
    ("serial", 3),
    ("version", 3),
    ("laser", 2),
    ("status", 3),
    ("show", 2),
    ("channel", 2),
    ("enable", 2),
    ("disable", 2),
    ("ext", 3),
    ("power", 3),
    ("micro", 3),
    ("current", 3),
    ("level", 3),
    ("temperature", 4),
    ("system", 3),
    ("satellite", 3),
    ("limit", 3),
    ("data", 4),
    ("timer", 5),
    ("uptime", 2),
    ("fine", 4),
    ("clip", 4),
    ("reset", 5),
    ("ini", 3),
    ("help", 4),
    ("set", 3),
    ("celsius", 3),
    ("config", 6),
    ("pass", 4),
    ("service", 7),
    ("save", 4),
    ("mode", 4),
    ("a", 1),
    ("b", 1),
];

/// The words of a command in full; words that are no keywords stay as they are.
pub(super) fn in_full(command: &str) -> Vec<String> {
    command.split_whitespace().map(|word| keyword(&word.to_ascii_lowercase())).collect()
}

fn keyword(word: &str) -> String {
    let known = |(keyword, fewest): &&(&str, usize)| word.len() >= *fewest && keyword.starts_with(word);
    KEYWORDS.iter().find(known).map_or_else(|| word.to_owned(), |(keyword, _)| (*keyword).to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shortened_words_are_known_and_numbers_stay() {
        assert_eq!(in_full("ch 2 pow 100.5 mic"), ["channel", "2", "power", "100.5", "micro"]);
        assert_eq!(in_full("sta la"), ["status", "laser"]);
        assert_eq!(in_full("SH SAT"), ["show", "satellite"]);
        assert_eq!(in_full("s la"), ["s", "laser"]);
    }
}
