//! Nothing takes memory while frames come: not per frame where cameras are read, and nowhere as much as a frame.
//!
//! Each part runs twice, the second time much longer, on a thread whose allocations are counted.
//! What the longer run took beyond the shorter one is what frames cost once the run has begun.

#[cfg(test)]
mod tests {
    use allocation_counter::{AllocationInfo, measure};
    use sofiscope::acquisition::{
        Conditions, Dispatch, ExposureRecord, Frame, FrameFacts, FramePair, FramePool, Grabbed, Grabber,
        GrabberEnd, HostClock, LeaveOut, Pairing, PairingSettings, Patience, PressureGauge, Progress,
        Surroundings,
    };
    use sofiscope::pipeline::{Bell, Received, Receiver, Sender, WhenFull, bounded, latest};
    use sofiscope::reconstruction::{BLOCK, LiveAnalysis};
    use sofiscope::sofi::cumulant::{CumulantEngine, CumulantSettings};
    use sofiscope_hal::{
        BlockId, Camera, CameraSettings, Channel, DeviceTime, Epoch, ExposureIndex, FrameInfo, FrameStatus,
        FrameStream, HostTime, Region, TriggerMode, TriggerSource,
    };
    use sofiscope_sim::instrument::{CameraFaults, SimulatedCamera};
    use sofiscope_sim::{Film, InstrumentSettings, SimulatedInstrument};
    use std::sync::Arc;
    use std::thread;
    use std::time::Duration;

    const SIDE: u32 = 64;
    const PIXELS: usize = (SIDE * SIDE) as usize;
    const FRAME_BYTES: u64 = (PIXELS * size_of::<u16>()) as u64;
    /// So short that no shuffled frame is waited for in vain: a camera's word for that takes memory.
    const PERIOD: Duration = Duration::from_millis(2);
    /// Exposures of the shorter and of the longer run; the longer one overflows every store for losses.
    const SHORT_AND_LONG: [u64; 2] = [2_000, 40_000];

    fn instrument(exposures: u64, faults: &CameraFaults) -> SimulatedInstrument {
        let film = Film::noise(SIDE as usize, SIDE as usize, 7, 11);
        let mut settings = InstrumentSettings { exposures: Some(exposures), ..InstrumentSettings::default() };
        for camera in &mut settings.cameras {
            camera.faults = faults.clone();
        }
        SimulatedInstrument::new(film, settings)
    }

    fn unkind() -> CameraFaults {
        CameraFaults {
            drop_one_in: Some(100),
            duplicate_one_in: Some(1000),
            reorder_within: Some(8),
            incomplete_one_in: Some(500),
            ..CameraFaults::default()
        }
    }

    /// Both cameras, armed, and their frames; the trigger has begun to fire.
    fn arm(
        instrument: &SimulatedInstrument,
        exposures: u64,
    ) -> ([SimulatedCamera; 2], [Box<dyn FrameStream>; 2]) {
        let region = Region { left: 0, top: 0, width: SIDE, height: SIDE };
        let settings =
            CameraSettings { region, exposure: PERIOD, period: PERIOD, trigger: TriggerMode::External };
        let mut cameras = instrument.cameras();
        let streams = cameras.each_mut().map(|camera| {
            camera.configure(&settings).unwrap();
            camera.arm().unwrap()
        });
        instrument.trigger().start(PERIOD, Some(exposures)).unwrap();
        (cameras, streams)
    }

    fn grabber(
        channel: Channel,
        stream: Box<dyn FrameStream>,
        slots: usize,
        to_pairing: Sender<Grabbed>,
        patience: Patience,
    ) -> Grabber {
        Grabber {
            channel,
            stream,
            pool: FramePool::new(slots, PIXELS).unwrap(),
            pixels: PIXELS,
            to_pairing,
            patience,
            clock: HostClock::start(),
            surroundings: Surroundings::default(),
            stop: Arc::default(),
            status: Arc::default(),
        }
    }

    fn drain<T>(mut queue: Receiver<T>) -> u64 {
        let mut taken = 0;
        loop {
            match queue.receive(Duration::from_secs(1)) {
                Received::Value(_) => taken += 1,
                Received::Empty => {}
                Received::Closed => return taken,
            }
        }
    }

    /// Who stands behind a grabber.
    #[derive(Debug, Clone, Copy)]
    enum Behind {
        /// Somebody who takes every frame.
        Reader,
        /// Nobody: the queue fills and stays full.
        NoReader,
    }

    /// What a grabber takes, and how many frames, or words of lost ones, somebody got.
    fn grab(exposures: u64, slots: usize, places: usize, behind: Behind) -> (AllocationInfo, u64) {
        let instrument = instrument(exposures, &unkind());
        let (_armed, [stream, _other]) = arm(&instrument, exposures);
        let (sender, queue) = bounded("grab→pair", places, WhenFull::Refuse, &Bell::default());
        let grabber = grabber(Channel::Reflected, stream, slots, sender, Patience::Live);
        let grabbing = || thread::spawn(move || measure(|| assert_eq!(grabber.run(), GrabberEnd::Ended)));
        match behind {
            Behind::Reader => {
                let reading = thread::spawn(move || drain(queue));
                (grabbing().join().unwrap(), reading.join().unwrap())
            }
            Behind::NoReader => (grabbing().join().unwrap(), drain(queue)),
        }
    }

    #[test]
    fn the_counter_counts() {
        let seen = measure(|| drop(std::hint::black_box(vec![0_u8; 10])));
        assert_eq!((seen.count_total, seen.bytes_total), (1, 10));
    }

    #[test]
    fn a_grabber_takes_nothing_per_frame() {
        let cases = [
            ("pool empty, nobody takes", 4, 64, Behind::NoReader),
            ("queue full, nobody takes", 64, 4, Behind::NoReader),
            ("somebody takes", 64, 256, Behind::Reader),
        ];
        for (name, slots, places, behind) in cases {
            let [short, long] = SHORT_AND_LONG.map(|exposures| grab(exposures, slots, places, behind));
            println!("{name}: {:?} for {} frames and more", long.0, long.1);
            // What it gives back differs: whoever is last to hold a queue frees it.
            let taken = |info: AllocationInfo| (info.count_total, info.bytes_total, info.bytes_max);
            assert_eq!(taken(short.0), taken(long.0), "{name}");
            assert!(long.0.count_total < 10, "{name}: {:?}", long.0);
            assert!(long.1 >= places.min(slots) as u64, "{name}");
        }
    }

    /// What the pairing thread takes.
    fn dispatch(exposures: u64) -> AllocationInfo {
        let instrument = instrument(exposures, &unkind());
        let bell = Bell::default();
        let (mut queues, mut grabbers) = (Vec::new(), Vec::new());
        let (_armed, streams) = arm(&instrument, exposures);
        for (channel, stream) in Channel::BOTH.into_iter().zip(streams) {
            let (sender, queue) = bounded("grab→pair", 4096, WhenFull::Refuse, &bell);
            grabbers.push(grabber(channel, stream, 256, sender, Patience::Patient));
            queues.push(queue);
        }
        let (to_analysis, pairs) = bounded::<FramePair>("pair→analyze", 96, WhenFull::Wait, &Bell::default());
        let (to_recording, records) =
            bounded::<ExposureRecord>("pair→record", 128, WhenFull::Wait, &Bell::default());
        let dispatch = Dispatch {
            from_grabbers: queues.try_into().unwrap(),
            bell,
            pairing: Pairing::new(PairingSettings { period: PERIOD, reorder: 16, lead: None }, 512),
            to_analysis: Some(to_analysis),
            to_recording: Some(to_recording),
            to_look: None,
            leave_out: LeaveOut::default(),
            gauge: PressureGauge::default(),
            progress: latest(Progress::default()).0,
            stop: Arc::default(),
        };
        thread::scope(|scope| {
            for grabber in grabbers {
                scope.spawn(|| grabber.run());
            }
            scope.spawn(|| drain(pairs));
            let recording = scope.spawn(|| drain(records));
            let taken = scope.spawn(|| measure(|| drop(dispatch.run()))).join().unwrap();
            assert!(recording.join().unwrap() >= exposures - 20);
            taken
        })
    }

    #[test]
    fn pairing_takes_less_per_exposure_than_a_line_of_text() {
        let [short, long] = SHORT_AND_LONG.map(dispatch);
        let exposures = SHORT_AND_LONG[1] - SHORT_AND_LONG[0];
        let bytes = (long.bytes_total - short.bytes_total) as f64 / exposures as f64;
        println!("pairing: {bytes:.1} bytes per exposure; {short:?}, {long:?}");
        assert!(bytes < 256.0, "{bytes} bytes per exposure");
        assert!(long.bytes_max < 32 * FRAME_BYTES, "{long:?}");
    }

    fn facts(channel: Channel, exposure: u64) -> FrameFacts {
        let info = FrameInfo {
            exposure: ExposureIndex(exposure),
            block_id: BlockId(exposure),
            epoch: Epoch(0),
            device_time: DeviceTime(exposure * 20_000_000),
            status: FrameStatus::Complete,
        };
        FrameFacts {
            channel,
            info,
            received: HostTime(exposure * 20_000_000),
            conditions: Conditions::default(),
        }
    }

    /// What the analysis thread takes for so many exposures of square frames, its helpers included.
    fn analyze(side: usize, order: usize, subsequence: u64, exposures: u64) -> AllocationInfo {
        let (mut sender, pairs) =
            bounded("pair→analyze", exposures as usize, WhenFull::Refuse, &Bell::default());
        let film = Film::noise(side, side, 7, 11);
        let shown: Vec<[Frame; 2]> = (0..7)
            .map(|exposure| {
                let counts = |channel| film.frame(channel, ExposureIndex(exposure));
                Channel::BOTH.map(|channel| Frame::of_counts(facts(channel, exposure), counts(channel)))
            })
            .collect();
        for exposure in 0..exposures {
            let frames = shown[(exposure % 7) as usize].clone();
            sender.send(FramePair { exposure: ExposureIndex(exposure), frames }).unwrap();
        }
        drop(sender);
        let settings = CumulantSettings::new(order, 2, subsequence);
        let engine = CumulantEngine::new(settings, side, side).unwrap();
        let clock = HostClock::start();
        let analysis = LiveAnalysis { engine, pairs, trace_every: 100, preview: None, quality: None, clock };
        let working = thread::spawn(move || {
            // Counted is what this thread takes, so it does all the work itself.
            let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
            let taken = measure(|| assert_eq!(analysis.run().unwrap().feed.exposures, exposures));
            drop(pool);
            taken
        });
        working.join().unwrap()
    }

    /// Within a subsequence: tables and lists per block, but nothing that grows with the number of pixels.
    #[test]
    fn the_analysis_takes_less_per_block_than_a_frame() {
        for order in [2, 4] {
            let per_block = [64, 128].map(|side| {
                let [short, long] = [320, 960].map(|exposures| analyze(side, order, 20_000, exposures));
                assert_eq!(short.bytes_max, long.bytes_max, "order {order}: nothing stays");
                (long.bytes_total - short.bytes_total) / (640 / BLOCK as u64)
            });
            println!("order {order}: {per_block:?} bytes per block at 64 and 128 pixels");
            let frames = [64, 128].map(|side| (side * side * size_of::<u16>()) as u64);
            assert!(per_block[1] < frames[1], "order {order}: {per_block:?}");
            assert!(
                per_block[1] - per_block[0] < (frames[1] - frames[0]) / 8,
                "order {order}: {per_block:?}"
            );
        }
    }

    /// Recentering takes planes for the shifts and gives them back; this happens a few times per subsequence.
    #[test]
    fn subsequences_leave_nothing_behind() {
        for order in [2, 4] {
            let [short, long] = [400, 1_400].map(|exposures| analyze(64, order, 100, exposures));
            let grown = long.bytes_max - short.bytes_max;
            let frames = (long.bytes_total - short.bytes_total) as f64 / 10.0 / FRAME_BYTES as f64;
            println!("order {order}: {frames:.1} frames' memory passes per subsequence; {grown} bytes stay");
            assert!(grown < FRAME_BYTES, "order {order}: {grown} bytes more after 10 subsequences");
        }
    }
}
