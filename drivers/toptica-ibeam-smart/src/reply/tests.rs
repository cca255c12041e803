//! Answers as the manual has them, and a million that are none.

use sofiscope_virtual::laser::noise::Noise;

use super::*;

fn texts(bytes: &[u8]) -> Vec<String> {
    match parse(bytes) {
        Some(Reply::Texts(texts)) => texts,
        other => panic!("{:?}: {other:?}", bytes.escape_ascii().to_string()),
    }
}

#[test]
fn answers_of_the_manual_are_understood() {
    assert_eq!(texts(b"\r\n[OK]\r\n"), [""; 0]);
    assert_eq!(switch(&texts(b"\r\nOFF\r\n[OK]\r\n")), Some(false));
    let power = measured_power(&texts(b"\r\nPIC  = 004987 uW  \r\n[OK]\r\n"));
    assert_eq!(power.map(Milliwatts::value), Some(4.987));
    assert_eq!(serial(&texts(b"\r\nSN: iBEAM-SMART-1\r\n[OK]\r\n")).as_deref(), Some("iBEAM-SMART-1"));
    let found = levels(&texts(b"\r\nCH1, PWR: 75.000 mW\r\nCH2, PWR: 1.5 mW\r\n[OK]\r\n")).unwrap();
    assert_eq!(found.iter().map(|level| level.value()).collect::<Vec<_>>(), [75.0, 1.5]);
    let most = most_power(&texts(b"\r\nPmax: 125 mW\r\nCH2 setp: 10.0 mW\r\n[OK]\r\n"));
    assert_eq!(most.map(Milliwatts::value), Some(125.0));
}

#[test]
fn the_letter_after_the_first_dash_tells_refusals_from_information() {
    assert_eq!(texts(b"\r\n%SYS-I-046, EMISSION\r\nON\r\n[OK]\r\n"), ["ON"]);
    for letter in ["W", "E", "F"] {
        // Micro-Manager looks for an I anywhere in the line, and takes this for no error.
        let answer = format!("\r\n%SYS-{letter}-00025, INVALID\r\n[OK]\r\n");
        let refused = Reply::Refused(format!("%SYS-{letter}-00025, INVALID"));
        assert_eq!(parse(answer.as_bytes()), Some(refused));
    }
    for broken in ["%SYS-X-1", "%SYS", "%SYS-EI-1", "%SY"] {
        assert_eq!(parse(format!("\r\n{broken}\r\n[OK]\r\n").as_bytes()), None, "{broken}");
    }
}

#[test]
fn echo_prompt_seams_and_lost_ends_are_no_answers() {
    for bytes in [
        &b"status laser\r\nOFF\r\n[OK]\r\n"[..],
        b"\r\nOFF\r\nCMD> ",
        b"\r\nOFF\r\n",
        b"\r\nOF[OK]\r\n",
        b"\r\nON\r\n[OK]\r\n\r\nOFF\r\n[OK]\r\n",
        b"OFF\r\n[OK]\r\n",
        b"\r\nO\x00N\r\n[OK]\r\n",
        b"",
    ] {
        assert_eq!(parse(bytes), None, "{}", bytes.escape_ascii());
    }
}

/// A slow twin of the grammar: splits into lines by hand and compares them as a person would.
fn is_clean(bytes: &[u8], value: impl Fn(&str) -> bool) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let lines: Vec<&str> = text.split("\r\n").collect();
    let information = |line: &str| line.trim().starts_with("%SYS-I-");
    match lines.as_slice() {
        ["", inner @ .., "[OK]", ""] => {
            let values: Vec<&&str> = inner.iter().filter(|line| !information(line)).collect();
            values.len() == 1 && value(values[0].trim())
        }
        _ => false,
    }
}

fn is_power(line: &str) -> bool {
    let words: Vec<&str> = line.split_whitespace().collect();
    // The parts may be written together; then the twin takes them apart by their letters.
    let joined = words.concat();
    joined.starts_with("PIC=") && joined.ends_with("uW") && {
        let digits = &joined[4..joined.len() - 2];
        !digits.is_empty() && digits.chars().all(|letter| letter.is_ascii_digit())
    }
}

const SEEDS: [&[u8]; 8] = [
    b"\r\n[OK]\r\n",
    b"\r\nON\r\n[OK]\r\n",
    b"\r\nOFF\r\n[OK]\r\n",
    b"\r\nPIC  = 004987 uW  \r\n[OK]\r\n",
    b"\r\nCH1, PWR: 75.000 mW\r\nCH2, PWR: 1.5 mW\r\n[OK]\r\n",
    b"\r\nSN: iBEAM-SMART-1\r\n[OK]\r\n",
    b"\r\n%SYS-E-00025, parameter error\r\n[OK]\r\n",
    b"status laser\r\nOFF\r\nCMD> ",
];

/// Random bytes, or an answer that was changed, cut, or merged with another.
fn mangled(noise: &mut Noise) -> Vec<u8> {
    let mut bytes = SEEDS[noise.below(SEEDS.len())].to_vec();
    for _ in 0..=noise.below(3) {
        let at = noise.below(bytes.len() + 1);
        match noise.below(7) {
            0 => bytes = (0..noise.below(40)).map(|_| noise.bits() as u8).collect(),
            1 => bytes.truncate(at),
            2 => bytes.extend(SEEDS[noise.below(SEEDS.len())]),
            3 => bytes.insert(at, noise.bits() as u8),
            4 if at < bytes.len() => bytes[at] = noise.bits() as u8,
            5 if at < bytes.len() => {
                bytes.remove(at);
            }
            _ => drop(bytes.splice(at..at, SEEDS[noise.below(SEEDS.len())].iter().copied())),
        }
    }
    bytes
}

#[test]
fn a_million_mangled_answers_are_never_taken_for_what_they_are_not() {
    let mut noise = Noise::new(46);
    let mut taken = [0; 3];
    for _ in 0..1_000_000 {
        let bytes = mangled(&mut noise);
        let found = end(&bytes).map(|(answer, _)| &bytes[..answer]);
        let Some(Reply::Texts(texts)) = found.and_then(parse) else { continue };
        let found = found.unwrap();
        let shown = found.escape_ascii();
        if texts.is_empty() {
            taken[0] += 1;
            let information = found.windows(7).any(|part| part == b"%SYS-I-");
            assert!(found == b"\r\n[OK]\r\n" || information, "{shown}");
        }
        if let Some(on) = switch(&texts) {
            taken[1] += 1;
            assert!(is_clean(found, |value| value == if on { "ON" } else { "OFF" }), "{shown}");
        }
        if measured_power(&texts).is_some() {
            taken[2] += 1;
            assert!(is_clean(found, is_power), "{shown}");
        }
        let _ = (levels(&texts), serial(&texts), most_power(&texts));
    }
    assert!(taken.iter().all(|taken| *taken > 1000), "the million has answers among it: {taken:?}");
}
