//! The driver and the virtual controller keep what every stage promises.

use std::time::Duration;

use crate::bench::{Bench, length, place};
use sofiscope_hal::conformance::{StageRig, stage};
use sofiscope_hal::{DeviceError, Micrometers, Properties, PropertyValue, Stage};
use sofiscope_maerzhaeuser_tango::Tango;

impl StageRig for Bench {
    fn stage(&mut self) -> &mut dyn Stage {
        &mut self.stage
    }

    fn pass(&mut self, time: Duration) {
        self.port.pass(time);
    }

    fn num_motions(&mut self) -> usize {
        self.port.with(|wire, _| wire.model().num_motions())
    }

    fn patience(&self) -> Duration {
        Duration::from_secs(60)
    }

    fn tolerance(&self) -> Micrometers {
        length(0.2)
    }
}

#[test]
fn the_stage_keeps_its_contract() {
    let mut bench = Bench::new();
    stage(&mut bench);
    assert!(bench.stage.identity().simulated, "{}", bench.stage.identity());
    let received = bench.received();
    assert!(!received.is_empty() && bench.now() > Duration::from_secs(30), "in the model's time only");
}

#[test]
fn no_call_waits_for_more_than_a_few_answers() {
    type Call = fn(&mut Tango) -> Result<(), DeviceError>;
    let calls: [(&str, Call); 6] = [
        ("position", |stage| stage.position().map(drop)),
        ("motion", |stage| stage.motion().map(drop)),
        ("properties", |stage| stage.properties().map(drop)),
        ("set_property", |stage| stage.set_property("vel x", &PropertyValue::Number(2.0))),
        ("move_to", |stage| stage.move_to(place(10_000.0, 10_000.0))),
        ("begin_homing", |stage| stage.begin_homing()),
    ];
    let mut bench = Bench::homed();
    for (name, call) in calls {
        bench.ended().unwrap();
        let begun = bench.now();
        call(&mut bench.stage).unwrap();
        let taken = bench.now() - begun;
        assert!(taken < Duration::from_millis(60), "{name} took {taken:?}");
    }
}
