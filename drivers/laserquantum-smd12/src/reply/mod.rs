//! What an answer says, and whether it is one.
//!
//! One line, ended by CR LF; empty for a command that was taken. Some units put an ETX or a blank before it.

#[cfg(test)]
mod tests;

use sofiscope_hal::Milliwatts;

/// Longest text of an answer.
const LONGEST_TEXT: usize = 80;

/// What the laser said.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Reply {
    /// A text, empty for a command that was taken.
    Text(String),
    /// `Error` and a number; spelling and spacing are not published.
    Refused(u32),
}

/// The answer in a line without its end, if it is one.
pub(crate) fn parse(line: &[u8]) -> Option<Reply> {
    let text =
        std::str::from_utf8(line).ok()?.trim_matches(|letter: char| letter == ' ' || letter == '\u{3}');
    let printable = text.bytes().all(|byte| (b' '..=b'~').contains(&byte));
    if !printable || text.len() > LONGEST_TEXT {
        return None;
    }
    if !text.to_ascii_lowercase().contains("error") {
        return Some(Reply::Text(text.to_owned()));
    }
    let digits: String = text.chars().filter(char::is_ascii_digit).collect();
    digits.parse().ok().map(Reply::Refused)
}

/// Nothing, as for commands that are taken.
pub(crate) fn taken(text: &str) -> Option<()> {
    text.is_empty().then_some(())
}

/// `ENABLED` or `DISABLED`.
pub(crate) fn enabled(text: &str) -> Option<bool> {
    match text {
        "ENABLED" => Some(true),
        "DISABLED" => Some(false),
        _ => None,
    }
}

/// The power in `150mW`, or `0.150W` on some supplies.
pub(crate) fn power(text: &str) -> Option<Milliwatts> {
    let (number, unit_mw) = match text.strip_suffix("mW") {
        Some(number) => (number, 1.0),
        None => (text.strip_suffix('W')?, 1000.0),
    };
    let number = number.trim_end();
    let plain = (1..=9).contains(&number.len())
        && number.starts_with(|letter: char| letter.is_ascii_digit())
        && number.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
    let power: f64 = number.parse().ok().filter(|_| plain)?;
    Milliwatts::new(power * unit_mw).ok()
}

/// The model and version, which name the supply.
pub(crate) fn version(text: &str) -> Option<String> {
    text.contains("SMD12").then(|| text.to_owned())
}

/// Any text but none.
pub(crate) fn something(text: &str) -> Option<String> {
    (!text.is_empty()).then(|| text.to_owned())
}
