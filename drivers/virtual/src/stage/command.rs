//! The words of the controller: one line in, at most one line out.

use std::time::Duration;

use super::{LONGEST_COMMAND, TangoModel};

/// Millimeters per revolution of the spindles.
const PITCH_MM: f64 = 2.0;
/// Micrometers per unit of position, and decimals, for every dim.
const UNITS: [(f64, usize); 11] = [
    (1e3 * PITCH_MM / 819_200.0, 0),
    (1.0, 1),
    (1e3, 4),
    (1e3 * PITCH_MM / 360.0, 2),
    (1e3 * PITCH_MM, 3),
    (1e4, 5),
    (1e6, 7),
    (25_400.0, 5),
    (25.4, 4),
    (1e3, 4),
    (1.0, 1),
];

// Codes of the controller.
const NO_AXIS: u16 = 1;
const TOO_LONG: u16 = 3;
const NO_INSTRUCTION: u16 = 4;
const BAD_NUMBER: u16 = 5;
const WRONG_COUNT: u16 = 6;
const NO_PREFIX: u16 = 7;
const JOYSTICK: u16 = 11;
const AMPLIFIERS_OFF: u16 = 29;
const MOVING: u16 = 31;
const OUTSIDE: u16 = 32;

/// A command that sets or does something: its verb, the axes it is for and its numbers.
struct Order<'a> {
    verb: &'a str,
    axes: &'a [usize],
    numbers: Vec<f64>,
}

impl TangoModel {
    /// Executes a line without its end.
    pub(super) fn execute(&mut self, line: &[u8], now: Duration) {
        let Ok(text) = std::str::from_utf8(line) else {
            self.error = NO_INSTRUCTION;
            return;
        };
        let text = text.to_ascii_lowercase();
        let done = match text.as_bytes() {
            [] => Ok(()),
            line if line.len() > LONGEST_COMMAND => Err(TOO_LONG),
            [b'?', ..] => self.question(&text[1..], now).map(|answer| self.answer(now, &answer)),
            [b'!', ..] => self.order(&text[1..], now),
            _ if ["a", "go", "reset"].contains(&first_word(&text)) => self.order(&text, now),
            _ => Err(NO_PREFIX),
        };
        if let Err(code) = done {
            self.error = code;
        }
    }

    fn question(&self, text: &str, now: Duration) -> Result<String, u16> {
        let (verb, axes, rest) = taken_apart(text)?;
        if !rest.is_empty() {
            return Err(WRONG_COUNT);
        }
        let seconds = now.as_secs_f64();
        let each = |read: &dyn Fn(usize) -> String| axes.iter().map(|axis| read(*axis)).collect::<Vec<_>>();
        let length = |axis: usize, um: f64| {
            let (unit, decimals) = UNITS[self.dims[axis]];
            format!("{:.decimals$}", um / unit)
        };
        let answer = match verb {
            "version" => vec!["TANGO-DT2-SIMULATED, Version 1.00, Mar 11 2022, 13:51:01".to_owned()],
            "ver" => vec!["Vers:LS-SIMULATED".to_owned()],
            "readsn" => vec![self.serial.clone()],
            "det" => vec!["32".to_owned()],
            "err" => vec![self.faults.condition.unwrap_or(self.error).to_string()],
            "status" => {
                vec![if self.error == 0 { "OK...".to_owned() } else { format!("ERR {}", self.error) }]
            }
            "statusaxis" | "sa" if axes.len() == 1 => each(&|axis| self.letter(&self.axes[axis]).to_string()),
            "statusaxis" | "sa" => vec![self.status_axis()],
            "pos" => each(&|axis| length(axis, self.axes[axis].coordinate(seconds))),
            "lim" => each(&|axis| {
                let [lower, upper] = self.axes[axis].limits;
                format!("{} {}", length(axis, lower), length(axis, upper))
            }),
            "dim" => each(&|axis| self.dims[axis].to_string()),
            "pitch" => each(&|_| format!("{PITCH_MM:.4}")),
            "vel" => each(&|axis| format!("{:.4}", self.axes[axis].velocity_mm_s / self.speed_unit(axis))),
            "accel" => each(&|axis| format!("{:.4}", self.axes[axis].acceleration_m_s2)),
            "backlash" => each(&|axis| format!("{:.1}", self.axes[axis].backlash_um)),
            "calst" => each(&|axis| self.axes[axis].calibration.to_string()),
            "joy" => vec![self.joystick.to_string()],
            "pa" => vec![u8::from(self.is_powered).to_string()],
            "autostatus" => vec![self.autostatus.to_string()],
            _ => return Err(NO_INSTRUCTION),
        };
        Ok(answer.join(" "))
    }

    fn order(&mut self, text: &str, now: Duration) -> Result<(), u16> {
        let moves = matches!(first_word(text), "moa" | "mor" | "go" | "cal" | "rm" | "speed");
        self.num_motions += usize::from(moves);
        let (verb, axes, rest) = taken_apart(text)?;
        if !["err", "a", "dim", "autostatus"].contains(&verb)
            && let Some(code) = self.faults.refuse.take()
        {
            return Err(code);
        }
        let numbers = rest.iter().map(|word| number(word).ok_or(BAD_NUMBER)).collect::<Result<_, _>>()?;
        let order = Order { verb, axes, numbers };
        if moves { self.motion(&order, now) } else { self.setting(&order, now) }
    }

    fn motion(&mut self, order: &Order<'_>, now: Duration) -> Result<(), u16> {
        let seconds = now.as_secs_f64();
        let homes = matches!(order.verb, "cal" | "rm");
        if order.numbers.len() != if homes { 0 } else { order.axes.len() } {
            return Err(WRONG_COUNT);
        }
        if let Some(code) = self.faults.condition {
            return Err(code);
        }
        if !self.is_powered {
            return Err(AMPLIFIERS_OFF);
        }
        if self.joystick > 0 {
            return Err(JOYSTICK);
        }
        match order.verb {
            "cal" => order.axes.iter().for_each(|axis| self.axes[*axis].calibrate(seconds)),
            "rm" => order.axes.iter().for_each(|axis| self.axes[*axis].measure_range(seconds)),
            "moa" | "mor" | "go" => {
                let targets = self.targets(order, seconds);
                if targets.iter().any(|(axis, um)| !self.axes[*axis].allows(*um)) {
                    return Err(OUTSIDE);
                }
                let jam = self.faults.jam.take();
                for (axis, um) in targets {
                    self.axes[axis].move_to(seconds, um, jam);
                }
            }
            _ => return Err(NO_INSTRUCTION),
        }
        Ok(())
    }

    fn targets(&self, order: &Order<'_>, seconds: f64) -> Vec<(usize, f64)> {
        let begin = |axis: usize| if order.verb == "mor" { self.axes[axis].coordinate(seconds) } else { 0.0 };
        let pairs = order.axes.iter().zip(&order.numbers);
        pairs.map(|(&axis, value)| (axis, begin(axis) + value * UNITS[self.dims[axis]].0)).collect()
    }

    fn setting(&mut self, order: &Order<'_>, now: Duration) -> Result<(), u16> {
        let wanted = match order.verb {
            "err" | "a" | "reset" => 0,
            "autostatus" | "joy" | "pa" => 1,
            "lim" => 2 * order.axes.len(),
            _ => order.axes.len(),
        };
        let is_known = matches!(
            order.verb,
            "err"
                | "a"
                | "reset"
                | "autostatus"
                | "joy"
                | "pa"
                | "lim"
                | "dim"
                | "vel"
                | "accel"
                | "backlash"
                | "pos"
        );
        if !is_known {
            return Err(NO_INSTRUCTION);
        }
        if order.numbers.len() != wanted {
            return Err(WRONG_COUNT);
        }
        match order.verb {
            "err" => self.error = 0,
            "a" => self.stop(now),
            "reset" => self.switch_off_and_on(now),
            "autostatus" => self.autostatus = whole(order.numbers[0], 4)?,
            "joy" if self.was_moving => return Err(MOVING),
            "joy" => self.joystick = whole(order.numbers[0], 2)?,
            "pa" => self.is_powered = whole(order.numbers[0], 1)? == 1,
            _ => return self.settings_of_axes(order, now),
        }
        Ok(())
    }

    fn settings_of_axes(&mut self, order: &Order<'_>, now: Duration) -> Result<(), u16> {
        let each = order.numbers.len() / order.axes.len();
        for (&axis, numbers) in order.axes.iter().zip(order.numbers.chunks(each)) {
            let (unit, speed_unit) = (UNITS[self.dims[axis]].0, self.speed_unit(axis));
            let changed = &mut self.axes[axis];
            match order.verb {
                "dim" => self.dims[axis] = usize::from(whole(numbers[0], 10)?),
                "vel" => changed.velocity_mm_s = within(numbers[0] * speed_unit, 0.001, 120.0)?,
                "accel" => changed.acceleration_m_s2 = within(numbers[0], 0.001, 10.0)?,
                "backlash" => changed.backlash_um = within(numbers[0], 0.0, 10.0)?,
                "pos" => changed.set_coordinate(now.as_secs_f64(), numbers[0] * unit),
                _ if numbers[0] > numbers[1] => return Err(BAD_NUMBER),
                _ => changed.limits = [numbers[0] * unit, numbers[1] * unit],
            }
        }
        Ok(())
    }

    /// Millimeters per second in one unit of velocity: revolutions per second but for dims 9 and 10.
    fn speed_unit(&self, axis: usize) -> f64 {
        if self.dims[axis] >= 9 { 1.0 } else { PITCH_MM }
    }
}

fn first_word(text: &str) -> &str {
    text.split(' ').next().unwrap_or_default()
}

/// Verb, axes and the words after them; words are separated by one space.
fn taken_apart(text: &str) -> Result<(&str, &'static [usize], Vec<&str>), u16> {
    let mut words = text.split(' ');
    let verb = words.next().unwrap_or_default();
    let rest: Vec<&str> = words.collect();
    match rest.first() {
        Some(&"x") => Ok((verb, &[0], rest[1..].to_vec())),
        Some(&"y") => Ok((verb, &[1], rest[1..].to_vec())),
        Some(&("z" | "a")) => Err(NO_AXIS),
        _ => Ok((verb, &[0, 1], rest)),
    }
}

/// A number with a decimal point and nothing else that Rust would take for one.
fn number(word: &str) -> Option<f64> {
    let is_plain = word.bytes().all(|byte| byte.is_ascii_digit() || b"+-.".contains(&byte));
    word.parse().ok().filter(|_| is_plain)
}

fn whole(number: f64, most: u8) -> Result<u8, u16> {
    let is_whole = number.fract() == 0.0 && (0.0..=f64::from(most)).contains(&number);
    if is_whole { Ok(number as u8) } else { Err(BAD_NUMBER) }
}

fn within(number: f64, least: f64, most: f64) -> Result<f64, u16> {
    if (least..=most).contains(&number) { Ok(number) } else { Err(BAD_NUMBER) }
}
