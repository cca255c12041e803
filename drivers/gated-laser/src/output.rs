//! The gate and the level of one laser, on a controller that several share.
//!
//! In: permissions and levels of lasers, patterns of the sequencer. Out: a controller that opens a claimed gate only
//! while its laser permits it. Never: keeps a permission through a reset, a trip or a new arming: every laser must
//! be switched on again. Fails: [`Fault`](ErrorKind::Fault) for patterns that open the gate of a laser that is off.

use std::collections::BTreeMap;

use sofiscope_hal::{
    DeviceError, DeviceIdentity, ErrorKind, GateCapabilities, GateController, GatePattern, GateState, Volts,
};

/// Whether a laser lets its gate open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Permission {
    /// Patterns may open its gate.
    Granted,
    /// Its gate stays closed.
    Withheld,
}

/// What the controller knows of one laser.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutputState {
    /// Whether its gate may open.
    pub permission: Permission,
    /// Level that the controller has taken since its reset; zero after it.
    pub level: Volts,
    /// The controller.
    pub gate: GateState,
}

/// The way from one laser to the controller: a mailbox to its thread, or the controller itself in tests.
pub trait Output: Send {
    /// Applies a level, and lets patterns open the gate from now on.
    ///
    /// # Errors
    /// [`Fault`](ErrorKind::Fault) unless the controller is armed and has not tripped; what the controller says.
    fn grant(&mut self, level: Volts) -> Result<(), DeviceError>;

    /// Applies another level to an output that is granted, and never grants it.
    ///
    /// # Errors
    /// [`Busy`](ErrorKind::Busy) when it is withheld; what the controller says.
    fn set_level(&mut self, level: Volts) -> Result<(), DeviceError>;

    /// Level zero, gate closed, and closed for all patterns to come; twice is no error.
    ///
    /// # Errors
    /// What the controller says; the laser is then to be taken as emitting.
    fn withhold(&mut self) -> Result<(), DeviceError>;

    /// What the controller knows.
    ///
    /// # Errors
    /// What the controller says.
    fn state(&mut self) -> Result<OutputState, DeviceError>;
}

/// One laser on the controller.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Claim {
    permission: Permission,
    level: Volts,
}

const WITHHELD: Claim = Claim { permission: Permission::Withheld, level: Volts::ZERO };

/// Where a laser is wired; the key of its claim.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Wiring {
    /// Gate, from 0; `None` for a laser that has only a level.
    pub line: Option<u8>,
    /// Analog output, from 0; `None` for a laser that has only a gate.
    pub output: Option<u8>,
}

/// A controller that opens claimed gates only by permission; gates that nobody has claimed are as before.
pub struct Permitting<C> {
    controller: C,
    claims: BTreeMap<Wiring, Claim>,
    epoch: Option<u32>,
    sequence: GatePattern,
}

impl<C: GateController> Permitting<C> {
    /// A controller without claims.
    pub fn new(controller: C) -> Self {
        Self { controller, claims: BTreeMap::new(), epoch: None, sequence: GatePattern::CLOSED }
    }

    /// The controller.
    pub fn controller(&mut self) -> &mut C {
        &mut self.controller
    }

    /// Claims gate and level for a laser, withheld.
    ///
    /// # Errors
    /// [`OutOfRange`](ErrorKind::OutOfRange) for outputs that are not there or belong to another laser.
    pub fn claim(&mut self, wiring: Wiring) -> Result<(), DeviceError> {
        let able = self.controller.capabilities();
        let there = wiring.line.is_none_or(|line| line < able.gates.min(8))
            && wiring.output.is_none_or(|output| output < able.levels);
        let shared = |other: &Wiring| {
            let same = |ours: Option<u8>, theirs: Option<u8>| ours.is_some() && ours == theirs;
            same(wiring.line, other.line) || same(wiring.output, other.output)
        };
        let nothing = wiring.line.is_none() && wiring.output.is_none();
        if nothing || !there || self.claims.keys().any(shared) {
            let told =
                format!("{wiring:?} is not there, or belongs to another laser; correct the configuration");
            return Err(self.error(ErrorKind::OutOfRange, told));
        }
        self.claims.insert(wiring, WITHHELD);
        Ok(())
    }

    /// As [`Output::grant`].
    ///
    /// # Errors
    /// As [`Output::grant`].
    pub fn grant(&mut self, wiring: Wiring, level: Volts) -> Result<(), DeviceError> {
        let state = self.state()?;
        if !self.claims.contains_key(&wiring) {
            return Err(self.error(ErrorKind::OutOfRange, format!("{wiring:?} was not claimed")));
        }
        if let Some(trip) = state.trip {
            let told = format!("tripped ({trip:?}); remove the reason, then arm again");
            return Err(self.error(ErrorKind::Fault, told));
        }
        if !state.armed {
            return Err(self.error(ErrorKind::Fault, "is not armed; arm it first".to_owned()));
        }
        if let Some(output) = wiring.output {
            self.controller.set_level(output, level)?;
        }
        self.claims.insert(wiring, Claim { permission: Permission::Granted, level });
        Ok(())
    }

    /// As [`Output::set_level`].
    ///
    /// # Errors
    /// As [`Output::set_level`].
    pub fn set_level_of(&mut self, wiring: Wiring, level: Volts) -> Result<(), DeviceError> {
        if self.output_state(wiring)?.permission == Permission::Withheld {
            return Err(self.error(ErrorKind::Busy, "the laser is off; switch it on first".to_owned()));
        }
        self.grant(wiring, level)
    }

    /// As [`Output::withhold`].
    ///
    /// # Errors
    /// As [`Output::withhold`].
    pub fn withhold(&mut self, wiring: Wiring) -> Result<(), DeviceError> {
        if let Some(claim) = self.claims.get_mut(&wiring) {
            claim.permission = Permission::Withheld;
        }
        let leveled = wiring.output.map_or(Ok(()), |output| self.controller.set_level(output, Volts::ZERO));
        let closed = self.close(wiring);
        leveled.and(closed)?;
        self.claims.insert(wiring, WITHHELD);
        Ok(())
    }

    /// As [`Output::state`].
    ///
    /// # Errors
    /// As [`Output::state`].
    pub fn output_state(&mut self, wiring: Wiring) -> Result<OutputState, DeviceError> {
        let gate = self.state()?;
        let Claim { permission, level } = self.claims.get(&wiring).copied().unwrap_or(WITHHELD);
        Ok(OutputState { permission, level, gate })
    }

    /// Closes the gate of a laser; a sequence that would open it again is ended.
    fn close(&mut self, wiring: Wiring) -> Result<(), DeviceError> {
        let Some(line) = wiring.line else { return Ok(()) };
        if self.sequence.has(line) {
            return self.end_sequence();
        }
        match self.controller.state() {
            Ok(state) if !state.armed || !state.open.has(line) => Ok(()),
            Ok(state) => self.controller.set_gates(GatePattern(state.open.0 & !(1 << line))),
            // Blind, the only safe pattern is the closed one.
            Err(error) => self.controller.disarm().and(Err(error)),
        }
    }

    /// Takes all permissions back, and all levels to zero.
    fn withdraw(&mut self) -> Result<(), DeviceError> {
        let mut result = Ok(());
        for (wiring, claim) in &mut self.claims {
            let dark = match wiring.output {
                Some(output) if *claim != WITHHELD => self.controller.set_level(output, Volts::ZERO),
                _ => Ok(()),
            };
            claim.permission = Permission::Withheld;
            if dark.is_ok() {
                *claim = WITHHELD;
            }
            result = result.and(dark);
        }
        result
    }

    fn allowed(&self, open: GatePattern) -> Result<(), DeviceError> {
        let off = |(wiring, claim): (&Wiring, &Claim)| {
            let line = wiring.line?;
            (claim.permission == Permission::Withheld && open.has(line)).then_some(line)
        };
        match self.claims.iter().find_map(off) {
            None => Ok(()),
            Some(line) => {
                let told = format!("gate {line} belongs to a laser that is off; switch it on first");
                Err(self.error(ErrorKind::Fault, told))
            }
        }
    }

    fn error(&self, kind: ErrorKind, told: String) -> DeviceError {
        DeviceError::new(kind, self.controller.identity().to_string(), told)
    }
}

impl<C: GateController> GateController for Permitting<C> {
    fn identity(&self) -> &DeviceIdentity {
        self.controller.identity()
    }

    fn capabilities(&self) -> &GateCapabilities {
        self.controller.capabilities()
    }

    /// Arms in the dark: permissions that were granted before are gone.
    fn arm(&mut self) -> Result<(), DeviceError> {
        self.disarm()?;
        self.controller.arm()
    }

    fn disarm(&mut self) -> Result<(), DeviceError> {
        let disarmed = self.controller.disarm();
        if disarmed.is_ok() {
            self.sequence = GatePattern::CLOSED;
        }
        disarmed.and(self.withdraw())
    }

    fn set_gates(&mut self, open: GatePattern) -> Result<(), DeviceError> {
        self.allowed(open)?;
        self.controller.set_gates(open)
    }

    /// Refuses the levels of lasers, which are theirs alone.
    fn set_level(&mut self, output: u8, level: Volts) -> Result<(), DeviceError> {
        if self.claims.keys().any(|wiring| wiring.output == Some(output)) && level != Volts::ZERO {
            let told = format!("output {output} belongs to a laser; set its power instead");
            return Err(self.error(ErrorKind::OutOfRange, told));
        }
        self.controller.set_level(output, level)
    }

    fn begin_sequence(&mut self, patterns: &[GatePattern]) -> Result<(), DeviceError> {
        let all = GatePattern(patterns.iter().fold(0, |all, pattern| all | pattern.0));
        self.allowed(all)?;
        self.controller.begin_sequence(patterns)?;
        self.sequence = all;
        Ok(())
    }

    fn end_sequence(&mut self) -> Result<(), DeviceError> {
        self.controller.end_sequence()?;
        // Only now: a sequence that could not be ended still opens its gates.
        self.sequence = GatePattern::CLOSED;
        Ok(())
    }

    fn heartbeat(&mut self) -> Result<(), DeviceError> {
        self.controller.heartbeat()
    }

    /// Looks, and takes all permissions back after a reset or a trip.
    fn state(&mut self) -> Result<GateState, DeviceError> {
        let state = self.controller.state()?;
        let reset = self.epoch.replace(state.epoch).is_some_and(|epoch| epoch != state.epoch);
        if reset || state.trip.is_some() {
            self.sequence = GatePattern::CLOSED;
            self.withdraw()?;
        }
        Ok(state)
    }
}
