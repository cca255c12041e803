//! A virtual Laser Quantum gem on an SMD12 supply: ASCII lines at 9600 8N1, power that rises slowly.
//!
//! In: commands ended by CR or CR LF, interlock of the table. Out: a text or an empty line, ended by CR LF; light.
//! Never: emits before `ON`, or with an open interlock. Fails: as [`Faults`] says.
//!
//! Dialect: adapters of Micro-Manager (LaserQuantumLaser) and qudi (laserquantum), iSIM notes of EPFL.

use std::collections::VecDeque;
use std::time::Duration;

use sofiscope_serial_line::LineModel;

use super::LOOKS_EVERY;
use super::head::{Head, Place};
use super::noise::Noise;

/// Time constant of the power, seconds.
const RISE_S: f64 = 3.0;
/// Below this it is dark, milliwatts: what a first-order decay never reaches by itself.
const DARK_MW: f64 = 1e-3;

/// What it does wrong; nothing by default.
#[expect(clippy::struct_excessive_bools, reason = "any of them can go wrong together")]
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Faults {
    /// It takes commands and says nothing.
    pub silent: bool,
    /// Sets are answered with this error number, and change nothing; `OFF` is always obeyed.
    pub refuses_with: Option<u32>,
    /// `TIMERS?` comes without its empty line at the end.
    pub timers_without_end: bool,
    /// Every answer begins with ETX.
    pub etx: bool,
    /// Every answer begins with a blank.
    pub blank: bool,
    /// `ON` is answered, and it stays disabled: its own interlock or key.
    pub key_off: bool,
    /// It says `ENABLED` and no light comes.
    pub dead_diode: bool,
    /// `OFF` is answered, and it goes on emitting.
    pub stuck_on: bool,
    /// Part by which the power is off, in light and in its own reading.
    pub power_error: f64,
    /// Delay of every answer, beside its own.
    pub delay: Duration,
}

/// The laser.
pub struct Smd12 {
    head: Head,
    max_mw: f64,
    current_control: CurrentControl,
    noise: Noise,
    /// What it does wrong.
    pub faults: Faults,
    on: bool,
    enabled_at_start: bool,
    by_current: bool,
    current_percent: f64,
    power_set_mw: f64,
    power_mw: f64,
    seconds_on: f64,
    seen: Duration,
    input: Vec<u8>,
    output: VecDeque<(Duration, Vec<u8>)>,
    num_received: u64,
}

impl Smd12 {
    /// A laser of this full power, dark, with the option of current control or without.
    #[must_use]
    pub fn new(place: Place, max_mw: f64, current_control: CurrentControl) -> Self {
        Self {
            head: Head::new(place),
            max_mw,
            current_control,
            noise: Noise::new(561),
            faults: Faults::default(),
            on: false,
            enabled_at_start: true,
            by_current: false,
            current_percent: 45.0,
            power_set_mw: 0.0,
            power_mw: 0.0,
            seconds_on: 0.0,
            seen: Duration::ZERO,
            input: Vec::new(),
            output: VecDeque::new(),
            num_received: 0,
        }
    }

    /// Bytes that have come since power-up.
    #[must_use]
    pub fn num_received(&self) -> u64 {
        self.num_received
    }

    /// Whether it would emit by itself at its next power-up.
    #[must_use]
    pub fn enabled_at_start(&self) -> bool {
        self.enabled_at_start
    }

    /// Lets it emit as another program may have left it.
    pub fn left_on(&mut self, power_mw: f64, now: Duration) {
        (self.on, self.power_set_mw, self.power_mw) = (true, power_mw, power_mw);
        self.let_pass(now);
    }

    /// Power follows the set value with one time constant; switched off it is gone at once.
    fn let_pass(&mut self, now: Duration) {
        let passed_s = now.saturating_sub(self.seen).as_secs_f64();
        self.seen = self.seen.max(now);
        self.on &= !self.head.interlock_open() && !self.faults.key_off;
        if self.on && !self.faults.dead_diode {
            self.seconds_on += passed_s;
            let target_mw = self.power_set_mw * (1.0 + self.faults.power_error);
            self.power_mw = target_mw + (self.power_mw - target_mw) * (-passed_s / RISE_S).exp();
            if self.power_mw < DARK_MW && target_mw < DARK_MW {
                self.power_mw = 0.0;
            }
        } else {
            self.power_mw = 0.0;
        }
        self.head.emit(self.power_mw, now);
    }

    fn answer(&mut self, command: &str) -> String {
        let (word, value) =
            command.split_once('=').map_or((command, None), |(word, value)| (word, Some(value)));
        match value {
            Some(value) => self.set(word, value),
            None => self.query(word),
        }
    }

    fn query(&mut self, word: &str) -> String {
        let warming = (self.seconds_on / 60.0).min(1.0);
        match word {
            "VERSION?" | "SOFTVER?" => "SMD12 virtual 1.0".to_owned(),
            "STATUS?" => if self.on { "ENABLED" } else { "DISABLED" }.to_owned(),
            "ON" if self.faults.refuses_with.is_some() => self.refusal(0),
            "ON" => {
                self.on = !self.head.interlock_open() && !self.faults.key_off;
                String::new()
            }
            "OFF" => {
                self.on &= self.faults.stuck_on;
                String::new()
            }
            "POWER?" => {
                let read_mw = self.power_mw * (1.0 + 2e-3 * self.noise.normal());
                format!("{:.0}mW", read_mw.max(0.0))
            }
            "CONTROL?" => if self.by_current { "CURRENT" } else { "POWER" }.to_owned(),
            "CURRENT?" => format!("{:.0}%", self.current_percent),
            "LASTEMP?" => format!("{:.1}C", 25.0 + 3.0 * warming),
            "PSUTEMP?" => "30.0C".to_owned(),
            "TIMERS?" => self.timers(),
            "WRITE" => String::new(),
            _ => "Error 01".to_owned(),
        }
    }

    fn set(&mut self, word: &str, value: &str) -> String {
        if self.faults.refuses_with.is_some() {
            return self.refusal(0);
        }
        let number = value.parse::<f64>().ok().filter(|number| number.is_finite());
        match (word, value, number) {
            ("POWER", _, Some(power_mw)) if (0.0..=self.max_mw).contains(&power_mw) && !self.by_current => {
                self.power_set_mw = power_mw;
            }
            ("CONTROL", "POWER", _) => self.by_current = false,
            // Number 67: the option of current control is not fitted.
            ("CONTROL", "CURRENT", _) | ("CURRENT", ..)
                if self.current_control == CurrentControl::Missing =>
            {
                return self.refusal(67);
            }
            ("CONTROL", "CURRENT", _) => self.by_current = true,
            ("CURRENT", _, Some(percent)) if (0.0..=100.0).contains(&percent) => {
                self.current_percent = percent;
            }
            ("STEN", "YES" | "NO", _) => self.enabled_at_start = value == "YES",
            _ => return self.refusal(2),
        }
        String::new()
    }

    fn refusal(&self, number: u32) -> String {
        format!("Error {:02}", self.faults.refuses_with.unwrap_or(number))
    }

    fn timers(&self) -> String {
        let hours = (self.seconds_on / 3600.0).floor();
        let end = if self.faults.timers_without_end { "" } else { "\r\n" };
        format!(
            "PSU Time = 1234 Hours\r\nLaser Enabled Time = {:.0} Hours\r\nLaser Operation Time = {:.0} Hours{end}",
            345.0 + hours,
            340.0 + hours
        )
    }

    fn command_has_come(&mut self, command: &str, now: Duration) {
        self.let_pass(now);
        let answer = self.answer(command);
        self.let_pass(now);
        if self.faults.silent {
            return;
        }
        let etx = if self.faults.etx { "\u{3}" } else { "" };
        let blank = if self.faults.blank { " " } else { "" };
        let prepares = Duration::from_micros(60_000 + (60_000.0 * self.noise.unit()) as u64);
        let at = now + prepares + self.faults.delay;
        self.output.push_back((at, format!("{etx}{blank}{answer}\r\n").into_bytes()));
    }
}

/// Whether the option of current control is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CurrentControl {
    /// It is.
    Fitted,
    /// It answers with error 67.
    Missing,
}

impl LineModel for Smd12 {
    fn receive(&mut self, bytes: &[u8], now: Duration) {
        self.num_received += bytes.len() as u64;
        for byte in bytes {
            match byte {
                b'\r' | b'\n' if self.input.is_empty() => {}
                b'\r' | b'\n' => {
                    let command = String::from_utf8_lossy(&std::mem::take(&mut self.input)).into_owned();
                    self.command_has_come(command.trim(), now);
                }
                _ if self.input.len() < 64 => self.input.push(*byte),
                _ => {}
            }
        }
    }

    fn advance(&mut self, now: Duration, out: &mut Vec<u8>) -> Option<Duration> {
        self.let_pass(now);
        while let Some((_, bytes)) = self.output.pop_front_if(|(at, _)| *at <= now) {
            out.extend(bytes);
        }
        let looks = self.on.then(|| now + LOOKS_EVERY);
        [looks, self.output.front().map(|(at, _)| *at)].into_iter().flatten().min()
    }
}

#[cfg(test)]
mod tests;
