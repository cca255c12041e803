//! The simulated stage keeps the contract of stages, and carries what the cameras see.

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::time::Duration;

    use sofiscope_hal::conformance::{StageRig, stage};
    use sofiscope_hal::{
        Camera, CameraSettings, Micrometers, Region, Stage, StageEnvelope, StagePoint, TriggerMode,
    };
    use sofiscope_sim::instrument::StageClock;
    use sofiscope_sim::{InstrumentSettings, Scene, SimulatedInstrument, SimulatedStage, Source, World};

    fn um(value: f64) -> Micrometers {
        Micrometers::new(value).unwrap()
    }

    /// A stage whose time passes only when the test says so.
    struct Rig {
        stage: SimulatedStage,
        now_ns: Arc<AtomicU64>,
    }

    impl StageRig for Rig {
        fn stage(&mut self) -> &mut dyn Stage {
            &mut self.stage
        }

        fn pass(&mut self, time: Duration) {
            self.now_ns.fetch_add(u64::try_from(time.as_nanos()).unwrap(), Ordering::SeqCst);
        }

        fn num_motions(&mut self) -> usize {
            self.stage.num_motions()
        }

        fn patience(&self) -> Duration {
            Duration::from_secs(2)
        }

        fn tolerance(&self) -> Micrometers {
            um(0.001)
        }
    }

    /// Four frames of a small part of the sample, without end.
    fn microscope(clock: StageClock) -> SimulatedInstrument {
        let scene = Scene::from_toml(Scene::built_in("figure-s4").unwrap()).unwrap().with_frames(4).unwrap();
        let source = Source::Again(Arc::new(World::new(&scene, 1)));
        SimulatedInstrument::timed(source, InstrumentSettings::default(), clock)
    }

    fn rig() -> (Rig, SimulatedInstrument) {
        let now_ns = Arc::new(AtomicU64::new(0));
        let now = Arc::clone(&now_ns);
        let microscope =
            microscope(StageClock::new(move || Duration::from_nanos(now.load(Ordering::SeqCst))));
        let envelope = StageEnvelope { x: um(0.0)..=um(1000.0), y: um(0.0)..=um(800.0) };
        (Rig { stage: microscope.stage(envelope), now_ns }, microscope)
    }

    #[test]
    fn the_simulated_stage_keeps_the_contract() {
        stage(&mut rig().0);
    }

    /// Frames 0 to 5 of camera R.
    fn frames(microscope: &SimulatedInstrument) -> Vec<Vec<u16>> {
        let [mut camera, _] = microscope.cameras();
        let (width, height) = (camera.capabilities().sensor_width, camera.capabilities().sensor_height);
        let region = Region { left: 0, top: 0, width, height };
        let (exposure, period) = (Duration::from_millis(10), Duration::from_millis(10));
        let settings = CameraSettings { region, exposure, period, trigger: TriggerMode::FreeRunning };
        camera.configure(&settings).unwrap();
        let mut stream = camera.arm().unwrap();
        (0..6)
            .map(|_| {
                let mut counts = vec![0; region.num_pixels()];
                stream.next_frame(&mut counts, Duration::from_secs(10)).unwrap();
                counts
            })
            .collect()
    }

    #[test]
    fn moving_the_stage_moves_the_sample_by_whole_pixels_and_it_begins_again_after_its_end() {
        let (mut rig, microscope) = rig();
        let before = frames(&microscope);
        assert_eq!(before[0], before[4], "after four frames the sample is there anew");
        assert_ne!(before[0], before[1]);
        rig.stage.begin_homing().unwrap();
        rig.pass(Duration::from_secs(1));
        let here = rig.stage.position().unwrap();
        // 3 columns and -2 rows of 108 nm.
        let target = StagePoint { x: um(here.x.value() + 0.324), y: um(here.y.value() - 0.216) };
        rig.stage.move_to(target).unwrap();
        rig.pass(Duration::from_secs(1));
        let (after, side) = (frames(&microscope), 72);
        for y in 0..side {
            for x in 0..side {
                let from = (y + side - 2) % side * side + (x + 3) % side;
                assert_eq!(after[1][y * side + x], before[1][from], "{y} {x}");
            }
        }
    }
}
