//! Trigger controllers that speak the Arduino protocol of Micro-Manager, version 5: Uno and Teensy.
//!
//! In: commands. Out: one-byte commands with raw parameters, and their echoes, compared.
//! Never: sends an upload that the firmware would execute; goes on after a silence as if nothing had happened.
//! Fails: as the contract of [`GateController`] says; every resynchronization is latched as a reset.
//!
//! The firmware has no watchdog, no framing and no check sums: its gates stay as they are when this computer dies,
//! so that a guard and a hardware interlock in series are needed. It has no notion of arming either; the driver
//! keeps it. Commands and defects were read in the firmware and its host adapter
//! (<https://github.com/micro-manager/mmCoreAndDevices/tree/main/DeviceAdapters/Arduino>).

mod board;
#[cfg(test)]
mod tests;

use sofiscope_hal::{
    DeviceError, DeviceIdentity, ErrorKind, GateCapabilities, GateController, GatePattern, GateState,
    GateTrip, Volts,
};
use sofiscope_serial_line::{Line, LineSettings};

use board::Board;

/// Full scale of the analog outputs: 12 bits, 0 to 5 V.
const FULL_LEVEL: f64 = 4095.0;
const FULL_VOLTS: f64 = 5.0;

/// Commands of the protocol.
mod command {
    pub(crate) const SET: u8 = 1;
    pub(crate) const READ: u8 = 2;
    pub(crate) const LEVEL: u8 = 3;
    pub(crate) const START: u8 = 8;
    pub(crate) const STOP: u8 = 9;
    pub(crate) const BLANKING_OFF: u8 = 21;
    pub(crate) const BLANK_WHILE: u8 = 22;
    pub(crate) const IDENTITY: u8 = 30;
    pub(crate) const VERSION: u8 = 31;
    pub(crate) const CAPACITY: u8 = 32;
    pub(crate) const UPLOAD: u8 = 33;
    pub(crate) const NUM_LEVELS: u8 = 34;
    pub(crate) const NUM_GATES: u8 = 35;
}

/// When the camera's line at the trigger input means that it exposes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExposureLevel {
    /// High during the exposure, as the firmware has it after reset.
    High,
    /// Low during the exposure.
    Low,
}

/// A board with the Arduino firmware of Micro-Manager.
pub struct MicroManagerArduino {
    board: Board,
    exposure: ExposureLevel,
    identity: DeviceIdentity,
    capabilities: GateCapabilities,
    armed: bool,
    /// What was set; `None` while a sequence decides.
    expected: Option<GatePattern>,
    trip: Option<GateTrip>,
    epoch: u32,
    /// Triggers of the last sequence, modulo 256.
    triggers: u8,
}

impl MicroManagerArduino {
    /// How the port is to be opened: 57600 for the Uno; a Teensy does not care.
    #[must_use]
    pub fn line_settings() -> LineSettings {
        LineSettings::new(57_600)
    }

    /// Waits for the boot loader, identifies the board and closes everything.
    ///
    /// # Errors
    /// [`Identity`](ErrorKind::Identity) for another device or protocol version.
    pub fn connect(line: Line, exposure: ExposureLevel) -> Result<Self, DeviceError> {
        let mut board = Board::open(line)?;
        let name = board.identify()?;
        let [gates] = board.ask([command::NUM_GATES], "asking for the number of gates")?;
        let [levels] = board.ask([command::NUM_LEVELS], "asking for the number of levels")?;
        let capacity = u16::from_be_bytes(board.ask([command::CAPACITY], "asking for the pattern memory")?);
        if !(1..=8).contains(&gates) || capacity == 0 {
            let message =
                format!("{gates} gates and memory for {capacity} patterns: no board of this protocol");
            return Err(board.error(ErrorKind::Protocol, &message));
        }
        let mut arduino = Self {
            board,
            exposure,
            identity: DeviceIdentity {
                vendor: "Micro-Manager".to_owned(),
                model: name,
                serial: String::new(),
                firmware: "5".to_owned(),
                simulated: false,
            },
            capabilities: GateCapabilities {
                gates,
                levels,
                // An upload as long as the memory is refused, and its patterns are executed as commands.
                sequence: u32::from(capacity) - 1,
                watchdog: None,
                limits_on_time: false,
                makes_triggers: false,
            },
            armed: false,
            expected: Some(GatePattern::CLOSED),
            trip: None,
            epoch: 0,
            triggers: 0,
        };
        arduino.close()?;
        Ok(arduino)
    }

    /// The same board, said to be simulated: the protocol has no word for it, the instrument file knows.
    #[must_use]
    pub fn simulated(mut self) -> Self {
        self.identity.simulated = true;
        self
    }

    /// Triggers that the last sequence had seen when it ended, modulo 256: the firmware tells one byte.
    #[must_use]
    pub fn triggers_modulo_256(&self) -> u8 {
        self.triggers
    }

    /// Everything off, in the order that leaves no way for a stored pattern to come back, and read back.
    fn close(&mut self) -> Result<(), DeviceError> {
        self.armed = false;
        let [] = self.board.ask_echoed([command::SET, 0], &[command::SET], "closing")?;
        let [triggers] = self.board.ask([command::STOP], "ending trigger mode")?;
        let [] = self.board.ask([command::BLANKING_OFF], "ending blanking")?;
        let [] = self.board.ask_echoed([command::SET, 0], &[command::SET], "closing")?;
        let level = u8::from(self.exposure == ExposureLevel::High);
        let [] = self.board.ask_echoed(
            [command::BLANK_WHILE, level],
            &[command::BLANK_WHILE],
            "setting the input",
        )?;
        if self.expected.is_none() {
            self.triggers = triggers;
        }
        self.expected = Some(GatePattern::CLOSED);
        let open = self.read_back()?;
        if open.is_closed() {
            return Ok(());
        }
        let message = format!("closing: gates {:08b} stay open; use the interlock", open.0);
        Err(self.board.error(ErrorKind::Fault, &message))
    }

    fn read_back(&mut self) -> Result<GatePattern, DeviceError> {
        let [open] = self.board.ask([command::READ], "reading the gates back")?;
        Ok(GatePattern(open))
    }

    /// Does something; after a silence or another answer than the one that is due, everything is closed, and the
    /// board counts as reset.
    fn attempt<T>(
        &mut self,
        act: impl FnOnce(&mut Self) -> Result<T, DeviceError>,
    ) -> Result<T, DeviceError> {
        let armed = self.armed;
        let error = match act(self) {
            Ok(value) => return Ok(value),
            Err(error) => error,
        };
        self.armed = armed;
        match error.kind() {
            ErrorKind::Timeout | ErrorKind::Protocol => {
                self.note_reset();
                self.board.resynchronize()?;
                self.board.identify()?;
                self.close()?;
            }
            ErrorKind::Fault => {
                self.note_reset();
                self.close()?;
            }
            _ => self.note_reset(),
        }
        Err(error)
    }

    /// From now on the board counts as reset: its pattern, its mode and its levels cannot be trusted.
    fn note_reset(&mut self) {
        if self.armed {
            self.trip = Some(GateTrip::Reset);
        }
        self.armed = false;
        self.epoch = self.epoch.wrapping_add(1);
    }

    fn assert_armed(&self, doing: &str) -> Result<(), DeviceError> {
        if self.armed {
            return Ok(());
        }
        Err(self.board.error(ErrorKind::Fault, &format!("{doing}: not armed; arm it first")))
    }

    fn assert_gates(&self, open: GatePattern) -> Result<(), DeviceError> {
        let gates = self.capabilities.gates;
        if gates < 8 && open.0 >> gates != 0 {
            let message = format!("gates {:08b}: this board has {gates}", open.0);
            return Err(self.board.error(ErrorKind::OutOfRange, &message));
        }
        Ok(())
    }

    fn open(&mut self, open: GatePattern) -> Result<(), DeviceError> {
        let [] = self.board.ask_echoed([command::SET, open.0], &[command::SET], "setting gates")?;
        self.expected = Some(open);
        let found = self.read_back()?;
        if found == open {
            return Ok(());
        }
        let message = format!("gates {:08b} are open instead of {:08b}; arm it again", found.0, open.0);
        Err(self.board.error(ErrorKind::Fault, &message))
    }
}

impl GateController for MicroManagerArduino {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn capabilities(&self) -> &GateCapabilities {
        &self.capabilities
    }

    fn arm(&mut self) -> Result<(), DeviceError> {
        self.attempt(Self::close)?;
        self.armed = true;
        self.trip = None;
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), DeviceError> {
        match self.attempt(Self::close) {
            // Closed and read back in the second attempt, after the board had to be found again.
            Err(error) if matches!(error.kind(), ErrorKind::Timeout | ErrorKind::Protocol) => self.close(),
            other => other,
        }
    }

    fn set_gates(&mut self, open: GatePattern) -> Result<(), DeviceError> {
        self.assert_gates(open)?;
        self.assert_armed("setting gates")?;
        if self.expected.is_none() {
            let message = "setting gates: a sequence runs; end it first";
            return Err(self.board.error(ErrorKind::Busy, message));
        }
        self.attempt(|arduino| arduino.open(open))
    }

    fn set_level(&mut self, output: u8, level: Volts) -> Result<(), DeviceError> {
        let share = level.value() / FULL_VOLTS;
        if output >= self.capabilities.levels || !(0.0..=1.0).contains(&share) {
            let levels = self.capabilities.levels;
            let message = format!("{level} at output {output}: there are {levels} outputs from 0 V to 5 V");
            return Err(self.board.error(ErrorKind::OutOfRange, &message));
        }
        let [high, low] = ((share * FULL_LEVEL).round() as u16).to_be_bytes();
        self.attempt(|arduino| {
            let order = [command::LEVEL, output, high, low];
            arduino.board.ask_echoed(order, &order, "setting a level").map(|[]| ())
        })
    }

    fn begin_sequence(&mut self, patterns: &[GatePattern]) -> Result<(), DeviceError> {
        let longest = self.capabilities.sequence;
        if patterns.is_empty() || patterns.len() > longest as usize {
            let message = format!("a sequence of {}: from 1 to {longest}", patterns.len());
            return Err(self.board.error(ErrorKind::OutOfRange, &message));
        }
        patterns.iter().try_for_each(|pattern| self.assert_gates(*pattern))?;
        self.assert_armed("beginning a sequence")?;
        let bytes: Vec<u8> = patterns.iter().map(|pattern| pattern.0).collect();
        self.attempt(|arduino| {
            arduino.close()?;
            arduino.board.upload(&bytes)?;
            let [] = arduino.board.ask([command::START], "starting trigger mode")?;
            arduino.armed = true;
            arduino.expected = None;
            Ok(())
        })
    }

    fn end_sequence(&mut self) -> Result<(), DeviceError> {
        let armed = self.armed;
        self.attempt(Self::close)?;
        self.armed = armed;
        Ok(())
    }

    fn heartbeat(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn state(&mut self) -> Result<GateState, DeviceError> {
        let read = self.attempt(Self::read_back);
        let open = match read {
            // The board was found again and closed; that it was gone is in the trip.
            Err(error) if error.kind() == ErrorKind::Timeout => self.read_back()?,
            other => other?,
        };
        if self.expected.is_some_and(|expected| expected != open) {
            self.note_reset();
            self.attempt(Self::close)?;
        }
        Ok(GateState { open, armed: self.armed, trip: self.trip, epoch: self.epoch })
    }
}
