//! A hundred thousand sequences of orders, accidents and pauses: never a gate that is open and must not be.
//!
//! The judge keeps its own account of who holds the gates, from what was sent and answered; it never asks the
//! firmware whether it is armed.

use proptest::prelude::*;

use super::bench::{Answer, Bench, command, crc, frame, status};

const SEQUENCES: u32 = 100_000;
const WATCHDOG_US: u64 = 250_000;

#[derive(Debug, Clone)]
enum Event {
    Arm,
    Order(u8, Vec<u8>),
    Sequence { patterns: Vec<u8>, step: u8 },
    Train { period: u32, number: u32, delay: u32, open: u32 },
    CloseNow,
    Interlock(bool),
    Exposing(bool),
    Pass(u64),
    Reset,
    Greet,
    Garbage(Vec<u8>),
    Half,
    Replay(usize),
}

fn events() -> impl Strategy<Value = Event> {
    use command::{DISARM, END, GATES, HEARTBEAT, LEVEL, LIMIT, STATE, STOP_TRAIN};
    let limit = (0_u8..9, prop_oneof![0_u32..400_000, any::<u32>()])
        .prop_map(|(gate, us)| Event::Order(LIMIT, [&[gate], us.to_be_bytes().as_slice()].concat()));
    let bare =
        prop::sample::select(vec![DISARM, END, STATE, STOP_TRAIN]).prop_map(|c| Event::Order(c, vec![]));
    prop_oneof![
        6 => Just(Event::Arm),
        6 => any::<u8>().prop_map(|gates| Event::Order(GATES, vec![gates])),
        6 => Just(Event::Order(HEARTBEAT, vec![])),
        2 => bare,
        2 => limit,
        1 => (0_u8..5, any::<[u8; 2]>()).prop_map(|(out, [a, b])| Event::Order(LEVEL, vec![out, a, b])),
        4 => (prop::collection::vec(any::<u8>(), 0..6), 0_u8..3)
            .prop_map(|(patterns, step)| Event::Sequence { patterns, step }),
        3 => (50_u32..50_000, 0_u32..9, 0_u32..30_000, 0_u32..30_000)
            .prop_map(|(period, number, delay, open)| Event::Train { period, number, delay, open }),
        1 => Just(Event::CloseNow),
        2 => any::<bool>().prop_map(Event::Interlock),
        6 => any::<bool>().prop_map(Event::Exposing),
        8 => (0_u64..260_000).prop_map(Event::Pass),
        1 => Just(Event::Reset),
        1 => Just(Event::Greet),
        1 => prop::collection::vec(any::<u8>(), 0..40).prop_map(Event::Garbage),
        1 => Just(Event::Half),
        3 => (0_usize..64).prop_map(Event::Replay),
        1 => (any::<u8>(), prop::collection::vec(any::<u8>(), 0..20))
            .prop_filter("no order that the judge must understand", |(c, _)| !(1..=13).contains(c))
            .prop_map(|(c, payload)| Event::Order(c, payload)),
    ]
}

struct Judge {
    bench: Bench,
    /// When somebody last said, in force, that he holds the gates.
    alive_us: Option<u64>,
    limits_us: [u64; 8],
    opened_us: [Option<u64>; 8],
    sent: Vec<Vec<u8>>,
}

impl Judge {
    fn new() -> Self {
        Self {
            bench: Bench::new(),
            alive_us: None,
            limits_us: [1_000_000; 8],
            opened_us: [None; 8],
            sent: Vec::new(),
        }
    }

    /// One turn, and the verdict about it.
    fn turn(&mut self, byte: Option<u8>) -> Result<Vec<u8>, TestCaseError> {
        let now = self.bench.now_us;
        if !self.bench.interlock_closed || self.alive_us.is_some_and(|alive| now - alive >= WATCHDOG_US) {
            self.alive_us = None;
        }
        let outputs = self.bench.step(byte);
        if byte == Some(b'!') {
            self.alive_us = None;
        }
        let open = outputs.gates;
        prop_assert!(open == 0 || self.bench.interlock_closed, "open while the interlock is open");
        for gate in 0..8 {
            let opened = if open >> gate & 1 == 0 { None } else { self.opened_us[gate].or(Some(now)) };
            let too_long = opened.is_some_and(|opened| now - opened >= self.limits_us[gate]);
            prop_assert!(!too_long, "gate {} open for longer than {} µs", gate, self.limits_us[gate]);
            let was_due = self.opened_us[gate].is_some_and(|opened| now - opened >= self.limits_us[gate]);
            if was_due {
                self.alive_us = None;
            }
            self.opened_us[gate] = opened;
        }
        // Orders in force are noted after their answer, so an order that opens comes after one that armed.
        prop_assert!(open == 0 || self.alive_us.is_some(), "open without anybody who holds it");
        prop_assert!(outputs.levels == [0; 4] || self.alive_us.is_some() || !outputs.bytes().is_empty());
        Ok(outputs.bytes().to_vec())
    }

    fn say(&mut self, bytes: &[u8]) -> Result<Vec<u8>, TestCaseError> {
        let mut answer = Vec::new();
        for byte in bytes {
            answer.extend(self.turn(Some(*byte))?);
        }
        Ok(answer)
    }

    fn order(&mut self, order: u8, payload: &[u8]) -> Result<Option<Answer>, TestCaseError> {
        self.bench.number = self.bench.number.wrapping_add(1);
        let line = frame(self.bench.number, order, self.bench.epoch, payload);
        self.sent.push(line.clone());
        let answer = Answer::read(&self.say(&line)?);
        let done = answer.as_ref().is_some_and(|answer| answer.status == status::OK);
        match order {
            command::ARM | command::HEARTBEAT if done => self.alive_us = Some(self.bench.now_us),
            command::DISARM => self.alive_us = None,
            command::LIMIT if done => {
                let us = u32::from_be_bytes([payload[1], payload[2], payload[3], payload[4]]);
                self.limits_us[usize::from(payload[0])] = u64::from(us);
            }
            _ => {}
        }
        Ok(answer)
    }

    fn pass(&mut self, us: u64) -> Result<(), TestCaseError> {
        let until = self.bench.now_us + us;
        while self.bench.now_us < until {
            self.turn(None)?;
            let idle = u64::from(self.bench.core.idle_us()).max(1);
            self.bench.now_us = until.min(self.bench.now_us + idle);
        }
        self.turn(None).map(drop)
    }

    fn arm(&mut self) -> Result<(), TestCaseError> {
        let config = self.order(command::STATE, &[])?.map_or(0, |answer| answer.config);
        self.order(command::ARM, &config.to_be_bytes()).map(drop)
    }

    fn happen(&mut self, event: &Event) -> Result<(), TestCaseError> {
        match event {
            Event::Arm => return self.arm(),
            Event::Order(order, payload) => return self.order(*order, payload).map(drop),
            Event::Sequence { patterns, step } => {
                self.order(command::LOAD, &[&[0, 0], patterns.as_slice()].concat())?;
                let [length, check] = [patterns.len() as u16, crc(patterns)].map(u16::to_be_bytes);
                self.order(command::BEGIN, &[length[0], length[1], check[0], check[1], *step])?;
            }
            Event::Train { period, number, delay, open } => {
                let numbers = [*period, *number, 40, *delay, *open];
                let payload: Vec<u8> = numbers.iter().flat_map(|number| number.to_be_bytes()).collect();
                self.order(command::TRAIN, &payload)?;
            }
            Event::CloseNow => drop(self.say(b"!")?),
            Event::Interlock(closed) => self.bench.interlock_closed = *closed,
            Event::Exposing(exposing) => self.bench.exposing = *exposing,
            Event::Pass(us) => return self.pass(*us),
            Event::Reset => {
                self.alive_us = None;
                self.opened_us = [None; 8];
                self.limits_us = [1_000_000; 8];
                self.bench.reset();
            }
            Event::Greet => self.bench.greet(),
            Event::Garbage(bytes) => drop(self.say(bytes)?),
            Event::Half => {
                let line = frame(self.bench.number.wrapping_add(1), command::GATES, self.bench.epoch, &[255]);
                self.say(&line[..line.len() / 2])?;
            }
            Event::Replay(at) => {
                let Some(line) = self.sent.get(at % self.sent.len().max(1)).cloned() else { return Ok(()) };
                self.say(&line)?;
                // Disarming is obeyed however stale it is.
                if line[5..7] == *b"03" {
                    self.alive_us = None;
                }
            }
        }
        self.turn(None).map(drop)
    }
}

#[test]
fn no_order_and_no_accident_opens_a_gate_that_nobody_holds() {
    let config = ProptestConfig { cases: SEQUENCES, failure_persistence: None, ..ProptestConfig::default() };
    let open_seen = std::cell::Cell::new(0_u64);
    proptest!(config, |(events in prop::collection::vec(events(), 1..24))| {
        let mut judge = Judge::new();
        for event in &events {
            judge.happen(event)?;
            open_seen.set(open_seen.get() + u64::from(judge.bench.outputs.gates != 0));
        }
    });
    assert!(open_seen.get() > 10_000, "only {} events ended with an open gate", open_seen.get());
}
