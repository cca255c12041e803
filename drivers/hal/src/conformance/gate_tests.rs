//! A trigger controller that keeps its contract passes; each broken promise is caught.

use std::time::Duration;

use super::{GateRig, gates};
use crate::{
    DeviceError, DeviceIdentity, ErrorKind, GateCapabilities, GateController, GatePattern, GateState,
    GateTrip, Volts,
};

const WATCHDOG: Duration = Duration::from_millis(250);

/// What the controller does wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bug {
    None,
    NoWatchdog,
    OpenAtTheStart,
    OpensUnarmed,
    BeginsUnarmed,
    OpensOnArming,
    OpensNeighbors,
    EchoesPattern,
    TakesAnyGate,
    TakesAnyLevel,
    TakesAnySequence,
    SendsBeforeRefusing,
    StaysOpenDisarmed,
    StaysArmed,
    DisarmsOnceOnly,
    OpensOnBegin,
    StaysOpenAfterSequence,
    IgnoresHeartbeats,
    SleepingWatchdog,
    SlowWatchdog,
    ForgetfulWatchdog,
    OverlooksResets,
    SameEpoch,
    BeatsWithoutWatchdog,
}

struct Fake {
    bug: Bug,
    identity: DeviceIdentity,
    capabilities: GateCapabilities,
    pins: GatePattern,
    told: GatePattern,
    armed: bool,
    trip: Option<GateTrip>,
    epoch: u32,
    disarms: u32,
    bytes: u64,
    silence: Duration,
}

impl Fake {
    fn new(bug: Bug) -> Self {
        let without = matches!(bug, Bug::NoWatchdog | Bug::BeatsWithoutWatchdog);
        let open = GatePattern(u8::from(bug == Bug::OpenAtTheStart));
        Self {
            bug,
            identity: DeviceIdentity {
                vendor: "nobody".into(),
                model: "fake".into(),
                serial: String::new(),
                firmware: "1".into(),
                simulated: true,
            },
            capabilities: GateCapabilities {
                gates: 6,
                levels: 2,
                sequence: 8,
                watchdog: (!without).then_some(WATCHDOG),
                limits_on_time: false,
                makes_triggers: false,
            },
            pins: open,
            told: open,
            armed: false,
            trip: None,
            epoch: 1,
            disarms: 0,
            bytes: 0,
            silence: Duration::ZERO,
        }
    }

    fn no(&mut self, kind: ErrorKind) -> DeviceError {
        self.bytes += u64::from(self.bug == Bug::SendsBeforeRefusing);
        DeviceError::new(kind, "fake", "no")
    }

    fn drive(&mut self, open: GatePattern) {
        (self.pins, self.told) = (open, open);
    }
}

impl GateController for Fake {
    fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    fn capabilities(&self) -> &GateCapabilities {
        &self.capabilities
    }

    fn arm(&mut self) -> Result<(), DeviceError> {
        self.drive(GatePattern(u8::from(self.bug == Bug::OpensOnArming)));
        (self.armed, self.trip, self.silence) = (true, None, Duration::ZERO);
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), DeviceError> {
        self.disarms += 1;
        if self.bug == Bug::DisarmsOnceOnly && !self.armed {
            return Err(self.no(ErrorKind::Busy));
        }
        if self.bug != Bug::StaysOpenDisarmed {
            self.drive(GatePattern::CLOSED);
        }
        self.armed = self.bug == Bug::StaysArmed;
        Ok(())
    }

    fn set_gates(&mut self, open: GatePattern) -> Result<(), DeviceError> {
        if open.0 >= 1 << 6 && self.bug != Bug::TakesAnyGate {
            return Err(self.no(ErrorKind::OutOfRange));
        }
        if !self.armed && self.bug != Bug::OpensUnarmed {
            return Err(self.no(ErrorKind::Fault));
        }
        self.drive(open);
        match self.bug {
            Bug::OpensNeighbors => self.drive(GatePattern(open.0 | open.0 << 1)),
            Bug::EchoesPattern => self.pins = GatePattern::CLOSED,
            _ => {}
        }
        Ok(())
    }

    fn set_level(&mut self, output: u8, level: Volts) -> Result<(), DeviceError> {
        let fits = output < 2 && (0.0..=5.0).contains(&level.value());
        if fits || self.bug == Bug::TakesAnyLevel { Ok(()) } else { Err(self.no(ErrorKind::OutOfRange)) }
    }

    fn begin_sequence(&mut self, patterns: &[GatePattern]) -> Result<(), DeviceError> {
        let fits = (1..=8).contains(&patterns.len()) && patterns.iter().all(|pattern| pattern.0 < 1 << 6);
        if !fits && self.bug != Bug::TakesAnySequence {
            return Err(self.no(ErrorKind::OutOfRange));
        }
        if !self.armed && self.bug != Bug::BeginsUnarmed {
            return Err(self.no(ErrorKind::Fault));
        }
        self.drive(if self.bug == Bug::OpensOnBegin { patterns[0] } else { GatePattern::CLOSED });
        Ok(())
    }

    fn end_sequence(&mut self) -> Result<(), DeviceError> {
        self.drive(GatePattern(u8::from(self.bug == Bug::StaysOpenAfterSequence)));
        Ok(())
    }

    fn heartbeat(&mut self) -> Result<(), DeviceError> {
        self.bytes += u64::from(self.bug == Bug::BeatsWithoutWatchdog);
        if self.bug != Bug::IgnoresHeartbeats {
            self.silence = Duration::ZERO;
        }
        Ok(())
    }

    fn state(&mut self) -> Result<GateState, DeviceError> {
        Ok(GateState { open: self.told, armed: self.armed, trip: self.trip, epoch: self.epoch })
    }
}

impl GateRig for Fake {
    fn gates(&mut self) -> &mut dyn GateController {
        self
    }

    fn pins(&mut self) -> GatePattern {
        self.pins
    }

    fn num_bytes(&mut self) -> u64 {
        self.bytes
    }

    fn pass(&mut self, time: Duration) {
        self.silence += time;
        let within = if self.bug == Bug::SlowWatchdog { WATCHDOG * 2 } else { WATCHDOG };
        let sleeps = self.bug == Bug::SleepingWatchdog || self.capabilities.watchdog.is_none();
        if self.armed && self.silence >= within && !sleeps {
            self.drive(GatePattern::CLOSED);
            self.trip = Some(GateTrip::Watchdog);
            self.armed = self.bug == Bug::ForgetfulWatchdog;
        }
    }

    fn reset(&mut self) {
        self.drive(GatePattern::CLOSED);
        self.epoch += u32::from(self.bug != Bug::SameEpoch);
        if self.bug != Bug::OverlooksResets {
            (self.armed, self.trip) = (false, Some(GateTrip::Reset));
        }
    }
}

#[test]
fn a_controller_that_keeps_its_contract_passes() {
    gates(&mut Fake::new(Bug::None));
    gates(&mut Fake::new(Bug::NoWatchdog));
}

macro_rules! caught {
    ($($name:ident: $bug:ident, $says:literal;)*) => {
        $(
            #[test]
            #[should_panic(expected = $says)]
            fn $name() {
                gates(&mut Fake::new(Bug::$bug));
            }
        )*
    };
}

caught! {
    gates_open_at_the_start_are_caught: OpenAtTheStart, "at the start: the outputs";
    gates_that_open_unarmed_are_caught: OpensUnarmed, "opening a gate of a disarmed controller must be refused";
    sequences_unarmed_are_caught: BeginsUnarmed, "beginning a sequence on a disarmed controller must be refused";
    gates_that_open_on_arming_are_caught: OpensOnArming, "arming opens no gate";
    neighbors_that_open_are_caught: OpensNeighbors, "after opening exactly these: the outputs";
    states_that_are_only_echoed_are_caught: EchoesPattern, "after opening exactly these: the outputs";
    gates_that_are_not_there_are_caught: TakesAnyGate, "opening a gate that is not there must be refused";
    levels_that_are_not_there_are_caught: TakesAnyLevel, "an analog output that is not there must be refused";
    endless_sequences_are_caught: TakesAnySequence, "a sequence of gates that are not there must be refused";
    bytes_before_refusals_are_caught: SendsBeforeRefusing, "sends no byte";
    gates_open_after_disarming_are_caught: StaysOpenDisarmed, "disarmed: the outputs";
    controllers_that_stay_armed_are_caught: StaysArmed, "disarmed: nothing is armed";
    disarming_only_once_is_caught: DisarmsOnceOnly, "disarming must succeed";
    sequences_that_begin_open_are_caught: OpensOnBegin, "without an exposure opens nothing";
    sequences_that_end_open_are_caught: StaysOpenAfterSequence, "after a sequence: the outputs";
    ignored_heartbeats_are_caught: IgnoresHeartbeats, "heartbeats hold the gates";
    sleeping_watchdogs_are_caught: SleepingWatchdog, "gates close within";
    slow_watchdogs_are_caught: SlowWatchdog, "gates close within";
    forgetful_watchdogs_are_caught: ForgetfulWatchdog, "the watchdog is told";
    overlooked_resets_are_caught: OverlooksResets, "a reset is told";
    equal_epochs_are_caught: SameEpoch, "a reset changes the epoch";
    needless_bytes_are_caught: BeatsWithoutWatchdog, "heartbeats without a watchdog do nothing";
}
