use super::*;
use crate::guard::client::GuardClient;
use sofiscope_hal::{
    DeviceIdentity, Emission, GateCapabilities, GateController, GateState, Interlock, Laser, LaserState,
    Properties, Property, TriggerSource, Volts,
};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Instant;

/// What a double of the devices does, and when it changed.
#[derive(Debug, Default)]
struct Bench {
    open: GatePattern,
    armed: bool,
    emits: bool,
    interlock_open: bool,
    closed_at: Option<Instant>,
}

/// Shared with the doubles; the condition tells of every change.
#[derive(Debug, Clone, Default)]
struct Shared(Arc<(Mutex<Bench>, Condvar)>);

impl Shared {
    fn with<T>(&self, change: impl FnOnce(&mut Bench) -> T) -> T {
        let outcome = change(&mut self.0.0.lock().unwrap());
        self.0.1.notify_all();
        outcome
    }

    /// Waits until it is so.
    fn wait(&self, is_so: impl Fn(&Bench) -> bool) {
        let bench = self.0.0.lock().unwrap();
        let patience = Duration::from_secs(20);
        let (_bench, timeout) = self.0.1.wait_timeout_while(bench, patience, |bench| !is_so(bench)).unwrap();
        assert!(!timeout.timed_out(), "it never came to that");
    }
}

fn identity(model: &str) -> DeviceIdentity {
    DeviceIdentity {
        vendor: "sofiscope".to_owned(),
        model: model.to_owned(),
        serial: "1".to_owned(),
        firmware: "test".to_owned(),
        simulated: true,
    }
}

struct Controller(Shared, DeviceIdentity, GateCapabilities);

impl GateController for Controller {
    fn identity(&self) -> &DeviceIdentity {
        &self.1
    }

    fn capabilities(&self) -> &GateCapabilities {
        &self.2
    }

    fn arm(&mut self) -> Result<(), DeviceError> {
        self.0.with(|bench| bench.armed = true);
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), DeviceError> {
        self.0.with(|bench| {
            if !bench.open.is_closed() {
                bench.closed_at = Some(Instant::now());
            }
            (bench.armed, bench.open) = (false, GatePattern::CLOSED);
        });
        Ok(())
    }

    fn set_gates(&mut self, open: GatePattern) -> Result<(), DeviceError> {
        self.0.with(|bench| {
            assert!(bench.armed, "opened without arming");
            bench.open = open;
        });
        Ok(())
    }

    fn set_level(&mut self, _output: u8, _level: Volts) -> Result<(), DeviceError> {
        Ok(())
    }

    fn begin_sequence(&mut self, _patterns: &[GatePattern]) -> Result<(), DeviceError> {
        Err(DeviceError::new(ErrorKind::OutOfRange, "double", "has no sequences"))
    }

    fn end_sequence(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn heartbeat(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn state(&mut self) -> Result<GateState, DeviceError> {
        Ok(self.0.with(|bench| GateState { open: bench.open, armed: bench.armed, trip: None, epoch: 1 }))
    }
}

impl TriggerSource for Controller {
    fn start(&mut self, _period: Duration, _pulses: Option<u64>) -> Result<(), DeviceError> {
        Ok(())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

struct Double(Shared, DeviceIdentity);

impl Properties for Double {
    fn properties(&mut self) -> Result<Vec<Property>, DeviceError> {
        Ok(Vec::new())
    }
}

impl Laser for Double {
    fn identity(&self) -> &DeviceIdentity {
        &self.1
    }

    fn wavelength_nm(&self) -> u32 {
        488
    }

    fn power_cap(&self) -> Milliwatts {
        Milliwatts::new(50.0).unwrap()
    }

    fn set_power(&mut self, _power: Milliwatts) -> Result<(), DeviceError> {
        Ok(())
    }

    fn switch_on(&mut self) -> Result<(), DeviceError> {
        self.0.with(|bench| {
            if bench.interlock_open {
                return Err(DeviceError::new(ErrorKind::Fault, "488 nm", "stays dark: interlock"));
            }
            bench.emits = true;
            Ok(())
        })
    }

    fn switch_off(&mut self) -> Result<(), DeviceError> {
        self.0.with(|bench| bench.emits = false);
        Ok(())
    }

    fn state(&mut self) -> Result<LaserState, DeviceError> {
        Ok(self.0.with(|bench| LaserState {
            emission: if bench.emits { Emission::On } else { Emission::Off },
            power_set: Milliwatts::ZERO,
            power_measured: None,
            interlock: if bench.interlock_open { Interlock::Open } else { Interlock::Closed },
            fault: None,
        }))
    }

    fn make_dark(&mut self) -> Result<(), DeviceError> {
        self.switch_off()
    }
}

struct Doubles(Shared);

impl Builder for Doubles {
    fn controller(&mut self, instrument: &str) -> Result<Box<dyn super::Controller>, DeviceError> {
        if instrument == "broken" {
            return Err(DeviceError::new(ErrorKind::Lost, "trigger controller", "no such port"));
        }
        let capabilities = GateCapabilities {
            gates: 4,
            levels: 0,
            sequence: 0,
            watchdog: None,
            limits_on_time: false,
            makes_triggers: true,
        };
        Ok(Box::new(Controller(self.0.clone(), identity("controller"), capabilities)))
    }

    fn lasers(&mut self, _gates: &Gates) -> Result<Vec<LaserStation>, DeviceError> {
        Ok(vec![LaserStation { gate: 2, laser: Box::new(Double(self.0.clone(), identity("laser"))) }])
    }
}

/// A guard with doubles, and its client, for as long as `test` runs.
fn guarded(test: impl FnOnce(&mut GuardClient, &Shared)) -> Shared {
    let (ours, theirs) = UnixStream::pair().unwrap();
    let bench = Shared::default();
    let doubles = bench.clone();
    let guard = std::thread::spawn(move || serve(theirs, &mut Doubles(doubles)));
    let (mut client, state) = GuardClient::set_up(ours, "instrument").unwrap();
    assert_eq!(state.phase, Phase::Dark);
    test(&mut client, &bench);
    drop(client);
    guard.join().unwrap().unwrap();
    bench.with(|bench| assert!(bench.open.is_closed() && !bench.emits, "light after the guard's end"));
    bench
}

fn lit(client: &mut GuardClient, bench: &Shared) {
    client.arm().unwrap();
    client.light(&BTreeMap::from([(488, 5.0)])).unwrap();
    bench.with(|bench| assert_eq!((bench.open, bench.emits), (GatePattern(4), true)));
}

#[test]
fn light_goes_when_nobody_proves_to_be_there() {
    guarded(|client, bench| {
        lit(client, bench);
        let silent_since = Instant::now();
        bench.wait(|bench| bench.open.is_closed());
        let closed_at = bench.with(|bench| bench.closed_at).unwrap();
        assert!(closed_at >= silent_since, "as long as somebody proved, it was held");
        bench.wait(|bench| !bench.emits);
        assert_eq!(client.trip(), Some(Trip::NoProof));
        let error = client.light(&BTreeMap::from([(488, 5.0)])).unwrap_err();
        assert!(error.to_string().contains("latched"), "{error}");
    });
}

#[test]
fn light_goes_when_the_instrument_is_gone() {
    // The end of the test is the end of the client; `guarded` looks at the sample afterwards.
    guarded(lit);
}

#[test]
fn an_open_interlock_is_latched() {
    guarded(|client, bench| {
        lit(client, bench);
        bench.with(|bench| bench.interlock_open = true);
        while client.trip().is_none() {
            client.prove();
        }
        assert!(matches!(client.trip(), Some(Trip::Interlock(_))), "{:?}", client.trip());
        bench.wait(|bench| bench.open.is_closed() && !bench.emits);
        bench.with(|bench| bench.interlock_open = false);
        assert!(client.light(&BTreeMap::from([(488, 5.0)])).is_err(), "closing it is not arming");
    });
}

#[test]
fn what_is_not_there_is_refused_and_changes_nothing() {
    guarded(|client, bench| {
        assert!(client.light(&BTreeMap::from([(488, 5.0)])).is_err(), "not armed");
        client.arm().unwrap();
        for powers in [[(405, 1.0)], [(488, 50.1)], [(488, -1.0)]] {
            let error = client.light(&BTreeMap::from(powers)).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::OutOfRange, "{error}");
        }
        bench.with(|bench| assert!(bench.open.is_closed() && !bench.emits));
    });
}

#[test]
fn a_laser_that_stays_dark_opens_no_gate() {
    guarded(|client, bench| {
        bench.with(|bench| bench.interlock_open = true);
        client.arm().unwrap();
        let error = client.light(&BTreeMap::from([(488, 5.0)])).unwrap_err();
        assert!(error.to_string().contains("stays dark"), "{error}");
        bench.with(|bench| assert!(bench.open.is_closed()));
    });
}

#[test]
fn devices_that_cannot_be_opened_are_told() {
    let (ours, theirs) = UnixStream::pair().unwrap();
    let guard = std::thread::spawn(move || serve(theirs, &mut Doubles(Shared::default())));
    let error = GuardClient::set_up(ours, "broken").unwrap_err();
    assert!(error.to_string().contains("no such port"), "{error}");
    guard.join().unwrap().unwrap();
}
