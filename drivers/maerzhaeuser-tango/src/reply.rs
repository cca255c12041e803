//! Answers of the controller as values, and nothing that is not one.
//!
//! In: a line without its end. Out: a value, or `None`. Never: guesses; reads past what it was given.

/// State of one axis (letters of `statusaxis`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Letter {
    /// `@`, and `A` and `D` after calibration and range measure.
    Ready,
    /// `M`
    Moving,
    /// `J`
    Joystick,
    /// `S`
    Limit,
    /// `E`
    Error,
    /// `T`
    Timeout,
    /// `-`
    Absent,
}

/// The answer to `?statusaxis x`.
pub(crate) fn letter(answer: &[u8]) -> Option<Letter> {
    match answer {
        b"@" | b"A" | b"D" => Some(Letter::Ready),
        b"M" => Some(Letter::Moving),
        b"J" => Some(Letter::Joystick),
        b"S" => Some(Letter::Limit),
        b"E" => Some(Letter::Error),
        b"T" => Some(Letter::Timeout),
        b"-" => Some(Letter::Absent),
        _ => None,
    }
}

/// Whether this is the line that autostatus sends unasked: four letters and a full stop.
pub(crate) fn is_autostatus(line: &[u8]) -> bool {
    matches!(line, [letters @ .., b'.'] if letters.len() == 4 && letters.iter().all(|letter| b"@MJSADET-".contains(letter)))
}

/// The answer to `?err`: a code of one to three digits.
pub(crate) fn error_code(answer: &[u8]) -> Option<u16> {
    if answer.len() > 3 { None } else { u16::try_from(whole(answer)?).ok() }
}

/// A whole number without sign, of at most nine digits.
pub(crate) fn whole(answer: &[u8]) -> Option<u32> {
    let is_number = (1..=9).contains(&answer.len()) && answer.iter().all(u8::is_ascii_digit);
    if is_number { str::from_utf8(answer).ok()?.parse().ok() } else { None }
}

/// Exactly `count` decimal numbers with one space between them.
pub(crate) fn numbers(answer: &[u8], count: usize) -> Option<Vec<f64>> {
    let words: Vec<&[u8]> = answer.split(|byte| *byte == b' ').collect();
    if words.len() == count { words.into_iter().map(number).collect() } else { None }
}

/// Whole numbers with one space between them, one per axis, at least two.
pub(crate) fn wholes(answer: &[u8]) -> Option<Vec<u32>> {
    let numbers: Option<Vec<u32>> = answer.split(|byte| *byte == b' ').map(whole).collect();
    numbers.filter(|numbers| numbers.len() >= 2)
}

/// A decimal number as the controller writes it: sign, digits, and digits behind a point.
fn number(word: &[u8]) -> Option<f64> {
    let unsigned = word.strip_prefix(b"-").unwrap_or(word);
    let mut parts = unsigned.split(|byte| *byte == b'.');
    let are_digits = parts.all(|part| !part.is_empty() && part.iter().all(u8::is_ascii_digit));
    let has_one_point = unsigned.iter().filter(|byte| **byte == b'.').count() <= 1;
    if !are_digits || !has_one_point || unsigned.len() > 16 {
        return None;
    }
    str::from_utf8(word).ok()?.parse().ok()
}

/// A text of printable characters.
pub(crate) fn text(answer: &[u8]) -> Option<String> {
    let is_text = !answer.is_empty() && answer.iter().all(|byte| (b' '..=b'~').contains(byte));
    if is_text { String::from_utf8(answer.to_vec()).ok() } else { None }
}

#[cfg(test)]
mod tests;
