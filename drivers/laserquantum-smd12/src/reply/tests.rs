//! Answers as the adapters have them, and a million that are none.

use sofiscope_virtual::laser::noise::Noise;

use super::*;

fn text(line: &[u8]) -> String {
    match parse(line) {
        Some(Reply::Text(text)) => text,
        other => panic!("{}: {other:?}", line.escape_ascii()),
    }
}

#[test]
fn answers_of_the_adapters_are_understood() {
    assert_eq!(taken(&text(b"")), Some(()));
    assert_eq!(enabled(&text(b"\x03DISABLED")), Some(false));
    assert_eq!(enabled(&text(b" ENABLED")), Some(true));
    assert_eq!(power(&text(b"150mW")).map(Milliwatts::value), Some(150.0));
    assert_eq!(power(&text(b"0.15W")).map(Milliwatts::value), Some(150.0));
    assert_eq!(version(&text(b"SMD12 1.0")).as_deref(), Some("SMD12 1.0"));
    for refused in [&b"Error 67"[..], b"ERROR67", b"\x03 error: 67"] {
        assert_eq!(parse(refused), Some(Reply::Refused(67)));
    }
    assert_eq!(parse(b"Error"), None, "an error without its number is no answer");
}

#[test]
fn powers_that_are_none_are_refused() {
    for wrong in ["", "mW", "-5mW", "1e3mW", "NaNmW", "infmW", "12", "1.2.3mW", "5 mWmW", ".5mW", "0x5mW"] {
        assert_eq!(power(wrong), None, "{wrong}");
    }
}

const SEEDS: [&[u8]; 9] = [
    b"",
    b"ENABLED",
    b"DISABLED",
    b"150mW",
    b"0.150W",
    b"SMD12 virtual 1.0",
    b"Error 67",
    b"\x03 25.3C",
    b"PSU Time = 1234 Hours",
];

/// Random bytes, or an answer that was changed, cut, or merged with another.
fn mangled(noise: &mut Noise) -> Vec<u8> {
    let mut bytes = SEEDS[noise.below(SEEDS.len())].to_vec();
    for _ in 0..noise.below(4) {
        let at = noise.below(bytes.len() + 1);
        match noise.below(6) {
            0 => bytes = (0..noise.below(30)).map(|_| noise.bits() as u8).collect(),
            1 => bytes.truncate(at),
            2 => bytes.extend(SEEDS[noise.below(SEEDS.len())]),
            3 => bytes.insert(at, noise.bits() as u8),
            4 if at < bytes.len() => bytes[at] = noise.bits() as u8,
            _ => drop(bytes.splice(at..at, SEEDS[noise.below(SEEDS.len())].iter().copied())),
        }
    }
    bytes
}

/// A slow twin: what is left when blanks and ETX are taken from both ends, by hand.
fn bare(bytes: &[u8]) -> &[u8] {
    match bytes {
        [b' ' | 3, rest @ ..] | [rest @ .., b' ' | 3] => bare(rest),
        _ => bytes,
    }
}

#[test]
fn a_million_mangled_answers_are_never_taken_for_what_they_are_not() {
    let mut noise = Noise::new(44);
    let mut num = [0; 4];
    for _ in 0..1_000_000 {
        let bytes = mangled(&mut noise);
        let (left, shown) = (bare(&bytes), bytes.escape_ascii());
        match parse(&bytes) {
            Some(Reply::Refused(_)) => {
                num[0] += 1;
                assert!(left.iter().any(u8::is_ascii_digit), "{shown}");
            }
            Some(Reply::Text(text)) => {
                if taken(&text).is_some() {
                    num[1] += 1;
                    assert!(left.is_empty(), "{shown}");
                }
                if let Some(on) = enabled(&text) {
                    num[2] += 1;
                    assert_eq!(left, if on { &b"ENABLED"[..] } else { b"DISABLED" }, "{shown}");
                }
                if let Some(power) = power(&text) {
                    num[3] += 1;
                    let digits: Vec<u8> = left.iter().copied().filter(u8::is_ascii_digit).collect();
                    let letters = left.iter().filter(|byte| byte.is_ascii_alphabetic()).count();
                    assert!(!digits.is_empty() && letters <= 2 && left.ends_with(b"W"), "{shown}");
                    assert!(power >= Milliwatts::ZERO, "{shown}");
                }
                assert!(!left.to_ascii_lowercase().windows(5).any(|part| part == b"error"), "{shown}");
            }
            None => {}
        }
    }
    assert!(num.iter().all(|num| *num > 1000), "the million has answers among it: {num:?}");
}
