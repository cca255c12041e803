//! What an answer says, and whether it is one.
//!
//! `reply := ␍␊ { text ␍␊ } "[OK]" ␍␊`, as it is with `echo off`, `prompt off`, `talk usual`. Texts that begin with
//! `%SYS-` and the letter W, E or F are refusals; those with I are information and no part of the answer.

#[cfg(test)]
mod tests;

use sofiscope_hal::Milliwatts;

/// Longest text of an answer.
const LONGEST_TEXT: usize = 120;

/// What the laser said.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Reply {
    /// These texts, none for a command that was taken.
    Texts(Vec<String>),
    /// It refuses, in its own words.
    Refused(String),
}

/// Where an answer ends: after `[OK]`, or after the prompt that stands there when it is on.
pub(crate) fn end(received: &[u8]) -> Option<(usize, usize)> {
    const OK: &[u8] = b"[OK]\r\n";
    let at_line = |at: usize| at == 0 || received[at - 1] == b'\n';
    let ok = received.windows(OK.len()).enumerate().find(|(at, part)| *part == OK && at_line(*at));
    let used =
        ok.map(|(at, _)| at + OK.len()).or_else(|| received.ends_with(b"CMD> ").then_some(received.len()));
    used.map(|used| (used, used))
}

/// The answer, if the bytes are exactly one.
pub(crate) fn parse(bytes: &[u8]) -> Option<Reply> {
    let body = bytes.strip_prefix(b"\r\n")?.strip_suffix(b"[OK]\r\n")?;
    let mut texts = Vec::new();
    let mut refusal = None;
    if !body.is_empty() {
        for text in std::str::from_utf8(body).ok()?.strip_suffix("\r\n")?.split("\r\n") {
            match severity(text)? {
                Severity::None => texts.push(text.trim().to_owned()),
                Severity::Information => {}
                Severity::Refusal => refusal = refusal.or_else(|| Some(text.trim().to_owned())),
            }
        }
    }
    Some(refusal.map_or(Reply::Texts(texts), Reply::Refused))
}

enum Severity {
    None,
    Information,
    Refusal,
}

/// How grave a text is, or nothing when no laser says such a thing.
fn severity(text: &str) -> Option<Severity> {
    let printable = text.bytes().all(|byte| (b' '..=b'~').contains(&byte));
    let whole = !text.trim().is_empty() && text.len() <= LONGEST_TEXT;
    // A mark inside a text is the seam of two answers.
    if !printable || !whole || text.contains("[OK]") || text.contains("CMD>") {
        return None;
    }
    match text.trim().strip_prefix('%') {
        None => Some(Severity::None),
        Some(message) => {
            let mut parts = message.strip_prefix("SYS-")?.splitn(2, '-');
            match (parts.next()?, parts.next().is_some()) {
                ("I", true) => Some(Severity::Information),
                ("W" | "E" | "F", true) => Some(Severity::Refusal),
                _ => None,
            }
        }
    }
}

/// The only text.
pub(crate) fn only(texts: &[String]) -> Option<&str> {
    match texts {
        [text] => Some(text),
        _ => None,
    }
}

/// `ON` or `OFF`.
pub(crate) fn switch(texts: &[String]) -> Option<bool> {
    match only(texts)? {
        "ON" => Some(true),
        "OFF" => Some(false),
        _ => None,
    }
}

/// The serial number in `SN: iBEAM-SMART-…`.
pub(crate) fn serial(texts: &[String]) -> Option<String> {
    let serial = only(texts)?.strip_prefix("SN:")?.trim();
    (!serial.is_empty()).then(|| serial.to_owned())
}

/// The power in `PIC  = 004987 uW`.
pub(crate) fn measured_power(texts: &[String]) -> Option<Milliwatts> {
    let digits = only(texts)?.strip_prefix("PIC")?.trim_start().strip_prefix('=')?.strip_suffix("uW")?.trim();
    let whole = (1..=9).contains(&digits.len()) && digits.bytes().all(|byte| byte.is_ascii_digit());
    let microwatts: f64 = digits.parse().ok().filter(|_| whole)?;
    Milliwatts::new(microwatts / 1000.0).ok()
}

/// The levels in `CH1, PWR: 75.000 mW`, one line per channel, two channels at least.
pub(crate) fn levels(texts: &[String]) -> Option<Vec<Milliwatts>> {
    let level = |(index, text): (usize, &String)| {
        let power = text.strip_prefix(&format!("CH{}, PWR:", index + 1))?.strip_suffix("mW")?;
        power_of(power)
    };
    let levels: Option<Vec<_>> = texts.iter().enumerate().map(level).collect();
    levels.filter(|levels| (2..=5).contains(&levels.len()))
}

/// The most it can do, in the `Pmax: 125 mW` of `show satellite`.
pub(crate) fn most_power(texts: &[String]) -> Option<Milliwatts> {
    let mut most = texts.iter().filter_map(|text| text.strip_prefix("Pmax:"));
    let power = power_of(most.next()?.strip_suffix("mW")?)?;
    (most.next().is_none() && power > Milliwatts::ZERO).then_some(power)
}

/// A number without sign and exponent.
fn power_of(text: &str) -> Option<Milliwatts> {
    let text = text.trim();
    let plain = (1..=12).contains(&text.len())
        && text.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.')
        && text.bytes().next().is_some_and(|byte| byte.is_ascii_digit());
    text.parse().ok().filter(|_| plain).and_then(|power| Milliwatts::new(power).ok())
}
