//! Trigger controller with our own firmware: watchdog, longest on-time, gates low at reset.
//!
//! In: commands. Out: frames of `firmware/PROTOCOL.md`, and what the board answered, read back.
//! Never: takes silence, garbage or a late answer for "done"; keeps a board armed whose settings are gone.
//! Fails: as the contracts of [`GateController`] and [`TriggerSource`] say; any reset is latched as a trip.

mod frame;
mod link;
mod settings;
#[cfg(test)]
mod tests;

use std::io::Write;
use std::time::Duration;

use sofiscope_hal::{
    DeviceError, DeviceIdentity, ErrorKind, GateCapabilities, GateController, GatePattern, GateState,
    GateTrip, TriggerSource, Volts,
};
use sofiscope_serial_line::{Line, LineSettings};

use frame::{Greeting, Report, command, status};
use link::Link;
pub use settings::{GatekeeperSettings, Step};

/// The one byte that closes everything for good, at any place on the line; for [`Gatekeeper::sender`].
pub const CLOSE_NOW: &[u8] = b"!";

/// Level of an analog output at full scale: 12 bits.
const FULL_LEVEL: f64 = 4095.0;
const PROTOCOL: u8 = 1;
const PERIODS_US: std::ops::RangeInclusive<u128> = 100..=60_000_000;

/// A board with the firmware of `firmware/gatekeeper`.
pub struct Gatekeeper {
    link: Link,
    settings: GatekeeperSettings,
    identity: DeviceIdentity,
    capabilities: GateCapabilities,
    config: u16,
    levels: Vec<Option<u16>>,
    armed: bool,
    /// Whether the board has been reset since it was armed, or since it was connected.
    reset: bool,
    /// The epoch in the newest answer.
    epoch: u16,
}

impl Gatekeeper {
    /// How the port is to be opened; boards with USB of their own do not care.
    #[must_use]
    pub fn line_settings() -> LineSettings {
        LineSettings::new(115_200)
    }

    /// Greets the board, closes all its gates and gives it its settings.
    ///
    /// # Errors
    /// [`Identity`](ErrorKind::Identity) for another board than the one wanted,
    /// [`OutOfRange`](ErrorKind::OutOfRange) for settings that the board cannot take.
    pub fn connect(line: Line, settings: GatekeeperSettings) -> Result<Self, DeviceError> {
        let (link, greeting) = Link::open(line)?;
        check(&link, &settings, &greeting)?;
        let mut gatekeeper = Self {
            identity: identity(&greeting),
            capabilities: GateCapabilities {
                gates: greeting.gates,
                levels: greeting.levels,
                sequence: u32::from(greeting.sequence),
                watchdog: Some(Duration::from_millis(u64::from(greeting.watchdog_ms))),
                limits_on_time: true,
                makes_triggers: true,
            },
            config: settings.config_crc(greeting.gates),
            levels: vec![None; usize::from(greeting.levels)],
            epoch: link.epoch,
            link,
            settings,
            armed: false,
            reset: false,
        };
        gatekeeper.disarm()?;
        gatekeeper.configure()?;
        Ok(gatekeeper)
    }

    /// A second handle that only sends, for [`CLOSE_NOW`] past every queue.
    ///
    /// # Errors
    /// When the system gives none.
    pub fn sender(&self) -> Result<Box<dyn Write + Send>, DeviceError> {
        self.link.sender()
    }

    /// Pulses that the board has made since it was reset.
    ///
    /// # Errors
    /// Whatever the line says.
    pub fn pulses(&mut self) -> Result<u32, DeviceError> {
        Ok(self.told(command::STATE, &[])?.1.pulses)
    }

    /// Exposures that the running or last sequence has shown a pattern for, modulo 65536.
    ///
    /// # Errors
    /// Whatever the line says.
    pub fn exposures(&mut self) -> Result<u16, DeviceError> {
        Ok(self.told(command::STATE, &[])?.1.exposures)
    }

    /// Frames that the board could not read since it was reset, at most 65535: the quality of the line.
    ///
    /// # Errors
    /// Whatever the line says.
    pub fn faulty_frames(&mut self) -> Result<u16, DeviceError> {
        Ok(self.told(command::STATE, &[])?.1.faulty)
    }

    /// Gives the board what a reset takes from it.
    fn configure(&mut self) -> Result<(), DeviceError> {
        for gate in 0..self.capabilities.gates {
            let limit = self.settings.limit_us(gate);
            let [a, b, c, d] = limit.to_be_bytes();
            self.done(command::LIMIT, &[gate, a, b, c, d], "setting the longest on-time")?;
        }
        for (output, level) in self.levels.clone().into_iter().enumerate() {
            if let Some(level) = level {
                self.send_level(output as u8, level)?;
            }
        }
        Ok(())
    }

    fn send_level(&mut self, output: u8, level: u16) -> Result<(), DeviceError> {
        let [high, low] = level.to_be_bytes();
        self.done(command::LEVEL, &[output, high, low], "setting a level").map(drop)
    }

    /// Asks, and notes what the answer says about resets and trips.
    fn told(&mut self, order: u8, payload: &[u8]) -> Result<(u8, Report), DeviceError> {
        let (epoch, status, report) = self.link.exchange(order, payload)?;
        self.epoch = epoch;
        if epoch != self.link.epoch || (self.armed && report.is_armed && report.config != self.config) {
            self.reset = true;
        }
        self.armed = self.armed && report.is_armed && !self.reset;
        Ok((status, report))
    }

    /// Asks for something that must then be done.
    fn done(&mut self, order: u8, payload: &[u8], doing: &str) -> Result<Report, DeviceError> {
        let (status, report) = self.told(order, payload)?;
        if self.reset {
            let message = format!("{doing}: the board has been reset, its settings are gone; arm it again");
            return Err(self.link.error(ErrorKind::Fault, &message));
        }
        let (kind, why) = match status {
            status::DONE => return Ok(report),
            status::RANGE => (ErrorKind::OutOfRange, "out of range for this board".to_owned()),
            status::NOT_ARMED => (ErrorKind::Fault, format!("not armed, {}; arm it again", tripped(&report))),
            status::INTERLOCK_OPEN => (ErrorKind::Fault, "the interlock is open; close it first".to_owned()),
            status::BUSY => (ErrorKind::Busy, "not while armed or running; stop first".to_owned()),
            status::CONTENT => (ErrorKind::Fault, "the board has other settings; connect again".to_owned()),
            other => (ErrorKind::Protocol, format!("status {other}; check the firmware's version")),
        };
        Err(self.link.error(kind, &format!("{doing}: {why}")))
    }

    fn out_of_range(&self, message: &str) -> DeviceError {
        self.link.error(ErrorKind::OutOfRange, message)
    }

    fn assert_gates(&self, open: GatePattern) -> Result<(), DeviceError> {
        let gates = self.capabilities.gates;
        if gates < 8 && open.0 >> gates != 0 {
            return Err(self.out_of_range(&format!("gates {:08b}: this board has {gates}", open.0)));
        }
        Ok(())
    }

    fn assert_armed(&self, doing: &str) -> Result<(), DeviceError> {
        if self.armed {
            return Ok(());
        }
        Err(self.link.error(ErrorKind::Fault, &format!("{doing}: not armed; arm it first")))
    }
}

fn identity(greeting: &Greeting) -> DeviceIdentity {
    DeviceIdentity {
        vendor: "sofiscope".to_owned(),
        model: "gatekeeper".to_owned(),
        serial: greeting.serial.to_string(),
        firmware: greeting.firmware.to_string(),
        simulated: greeting.is_simulated,
    }
}

fn check(link: &Link, settings: &GatekeeperSettings, greeting: &Greeting) -> Result<(), DeviceError> {
    if greeting.protocol != PROTOCOL {
        let message = format!("protocol {}, wanted {PROTOCOL}; flash the board again", greeting.protocol);
        return Err(link.error(ErrorKind::Identity, &message));
    }
    if settings.serial.is_some_and(|serial| serial != greeting.serial) {
        let wanted = settings.serial.unwrap_or_default();
        let message = format!("board {} is at this port, wanted {wanted}; check the port", greeting.serial);
        return Err(link.error(ErrorKind::Identity, &message));
    }
    settings.check(greeting.gates).map_err(|message| link.error(ErrorKind::OutOfRange, &message))
}

fn trip_of(code: u8) -> Option<GateTrip> {
    match code {
        1 => Some(GateTrip::Watchdog),
        2 => Some(GateTrip::OnTime),
        3 => Some(GateTrip::Interlock),
        4 => Some(GateTrip::Commanded),
        _ => None,
    }
}

fn tripped(report: &Report) -> String {
    trip_of(report.trip).map_or("without a trip".to_owned(), |trip| format!("tripped by {trip:?}"))
}

impl GateController for Gatekeeper {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn capabilities(&self) -> &GateCapabilities {
        &self.capabilities
    }

    fn arm(&mut self) -> Result<(), DeviceError> {
        let (status, _) = self.told(command::DISARM, &[])?;
        if self.reset || status == status::EPOCH {
            self.link.greet()?;
            self.reset = false;
            self.configure()?;
        }
        let report = self.done(command::ARM, &self.config.to_be_bytes(), "arming")?;
        self.armed = report.is_armed;
        if self.armed && report.open == 0 {
            return Ok(());
        }
        Err(self.link.error(ErrorKind::Fault, &format!("arming: it stays disarmed, {}", tripped(&report))))
    }

    fn disarm(&mut self) -> Result<(), DeviceError> {
        // Closing is done whatever the status says; the outputs that come with it are the proof.
        let (_, report) = self.told(command::DISARM, &[])?;
        if report.is_armed || report.open != 0 {
            let message = format!("disarming: gates {:08b} stay open; use the interlock", report.open);
            return Err(self.link.error(ErrorKind::Fault, &message));
        }
        Ok(())
    }

    fn set_gates(&mut self, open: GatePattern) -> Result<(), DeviceError> {
        self.assert_gates(open)?;
        self.assert_armed("setting gates")?;
        let report = self.done(command::GATES, &[open.0], "setting gates")?;
        if report.open != open.0 {
            let message =
                format!("gates {:08b} are open instead of {:08b}, {}", report.open, open.0, tripped(&report));
            return Err(self.link.error(ErrorKind::Fault, &message));
        }
        Ok(())
    }

    fn set_level(&mut self, output: u8, level: Volts) -> Result<(), DeviceError> {
        let share = level.value() / self.settings.full_scale.value();
        if output >= self.capabilities.levels || !(0.0..=1.0).contains(&share) {
            let (levels, full) = (self.capabilities.levels, self.settings.full_scale);
            let message = format!("{level} at output {output}: there are {levels} outputs from 0 to {full}");
            return Err(self.out_of_range(&message));
        }
        let steps = (share * FULL_LEVEL).round() as u16;
        self.send_level(output, steps)?;
        self.levels[usize::from(output)] = Some(steps);
        Ok(())
    }

    fn begin_sequence(&mut self, patterns: &[GatePattern]) -> Result<(), DeviceError> {
        if patterns.is_empty() || patterns.len() > self.capabilities.sequence as usize {
            let longest = self.capabilities.sequence;
            return Err(self.out_of_range(&format!("a sequence of {}: from 1 to {longest}", patterns.len())));
        }
        patterns.iter().try_for_each(|pattern| self.assert_gates(*pattern))?;
        self.assert_armed("beginning a sequence")?;
        let bytes: Vec<u8> = patterns.iter().map(|pattern| pattern.0).collect();
        self.done(command::END, &[], "ending the sequence before")?;
        for (number, part) in bytes.chunks(frame::PATTERNS_PER_FRAME).enumerate() {
            let [high, low] = ((number * frame::PATTERNS_PER_FRAME) as u16).to_be_bytes();
            self.done(command::LOAD, &[&[high, low], part].concat(), "loading patterns")?;
        }
        let [l1, l0] = (bytes.len() as u16).to_be_bytes();
        let [c1, c0] = frame::crc(&bytes).to_be_bytes();
        let step = u8::from(matches!(self.settings.step, Step::OwnClock { .. }));
        self.done(command::BEGIN, &[l1, l0, c1, c0, step], "beginning a sequence").map(drop)
    }

    fn end_sequence(&mut self) -> Result<(), DeviceError> {
        let (_, report) = self.told(command::END, &[])?;
        if report.open != 0 {
            let message =
                format!("ending a sequence: gates {:08b} stay open; use the interlock", report.open);
            return Err(self.link.error(ErrorKind::Fault, &message));
        }
        Ok(())
    }

    fn heartbeat(&mut self) -> Result<(), DeviceError> {
        if !self.armed {
            return Ok(());
        }
        self.done(command::HEARTBEAT, &[], "a heartbeat").map(drop)
    }

    fn state(&mut self) -> Result<GateState, DeviceError> {
        let (_, report) = self.told(command::STATE, &[])?;
        // A person sees the first reason; after a reset that is the reset, whatever the new board says.
        let trip = if self.reset { Some(GateTrip::Reset) } else { trip_of(report.trip) };
        Ok(GateState {
            open: GatePattern(report.open),
            armed: self.armed,
            trip,
            epoch: u32::from(self.epoch),
        })
    }
}

impl TriggerSource for Gatekeeper {
    fn start(&mut self, period: Duration, pulses: Option<u64>) -> Result<(), DeviceError> {
        let period_us = (period.as_nanos() + 500) / 1000;
        let number = pulses.map_or(Ok(0), u32::try_from);
        let (Ok(number), true, true) = (number, pulses != Some(0), PERIODS_US.contains(&period_us)) else {
            let message =
                format!("a train of {pulses:?} pulses every {period:?}: from 100 µs to 60 s, at most 2³²-1");
            return Err(self.out_of_range(&message));
        };
        let period_us = period_us as u32;
        let (delay, open) = self.settings.window_us();
        if delay.checked_add(open).is_none_or(|end| end > period_us) {
            let message = format!("gates open until {delay} + {open} µs, but a period has {period_us} µs");
            return Err(self.out_of_range(&message));
        }
        let width = self.settings.width_us(period_us);
        let numbers = [period_us, number, width, delay, open];
        let payload: Vec<u8> = numbers.iter().flat_map(|number| number.to_be_bytes()).collect();
        self.done(command::TRAIN, &payload, "starting a train").map(drop)
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        // Done whatever the status says, as all that closes.
        self.told(command::STOP_TRAIN, &[]).map(drop)
    }
}
