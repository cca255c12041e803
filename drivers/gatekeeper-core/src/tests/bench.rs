//! A board on the bench: a clock that passes when told, and a writer of frames that owes nothing to the firmware.

use crate::{Board, Core, Inputs, Outputs};

pub(super) mod command {
    pub(crate) const HELLO: u8 = 1;
    pub(crate) const ARM: u8 = 2;
    pub(crate) const DISARM: u8 = 3;
    pub(crate) const HEARTBEAT: u8 = 4;
    pub(crate) const GATES: u8 = 5;
    pub(crate) const LEVEL: u8 = 6;
    pub(crate) const LIMIT: u8 = 7;
    pub(crate) const LOAD: u8 = 8;
    pub(crate) const BEGIN: u8 = 9;
    pub(crate) const END: u8 = 10;
    pub(crate) const TRAIN: u8 = 11;
    pub(crate) const STOP_TRAIN: u8 = 12;
    pub(crate) const STATE: u8 = 13;
}

pub(super) mod status {
    pub(crate) const OK: u8 = 0;
    pub(crate) const RANGE: u8 = 3;
    pub(crate) const NOT_ARMED: u8 = 4;
    pub(crate) const INTERLOCK_OPEN: u8 = 5;
    pub(crate) const BUSY: u8 = 6;
    pub(crate) const NUMBER: u8 = 7;
    pub(crate) const EPOCH: u8 = 8;
    pub(crate) const CONTENT: u8 = 9;
}

pub(super) mod trip {
    pub(crate) const NONE: u8 = 0;
    pub(crate) const WATCHDOG: u8 = 1;
    pub(crate) const ON_TIME: u8 = 2;
    pub(crate) const INTERLOCK: u8 = 3;
    pub(crate) const COMMANDED: u8 = 4;
    pub(crate) const RESET: u8 = 5;
}

/// CRC-16/CCITT-FALSE as its definition has it: a long division.
pub(super) fn crc(bytes: &[u8]) -> u16 {
    let mut remainder = 0xFFFF_u32;
    for bit in bytes.iter().flat_map(|byte| (0..8).rev().map(move |at| u32::from(byte >> at & 1))) {
        let top = remainder >> 15 ^ bit;
        remainder = ((remainder << 1) ^ (top * 0x1021)) & 0xFFFF;
    }
    remainder as u16
}

pub(super) fn frame(number: u16, command: u8, epoch: u16, payload: &[u8]) -> Vec<u8> {
    let mut bytes = number.to_be_bytes().to_vec();
    bytes.push(command);
    bytes.extend(epoch.to_be_bytes());
    bytes.extend(payload);
    bytes.extend(crc(&bytes).to_be_bytes());
    let digits: String = bytes.iter().map(|byte| format!("{byte:02X}")).collect();
    format!(":{digits}\n").into_bytes()
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Answer {
    pub(super) number: u16,
    pub(super) epoch: u16,
    pub(super) status: u8,
    pub(super) open: u8,
    flags: u8,
    pub(super) trip: u8,
    pub(super) config: u16,
    pub(super) pulses: u32,
    pub(super) exposures: u16,
    pub(super) faulty: u16,
}

impl Answer {
    /// Reads an answer that is no hello.
    pub(super) fn read(line: &[u8]) -> Option<Self> {
        let digits = line.strip_prefix(b":")?.strip_suffix(b"\n")?;
        let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
        let bytes: Vec<u8> = digits.chunks(2).map(byte).collect::<Option<_>>()?;
        let (all, check) = bytes.split_at(bytes.len().checked_sub(2)?);
        if crc(all).to_be_bytes() != check || all.len() != 19 {
            return None;
        }
        let short = |at: usize| u16::from_be_bytes([all[at], all[at + 1]]);
        Some(Self {
            number: short(0),
            epoch: short(3),
            status: all[5],
            open: all[6],
            flags: all[7],
            trip: all[8],
            config: short(9),
            pulses: u32::from_be_bytes([all[11], all[12], all[13], all[14]]),
            exposures: short(15),
            faulty: short(17),
        })
    }

    pub(super) fn is_armed(&self) -> bool {
        self.flags & 1 != 0
    }

    pub(super) fn runs_train(&self) -> bool {
        self.flags & 16 != 0
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Change {
    pub(super) at_us: u64,
    pub(super) gates: u8,
    pub(super) pulse: bool,
}

pub(super) struct Bench {
    pub(super) core: Core,
    pub(super) now_us: u64,
    pub(super) number: u16,
    pub(super) epoch: u16,
    pub(super) interlock_closed: bool,
    pub(super) exposing: bool,
    pub(super) outputs: Outputs,
}

impl Bench {
    /// A board that has been greeted.
    pub(super) fn new() -> Self {
        let mut core = Core::power_up(&Board::simulated(42, 5, 8, 4), 0);
        let idle = Inputs { now_us: 0, byte: None, interlock_closed: true, exposing: false };
        let outputs = core.step(&idle);
        let mut bench =
            Self { core, now_us: 0, number: 100, epoch: 5, interlock_closed: true, exposing: false, outputs };
        bench.greet();
        bench
    }

    pub(super) fn reset(&mut self) {
        self.epoch += 1;
        self.core = Core::power_up(&Board::simulated(42, self.epoch, 8, 4), self.now_us as u32);
        self.greet();
    }

    pub(super) fn greet(&mut self) {
        self.number = self.number.wrapping_add(1);
        let hello = frame(self.number, command::HELLO, 0, &[]);
        assert!(!self.say(&hello).is_empty());
    }

    pub(super) fn step(&mut self, byte: Option<u8>) -> Outputs {
        let inputs = Inputs {
            now_us: self.now_us as u32,
            byte,
            interlock_closed: self.interlock_closed,
            exposing: self.exposing,
        };
        self.outputs = self.core.step(&inputs);
        self.outputs
    }

    pub(super) fn say(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut answer = Vec::new();
        for byte in bytes {
            answer.extend_from_slice(self.step(Some(*byte)).bytes());
        }
        answer
    }

    pub(super) fn command(&mut self, command: u8, payload: &[u8]) -> Answer {
        self.number = self.number.wrapping_add(1);
        let line = self.say(&frame(self.number, command, self.epoch, payload));
        let answer = Answer::read(&line).unwrap();
        assert_eq!((answer.number, answer.epoch), (self.number, self.epoch));
        answer
    }

    pub(super) fn state(&mut self) -> Answer {
        self.command(command::STATE, &[])
    }

    pub(super) fn config(&mut self) -> u16 {
        self.state().config
    }

    pub(super) fn try_arm(&mut self) -> Answer {
        let config = self.config();
        self.command(command::ARM, &config.to_be_bytes())
    }

    pub(super) fn arm(&mut self) {
        let answer = self.try_arm();
        assert_eq!((answer.status, answer.is_armed()), (status::OK, true));
    }

    pub(super) fn load(&mut self, patterns: &[u8]) {
        let payload = [&[0, 0], patterns].concat();
        assert_eq!(self.command(command::LOAD, &payload).status, status::OK);
    }

    pub(super) fn begin(&mut self, patterns: &[u8], step: u8) -> Answer {
        let [length, check] = [patterns.len() as u16, crc(patterns)].map(u16::to_be_bytes);
        self.command(command::BEGIN, &[length[0], length[1], check[0], check[1], step])
    }

    pub(super) fn train(&mut self, period: u32, number: u32, width: u32, delay: u32, open: u32) -> Answer {
        let payload: Vec<u8> =
            [period, number, width, delay, open].iter().flat_map(|v| v.to_be_bytes()).collect();
        self.command(command::TRAIN, &payload)
    }

    /// Lets time pass as the firmware says it may, and tells what changed.
    pub(super) fn pass(&mut self, us: u64) -> Vec<Change> {
        let until = self.now_us + us;
        let mut changes = Vec::new();
        let mut before = self.outputs;
        loop {
            let now = self.step(None);
            if (now.gates, now.pulse()) != (before.gates, before.pulse()) {
                changes.push(Change { at_us: self.now_us, gates: now.gates, pulse: now.pulse() });
            }
            before = now;
            if self.now_us >= until {
                return changes;
            }
            self.now_us = until.min(self.now_us + u64::from(self.core.idle_us()).max(1));
        }
    }
}
