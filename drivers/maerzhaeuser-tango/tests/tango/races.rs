//! STOP that comes in the very moment in which a move is begun.

use std::io;
use std::io::Write;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use sofiscope_hal::{ErrorKind, Motion, Stage, StopMotion};
use sofiscope_maerzhaeuser_tango::Tango;
use sofiscope_serial_line::{Line, Port as SerialPort};

use crate::bench::{self, Bench, place, settings};

/// A port through which STOP comes right before or right after a command that begins with `word`.
struct Meddled {
    port: bench::Port,
    plan: Arc<Mutex<Option<Plan>>>,
}

struct Plan {
    word: &'static str,
    comes_before: bool,
    stopper: Box<dyn StopMotion>,
}

impl SerialPort for Meddled {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let plan =
            self.plan.lock().expect("no panic").take_if(|plan| bytes.starts_with(plan.word.as_bytes()));
        if let Some(plan) = plan.as_ref().filter(|plan| plan.comes_before) {
            plan.stopper.stop_motion().expect("a healthy line");
        }
        self.port.send(bytes)?;
        if let Some(plan) = plan.filter(|plan| !plan.comes_before) {
            plan.stopper.stop_motion().expect("a healthy line");
        }
        Ok(())
    }

    fn receive(&mut self, bytes: &mut [u8], within: Duration) -> io::Result<usize> {
        self.port.receive(bytes, within)
    }

    fn forget_received(&mut self) -> io::Result<()> {
        self.port.forget_received()
    }

    fn sender(&self) -> io::Result<Box<dyn Write + Send>> {
        self.port.sender()
    }
}

#[test]
fn no_move_survives_a_stop_that_comes_while_it_begins() {
    for (word, comes_before) in
        [("?dim", true), ("?pos", true), ("?err", true), ("!moa", true), ("!moa", false)]
    {
        let port = Bench::homed().port;
        let plan = Arc::new(Mutex::new(None));
        let meddled = Meddled { port: port.again(), plan: Arc::clone(&plan) };
        let watch = port.again();
        let clock = Box::new(move || watch.with(|_, now| now));
        let mut stage = Tango::with_clock(Line::new(Box::new(meddled), "stage"), settings(), clock).unwrap();
        *plan.lock().unwrap() = Some(Plan { word, comes_before, stopper: stage.stopper() });
        let error = stage.move_to(place(10_000.0, 10_000.0)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Busy, "{word}: {error}");
        let mut bench = Bench { stage, port };
        bench.port.pass(Duration::from_secs(1));
        let there = bench.port.with(|wire, now| wire.model().place_um(now));
        assert!(there[0] > 119_000.0 && there[1] > 79_000.0, "{word}: the stage went on to {there:?}");
        assert_eq!(bench.ended().unwrap(), Motion::Still, "{word}");
        bench.stage.move_to(place(10_000.0, 10_000.0)).unwrap();
        assert_eq!(bench.ended().unwrap(), Motion::Still, "{word}: the next move is a new one");
    }
}

#[test]
fn no_leg_of_homing_survives_a_stop() {
    for word in ["!cal x", "!cal y", "!rm x", "!rm y"] {
        let port = Bench::homed().port;
        let plan = Arc::new(Mutex::new(None));
        let meddled = Meddled { port: port.again(), plan: Arc::clone(&plan) };
        let watch = port.again();
        let clock = Box::new(move || watch.with(|_, now| now));
        let stage = Tango::with_clock(Line::new(Box::new(meddled), "stage"), settings(), clock).unwrap();
        let mut bench = Bench { stage, port };
        *plan.lock().unwrap() = Some(Plan { word, comes_before: true, stopper: bench.stage.stopper() });
        let homed = bench.stage.begin_homing().and_then(|()| bench.ended());
        assert_eq!(homed.unwrap_err().kind(), ErrorKind::Busy, "{word}");
        bench.port.pass(Duration::from_secs(1));
        let before = bench.port.with(|wire, now| wire.model().place_um(now));
        bench.port.pass(Duration::from_secs(10));
        assert_eq!(bench.port.with(|wire, now| wire.model().place_um(now)), before, "{word}: it stands");
        assert_eq!(bench.ended().unwrap(), Motion::Unknown, "{word}");
    }
}

#[test]
fn a_refused_move_after_a_stop_leaves_the_stop_in_force() {
    let mut bench = Bench::homed();
    bench.stage.move_to(place(10_000.0, 10_000.0)).unwrap();
    bench.port.pass(Duration::from_secs(1));
    bench.stage.stopper().stop_motion().unwrap();
    bench.with(|model| model.faults().refuse = Some(32));
    assert_eq!(bench.stage.move_to(place(20_000.0, 10_000.0)).unwrap_err().kind(), ErrorKind::OutOfRange);
    assert_eq!(bench.ended().unwrap(), Motion::Still, "a stopped move is no fault");
}
