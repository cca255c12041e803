//! A simulated trigger controller that keeps its contract, and stands on the optical table.

use sofiscope_hal::{
    DeviceError, DeviceIdentity, ErrorKind, GateCapabilities, GateController, GatePattern, GateState,
    GateTrip, Volts,
};
use sofiscope_virtual::table::{OpticalTable, Quantity};

pub(crate) const OUTPUTS: u8 = 4;

pub(crate) struct Controller {
    table: OpticalTable,
    identity: DeviceIdentity,
    capabilities: GateCapabilities,
    state: GateState,
    pub(crate) lost: bool,
    pub(crate) num_calls: u64,
}

impl Controller {
    pub(crate) fn new(table: OpticalTable) -> Self {
        Self {
            table,
            identity: DeviceIdentity {
                vendor: "nobody".into(),
                model: "simulated controller".into(),
                serial: String::new(),
                firmware: String::new(),
                simulated: true,
            },
            capabilities: GateCapabilities {
                gates: 8,
                levels: OUTPUTS,
                sequence: 16,
                watchdog: None,
                limits_on_time: false,
                makes_triggers: false,
            },
            state: GateState { open: GatePattern::CLOSED, armed: false, trip: None, epoch: 1 },
            lost: false,
            num_calls: 0,
        }
    }

    /// Gates closed, levels zero, disarmed.
    fn fall(&mut self) {
        (self.state.open, self.state.armed) = (GatePattern::CLOSED, false);
        self.table.set(Quantity::Gates, 0.0);
        (0..usize::from(OUTPUTS)).for_each(|output| self.table.set(Quantity::Level(output), 0.0));
    }

    pub(crate) fn trip(&mut self, trip: GateTrip) {
        self.fall();
        self.state.trip = self.state.trip.or(Some(trip));
    }

    /// As a controller does whose port was opened with DTR.
    pub(crate) fn reset(&mut self) {
        self.fall();
        self.state.trip = None;
        self.state.epoch += 1;
    }

    /// Looks at the door, as its hardware does all the time.
    pub(crate) fn look(&mut self) {
        if self.table.get(Quantity::InterlockOpen) != 0.0 && self.state.armed {
            self.trip(GateTrip::Interlock);
        }
    }

    fn called(&mut self) -> Result<(), DeviceError> {
        self.num_calls += 1;
        self.look();
        if self.lost { Err(self.error(ErrorKind::Lost)) } else { Ok(()) }
    }

    fn error(&self, kind: ErrorKind) -> DeviceError {
        DeviceError::new(kind, "simulated controller", "no")
    }

    fn open(&mut self, open: GatePattern) -> Result<(), DeviceError> {
        if !self.state.armed {
            return Err(self.error(ErrorKind::Fault));
        }
        self.state.open = open;
        self.table.set(Quantity::Gates, f64::from(open.0));
        Ok(())
    }
}

impl GateController for Controller {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn capabilities(&self) -> &GateCapabilities {
        &self.capabilities
    }

    fn arm(&mut self) -> Result<(), DeviceError> {
        self.called()?;
        if self.table.get(Quantity::InterlockOpen) != 0.0 {
            return Err(self.error(ErrorKind::Fault));
        }
        (self.state.armed, self.state.trip) = (true, None);
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), DeviceError> {
        self.called()?;
        (self.state.armed, self.state.open) = (false, GatePattern::CLOSED);
        self.table.set(Quantity::Gates, 0.0);
        Ok(())
    }

    fn set_gates(&mut self, open: GatePattern) -> Result<(), DeviceError> {
        self.called()?;
        self.open(open)
    }

    fn set_level(&mut self, output: u8, level: Volts) -> Result<(), DeviceError> {
        self.called()?;
        if output >= OUTPUTS || !(0.0..=5.0).contains(&level.value()) {
            return Err(self.error(ErrorKind::OutOfRange));
        }
        self.table.set(Quantity::Level(usize::from(output)), level.value());
        Ok(())
    }

    /// Stands at the first pattern: there are no triggers on this bench.
    fn begin_sequence(&mut self, patterns: &[GatePattern]) -> Result<(), DeviceError> {
        self.called()?;
        match patterns {
            [first, ..] => self.open(*first),
            [] => Err(self.error(ErrorKind::OutOfRange)),
        }
    }

    fn end_sequence(&mut self) -> Result<(), DeviceError> {
        self.called()?;
        self.state.open = GatePattern::CLOSED;
        self.table.set(Quantity::Gates, 0.0);
        Ok(())
    }

    fn heartbeat(&mut self) -> Result<(), DeviceError> {
        self.called()
    }

    fn state(&mut self) -> Result<GateState, DeviceError> {
        self.called()?;
        Ok(self.state)
    }
}
