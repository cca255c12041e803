//! A million wrong answers, none of which is taken for a right one.

use super::*;

/// Deterministic random numbers (splitmix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    fn below(&mut self, end: usize) -> usize {
        usize::try_from(self.next() % end as u64).unwrap()
    }
}

const RIGHT: [&[u8]; 14] = [
    b"0",
    b"32",
    b"@",
    b"M",
    b"@@--.",
    b"1250.0 -340.5",
    b"0.1300 -0.0300",
    b"120000.0 80000.0",
    b"9 9",
    b"3 3",
    b"10.0000",
    b"20260001",
    b"TANGO-DT2, Version 1.00, Mar 11 2022, 13:51:01",
    b"",
];

fn mutated(random: &mut Random) -> Vec<u8> {
    let mut answer = RIGHT[random.below(RIGHT.len())].to_vec();
    for _ in 0..=random.below(4) {
        let place = random.below(answer.len() + 1);
        let byte = match random.below(3) {
            0 => b"0123456789+-. @MJSADETeEnNaif,"[random.below(30)],
            _ => u8::try_from(random.below(256)).unwrap(),
        };
        match random.below(6) {
            0 => answer.insert(place, byte),
            1 => drop(answer.splice(place.min(answer.len().saturating_sub(1))..answer.len(), [])),
            2 => answer.extend_from_slice(RIGHT[random.below(RIGHT.len())]),
            3 if place < answer.len() => drop(answer.remove(place)),
            4 => answer = (0..random.below(40)).map(|_| u8::try_from(random.below(256)).unwrap()).collect(),
            _ if place < answer.len() => answer[place] = byte,
            _ => {}
        }
    }
    answer
}

/// The grammar of a number again, slow and obvious.
fn is_number(word: &str) -> bool {
    let digits = |text: &str| !text.is_empty() && text.chars().all(|letter| letter.is_ascii_digit());
    let unsigned = word.strip_prefix('-').unwrap_or(word);
    match unsigned.split_once('.') {
        Some((before, behind)) => digits(before) && digits(behind),
        None => digits(unsigned),
    }
}

#[test]
fn no_wrong_answer_is_taken_for_a_right_one() {
    let seed = 20_260_722;
    let mut random = Random(seed);
    let mut taken = [0_usize; 5];
    for trial in 0..1_000_000 {
        let answer = mutated(&mut random);
        let shown = answer.escape_ascii().to_string();
        let as_text = str::from_utf8(&answer).unwrap_or("\u{0}");
        let what = format!("trial {trial} of seed {seed}: \"{shown}\"");
        if let Some(code) = error_code(&answer) {
            taken[0] += 1;
            assert!(answer.len() <= 3 && answer.iter().all(u8::is_ascii_digit), "{what} as {code}");
            assert_eq!(code == 0, answer.iter().all(|byte| *byte == b'0'), "{what} as {code}");
        }
        if let Some(state) = letter(&answer) {
            taken[1] += 1;
            assert_eq!(answer.len(), 1, "{what} as {state:?}");
            assert_eq!(state == Letter::Ready, b"@AD".contains(&answer[0]), "{what} as {state:?}");
        }
        if let Some(numbers) = numbers(&answer, 2) {
            taken[2] += 1;
            let words: Vec<&str> = as_text.split(' ').collect();
            assert!(words.len() == 2 && words.iter().all(|word| is_number(word)), "{what} as {numbers:?}");
            assert!(numbers.iter().all(|number| number.is_finite()), "{what} as {numbers:?}");
        }
        if let Some(numbers) = wholes(&answer) {
            taken[3] += 1;
            let again: Vec<u32> = as_text.split(' ').map(|word| word.parse().unwrap()).collect();
            assert_eq!(again, numbers, "{what}");
        }
        if is_autostatus(&answer) {
            taken[4] += 1;
            assert!(answer.len() == 5 && answer[4] == b'.', "{what} as autostatus");
        }
    }
    println!("of 1000000: {taken:?} codes, letters, pairs, wholes, autostatus");
    assert!(taken.iter().all(|taken| *taken > 100), "{taken:?}: the mutations must leave some right answers");
}

#[test]
fn answers_of_the_manual_are_read() {
    assert_eq!(numbers(b"1250.0 -340.5", 2), Some(vec![1250.0, -340.5]));
    assert_eq!(error_code(b"32"), Some(32));
    assert_eq!(wholes(b"9 9 2"), Some(vec![9, 9, 2]));
    assert_eq!(letter(b"A"), Some(Letter::Ready));
    assert!(is_autostatus(b"@@--.") && is_autostatus(b"MJE-."));
    assert_eq!(text(b"TANGO-DT2, Version 1.00").as_deref(), Some("TANGO-DT2, Version 1.00"));
}

#[test]
fn what_only_looks_like_an_answer_is_none() {
    for answer in
        ["1250.0", "1250.0  -340.5", "1250.0 -340.5 ", "nan 0", "1e3 0", "+1 0", "1. 2.", "--1 2", "1,5 2"]
    {
        assert_eq!(numbers(answer.as_bytes(), 2), None, "{answer}");
    }
    for answer in ["", "-1", " 0", "0 ", "0.0", "1000", "x"] {
        assert_eq!(error_code(answer.as_bytes()), None, "{answer}");
    }
    assert_eq!((text(b""), text(b"TAN\x80GO")), (None, None));
}
