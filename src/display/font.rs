//! Letters of five by seven pixels, just those that a scale bar needs.
//!
//! In: a short text. Out: the pixels it covers.
//! Never: wraps lines. Fails: never; a letter that is not there is drawn as a box.

/// Columns of one letter.
const COLUMNS: usize = 5;
/// Rows of one letter, one more than seven for the tail of the µ.
const ROWS: usize = 8;

/// Rows from top to bottom; the highest of the five low bits is the leftmost pixel.
fn glyph(letter: char) -> [u8; ROWS] {
    match letter {
        '0' => [14, 17, 19, 21, 25, 17, 14, 0],
        '1' => [4, 12, 4, 4, 4, 4, 14, 0],
        '2' => [14, 17, 1, 2, 4, 8, 31, 0],
        '3' => [31, 2, 4, 2, 1, 17, 14, 0],
        '4' => [2, 6, 10, 18, 31, 2, 2, 0],
        '5' => [31, 16, 30, 1, 1, 17, 14, 0],
        '6' => [6, 8, 16, 30, 17, 17, 14, 0],
        '7' => [31, 1, 2, 4, 8, 8, 8, 0],
        '8' => [14, 17, 17, 14, 17, 17, 14, 0],
        '9' => [14, 17, 17, 15, 1, 2, 12, 0],
        'm' => [0, 0, 26, 21, 21, 21, 21, 0],
        'n' => [0, 0, 22, 25, 17, 17, 17, 0],
        'µ' => [0, 0, 17, 17, 17, 19, 29, 16],
        '.' => [0, 0, 0, 0, 0, 12, 12, 0],
        '-' => [0, 0, 0, 31, 0, 0, 0, 0],
        ' ' => [0; ROWS],
        _ => [31, 17, 17, 17, 17, 17, 31, 0],
    }
}

/// Width and height of a text in pixels, letters `size` times as large.
pub(super) fn extent(text: &str, size: usize) -> (usize, usize) {
    let letters = text.chars().count();
    ((letters * (COLUMNS + 1)).saturating_sub(1) * size, ROWS * size)
}

/// Pixels `(y, x)` covered by a text whose upper left corner is at `(top, left)`.
pub(super) fn pixels(text: &str, size: usize, top: usize, left: usize) -> Vec<(usize, usize)> {
    let mut covered = Vec::new();
    for (index, letter) in text.chars().enumerate() {
        let rows = glyph(letter);
        for (y, x) in (0..ROWS * size).flat_map(|y| (0..COLUMNS * size).map(move |x| (y, x))) {
            if rows[y / size] >> (COLUMNS - 1 - x / size) & 1 == 1 {
                covered.push((top + y, left + index * (COLUMNS + 1) * size + x));
            }
        }
    }
    covered
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_stay_inside_their_extent() {
        let (width, height) = extent("10 µm", 3);
        assert_eq!((width, height), (87, 24));
        assert!(pixels("10 µm", 3, 0, 0).iter().all(|&(y, x)| y < height && x < width));
    }

    #[test]
    fn every_letter_of_a_label_is_known_and_distinct() {
        let letters: Vec<char> = "0123456789.mnµ-".chars().collect();
        for (index, &letter) in letters.iter().enumerate() {
            assert_ne!(glyph(letter), glyph('?'));
            assert!(letters[index + 1..].iter().all(|&other| glyph(other) != glyph(letter)));
        }
    }
}
