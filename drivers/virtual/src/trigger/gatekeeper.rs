//! The gatekeeper as a virtual board: the firmware is the real one, only its pins lead to the optical table.

use std::time::Duration;

use sofiscope_gatekeeper_core::{Board, Core, Inputs, Outputs};
use sofiscope_serial_line::LineModel;

use super::pins::{Bench, ExposureLine, Pins};
use crate::table::Quantity;

/// How often the inputs are looked at while gates may be open, and otherwise.
const LOOP_ARMED: Duration = Duration::from_millis(1);
const LOOP_IDLE: Duration = Duration::from_millis(20);

/// What kind of board stands there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoardSetup {
    /// Number of its own.
    pub serial: u32,
    /// Gates, at most 8.
    pub gates: u8,
    /// Analog outputs, at most 4.
    pub levels: u8,
    /// How long it is silent after a reset: the boot loader of an Uno, nothing on a Teensy.
    pub boot: Duration,
    /// Whether opening the port resets it.
    pub resets_on_open: bool,
}

impl BoardSetup {
    /// An Arduino Uno.
    #[must_use]
    pub fn uno(serial: u32) -> Self {
        Self { serial, gates: 6, levels: 2, boot: Duration::from_millis(1600), resets_on_open: true }
    }

    /// A Teensy 4.
    #[must_use]
    pub fn teensy(serial: u32) -> Self {
        Self { serial, gates: 8, levels: 4, boot: Duration::ZERO, resets_on_open: false }
    }
}

/// The virtual board.
#[derive(Debug)]
pub struct VirtualGatekeeper {
    setup: BoardSetup,
    core: Core,
    epoch: u16,
    pins: Pins,
    pulse: bool,
    /// Time of the last turn of its main loop.
    at: Duration,
    /// Until when its boot loader runs.
    dead_until: Duration,
    sent: Vec<u8>,
    num_bytes: u64,
    /// Presses of its reset button that it has felt.
    resets: f64,
    /// The camera's exposure output.
    pub exposure: ExposureLine,
    /// What the board sends while it boots.
    pub boot_noise: Vec<u8>,
}

impl VirtualGatekeeper {
    /// A board that was switched on at time zero of the model and has booted.
    #[must_use]
    pub fn new(setup: BoardSetup, bench: Bench) -> Self {
        let board = Board::simulated(setup.serial, 1, setup.gates, setup.levels);
        let resets = bench.table.get(Quantity::ControllerResets);
        Self {
            setup,
            core: Core::power_up(&board, 0),
            epoch: 1,
            pins: Pins::low(bench, usize::from(setup.levels)),
            pulse: false,
            at: Duration::ZERO,
            dead_until: Duration::ZERO,
            sent: Vec::new(),
            num_bytes: 0,
            resets,
            exposure: ExposureLine::default(),
            boot_noise: Vec::new(),
        }
    }

    /// A reset, by a brown-out or a line of the port: outputs low, then silence until it has booted.
    pub fn reset(&mut self, now: Duration) {
        self.run_until(now);
        self.epoch = self.epoch.checked_add(1).unwrap_or(1);
        let board = Board::simulated(self.setup.serial, self.epoch, self.setup.gates, self.setup.levels);
        self.core = Core::power_up(&board, clock(now));
        self.dead_until = now + self.setup.boot;
        self.sent.clear();
        self.sent.extend_from_slice(&self.boot_noise);
        self.turn(now, None);
    }

    /// Resets when somebody has pressed the button on the table.
    fn feel_button(&mut self, now: Duration) {
        let resets = self.pins.bench.table.get(Quantity::ControllerResets);
        if resets != self.resets {
            self.resets = resets;
            self.reset(now);
        }
    }

    /// What happens to the board when somebody opens its port.
    pub fn open_again(&mut self, now: Duration) {
        if self.setup.resets_on_open {
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

    fn turn(&mut self, now: Duration, byte: Option<u8>) {
        self.at = now;
        let table = &self.pins.bench.table;
        let inputs = Inputs {
            now_us: clock(now),
            byte,
            interlock_closed: table.get(Quantity::InterlockOpen) == 0.0,
            exposing: self.exposure.level(table, self.pins.monotonic(now)),
        };
        let outputs = self.core.step(&inputs);
        self.show(&outputs, now);
    }

    fn show(&mut self, outputs: &Outputs, now: Duration) {
        self.pins.drive(outputs.gates, now);
        for (output, level) in outputs.levels.iter().enumerate() {
            self.pins.set_level(output, *level);
        }
        if outputs.pulse() && !self.pulse {
            self.pins.pulse(now);
        }
        self.pulse = outputs.pulse();
        self.sent.extend_from_slice(outputs.bytes());
    }

    /// When something can happen by itself.
    fn due(&self) -> Duration {
        let by_itself = self.at + Duration::from_micros(u64::from(self.core.idle_us()).max(1));
        let edge = self.exposure.next_edge(&self.pins.bench.table, self.pins.monotonic(self.at));
        edge.map_or(by_itself, |edge| by_itself.min(edge.saturating_sub(self.pins.bench.base)))
    }

    fn run_until(&mut self, now: Duration) {
        loop {
            let due = self.due().max(self.at + Duration::from_nanos(1));
            if due >= now {
                break;
            }
            self.turn(due, None);
        }
        self.turn(now.max(self.at), None);
    }
}

/// The board's clock, which begins again after 71 minutes.
fn clock(now: Duration) -> u32 {
    (now.as_micros() & u128::from(u32::MAX)) as u32
}

impl LineModel for VirtualGatekeeper {
    fn receive(&mut self, bytes: &[u8], now: Duration) {
        self.feel_button(now);
        self.run_until(now);
        self.num_bytes += bytes.len() as u64;
        if now < self.dead_until {
            return;
        }
        for byte in bytes {
            self.turn(now, Some(*byte));
        }
    }

    fn advance(&mut self, now: Duration, out: &mut Vec<u8>) -> Option<Duration> {
        self.feel_button(now);
        self.run_until(now);
        out.append(&mut self.sent);
        let inputs_at = now + if self.pins.gates() == 0 { LOOP_IDLE } else { LOOP_ARMED };
        Some(self.due().max(now + Duration::from_micros(1)).min(inputs_at))
    }
}
