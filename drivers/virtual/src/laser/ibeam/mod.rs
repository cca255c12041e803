//! A virtual Toptica iBEAM smart: ASCII lines at 115200 8N1, five channels, one master switch.
//!
//! In: commands ended by CR or CR LF, gate and interlock of the table. Out: `␍␊`, texts, `[OK]␍␊`; light.
//! Never: emits without master switch, an enabled channel and a closed interlock. Fails: as [`Faults`] says.
//!
//! Grammar and quirks: manual as quoted in python-microscope, tests of PyMeasure, adapters of Micro-Manager.

mod commands;
mod words;

use std::collections::VecDeque;
use std::time::Duration;

use sofiscope_serial_line::LineModel;

use super::LOOKS_EVERY;
use super::head::{Head, Place};
use super::noise::Noise;

/// Time in which it prepares an answer.
const ANSWERS_AFTER: Duration = Duration::from_millis(10);
/// Commands that come sooner after each other let its answers lag.
const HASTE: Duration = Duration::from_millis(40);
/// Silence of a reboot.
const REBOOT: Duration = Duration::from_secs(6);

/// What it does wrong; nothing by default.
#[expect(clippy::struct_excessive_bools, reason = "any of them can go wrong together")]
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Faults {
    /// Answers every command with the answer to the one before, until it is reset.
    pub lags: bool,
    /// Answers that lose their `[OK]` from now on.
    pub lose_ok: usize,
    /// Channels take `enable` and stay disabled.
    pub channels_dead: bool,
    /// The key is off: `laser on` is taken and it stays dark.
    pub key_off: bool,
    /// `laser off` and `disable` are answered, and it goes on emitting.
    pub stuck_on: bool,
    /// Part by which the power is off, in light and in its own reading: 0.2 for a fifth too much.
    pub power_error: f64,
    /// Part by which a set level is stored wrongly.
    pub level_error: f64,
    /// Sets are answered with this line, and change nothing; those that make it dark are always obeyed.
    pub refuses_with: Option<String>,
    /// A line that appears in the next answer.
    pub chatter: Option<String>,
}

/// How it talks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Manners {
    echo: bool,
    prompt: bool,
    quiet: bool,
}

const MANNERS_AT_POWER_UP: Manners = Manners { echo: true, prompt: true, quiet: false };

#[derive(Debug, Clone, Copy, Default)]
struct Channel {
    enabled: bool,
    power_uw: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Fine {
    on: bool,
    a_percent: f64,
    b_percent: f64,
}

/// The laser.
pub struct IbeamSmart {
    head: Head,
    serial: String,
    max_mw: f64,
    noise: Noise,
    /// What it does wrong.
    pub faults: Faults,
    manners: Manners,
    on: bool,
    channels: [Channel; 5],
    ext: bool,
    fine: Fine,
    clip: &'static str,
    input: Vec<u8>,
    last_command: Option<Duration>,
    /// The answer that it still owes while it lags.
    owed: Vec<u8>,
    output: VecDeque<(Duration, Vec<u8>)>,
    booting_until: Duration,
    num_received: u64,
}

impl IbeamSmart {
    /// A laser with this serial number, dark, with echo and prompt on and its banner on the way.
    #[must_use]
    pub fn new(place: Place, serial: impl Into<String>, max_mw: f64) -> Self {
        let serial = serial.into();
        let seed =
            serial.bytes().fold(1_u64, |seed, byte| seed.wrapping_mul(31).wrapping_add(u64::from(byte)));
        let mut laser = Self {
            head: Head::new(place),
            serial,
            max_mw,
            noise: Noise::new(seed),
            faults: Faults::default(),
            manners: MANNERS_AT_POWER_UP,
            on: false,
            channels: Default::default(),
            ext: false,
            fine: Fine::default(),
            clip: "GOOD",
            input: Vec::new(),
            last_command: None,
            owed: b"\r\n[OK]\r\n".to_vec(),
            output: VecDeque::new(),
            booting_until: Duration::ZERO,
            num_received: 0,
        };
        laser.announce(Duration::ZERO);
        laser
    }

    /// Bytes that have come since power-up.
    #[must_use]
    pub fn num_received(&self) -> u64 {
        self.num_received
    }

    /// Lets it emit as another program may have left it: switched on, without modulation.
    pub fn left_on(&mut self, power_mw: f64, now: Duration) {
        self.on = true;
        self.channels[1] = Channel { enabled: true, power_uw: power_mw * 1000.0 };
        self.shine(now);
    }

    /// Its banner, out of turn.
    pub fn announce(&mut self, now: Duration) {
        let banner = "\r\niBEAM smart (virtual, sofiscope)\r\n(c) no maker: simulated device\r\n";
        let prompt = if self.manners.prompt { "CMD> " } else { "" };
        self.output.push_back((now + ANSWERS_AFTER, format!("{banner}{prompt}").into_bytes()));
    }

    /// Power is lost and comes back: dark, silent, then as at power-up.
    pub fn restart(&mut self, now: Duration) {
        self.on = false;
        self.manners = MANNERS_AT_POWER_UP;
        self.channels = Default::default();
        (self.ext, self.fine, self.clip) = (false, Fine::default(), "GOOD");
        self.faults.lags = false;
        self.last_command = None;
        self.input.clear();
        self.output.clear();
        self.booting_until = now + REBOOT;
        self.announce(self.booting_until);
        self.shine(now);
    }

    fn shine(&mut self, now: Duration) {
        if self.head.interlock_open() || self.faults.key_off {
            // The master switch falls, and nothing but `laser on` raises it again.
            self.on = false;
        }
        let power_mw = if self.on { self.enabled_mw() * (1.0 + self.faults.power_error) } else { 0.0 };
        self.head.emit(power_mw.max(0.0), now);
    }

    /// Levels of all enabled channels, on top of each other, as far as the diode goes.
    fn enabled_mw(&self) -> f64 {
        let enabled = self.channels.iter().filter(|channel| channel.enabled);
        (enabled.map(|channel| channel.power_uw).sum::<f64>() / 1000.0).min(self.max_mw)
    }

    /// What its photodiode sees, microwatts.
    fn measured_uw(&mut self) -> f64 {
        let gated = self.ext && !self.head.gate_open();
        let bias = self.channels[0];
        let power_mw = match (self.on, gated) {
            (false, _) => 0.0,
            (true, false) => self.head.power_mw(),
            (true, true) => f64::from(u8::from(bias.enabled)) * bias.power_uw / 1000.0,
        };
        (power_mw * 1000.0 * 0.998 * (1.0 + 5e-4 * self.noise.normal())).max(0.0)
    }

    fn command_has_come(&mut self, command: &str, now: Duration) {
        let hasty = self.last_command.is_some_and(|last| now < last + HASTE);
        self.last_command = Some(now);
        let manners = self.manners;
        let texts = self.execute(command, now);
        if now < self.booting_until {
            return;
        }
        self.shine(now);
        let mut answer = String::new();
        if manners.echo {
            answer.push_str(&words::in_full(command).join(" "));
        }
        answer.push_str("\r\n");
        for text in self.faults.chatter.take().into_iter().chain(texts) {
            answer.push_str(&text);
            answer.push_str("\r\n");
        }
        // A prompt stands where `[OK]` would, with the manners that hold after the command.
        if self.manners.prompt {
            answer.push_str("CMD> ");
        } else if self.faults.lose_ok > 0 {
            self.faults.lose_ok -= 1;
        } else {
            answer.push_str("[OK]\r\n");
        }
        self.faults.lags |= hasty;
        let answer = answer.into_bytes();
        let said = if self.faults.lags { std::mem::replace(&mut self.owed, answer) } else { answer };
        if !self.faults.lags {
            self.owed = said.clone();
        }
        self.output.push_back((now + ANSWERS_AFTER, said));
    }
}

impl LineModel for IbeamSmart {
    fn receive(&mut self, bytes: &[u8], now: Duration) {
        self.num_received += bytes.len() as u64;
        if now < self.booting_until {
            return;
        }
        for byte in bytes {
            match byte {
                b'\r' | b'\n' if self.input.is_empty() => {}
                b'\r' | b'\n' => {
                    let command = String::from_utf8_lossy(&std::mem::take(&mut self.input)).into_owned();
                    self.command_has_come(command.trim(), now);
                }
                _ if self.input.len() < 256 => self.input.push(*byte),
                _ => {}
            }
        }
    }

    fn advance(&mut self, now: Duration, out: &mut Vec<u8>) -> Option<Duration> {
        self.shine(now);
        while let Some((_, bytes)) = self.output.pop_front_if(|(at, _)| *at <= now) {
            out.extend(bytes);
        }
        let looks = self.on.then(|| now + LOOKS_EVERY);
        [looks, self.output.front().map(|(at, _)| *at)].into_iter().flatten().min()
    }
}

#[cfg(test)]
mod tests;
