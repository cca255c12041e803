//! A stage that is not there: a TANGO controller with a SCANplus stage, as a pure state machine.
//!
//! In: bytes, time. Out: bytes, and the place of the sample on the optical table.
//! Never: reads a clock; pretends to be real: its version text says SIMULATED.
//! Fails: as its [`StageFaults`] say.
//!
//! It is unkind where the manual leaves room: it powers up with autostatus on and in millimeters with
//! revolutions per second, reading an error does not clear it, the letter after an abort is `E` until the next move,
//! and an abort leaves a half-received command where it is.

mod axis;
mod command;
mod faults;

use std::collections::VecDeque;
use std::time::Duration;

use sofiscope_serial_line::LineModel;

use crate::OpticalTable;
use crate::table::Quantity;
use axis::{Axis, TRAVELS_UM};

pub use faults::{Jam, StageFaults};

/// What the controller thinks about each command.
const LATENCY: Duration = Duration::from_millis(2);
/// How often the table hears of a motion.
const TABLE_EVERY: Duration = Duration::from_millis(10);
/// Where the stage stands at power-up, micrometers from its lower end switches.
const POWER_UP_UM: [f64; 2] = [41_234.5, 29_876.5];
/// Commands that are remembered.
const REMEMBERED: usize = 20_000;
/// Error 3 beyond this many bytes; the real number is not published.
const LONGEST_COMMAND: usize = 256;
/// Ctrl-C, the abort of one byte.
const ABORT: u8 = 0x03;

/// A TANGO controller with its stage.
pub struct TangoModel {
    serial: String,
    table: OpticalTable,
    axes: [Axis; 2],
    dims: [usize; 2],
    error: u16,
    autostatus: u8,
    joystick: u8,
    is_powered: bool,
    was_moving: bool,
    partial: Vec<u8>,
    answers: VecDeque<(Duration, Vec<u8>)>,
    received: VecDeque<(Duration, Vec<u8>)>,
    num_motions: usize,
    faults: StageFaults,
}

impl TangoModel {
    /// A controller that was just switched on.
    pub fn new(serial: impl Into<String>, table: OpticalTable) -> Self {
        Self {
            serial: serial.into(),
            table,
            axes: [0, 1].map(|axis| Axis::new(TRAVELS_UM[axis], POWER_UP_UM[axis])),
            dims: [2, 2],
            error: 0,
            autostatus: 1,
            joystick: 0,
            is_powered: true,
            was_moving: false,
            partial: Vec::new(),
            answers: VecDeque::new(),
            received: VecDeque::new(),
            num_motions: 0,
            faults: StageFaults::default(),
        }
    }

    /// What goes wrong from now on.
    pub fn faults(&mut self) -> &mut StageFaults {
        &mut self.faults
    }

    /// Commands as they came, each with its time, since they were last taken; the newest 20 000.
    /// An abort of one byte is a command of its own.
    pub fn take_received(&mut self) -> Vec<(Duration, Vec<u8>)> {
        self.received.drain(..).collect()
    }

    /// Commands to move, jog or home that have come since power-up.
    #[must_use]
    pub fn num_motions(&self) -> usize {
        self.num_motions
    }

    /// Micrometers from the lower end switches, where the stage really is.
    #[must_use]
    pub fn place_um(&self, now: Duration) -> [f64; 2] {
        [0, 1].map(|axis: usize| self.axes[axis].place(now.as_secs_f64()))
    }

    /// A person moves the stage by the joystick; nothing happens while that is off.
    pub fn push(&mut self, way_um: [f64; 2]) {
        if self.joystick > 0 {
            for (axis, way) in self.axes.iter_mut().zip(way_um) {
                axis.push(way);
            }
        }
    }

    /// Somebody else sets the units.
    pub fn set_dims(&mut self, dims: [usize; 2]) {
        self.dims = dims;
    }

    /// Somebody switches it off and on; the stage stays where it is.
    pub fn switch_off_and_on(&mut self, now: Duration) {
        let place = self.place_um(now);
        let mut fresh = Self::new(self.serial.clone(), self.table.clone());
        fresh.axes = [0, 1].map(|axis| Axis::new(TRAVELS_UM[axis], place[axis]));
        *self = fresh;
    }

    fn stop(&mut self, now: Duration) {
        for axis in &mut self.axes {
            axis.stop(now.as_secs_f64());
        }
    }

    /// The five characters of `statusaxis`.
    fn status_axis(&self) -> String {
        let letters = self.axes.each_ref().map(|axis| self.letter(axis));
        format!("{}{}--.", letters[0], letters[1])
    }

    fn letter(&self, axis: &Axis) -> char {
        if self.joystick > 0 && matches!(axis.letter, '@' | 'A' | 'D') { 'J' } else { axis.letter }
    }

    fn answer(&mut self, now: Duration, text: &str) {
        let StageFaults { silent, spared, .. } = &mut self.faults;
        if *silent > 0 && *spared == 0 {
            *silent -= usize::from(*silent < usize::MAX);
            return;
        }
        *spared = spared.saturating_sub(1);
        if self.faults.talks_between {
            let line = self.status_axis();
            self.say(now, &line);
        }
        self.say(now, text);
    }

    fn say(&mut self, now: Duration, text: &str) {
        let late = self.faults.late.take().unwrap_or_default();
        let earliest = self.answers.back().map_or(Duration::ZERO, |(due, _)| *due);
        self.answers.push_back(((now + LATENCY + late).max(earliest), format!("{text}\r").into_bytes()));
    }

    fn settle(&mut self, now: Duration) {
        for axis in &mut self.axes {
            if axis.settle(now.as_secs_f64()) {
                self.error = 12;
            }
        }
        let is_moving = self.axes.iter().any(Axis::is_moving);
        if self.was_moving && !is_moving && self.autostatus > 0 {
            let line = self.status_axis();
            self.say(now, &line);
        }
        self.was_moving = is_moving;
        let place = self.place_um(now);
        self.table.set(Quantity::StageX, place[0]);
        self.table.set(Quantity::StageY, place[1]);
        self.table.set(Quantity::StageMoving, f64::from(u8::from(is_moving)));
    }

    fn remember(&mut self, now: Duration, command: &[u8]) {
        if self.received.len() == REMEMBERED {
            self.received.pop_front();
        }
        self.received.push_back((now, command.to_vec()));
    }
}

impl LineModel for TangoModel {
    fn receive(&mut self, bytes: &[u8], now: Duration) {
        self.settle(now);
        for &byte in bytes {
            match byte {
                ABORT => {
                    self.remember(now, &[ABORT]);
                    self.stop(now);
                }
                b'\r' => {
                    let line = std::mem::take(&mut self.partial);
                    self.remember(now, &line);
                    self.execute(&line, now);
                }
                _ if self.partial.len() <= LONGEST_COMMAND => self.partial.push(byte),
                _ => {}
            }
            self.settle(now);
        }
    }

    fn advance(&mut self, now: Duration, out: &mut Vec<u8>) -> Option<Duration> {
        self.settle(now);
        while let Some((_, line)) = self.answers.pop_front_if(|(due, _)| *due <= now) {
            out.extend(line);
        }
        let answer = self.answers.front().map(|(due, _)| *due);
        let end = self.axes.iter().filter_map(Axis::end).reduce(f64::min);
        // One microsecond more, so that the end is over when it is asked again.
        let motion = end.map(|end| {
            let end = Duration::from_secs_f64(end.max(0.0)) + Duration::from_micros(1);
            end.min(now + TABLE_EVERY)
        });
        [answer, motion].into_iter().flatten().min()
    }
}

#[cfg(test)]
mod tests;
