//! Text and numbers made safe and readable for a page.
//!
//! In: any text, any number. Out: the same for HTML, SVG and XML.
//! Never: lets markup through. Fails: never.

/// Text with the characters that mean something in markup replaced, and control characters made visible.
pub(super) fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            '\n' | '\t' => safe.push(letter),
            '\u{FFFE}' | '\u{FFFF}' => safe.push('\u{FFFD}'),
            _ if letter.is_control() => safe.push('\u{FFFD}'),
            _ => safe.push(letter),
        }
    }
    safe
}

/// Three significant digits, no exponent between 0.001 and a million, thousands set apart; `–` if not finite.
pub(super) fn number(value: f64) -> String {
    let size = value.abs();
    if !value.is_finite() {
        "–".to_owned()
    } else if size != 0.0 && !(1e-3..1e6).contains(&size) {
        power_of_ten(value)
    } else if size >= 99.95 || value == value.trunc() {
        count(value)
    } else {
        let decimals = if size >= 9.995 {
            1
        } else if size >= 0.9995 {
            2
        } else {
            3
        };
        minus(&format!("{value:.decimals$}"))
    }
}

/// A percentage with one decimal; `–` if not finite.
pub(super) fn percent(value: f64) -> String {
    let rounded = (value * 10.0).round() / 10.0 + 0.0;
    if value.is_finite() { minus(&format!("{rounded:.1}")) } else { "–".to_owned() }
}

/// A whole number with thousands set apart by narrow spaces.
pub(super) fn count(value: f64) -> String {
    let digits = format!("{:.0}", value.abs());
    let mut grouped = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) && digits.len() > 4 {
            grouped.push('\u{202F}');
        }
        grouped.push(digit);
    }
    if value <= -0.5 { format!("−{grouped}") } else { grouped }
}

/// The number, or `–` where there is none.
pub(super) fn optional(value: Option<f64>) -> String {
    value.map_or_else(|| "–".to_owned(), number)
}

/// `one name` or `5 names`.
pub(super) fn plural(value: usize, name: &str) -> String {
    if value == 1 { format!("1 {name}") } else { format!("{} {name}s", count(value as f64)) }
}

/// Raises the digits of an exponent.
pub(super) fn superscript(exponent: i32) -> String {
    let raised = |digit: char| match digit {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        other => char::from_u32('⁰' as u32 + other.to_digit(10).unwrap_or(0)).unwrap_or(other),
    };
    exponent.to_string().chars().map(raised).collect()
}

/// A hyphen before a number becomes a minus sign.
pub(super) fn minus(text: &str) -> String {
    text.replace('-', "−")
}

fn power_of_ten(value: f64) -> String {
    let text = format!("{value:.2e}");
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    format!("{} × 10{}", minus(mantissa), superscript(exponent.parse().unwrap_or(0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_does_not_get_through() {
        assert_eq!(
            escape("<a href='x'>\"&\u{1b}\0"),
            "&lt;a href=&#39;x&#39;&gt;&quot;&amp;\u{FFFD}\u{FFFD}"
        );
    }

    #[test]
    fn numbers_are_short() {
        for (value, expected) in [
            (0.0, "0"),
            (4000.0, "4000"),
            (123_456.0, "123\u{202F}456"),
            (0.35, "0.350"),
            (2.6, "2.60"),
            (62.34, "62.3"),
            (-12.34, "−12.3"),
            (1234.5, "1234"),
            (0.000_12, "1.20 × 10⁻⁴"),
            (-3.5e9, "−3.50 × 10⁹"),
            (f64::NAN, "–"),
        ] {
            assert_eq!(number(value), expected);
        }
        assert_eq!([percent(-0.02), percent(-2.65), percent(f64::NAN)], ["0.0", "−2.7", "–"]);
        assert_eq!(plural(1, "frame"), "1 frame");
        assert_eq!(plural(12_000, "frame"), "12\u{202F}000 frames");
        assert_eq!(superscript(-12), "⁻¹²");
    }
}
