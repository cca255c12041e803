//! Both sensors on a virtual beam: their promises, and what frames do to readings.

#[cfg(test)]
mod bench;

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::Ordering::SeqCst;
    use std::time::{Duration, Instant};

    use sofiscope_focus_sensor::{
        AnalogInput, QuadrantSensor, QuadrantSettings, SpotFinder, SpotForm, SpotMethod, SpotSensor,
        SpotSettings,
    };
    use sofiscope_hal::conformance::{FocusSensorRig, focus_sensor};
    use sofiscope_hal::{Clock, DeviceError, ErrorKind, FocusSensor, HostTime, Nanometers, Region, Volts};
    use sofiscope_virtual::OpticalTable;
    use sofiscope_virtual::spot::{FocusSpot, SpotPattern, SpotScene};
    use sofiscope_virtual::table::Quantity;

    use crate::bench::{Halves, MemoryCamera, PERIOD, Shared, detector_identity};

    const REGION: Region = Region { left: 203, top: 100, width: 200, height: 64 };
    const PATIENCE: Duration = Duration::from_millis(100);

    struct Rig {
        sensor: Box<dyn FocusSensor>,
        table: OpticalTable,
        shared: Arc<Shared>,
        is_camera: bool,
    }

    fn settings(method: SpotMethod) -> SpotSettings {
        SpotSettings {
            method,
            region: REGION,
            exposure: Duration::from_millis(1),
            period: PERIOD,
            sigma_px: 4.0,
        }
    }

    fn on_camera(method: SpotMethod, pattern: SpotPattern) -> Rig {
        let (table, shared) = (OpticalTable::private().unwrap(), Arc::<Shared>::default());
        let camera = MemoryCamera::new(&table, SpotScene { pattern, ..SpotScene::default() }, &shared);
        let sensor = SpotSensor::open(Box::new(camera), &settings(method), shared.now()).unwrap();
        Rig { sensor: Box::new(sensor), table, shared, is_camera: true }
    }

    fn wiring() -> QuadrantSettings {
        let volts = |volts| Volts::new(volts).unwrap();
        QuadrantSettings {
            plus: 0,
            minus: 1,
            dark: volts(0.1),
            full_scale: volts(10.0),
            least_light: volts(0.5),
            samples: 4,
        }
    }

    fn on_detector() -> Rig {
        let (table, shared) = (OpticalTable::private().unwrap(), Arc::<Shared>::default());
        let input = Box::new(Halves { table: table.clone(), noise: 1 });
        let sensor = QuadrantSensor::new(input, detector_identity(), wiring(), shared.now()).unwrap();
        Rig { sensor: Box::new(sensor), table, shared, is_camera: false }
    }

    impl FocusSensorRig for Rig {
        fn sensor(&mut self) -> &mut dyn FocusSensor {
            self.sensor.as_mut()
        }

        fn now(&self) -> HostTime {
            self.shared.clock.now()
        }

        fn defocus(&mut self, error: Nanometers) {
            self.table.set(Quantity::PiezoZ, error.value());
        }

        fn block(&mut self) {
            self.table.set(Quantity::FocusBeamBlocked, 1.0);
        }

        fn unblock(&mut self) {
            self.table.set(Quantity::FocusBeamBlocked, 0.0);
        }

        fn silence(&mut self) -> bool {
            self.shared.silent.store(self.is_camera, SeqCst);
            self.is_camera
        }

        fn resume(&mut self) {
            self.shared.silent.store(false, SeqCst);
        }

        fn reach(&self) -> Nanometers {
            Nanometers::new(if self.is_camera { 800.0 } else { 600.0 }).unwrap()
        }

        fn patience(&self) -> Duration {
            PATIENCE
        }

        fn slack(&self) -> Duration {
            Duration::ZERO
        }
    }

    #[test]
    fn spots_and_detectors_keep_the_promises_of_focus_sensors() {
        focus_sensor(&mut on_camera(SpotMethod::Centroid, SpotPattern::One));
        focus_sensor(&mut on_camera(SpotMethod::TwoSpots, SpotPattern::Two(100.0)));
        focus_sensor(&mut on_detector());
    }

    #[test]
    fn the_signal_is_the_column_on_the_sensor_whatever_the_region() {
        let mut rig = on_camera(SpotMethod::Centroid, SpotPattern::One);
        rig.table.set(Quantity::PiezoZ, 100.0);
        // Zero of the scene and 65 px/µm, though the camera rounds the region to begin with column 200.
        let signal = rig.sensor.read(PATIENCE).unwrap().signal;
        assert!((signal - 306.5).abs() < 0.08, "{signal}");
    }

    #[test]
    fn incomplete_frames_are_no_reading() {
        let mut rig = on_camera(SpotMethod::Centroid, SpotPattern::One);
        rig.shared.faults.lock().unwrap().incomplete = (0..3).chain(4..1000).collect();
        assert_eq!(rig.sensor.read(PATIENCE).unwrap().number, 3);
        let begun = rig.now();
        let error = rig.sensor.read(PATIENCE).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Timeout, "{error}");
        assert_eq!(rig.now().since(begun), PATIENCE);
    }

    #[test]
    fn a_doubled_frame_is_the_same_reading() {
        let mut rig = on_camera(SpotMethod::Centroid, SpotPattern::One);
        rig.shared.faults.lock().unwrap().doubled = [1].into();
        let [first, again, next] = [(); 3].map(|()| rig.sensor.read(PATIENCE).unwrap());
        assert_eq!(first, again, "also its time is that of the first frame");
        assert_eq!((first.number, next.number), (0, 1));
        assert!(next.at > first.at);
    }

    #[test]
    fn of_frames_that_wait_the_newest_is_read() {
        let mut rig = on_camera(SpotMethod::Centroid, SpotPattern::One);
        rig.sensor.read(PATIENCE).unwrap();
        rig.shared.clock.advance(6 * PERIOD);
        assert_eq!(rig.sensor.read(PATIENCE).unwrap().number, 6);
    }

    #[test]
    fn a_stopped_camera_is_lost_and_the_sensor_stops_its_camera() {
        let mut rig = on_camera(SpotMethod::Centroid, SpotPattern::One);
        rig.shared.stopped.store(true, SeqCst);
        assert_eq!(rig.sensor.read(PATIENCE).unwrap_err().kind(), ErrorKind::Lost);
        rig.shared.stopped.store(false, SeqCst);
        drop(rig.sensor);
        assert!(rig.shared.stopped.load(SeqCst));
    }

    #[test]
    fn settings_that_fit_no_spot_are_refused() {
        let (table, shared) = (OpticalTable::private().unwrap(), Arc::<Shared>::default());
        for (sigma_px, width) in [(0.0, 200), (f64::NAN, 200), (4.0, 7)] {
            let camera = Box::new(MemoryCamera::new(&table, SpotScene::default(), &shared));
            let want = SpotSettings {
                sigma_px,
                region: Region { width, ..REGION },
                ..settings(SpotMethod::Centroid)
            };
            let refused = SpotSensor::open(camera, &want, shared.now()).err().map(|error| error.kind());
            assert_eq!(refused, Some(ErrorKind::OutOfRange));
        }
    }

    struct Fixed(f64);

    impl AnalogInput for Fixed {
        fn read(&mut self, channel: u8) -> Result<f64, DeviceError> {
            Ok(if channel == 0 { self.0 } else { 2.1 })
        }
    }

    #[test]
    fn a_detector_tells_ratio_sum_and_saturation() {
        let shared = Arc::<Shared>::default();
        let read = |volts| {
            let input = Box::new(Fixed(volts));
            QuadrantSensor::new(input, detector_identity(), wiring(), shared.now())
                .unwrap()
                .read(Duration::ZERO)
        };
        let reading = read(6.1).unwrap();
        assert!((reading.signal - 0.5).abs() < 1e-12 && (reading.light - 8.0).abs() < 1e-12, "{reading:?}");
        assert!((reading.shape - 0.75).abs() < 1e-12 && reading.saturated == 0.0, "{reading:?}");
        assert_eq!(read(10.0).unwrap().saturated, 1.0);
        assert_eq!(read(f64::NAN).unwrap_err().kind(), ErrorKind::Protocol);
        let twice = QuadrantSettings { minus: 0, ..wiring() };
        assert!(QuadrantSensor::new(Box::new(Fixed(1.0)), detector_identity(), twice, shared.now()).is_err());
    }

    #[test]
    fn frames_are_measured_without_memory_and_fast() {
        let region = Region { left: 200, ..REGION };
        let mut counts = vec![0; region.num_pixels()];
        let table = OpticalTable::private().unwrap();
        FocusSpot::new(table, SpotScene::default()).render(region, 0, Duration::ZERO, &mut counts);
        let form = SpotForm { width: 200, height: 64, sigma_px: 4.0, saturation_counts: 4095 };
        let mut finder = SpotFinder::new(SpotMethod::Centroid, form);
        let begun = Instant::now();
        let allocations = allocation_counter::measure(|| {
            for _ in 0..1000 {
                std::hint::black_box(finder.measure(std::hint::black_box(&counts)));
            }
        });
        let each = begun.elapsed() / 1000;
        println!("{each:?} for each frame of 200 × 64 px");
        assert_eq!(allocations.count_total, 0, "a frame takes no memory");
        assert!(each < Duration::from_millis(1), "{each:?} for each frame");
    }
}
