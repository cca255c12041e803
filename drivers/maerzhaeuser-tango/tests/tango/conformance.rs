//! The driver and the virtual controller keep what every stage promises.

use std::time::Duration;

use crate::bench::{Bench, length};
use sofiscope_hal::conformance::{StageRig, stage};
use sofiscope_hal::{Micrometers, Stage};

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
