//! The driver against the stand-in library: the contract, two cameras, and everything that goes wrong.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod bench;

use std::time::Duration;

use bench::{Bench, PATIENCE, SERIALS, armed, drain, exposures, failed, lines, take, wish};
use sofiscope_dcam::{
    Dcam, DcamCamera, DcamOptions, Losses, PulseInput, arm_both, arm_slave_then_master, give_frame_pulses,
};
use sofiscope_dcam_stand_in::Remote;
use sofiscope_hal::conformance::{self, CameraRig};
use sofiscope_hal::{
    Camera, CameraSettings, ErrorKind, FrameStatus, Properties, PropertyValue, Region, TriggerMode,
    TriggerSource,
};
use sofiscope_virtual::OpticalTable;
use sofiscope_virtual::table::Quantity;

const QUIET: Duration = Duration::from_millis(250);

struct Rig {
    camera: DcamCamera,
    trigger: Option<Remote>,
    settings: CameraSettings,
}

impl CameraRig for Rig {
    fn camera(&mut self) -> &mut dyn Camera {
        &mut self.camera
    }

    fn trigger(&mut self) -> Option<&mut dyn TriggerSource> {
        self.trigger.as_mut().map(|trigger| trigger as &mut dyn TriggerSource)
    }

    fn settings(&self) -> CameraSettings {
        self.settings
    }

    fn patience(&self) -> Duration {
        PATIENCE
    }
}

fn conforms(pulse_input: PulseInput, settings: CameraSettings) {
    let bench = Bench::new();
    let options = DcamOptions { pulse_input, ..DcamOptions::default() };
    let external = settings.trigger == TriggerMode::External;
    let mut rig = Rig { camera: bench.open(0, options), trigger: external.then_some(bench.remote), settings };
    conformance::camera(&mut rig);
    assert_eq!(rig.camera.losses(), Losses::default());
}

#[test]
fn a_free_running_camera_keeps_its_contract() {
    let exposure = lines(410.0);
    let free = CameraSettings { exposure, period: exposure, ..wish(TriggerMode::FreeRunning) };
    conforms(PulseInput::SynchronousReadout, free);
}

#[test]
fn a_camera_on_edges_keeps_its_contract() {
    conforms(PulseInput::Edge, wish(TriggerMode::External));
}

#[test]
fn a_camera_with_synchronous_readout_keeps_its_contract() {
    let period = Duration::from_millis(5);
    conforms(
        PulseInput::SynchronousReadout,
        CameraSettings { exposure: period, ..wish(TriggerMode::External) },
    );
}

#[test]
fn the_trigger_of_the_bench_keeps_its_contract() {
    let mut bench = Bench::new();
    conformance::trigger(&mut bench.remote, Duration::from_millis(5));
}

#[test]
fn settings_go_to_the_camera_in_the_order_of_the_recipe_and_come_back() {
    let bench = Bench::new();
    let mut camera = bench.open(0, DcamOptions::default());
    bench.say("journal");
    let done = camera.configure(&wish(TriggerMode::External)).unwrap();
    assert_eq!(done.exposure, done.period, "with synchronous readout the pulses make the exposure");
    let journal = bench.say("journal");
    let set: Vec<&str> = journal.lines().collect();
    assert_eq!(
        set,
        [
            "set SENSOR MODE 1",
            "set READOUT SPEED 2",
            "set BINNING 1",
            "set SUBARRAY MODE 1",
            "set SUBARRAY HPOS 0",
            "set SUBARRAY HSIZE 32",
            "set SUBARRAY HPOS 1008",
            "set SUBARRAY VPOS 0",
            "set SUBARRAY VSIZE 32",
            "set SUBARRAY VPOS 1008",
            "set SUBARRAY MODE 2",
            "set DEFECT CORRECT MODE 1",
            "set EXPOSURE TIME 0.001997594",
            "set TRIGGER SOURCE 2",
            "set TRIGGER MODE 1",
            "set TRIGGER ACTIVE 3",
            "set TRIGGER POLARITY 2",
        ]
    );
    let free = CameraSettings { exposure: Duration::from_millis(10), ..wish(TriggerMode::FreeRunning) };
    let done = camera.configure(&free).unwrap();
    assert_eq!(done.exposure, lines(1026.0), "10 ms are 1026 lines and a bit");
}

#[test]
fn a_region_is_a_multiple_of_four_and_refused_otherwise() {
    let bench = Bench::new();
    let mut camera = bench.open(0, DcamOptions::default());
    bench.say("journal");
    for region in [
        Region { left: 1002, ..bench::REGION },
        Region { height: 30, ..bench::REGION },
        Region { left: 2040, ..bench::REGION },
    ] {
        let text = failed(
            camera.configure(&CameraSettings { region, ..wish(TriggerMode::External) }),
            ErrorKind::OutOfRange,
        );
        assert!(text.contains("steps of 4") && text.contains("S/N 000001"), "{text}");
    }
    assert_eq!(bench.say("journal"), "", "nothing was sent");
}

#[test]
fn a_run_ends_in_the_order_of_the_recipe() {
    let bench = Bench::new();
    let mut camera = bench.open(0, DcamOptions::default());
    let stream = armed(&mut camera, &wish(TriggerMode::External));
    bench.say("journal");
    camera.stop().unwrap();
    drop(stream);
    drop(camera);
    let journal = bench.say("journal");
    assert_eq!(journal.lines().collect::<Vec<_>>(), ["stop", "abort", "release", "wait-close", "close"]);
    assert_eq!(bench.say("open"), "1 0 0 0");
}

#[test]
fn both_cameras_see_the_same_exposures_on_edges() {
    let bench = Bench::new();
    let mut cameras = bench.both(PulseInput::Edge);
    for camera in &mut cameras {
        camera.configure(&wish(TriggerMode::External)).unwrap();
    }
    let [first, second] = &mut cameras;
    let mut streams = arm_both([first, second]).unwrap();
    bench.pulses(Duration::from_millis(5), PulseInput::Edge.pulses_for(20));
    let [reflected, transmitted] = streams.each_mut().map(|stream| take(stream.as_mut(), 20));
    for (number, ((here, _), (there, _))) in reflected.iter().zip(&transmitted).enumerate() {
        assert_eq!((here.exposure.0, there.exposure.0), (number as u64, number as u64));
        assert!(here.device_time.nanoseconds_since(there.device_time).abs() < 1_000_000);
    }
    let [reflected_more, transmitted_more] = streams.each_mut().map(|stream| drain(stream.as_mut(), QUIET));
    assert_eq!((reflected_more.len(), transmitted_more.len()), (0, 0), "as many frames as pulses");
}

#[test]
fn synchronous_readout_gives_n_frames_for_n_plus_1_pulses_and_exposure_0_is_the_first() {
    let bench = Bench::new();
    let mut cameras = bench.both(PulseInput::SynchronousReadout);
    for camera in &mut cameras {
        camera.configure(&wish(TriggerMode::External)).unwrap();
    }
    let [first, second] = &mut cameras;
    let mut streams = arm_both([first, second]).unwrap();
    let pulses = PulseInput::SynchronousReadout.pulses_for(12);
    bench.pulses(Duration::from_millis(5), pulses);
    let frames = streams.each_mut().map(|stream| drain(stream.as_mut(), QUIET));
    for frames in &frames {
        assert_eq!(exposures(frames), (0..12).collect::<Vec<_>>(), "{pulses} pulses");
        assert_eq!(frames[0].block_id.0, 0);
    }
    for (here, there) in frames[0].iter().zip(&frames[1]) {
        assert_eq!(here.device_time, there.device_time, "one pulse, one time");
    }
}

#[test]
fn both_cameras_look_at_one_world() {
    let bench = Bench::new();
    let mut cameras = bench.both(PulseInput::Edge);
    let mut shots = Vec::new();
    for run in 0..2 {
        for camera in &mut cameras {
            camera.configure(&wish(TriggerMode::External)).unwrap();
        }
        let [first, second] = &mut cameras;
        let mut streams = arm_both([first, second]).unwrap();
        bench.pulses(Duration::from_millis(5), 3);
        shots.push(streams.each_mut().map(|stream| take(stream.as_mut(), 3)));
        for camera in &mut cameras {
            camera.stop().unwrap();
        }
        let pixels = |camera: usize| shots[run][camera].iter().map(|(_, counts)| counts.clone()).collect();
        let [reflected, transmitted]: [Vec<Vec<u16>>; 2] = [pixels(0), pixels(1)];
        assert_ne!(reflected, transmitted);
        assert_ne!(reflected[0], reflected[1]);
    }
    let [before, after] = [&shots[0], &shots[1]];
    for (before, after) in before.iter().flatten().zip(after.iter().flatten()) {
        assert_eq!(before.1, after.1, "the same exposure of the same world");
    }
}

#[test]
fn a_start_trigger_is_set_again_before_every_run() {
    let bench = Bench::new();
    let options = DcamOptions { pulse_input: PulseInput::Start, ..DcamOptions::default() };
    let mut camera = bench.open(0, options);
    camera.configure(&wish(TriggerMode::External)).unwrap();
    for _ in 0..2 {
        let mut stream = camera.arm().unwrap();
        assert_eq!(drain(stream.as_mut(), Duration::from_millis(30)), [], "no frame before the first pulse");
        bench.pulses(Duration::from_secs(1), 1);
        let frames = take(stream.as_mut(), 5);
        assert_eq!(frames[0].0.exposure.0, 0);
        camera.stop().unwrap();
    }
}

#[test]
fn a_slave_that_is_armed_first_misses_no_frame_of_its_master() {
    let bench = Bench::new();
    bench.say("cable");
    let options = DcamOptions { pulse_input: PulseInput::SynchronousReadout, ..DcamOptions::default() };
    let [mut master, mut slave] = [bench.open(0, options), bench.open(1, options)];
    let period = lines(500.0);
    let want = CameraSettings { exposure: period, period, ..wish(TriggerMode::FreeRunning) };
    master.configure(&want).unwrap();
    give_frame_pulses(&master, 0).unwrap();
    slave.configure(&CameraSettings { trigger: TriggerMode::External, ..want }).unwrap();
    let mut streams = arm_slave_then_master(&mut master, &mut slave).unwrap();
    let [of_master, of_slave] = streams.each_mut().map(|stream| take(stream.as_mut(), 8));
    let lag =
        |number: usize| of_slave[number].0.device_time.nanoseconds_since(of_master[number].0.device_time);
    for number in 0..8 {
        assert_eq!(of_slave[number].0.exposure, of_master[number].0.exposure);
        assert!((lag(number) - lag(0)).abs() <= 2000, "a constant lag: {} ns, {} ns", lag(0), lag(number));
    }
    failed(give_frame_pulses(&master, 0), ErrorKind::Busy);
    for camera in [&mut master, &mut slave] {
        camera.stop().unwrap();
    }
    failed(give_frame_pulses(&master, 7), ErrorKind::OutOfRange);
}

#[test]
fn when_one_camera_cannot_be_armed_the_other_is_stopped() {
    let bench = Bench::new();
    let [mut first, mut second] = bench.both(PulseInput::Edge);
    first.configure(&wish(TriggerMode::External)).unwrap();
    second.configure(&wish(TriggerMode::External)).unwrap();
    bench.say("camera 1 unplug");
    failed(arm_both([&mut first, &mut second]), ErrorKind::Lost);
    assert!(!first.is_armed() && !second.is_armed());
    first.configure(&wish(TriggerMode::External)).unwrap();
}

#[test]
fn a_lost_frame_is_a_gap_and_a_count_and_does_not_end_the_run() {
    let bench = Bench::new();
    bench.say("camera 0 lose 3; camera 0 lose 4");
    let mut camera = bench.open(0, DcamOptions { pulse_input: PulseInput::Edge, ..DcamOptions::default() });
    let mut stream = armed(&mut camera, &wish(TriggerMode::External));
    bench.pulses(Duration::from_millis(5), 8);
    assert_eq!(exposures(&drain(stream.as_mut(), QUIET)), [0, 1, 2, 5, 6, 7]);
    assert_eq!(camera.losses(), Losses { missing: 2, reported: 2, ..Losses::default() });
}

#[test]
fn a_missed_trigger_is_seen_in_the_times() {
    let bench = Bench::new();
    bench.say("camera 0 miss 3");
    let mut camera = bench.open(0, DcamOptions { pulse_input: PulseInput::Edge, ..DcamOptions::default() });
    let mut stream = armed(&mut camera, &wish(TriggerMode::External));
    bench.pulses(Duration::from_millis(5), 8);
    let frames = drain(stream.as_mut(), QUIET);
    assert_eq!(exposures(&frames), (0..7).collect::<Vec<_>>(), "frame stamps have no gap");
    let gaps = frames.windows(2).map(|pair| pair[1].device_time.nanoseconds_since(pair[0].device_time));
    let long: Vec<usize> = gaps.enumerate().filter(|(_, gap)| *gap > 7_500_000).map(|(at, _)| at).collect();
    assert_eq!(long, [2], "more than one and a half periods");
}

#[test]
fn frames_overwritten_before_they_were_read_are_counted() {
    let bench = Bench::new();
    let options = DcamOptions { buffers: Some(4), pulse_input: PulseInput::Edge, ..DcamOptions::default() };
    let mut slow = bench.open(0, options);
    let mut watch = bench.open(1, DcamOptions { buffers: None, ..options });
    let mut stream = armed(&mut slow, &wish(TriggerMode::External));
    let mut other = armed(&mut watch, &wish(TriggerMode::External));
    bench.pulses(Duration::from_millis(5), 20);
    // The other camera tells when all pulses have come.
    take(other.as_mut(), 20);
    slow.stop().unwrap();
    let frames = drain(stream.as_mut(), QUIET);
    assert_eq!(exposures(&frames), [17, 18, 19], "4 buffers, of which one may be in use");
    assert!(frames.iter().all(|info| info.status == FrameStatus::Complete));
    assert_eq!(slow.losses(), Losses { overwritten: 17, ..Losses::default() });
}

#[test]
fn triggers_that_come_too_often_are_counted() {
    let bench = Bench::new();
    let mut camera = bench.open(0, DcamOptions { pulse_input: PulseInput::Edge, ..DcamOptions::default() });
    let done = camera.configure(&CameraSettings { period: Duration::ZERO, ..wish(TriggerMode::External) });
    let shortest = done.unwrap().period;
    let mut stream = camera.arm().unwrap();
    bench.pulses(shortest * 2 / 3, 10);
    let frames = drain(stream.as_mut(), QUIET);
    assert_eq!(frames.len(), 5);
    assert_eq!(camera.losses(), Losses { too_frequent: 5, ..Losses::default() });
    camera.stop().unwrap();
    let mut stream = camera.arm().unwrap();
    bench.pulses(shortest, 10);
    assert_eq!(drain(stream.as_mut(), QUIET).len(), 10, "at the period read back all are heard");
    assert_eq!(camera.losses(), Losses::default());
}

#[test]
fn settings_refused_half_way_have_to_be_made_again() {
    let bench = Bench::new();
    let mut camera = bench.open(0, DcamOptions::default());
    camera.configure(&wish(TriggerMode::External)).unwrap();
    bench.say("camera 0 busy 1");
    let text = failed(camera.configure(&wish(TriggerMode::External)), ErrorKind::Busy);
    assert!(text.contains("SENSOR MODE cannot be set to 1: BUSY (0x80000101)"), "{text}");
    failed(camera.arm(), ErrorKind::Busy);
    camera.configure(&wish(TriggerMode::External)).unwrap();
    camera.arm().unwrap();
}

#[test]
fn an_unplugged_camera_is_lost_for_stream_and_camera() {
    let bench = Bench::new();
    bench.say("camera 0 unplug-after 3");
    let mut camera = bench.open(0, DcamOptions { pulse_input: PulseInput::Edge, ..DcamOptions::default() });
    let mut stream = armed(&mut camera, &wish(TriggerMode::External));
    bench.pulses(Duration::from_millis(5), 8);
    let mut counts = vec![0; bench::REGION.num_pixels()];
    let error = (0..8).find_map(|_| stream.next_frame(&mut counts, PATIENCE).err()).unwrap();
    assert_eq!(error.kind(), ErrorKind::Lost);
    assert!(error.to_string().contains("check cable and power"), "{error}");
    failed(camera.stop(), ErrorKind::Lost);
    failed(camera.configure(&wish(TriggerMode::External)), ErrorKind::Lost);
    drop((stream, camera));
    failed(DcamCamera::open(&bench.dcam, SERIALS[0], DcamOptions::default()), ErrorKind::Identity);
    bench.say("camera 0 plug");
    let mut camera = bench.open(0, DcamOptions::default());
    camera.configure(&wish(TriggerMode::External)).unwrap();
}

#[test]
fn cameras_are_opened_by_serial_number_and_by_nothing_else() {
    let bench = Bench::new();
    assert_eq!(bench.dcam.serials(), SERIALS);
    bench.say("serials 000002 000001");
    let mut camera = bench.open(0, DcamOptions::default());
    assert_eq!(camera.identity().serial, SERIALS[0], "it is the second of the list now");
    assert!(camera.identity().simulated, "{:?}", camera.identity());
    failed(DcamCamera::open(&bench.dcam, "000001", DcamOptions::default()), ErrorKind::Busy);
    let text = failed(DcamCamera::open(&bench.dcam, "S/N: 123", DcamOptions::default()), ErrorKind::Identity);
    assert!(text.contains("S/N 123") && text.contains("000002, 000001"), "{text}");
    camera.stop().unwrap();
}

#[test]
fn properties_are_browsed_and_those_of_a_run_are_not_changed_there() {
    let bench = Bench::new();
    let mut camera = bench.open(0, DcamOptions::default());
    let all = camera.properties().unwrap();
    let find = |name: &str| all.iter().find(|property| property.name == name).unwrap();
    assert!(all.len() > 30);
    assert_eq!(find("READOUT SPEED").value, PropertyValue::Text("FASTEST".into()));
    assert_eq!((find("EXPOSURE TIME").unit.as_str(), find("EXPOSURE TIME").writable), ("s", false));
    assert!(find("SENSOR COOLER").writable && !find("SENSOR TEMPERATURE").writable);
    let text = |text: &str| PropertyValue::Text(text.into());
    camera.set_property("SENSOR COOLER", &text("MAX")).unwrap();
    let cooler = camera.properties().unwrap().into_iter().find(|property| property.name == "SENSOR COOLER");
    assert_eq!(cooler.unwrap().value, text("MAX"));
    for (name, value) in [
        ("SENSOR COOLER", text("WARM")),
        ("EXPOSURE TIME", PropertyValue::Number(0.1)),
        ("SENSOR TEMPERATURE", PropertyValue::Number(0.0)),
        ("TRIGGER DELAY", PropertyValue::Number(11.0)),
        ("TRIGGER DELAY", PropertyValue::Number(f64::NAN)),
        ("NOTHING", PropertyValue::Flag(true)),
    ] {
        failed(camera.set_property(name, &value), ErrorKind::OutOfRange);
    }
    let _stream = armed(&mut camera, &wish(TriggerMode::External));
    failed(camera.set_property("SENSOR COOLER", &text("ON")), ErrorKind::Busy);
}

#[test]
fn pulses_may_come_from_an_optical_table() {
    let bench = Bench::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("table");
    let table = OpticalTable::set_up(&path).unwrap();
    table.set(Quantity::Pulses, 500.0);
    bench.say(&format!("table {}", path.display()));
    let mut camera = bench.open(0, DcamOptions { pulse_input: PulseInput::Edge, ..DcamOptions::default() });
    let mut stream = armed(&mut camera, &wish(TriggerMode::External));
    for pulse in 1..=5 {
        table.set(Quantity::LastPulse, sofiscope_virtual::monotonic().as_secs_f64());
        table.set(Quantity::Pulses, 500.0 + f64::from(pulse));
        assert_eq!(take(stream.as_mut(), 1)[0].0.exposure.0, u64::from(pulse as u32) - 1);
        // A pulse gives one frame. The camera is blind for some lines after its readout: the next pulse comes
        // when they are over.
        assert!(drain(stream.as_mut(), Duration::from_millis(5)).is_empty());
    }
}

#[test]
fn a_stop_from_another_thread_wakes_the_reader() {
    let bench = Bench::new();
    let mut camera = bench.open(0, DcamOptions::default());
    let mut stream = armed(&mut camera, &wish(TriggerMode::External));
    let (waits, begun) = std::sync::mpsc::sync_channel(1);
    let reader = std::thread::spawn(move || {
        waits.send(()).unwrap();
        let mut counts = vec![0; bench::REGION.num_pixels()];
        stream.next_frame(&mut counts, Duration::from_secs(30)).unwrap_err()
    });
    begun.recv().unwrap();
    let stopped = std::time::Instant::now();
    camera.stop().unwrap();
    assert_eq!(reader.join().unwrap().kind(), ErrorKind::Ended);
    assert!(stopped.elapsed() < PATIENCE, "it took {:?}", stopped.elapsed());
}

#[test]
fn opening_and_closing_ten_thousand_times_leaves_nothing_behind() {
    let bench = Bench::new();
    let resident = || {
        let statm = std::fs::read_to_string("/proc/self/statm").unwrap();
        statm.split_whitespace().nth(1).unwrap().parse::<i64>().unwrap() * 4
    };
    let cycle = || {
        let mut camera = bench.open(0, DcamOptions::default());
        let stream = armed(&mut camera, &wish(TriggerMode::External));
        drop((camera, stream));
    };
    let cycles = if std::env::var_os("SOFISCOPE_FEW_CYCLES").is_some() { 100 } else { 10_000 };
    (0..cycles / 10).for_each(|_| cycle());
    let before = resident();
    (0..cycles).for_each(|_| cycle());
    let grown = resident() - before;
    assert!(grown < 1024, "grew by {grown} KiB in {cycles} cycles");
    assert_eq!(bench.say("open"), "1 0 0 0");
}

#[test]
fn the_library_is_started_once_and_ended_by_its_last_user() {
    let bench = Bench::new();
    let path = sofiscope_dcam_stand_in::library().unwrap();
    let again = Dcam::open(Some(&path)).unwrap();
    assert_eq!(bench.say("open"), "1 0 0 0");
    let Bench { dcam, remote, .. } = bench;
    drop(dcam);
    assert_eq!(remote.say("open").unwrap(), "1 0 0 0");
    drop(again);
    assert_eq!(remote.say("open").unwrap(), "0 0 0 0");
}
