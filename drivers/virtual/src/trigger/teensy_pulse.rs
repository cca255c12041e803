//! The TeensyPulseGenerator of Micro-Manager, firmware version 1.
//!
//! Commands, defaults and quirks as its source has them
//! (<https://github.com/micro-manager/mmCoreAndDevices/tree/main/DeviceAdapters/TeensyPulseGenerator>).

use std::time::Duration;

use sofiscope_serial_line::LineModel;

use super::pins::{Bench, Pins};

const VERSION: u32 = 1;
const ENQUIRY: u8 = 0xFF;

/// The virtual pulse generator.
#[derive(Debug)]
#[expect(clippy::struct_excessive_bools, reason = "the variables of the firmware, one by one")]
pub struct VirtualTeensyPulse {
    pins: Pins,
    pending: Vec<u8>,
    sent: Vec<u8>,
    interval_us: u32,
    width_us: u32,
    waits_for_input: bool,
    number: u32,
    running: bool,
    /// "Ready" of the firmware: true after power-up, so that one edge of the input makes a stray pulse.
    ready: bool,
    busy: bool,
    next: Duration,
    pulses: u32,
    num_bytes: u64,
}

impl VirtualTeensyPulse {
    /// A generator that has booted.
    #[must_use]
    pub fn new(bench: Bench) -> Self {
        Self {
            pins: Pins::low(bench, 0),
            pending: Vec::new(),
            sent: Vec::new(),
            interval_us: 100_000,
            width_us: 1000,
            waits_for_input: false,
            number: 0,
            running: false,
            ready: true,
            busy: false,
            next: Duration::ZERO,
            pulses: 0,
            num_bytes: 0,
        }
    }

    /// Whether a train runs.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.running
    }

    /// Interval and width that are set, microseconds, and the number of pulses.
    #[must_use]
    pub fn settings(&self) -> (u32, u32, u32) {
        (self.interval_us, self.width_us, self.number)
    }

    /// Pulses of the train so far.
    #[must_use]
    pub fn pulses(&self) -> u32 {
        self.pulses
    }

    /// Bytes that have reached the generator.
    #[must_use]
    pub fn num_bytes(&self) -> u64 {
        self.num_bytes
    }

    /// The level of the input: busy is high.
    pub fn set_busy(&mut self, busy: bool, now: Duration) {
        self.run_until(now);
        let falls = self.busy && !busy;
        self.busy = busy;
        if falls && self.waits_for_input && self.ready {
            self.ready = false;
            self.pulse(now);
            if self.running {
                self.next = now + self.interval();
            }
        }
    }

    fn interval(&self) -> Duration {
        Duration::from_micros(u64::from(self.interval_us.max(1)))
    }

    fn pulse(&mut self, now: Duration) {
        self.pins.pulse(now);
        self.pulses = self.pulses.wrapping_add(1);
        // A finite train ends without a word.
        if self.running && self.number != 0 && self.pulses >= self.number {
            self.running = false;
        }
    }

    /// A tick of the interval timer: a pulse, or one that waits until the input is ready.
    fn tick(&mut self, now: Duration) {
        if self.waits_for_input && self.busy {
            self.ready = true;
        } else {
            self.pulse(now);
        }
    }

    fn run_until(&mut self, now: Duration) {
        while self.running && self.next <= now {
            let due = self.next;
            self.next = due + self.interval();
            self.tick(due);
        }
    }

    fn answer(&mut self, command: u8, value: u32) {
        self.sent.push(command);
        self.sent.extend(value.to_le_bytes());
    }

    fn set(&mut self, command: u8, value: u32, now: Duration) {
        let answer = match command {
            0 => VERSION,
            1 => {
                self.running = true;
                self.ready = false;
                self.pulses = 0;
                self.next = now + self.interval();
                self.tick(now);
                1
            }
            2 => {
                self.running = false;
                self.ready = false;
                self.pulses
            }
            3 => {
                self.interval_us = value;
                // The timer begins anew, so the train jumps.
                self.next = now + self.interval();
                value
            }
            4 => {
                self.width_us = value;
                value
            }
            5 => {
                self.waits_for_input = value != 0;
                u32::from(self.waits_for_input)
            }
            6 => {
                self.number = value;
                value
            }
            _ => return,
        };
        self.answer(command, answer);
    }

    fn tell(&mut self, command: u8) {
        let value = match command {
            0 => VERSION,
            1 => u32::from(self.running),
            2 => u32::from(!self.running),
            3 => self.interval_us,
            4 => self.width_us,
            5 => u32::from(self.waits_for_input),
            6 => self.number,
            _ => return,
        };
        self.answer(command, value);
    }
}

impl LineModel for VirtualTeensyPulse {
    fn receive(&mut self, bytes: &[u8], now: Duration) {
        self.run_until(now);
        self.num_bytes += bytes.len() as u64;
        for byte in bytes {
            self.pending.push(*byte);
            match *self.pending.as_slice() {
                [ENQUIRY, command] => {
                    self.pending.clear();
                    self.tell(command);
                }
                [command, a, b, c, d] => {
                    self.pending.clear();
                    self.set(command, u32::from_le_bytes([a, b, c, d]), now);
                }
                _ => {}
            }
        }
    }

    fn advance(&mut self, now: Duration, out: &mut Vec<u8>) -> Option<Duration> {
        self.run_until(now);
        out.append(&mut self.sent);
        self.running.then_some(self.next)
    }
}
