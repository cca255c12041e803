//! A million lines that are no commands: nothing panics, and no gate opens.

use super::bench::{Bench, command, frame};

const LINES: u32 = 1_000_000;

/// Xorshift: the same lines in every run.
struct Dice(u64);

impl Dice {
    fn throw(&mut self, below: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % below
    }

    fn byte(&mut self) -> u8 {
        self.throw(256) as u8
    }

    fn digit(&mut self) -> u8 {
        b"0123456789ABCDEF"[self.throw(16) as usize]
    }
}

/// A line that looks more or less like the command to open all gates.
fn line(dice: &mut Dice, open: &[u8]) -> Vec<u8> {
    let mut line = open.to_vec();
    match dice.throw(6) {
        0 => return (0..dice.throw(64)).map(|_| dice.byte()).filter(|byte| *byte != b'!').collect(),
        1 => {
            let digits = dice.throw(58);
            return [b':'].into_iter().chain((0..digits).map(|_| dice.digit())).chain([b'\n']).collect();
        }
        // One character is another one.
        2 => {
            let at = dice.throw(line.len() as u64) as usize;
            let before = line[at];
            while line[at] == before || line[at] == b'!' {
                line[at] = if dice.throw(4) == 0 { dice.byte() } else { dice.digit() };
            }
        }
        // One character is missing.
        3 => {
            line.remove(dice.throw(line.len() as u64 - 1) as usize);
        }
        // The beginning of one and the end of another.
        4 => {
            let keep = 1 + dice.throw(line.len() as u64 - 2) as usize;
            let from = keep + 1 + dice.throw((line.len() - keep) as u64) as usize;
            line = [&line[..keep], &open[from.min(open.len())..]].concat();
        }
        // One character too many, inside.
        _ => {
            let at = 1 + dice.throw(line.len() as u64 - 2) as usize;
            let extra = dice.digit();
            line.insert(at, extra);
        }
    }
    line
}

#[test]
fn a_million_lines_of_garbage_open_no_gate() {
    let mut bench = Bench::new();
    bench.arm();
    let mut dice = Dice(0x5EED_0001);
    let open = frame(bench.number.wrapping_add(1), command::GATES, bench.epoch, &[0xFF]);
    for number in 0..LINES {
        let garbage = line(&mut dice, &open);
        for byte in &garbage {
            assert_eq!(bench.step(Some(*byte)).gates, 0, "line {number}: {}", garbage.escape_ascii());
        }
        // Whatever is open at its end is over with the next beginning.
        bench.step(Some(b'\n'));
    }
    let state = bench.state();
    assert!(state.is_armed(), "garbage closes nothing either");
    assert_eq!(state.faulty, u16::MAX, "faulty frames are counted");
    assert_eq!(bench.command(command::GATES, &[0xFF]).open, 0xFF, "the board still listens");
}
