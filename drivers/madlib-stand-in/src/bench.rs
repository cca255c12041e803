//! The bench: one Nano-Drive with a piezo along z, its handle, its clock, what goes wrong with it.
//!
//! In: calls of the library, commands as text. Out: answers. Never: waits; the exports do.
//! Fails: with error codes of Madlib.
//!
//! | words | what happens |
//! |---|---|
//! | `reset` | everything as at power-up |
//! | `bits 16`, `bits 20` | converters and model |
//! | `serial 1234` | serial number |
//! | `time 1.5`, `real-time` | time stands at 1.5 s until told, or passes by itself (as at power-up) |
//! | `noise 0.5` | noise of the sensor, nanometers rms |
//! | `offset -0.0003` | error of the sensor, micrometers |
//! | `frequency 30` | of the closed loop, Hz |
//! | `fail -2 1` | the next call fails so, once |
//! | `slow 600` | the next call takes so many milliseconds |
//! | `unplug`, `plug` | cable |
//! | `owned`, `free` | another program owns the device, or not |
//! | `at 150` | a person has focused there, micrometers |
//! | `table /path` | tells an optical table where the piezo is |
//! | `where`, `open` | answers: true position in micrometers, handles in use |

use std::path::Path;
use std::time::{Duration, Instant};

use sofiscope_virtual::OpticalTable;
use sofiscope_virtual::table::Quantity;

use crate::plant::Plant;

/// Why a call is refused.
pub(crate) mod code {
    pub(crate) const NOT_ATTACHED: i32 = -3;
    pub(crate) const BAD_ARGUMENT: i32 = -6;
    pub(crate) const INVALID_AXIS: i32 = -7;
    pub(crate) const INVALID_HANDLE: i32 = -8;
}

/// The only axis there is.
const Z: u32 = 3;

/// What time it is on the bench.
#[derive(Debug, Clone, Copy)]
enum Time {
    Real(Instant),
    Told(f64),
}

/// Everything behind the library.
#[derive(Debug)]
pub(crate) struct Bench {
    plant: Plant,
    pub(crate) bits: i16,
    pub(crate) serial: i16,
    time: Time,
    seen_s: f64,
    handle: Option<i32>,
    handles: i32,
    noise_nm: f64,
    offset_um: f64,
    random: u64,
    fail: Option<(i32, u32)>,
    slow: Option<Duration>,
    unplugged: bool,
    owned: bool,
    table: Option<OpticalTable>,
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self {
            plant: Plant::NEW,
            bits: 20,
            serial: 1234,
            time: Time::Real(Instant::now()),
            seen_s: 0.0,
            handle: None,
            handles: 0,
            noise_nm: 0.5,
            offset_um: 0.0,
            random: 1,
            fail: None,
            slow: None,
            unplugged: false,
            owned: false,
            table: None,
        }
    }

    /// Lets the plant come to the present, and the table see it.
    pub(crate) fn advance(&mut self) {
        let now = match self.time {
            Time::Real(begun) => begun.elapsed().as_secs_f64(),
            Time::Told(seconds) => seconds,
        };
        self.plant.advance((now - self.seen_s).max(0.0));
        self.seen_s = now;
        if let Some(table) = &self.table {
            table.set(Quantity::PiezoZ, self.plant.z_um * 1e3);
        }
    }

    /// Whether somebody has to look again soon, for the table.
    pub(crate) fn is_moving(&self) -> bool {
        self.table.is_some() && !self.plant.is_settled()
    }

    /// Time that the next call takes.
    pub(crate) fn slowness(&mut self) -> Option<Duration> {
        self.slow.take()
    }

    /// A handle; none when somebody else has the device, or this process has it and wants another.
    pub(crate) fn take(&mut self, reuse: bool) -> Option<i32> {
        if self.unplugged || self.owned {
            return None;
        }
        match self.handle {
            Some(handle) => reuse.then_some(handle),
            None => {
                self.handles += 1;
                self.handle = Some(self.handles);
                self.handle
            }
        }
    }

    pub(crate) fn handle(&self) -> Option<i32> {
        self.handle
    }

    pub(crate) fn release(&mut self, handle: i32) {
        self.handle = self.handle.filter(|own| *own != handle);
    }

    pub(crate) fn release_all(&mut self) {
        self.handle = None;
    }

    /// Whether a handle may be used now.
    pub(crate) fn check(&mut self, handle: i32) -> Result<(), i32> {
        if self.handle != Some(handle) {
            return Err(code::INVALID_HANDLE);
        }
        if let Some((code, times)) = self.fail.take() {
            self.fail = (times > 1).then(|| (code, times - 1));
            return Err(code);
        }
        if self.unplugged { Err(code::NOT_ATTACHED) } else { Ok(()) }
    }

    fn check_axis(&mut self, axis: u32, handle: i32) -> Result<(), i32> {
        self.check(handle)?;
        if axis == Z { Ok(()) } else { Err(code::INVALID_AXIS) }
    }

    pub(crate) fn is_attached(&self, handle: i32) -> bool {
        self.handle == Some(handle) && !self.unplugged
    }

    fn step_um(&self) -> f64 {
        self.plant.range_um / ((1_u32 << self.bits) - 1) as f64
    }

    pub(crate) fn read(&mut self, axis: u32, handle: i32) -> Result<f64, i32> {
        self.check_axis(axis, handle)?;
        self.advance();
        let noisy = self.plant.z_um + self.offset_um + self.noise_nm * 1e-3 * self.normal();
        Ok((noisy / self.step_um()).round() * self.step_um())
    }

    pub(crate) fn write(&mut self, um: f64, axis: u32, handle: i32) -> Result<(), i32> {
        self.check_axis(axis, handle)?;
        self.advance();
        if !(0.0..=self.plant.range_um).contains(&um) {
            return Err(code::BAD_ARGUMENT);
        }
        self.plant.target_um = (um / self.step_um()).round() * self.step_um();
        Ok(())
    }

    pub(crate) fn calibration(&mut self, axis: u32, handle: i32) -> Result<f64, i32> {
        self.check_axis(axis, handle).map(|()| self.plant.range_um)
    }

    pub(crate) fn target(&mut self, handle: i32) -> Result<f64, i32> {
        self.check(handle).map(|()| self.plant.target_um)
    }

    /// Twelve even numbers make one that is as good as normal, rms 1.
    fn normal(&mut self) -> f64 {
        let even = |random: &mut u64| {
            // SplitMix64.
            *random = random.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let mixed = (*random ^ (*random >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| even(&mut self.random)).sum::<f64>() - 6.0
    }

    /// Does what it is told; gives an answer, or what was wrong.
    pub(crate) fn obey(&mut self, text: &str) -> Result<String, String> {
        self.advance();
        let words: Vec<&str> = text.split_whitespace().collect();
        let wrong = || format!("'{text}' is no command");
        let number =
            |word: &str| word.parse::<f64>().ok().filter(|number| number.is_finite()).ok_or_else(wrong);
        match words.as_slice() {
            ["reset"] => *self = Self { handles: self.handles, ..Self::new() },
            ["bits", bits @ ("16" | "20")] => self.bits = bits.parse().map_err(|_| wrong())?,
            ["serial", serial] => self.serial = serial.parse().map_err(|_| wrong())?,
            ["time", seconds] => {
                let seconds = number(seconds)?;
                if !matches!(self.time, Time::Told(_)) {
                    self.seen_s = seconds;
                }
                self.time = Time::Told(seconds);
                self.advance();
            }
            ["real-time"] => (self.time, self.seen_s) = (Time::Real(Instant::now()), 0.0),
            ["noise", nm] => self.noise_nm = number(nm)?.max(0.0),
            ["offset", um] => self.offset_um = number(um)?,
            ["frequency", hz] => self.plant.omega = std::f64::consts::TAU * number(hz)?.clamp(0.1, 1000.0),
            ["fail", code, times] => {
                self.fail = Some((code.parse().map_err(|_| wrong())?, times.parse().map_err(|_| wrong())?));
            }
            ["slow", milliseconds] => {
                self.slow = Some(Duration::from_millis(milliseconds.parse().map_err(|_| wrong())?));
            }
            ["unplug"] => self.unplugged = true,
            ["plug"] => self.unplugged = false,
            ["owned"] => self.owned = true,
            ["free"] => self.owned = false,
            ["at", um] => {
                let um = number(um)?;
                (self.plant.z_um, self.plant.target_um) = (um, um);
            }
            ["table", path] => {
                let table =
                    OpticalTable::join(Path::new(path)).map_err(|error| format!("{path}: {error}"))?;
                self.table = Some(table);
                self.advance();
            }
            ["where"] => return Ok(format!("{}", self.plant.z_um)),
            ["open"] => return Ok(format!("{}", self.handle.iter().count())),
            _ => return Err(wrong()),
        }
        Ok(String::new())
    }
}
