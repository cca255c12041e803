//! A board with the Arduino firmware of Micro-Manager, protocol version 5.
//!
//! Commands, semantics and defects as the firmware has them
//! (<https://github.com/micro-manager/mmCoreAndDevices/tree/main/DeviceAdapters/Arduino>). Timed patterns (10 to 12)
//! are left out: the firmware is deaf while it shows them, so no driver here asks for them, and the virtual board
//! treats these bytes as it treats every unknown one.

use std::collections::VecDeque;
use std::time::Duration;

use sofiscope_serial_line::LineModel;

use super::pins::{Bench, ExposureLine, Pins};

/// How long the firmware waits for a byte that belongs to a command.
const PARAMETER_WAIT: Duration = Duration::from_secs(1);
/// Boot loader of an Uno after its port was opened.
const BOOT: Duration = Duration::from_secs(2);
/// How often the inputs are looked at while they matter.
const LOOP: Duration = Duration::from_millis(1);

/// Which board runs the firmware.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ArduinoKind {
    /// Arduino Uno: 6 gates, 2 levels, 256 patterns, reset by opening its port.
    Uno,
    /// Teensy 4.0 and 4.1: 8 gates, 8 levels, 40000 patterns.
    Teensy4,
}

impl ArduinoKind {
    fn gates(self) -> u8 {
        if self == Self::Uno { 6 } else { 8 }
    }

    fn levels(self) -> u8 {
        if self == Self::Uno { 2 } else { 8 }
    }

    fn capacity(self) -> u16 {
        if self == Self::Uno { 256 } else { 40_000 }
    }

    fn identity(self) -> &'static [u8] {
        if self == Self::Uno { b"MM-Ard\r\n" } else { b"MM-Ard-1\r\n" }
    }
}

/// Known defects of the firmware; the real one has all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ArduinoDefects {
    /// A refused upload is executed byte by byte.
    pub executes_refused_uploads: bool,
    /// Skipped triggers are not skipped, and the count is that much too low (Teensy).
    pub counts_skipped: bool,
    /// Triggers go unnoticed while the firmware waits for a byte.
    pub deaf_while_waiting: bool,
}

impl Default for ArduinoDefects {
    fn default() -> Self {
        Self { executes_refused_uploads: true, counts_skipped: true, deaf_while_waiting: true }
    }
}

/// The virtual board.
#[derive(Debug)]
#[expect(clippy::struct_excessive_bools, reason = "the variables of the firmware, one by one")]
pub struct VirtualArduino {
    kind: ArduinoKind,
    defects: ArduinoDefects,
    pins: Pins,
    pending: VecDeque<u8>,
    last_byte: Duration,
    sent: Vec<u8>,
    at: Duration,
    dead_until: Duration,
    stored: u8,
    patterns: Vec<u8>,
    num_patterns: u16,
    trigger_mode: bool,
    triggers: i64,
    skip: u8,
    blanking: bool,
    blank_while_low: bool,
    input: bool,
    num_bytes: u64,
    /// The camera's exposure output, at the trigger input.
    pub exposure: ExposureLine,
    /// What the board sends while it boots.
    pub boot_noise: Vec<u8>,
}

impl VirtualArduino {
    /// A board that has booted long ago.
    #[must_use]
    pub fn new(kind: ArduinoKind, defects: ArduinoDefects, bench: Bench) -> Self {
        Self {
            kind,
            defects,
            pins: Pins::low(bench, usize::from(kind.levels())),
            pending: VecDeque::new(),
            last_byte: Duration::ZERO,
            sent: Vec::new(),
            at: Duration::ZERO,
            dead_until: Duration::ZERO,
            stored: 0,
            patterns: vec![0; usize::from(kind.capacity())],
            num_patterns: 0,
            trigger_mode: false,
            triggers: 0,
            skip: 0,
            blanking: false,
            blank_while_low: true,
            input: false,
            num_bytes: 0,
            exposure: ExposureLine::default(),
            boot_noise: Vec::new(),
        }
    }

    /// A reset, by a brown-out or a line of the port: outputs low, all settings gone, then silence.
    pub fn reset(&mut self, now: Duration) {
        self.run_until(now);
        self.pins.drive(0, now);
        for level in 0..usize::from(self.kind.levels()) {
            self.pins.set_level(level, 0);
        }
        self.pending.clear();
        self.sent.clone_from(&self.boot_noise);
        self.dead_until = now + BOOT;
        (self.stored, self.num_patterns, self.skip) = (0, 0, 0);
        (self.trigger_mode, self.blanking, self.blank_while_low) = (false, false, true);
        self.patterns.fill(0);
    }

    /// What happens to the board when somebody opens its port.
    pub fn open_again(&mut self, now: Duration) {
        if self.kind == ArduinoKind::Uno {
            self.reset(now);
        }
    }

    /// Gates that are high.
    #[must_use]
    pub fn gates(&self) -> u8 {
        self.pins.gates()
    }

    /// Bytes that have reached the board.
    #[must_use]
    pub fn num_bytes(&self) -> u64 {
        self.num_bytes
    }

    fn drive(&mut self, pattern: u8) {
        let mask = if self.kind == ArduinoKind::Uno { 0x3F } else { 0xFF };
        self.pins.drive(pattern & mask, self.at);
    }

    /// One turn of the main loop: commands first, then the input.
    fn turn(&mut self, now: Duration) {
        self.at = now;
        while let Some(used) = self.command() {
            self.pending.drain(..used.min(self.pending.len()));
        }
        if !self.pending.is_empty() && now >= self.last_byte + PARAMETER_WAIT {
            self.pending.clear();
        }
        if self.pending.is_empty() || !self.defects.deaf_while_waiting {
            self.follow_input();
        }
    }

    fn follow_input(&mut self) {
        let level = self.exposure.level(&self.pins.bench.table, self.pins.monotonic(self.at));
        let (changed, shows) = (level != self.input, level == self.blank_while_low);
        self.input = level;
        if self.trigger_mode {
            if changed && shows {
                if self.triggers >= 0 && self.num_patterns > 0 {
                    let index = (self.triggers % i64::from(self.num_patterns)) as usize;
                    self.drive(self.patterns[index]);
                }
                self.triggers += 1;
            } else if changed {
                self.drive(0);
            }
        } else if self.blanking {
            self.drive(if shows { self.stored } else { 0 });
        }
    }

    /// Does the command at the front, if all its bytes are there, and tells how many they were.
    fn command(&mut self) -> Option<usize> {
        let bytes: Vec<u8> = self.pending.iter().take(5).copied().collect();
        match *bytes.as_slice() {
            [1, pattern, ..] => {
                self.stored = pattern;
                if !self.blanking {
                    self.drive(pattern);
                }
                self.say(&[1], 2)
            }
            [2, ..] => self.say(&[2, self.pins.gates()], 1),
            [3, output, high, low, ..] => {
                let high = high & 0x0F;
                self.pins.set_level(usize::from(output), u16::from_be_bytes([high, low]));
                self.say(&[3, output, high, low], 4)
            }
            [5, at, pattern, ..] => {
                self.patterns[usize::from(at)] = pattern;
                self.say(&[5, at, pattern], 3)
            }
            [6, number, ..] => {
                self.num_patterns = u16::from(number);
                self.say(&[6, number], 2)
            }
            [7, skip, ..] => {
                self.skip = skip;
                self.say(&[7, skip], 2)
            }
            [8, ..] if self.num_patterns > 0 => {
                self.trigger_mode = true;
                self.triggers = if self.defects.counts_skipped { 0 } else { -i64::from(self.skip) };
                self.drive(0);
                self.say(&[8], 1)
            }
            [9, ..] => {
                self.trigger_mode = false;
                self.drive(0);
                let skipped = if self.defects.counts_skipped { i64::from(self.skip) } else { 0 };
                let count = (self.triggers - skipped).rem_euclid(256) as u8;
                self.say(&[9, count], 1)
            }
            [20, ..] => {
                self.blanking = true;
                self.say(&[20], 1)
            }
            [21, ..] => {
                self.blanking = false;
                self.drive(self.stored);
                self.say(&[21], 1)
            }
            [22, level, ..] => {
                self.blank_while_low = level != 0;
                self.say(&[22], 2)
            }
            [30, ..] => self.say(self.kind.identity(), 1),
            [31, ..] => self.say(b"5\r\n", 1),
            [32, ..] => {
                let [high, low] = self.kind.capacity().to_be_bytes();
                self.say(&[32, high, low], 1)
            }
            [33, high, low, ..] => self.upload(u16::from_be_bytes([high, low])),
            [34, ..] => self.say(&[34, self.kind.levels()], 1),
            [35, ..] => self.say(&[35, self.kind.gates()], 1),
            [1 | 3 | 5 | 6 | 7 | 22 | 33, ..] | [] => None,
            // Unknown bytes are ignored without a word.
            _ => Some(1),
        }
    }

    fn say(&mut self, answer: &[u8], used: usize) -> Option<usize> {
        self.sent.extend_from_slice(answer);
        Some(used)
    }

    fn upload(&mut self, length: u16) -> Option<usize> {
        let num_bytes = usize::from(length);
        if length >= self.kind.capacity() {
            let used = if self.defects.executes_refused_uploads { 3 } else { 3 + num_bytes };
            return (self.pending.len() >= used).then(|| self.say(&[33, 0, 0], used)).flatten();
        }
        if self.pending.len() < 3 + num_bytes {
            return None;
        }
        for (place, pattern) in self.patterns.iter_mut().zip(self.pending.iter().skip(3).take(num_bytes)) {
            *place = *pattern;
        }
        self.num_patterns = length;
        let [high, low] = length.to_be_bytes();
        self.say(&[33, high, low], 3 + num_bytes)
    }

    fn run_until(&mut self, now: Duration) {
        let base = self.pins.bench.base;
        while let Some(edge) = self.exposure.next_edge(&self.pins.bench.table, base + self.at) {
            let edge = edge.saturating_sub(base);
            if edge >= now || edge <= self.at {
                break;
            }
            self.turn(edge);
        }
        self.turn(now.max(self.at));
    }
}

impl LineModel for VirtualArduino {
    fn receive(&mut self, bytes: &[u8], now: Duration) {
        self.run_until(now);
        self.num_bytes += bytes.len() as u64;
        if now < self.dead_until {
            return;
        }
        self.pending.extend(bytes);
        self.last_byte = now;
        self.turn(now);
    }

    fn advance(&mut self, now: Duration, out: &mut Vec<u8>) -> Option<Duration> {
        self.run_until(now);
        out.append(&mut self.sent);
        let watches = self.trigger_mode || self.blanking;
        let deadline = (!self.pending.is_empty()).then_some(self.last_byte + PARAMETER_WAIT);
        let edge = self.exposure.next_edge(&self.pins.bench.table, self.pins.monotonic(now));
        let edge = edge.map(|edge| edge.saturating_sub(self.pins.bench.base));
        [watches.then_some(now + LOOP), deadline, edge.filter(|_| watches)].into_iter().flatten().min()
    }
}
