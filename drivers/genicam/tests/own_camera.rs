//! The driver against the simulated GigE Vision camera, with everything that goes wrong on a network.
#![cfg(feature = "aravis")]

mod bench;

use std::time::{Duration, Instant};

use bench::{Fake, Pulses, Rig, SERIAL, address, count_of, driver, next, settings};
use sofiscope_genicam::{GenicamCamera, GenicamSettings};
use sofiscope_hal::{
    Camera, Epoch, ErrorKind, FrameInfo, FrameStatus, Properties, PropertyRange, PropertyValue, Region,
    TriggerMode, conformance,
};
use sofiscope_virtual::OpticalTable;
use sofiscope_virtual::gige::{Fate, GigeFaults, GigeSettings};

fn open(settings: GenicamSettings) -> GenicamCamera {
    GenicamCamera::open(settings).expect("the simulated camera answers")
}

/// Frames of a camera that was just opened, until `number` of them are taken; complete ones are proved by their
/// pixels, which know the exposure.
fn frames(camera: &mut GenicamCamera, number: usize) -> Vec<FrameInfo> {
    let settings = settings(64, 48, 4);
    camera.configure(&settings).expect("the camera answers");
    let mut stream = camera.arm().expect("the camera answers");
    let mut counts = vec![0; settings.region.num_pixels()];
    let frames = (0..number)
        .map(|_| {
            let info = next(stream.as_mut(), &mut counts).expect("the camera answers");
            if info.status == FrameStatus::Complete {
                assert_pixels(&info, &counts);
            }
            info
        })
        .collect();
    camera.stop().expect("the camera answers");
    frames
}

fn assert_pixels(info: &FrameInfo, counts: &[u16]) {
    let wrong = counts.iter().enumerate().find(|&(pixel, &count)| count != count_of(info.exposure.0, pixel));
    assert_eq!(wrong, None, "{info:?}");
}

#[test]
fn the_contract_is_kept_when_free_running() {
    let _fake = Fake::start(GigeSettings::new(address(1, 1), SERIAL));
    let camera = open(driver(address(1, 1)));
    assert!(camera.identity().simulated, "{:?}", camera.identity());
    conformance::camera(&mut Rig { camera, pulses: None, settings: settings(64, 48, 10) });
}

#[test]
fn the_contract_is_kept_with_pulses_on_a_line() {
    let table = OpticalTable::private().unwrap();
    let _fake =
        Fake::start(GigeSettings { table: Some(table.clone()), ..GigeSettings::new(address(2, 1), SERIAL) });
    let mut pulses = Pulses::new(table);
    conformance::trigger(&mut pulses, Duration::from_millis(5));
    let settings = sofiscope_hal::CameraSettings { trigger: TriggerMode::External, ..settings(64, 48, 10) };
    conformance::camera(&mut Rig { camera: open(driver(address(2, 1))), pulses: Some(pulses), settings });
}

#[test]
fn every_format_of_pixels_gives_the_same_counts() {
    let _fake = Fake::start(GigeSettings::new(address(3, 1), SERIAL));
    for (format, saturation) in
        [("Mono16", 65_535), ("Mono12", 4095), ("Mono12p", 4095), ("Mono12Packed", 4095), ("Mono8", 255)]
    {
        let mut camera =
            open(GenicamSettings { pixel_format: Some(format.to_owned()), ..driver(address(3, 1)) });
        assert_eq!(camera.capabilities().saturation_counts, saturation, "{format}");
        let settings = settings(36, 20, 10);
        camera.configure(&settings).unwrap();
        let mut stream = camera.arm().unwrap();
        let mut counts = vec![0; settings.region.num_pixels()];
        let info = next(stream.as_mut(), &mut counts).unwrap();
        let expected: Vec<u16> =
            (0..counts.len()).map(|pixel| count_of(info.exposure.0, pixel).min(saturation)).collect();
        assert_eq!(counts, expected, "{format}");
    }
}

#[test]
fn damaged_frames_are_exactly_those_that_were_damaged() {
    let faults = GigeFaults { lost_packets_per_thousand: 10, no_resend: true, ..GigeFaults::default() };
    let fake = Fake::start(GigeSettings { faults, seed: 5, ..GigeSettings::new(address(4, 1), SERIAL) });
    let frames = frames(&mut open(driver(address(4, 1))), 400);
    let last = frames.iter().map(|info| info.exposure.0).max().unwrap();
    let found: Vec<(u64, u64)> = frames
        .iter()
        .filter(|info| info.status == FrameStatus::Incomplete)
        .map(|info| (info.exposure.0, info.block_id.0))
        .collect();
    let expected: Vec<(u64, u64)> = fake
        .record
        .damages()
        .iter()
        .filter(|damage| damage.exposure <= last)
        .map(|damage| (damage.exposure, damage.block_id.into()))
        .collect();
    assert!(expected.len() > 20, "{expected:?}");
    assert_eq!(found, expected);
    assert_eq!(last, 399, "no frame is missing");
}

#[test]
fn packets_that_were_lost_are_asked_for_again() {
    let faults = GigeFaults { lost_packets_per_thousand: 10, ..GigeFaults::default() };
    let fake = Fake::start(GigeSettings { faults, seed: 6, ..GigeSettings::new(address(5, 1), SERIAL) });
    let mut camera = open(driver(address(5, 1)));
    let frames = frames(&mut camera, 400);
    let damaged = fake.record.damages().len();
    let incomplete = frames.iter().filter(|info| info.status == FrameStatus::Incomplete).count();
    // Aravis gives up a packet after a time of its own; a busy computer asks too late for some of them.
    assert!(damaged > 20 && incomplete * 4 <= damaged, "{incomplete} of {damaged} stayed incomplete");
    assert!(fake.record.resent_packets() as usize >= damaged - incomplete);
}

#[test]
fn whole_frames_that_are_missing_leave_gaps_and_nothing_moves() {
    let faults = GigeFaults {
        lost_frames: vec![3, 140],
        lost_bursts: vec![10..30, 150..310],
        missed_triggers: vec![],
        ..GigeFaults::default()
    };
    let fake = Fake::start(GigeSettings { faults, ..GigeSettings::new(address(6, 1), SERIAL) });
    // Exposure 136 is the wrap of the counter, and pixels prove every number.
    let frames = frames(&mut open(driver(address(6, 1))), 220);
    let found: Vec<u64> = frames.iter().map(|info| info.exposure.0).collect();
    let lost: Vec<u64> = fake.record.damages().iter().map(|damage| damage.exposure).collect();
    let expected: Vec<u64> = (0..).filter(|exposure| !lost.contains(exposure)).take(220).collect();
    assert_eq!(found, expected);
    assert!(fake.record.damages().iter().all(|damage| damage.fate == Fate::Lost));
    assert!(frames.iter().all(|info| info.epoch == Epoch(0)), "gaps are no restarts");
}

#[test]
fn a_lost_first_frame_is_noticed_where_its_id_is_known() {
    let faults = GigeFaults { lost_frames: vec![0, 1], ..GigeFaults::default() };
    let _fake = Fake::start(GigeSettings { faults, ..GigeSettings::new(address(19, 1), SERIAL) });
    let settings = GenicamSettings { first_block_id: Some(65_400), ..driver(address(19, 1)) };
    let found: Vec<u64> = frames(&mut open(settings), 4).iter().map(|info| info.exposure.0).collect();
    assert_eq!(found, [2, 3, 4, 5]);
}

#[test]
fn packets_in_disorder_and_twice_change_nothing() {
    let faults =
        GigeFaults { shuffled_packets: 6, doubled_packets_per_thousand: 100, ..GigeFaults::default() };
    let _fake = Fake::start(GigeSettings { faults, ..GigeSettings::new(address(7, 1), SERIAL) });
    let frames = frames(&mut open(driver(address(7, 1))), 200);
    for (exposure, info) in (0..).zip(&frames) {
        assert_eq!((info.exposure.0, info.status), (exposure, FrameStatus::Complete));
    }
}

#[test]
fn a_counter_that_restarts_begins_an_epoch() {
    let faults = GigeFaults { restart_ids_at: Some(20), ..GigeFaults::default() };
    let _fake = Fake::start(GigeSettings {
        first_block_id: 30_000,
        faults,
        ..GigeSettings::new(address(8, 1), SERIAL)
    });
    let frames = frames(&mut open(driver(address(8, 1))), 40);
    let found: Vec<(u64, u32)> = frames.iter().map(|info| (info.exposure.0, info.epoch.0)).collect();
    let expected: Vec<(u64, u32)> = (0..40).map(|exposure| (exposure, u32::from(exposure >= 20))).collect();
    assert_eq!(found, expected);
}

#[test]
fn a_stall_is_told_with_what_to_check() {
    let faults = GigeFaults { stall_at: Some(5), ..GigeFaults::default() };
    let _fake = Fake::start(GigeSettings { faults, ..GigeSettings::new(address(9, 1), SERIAL) });
    let mut camera = open(driver(address(9, 1)));
    let settings = settings(64, 48, 4);
    camera.configure(&settings).unwrap();
    let mut stream = camera.arm().unwrap();
    let mut counts = vec![0; settings.region.num_pixels()];
    (0..5).for_each(|_| assert!(next(stream.as_mut(), &mut counts).is_ok()));
    let error = stream.next_frame(&mut counts, Duration::from_millis(700)).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Timeout, "{error}");
    let text = error.to_string();
    assert!(text.contains("no frames for") && text.contains("control channel answers"), "{text}");
    assert!(text.contains("firewall") && text.contains(SERIAL), "{text}");
    camera.stop().unwrap();
    assert_eq!(next(stream.as_mut(), &mut counts).unwrap_err().kind(), ErrorKind::Ended);
}

/// A camera that is lost while it exposes, and how long that took to be noticed.
fn lost(camera: &mut GenicamCamera, mut unplug: impl FnMut()) -> Duration {
    let settings = settings(64, 48, 4);
    camera.configure(&settings).expect("the camera answers");
    let mut stream = camera.arm().expect("the camera answers");
    let mut counts = vec![0; settings.region.num_pixels()];
    (0..5).for_each(|_| assert!(next(stream.as_mut(), &mut counts).is_ok()));
    unplug();
    let begun = Instant::now();
    let error = loop {
        if let Err(error) = next(stream.as_mut(), &mut counts) {
            break error;
        }
    };
    assert_eq!(error.kind(), ErrorKind::Lost, "{error}");
    assert!(camera.is_lost());
    begun.elapsed()
}

#[test]
fn a_camera_that_was_unplugged_comes_back() {
    let at = address(10, 1);
    let mut fake = Fake::start(GigeSettings::new(at, SERIAL));
    let mut camera = open(driver(at));
    let took = lost(&mut camera, || fake.unplug());
    assert!(took < Duration::from_millis(1500), "{took:?}");
    assert_eq!(camera.arm().err().map(|error| error.kind()), Some(ErrorKind::Lost));
    let fake = Fake::start(GigeSettings::new(at, SERIAL));
    let begun = Instant::now();
    let frames = frames(&mut camera, 10);
    assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    assert_eq!(frames.last().map(|info| info.exposure.0), Some(9));
    assert!(fake.record.damages().is_empty());
}

#[test]
fn a_camera_whose_control_channel_falls_silent_is_lost() {
    let faults = GigeFaults { silent_at: Some(8), ..GigeFaults::default() };
    let _fake = Fake::start(GigeSettings { faults, ..GigeSettings::new(address(11, 1), SERIAL) });
    let took = lost(&mut open(driver(address(11, 1))), || {});
    assert!(took < Duration::from_millis(1500), "{took:?}");
}

#[test]
fn a_camera_that_takes_control_away_is_lost_and_can_be_had_again() {
    let at = address(18, 1);
    let faults = GigeFaults { control_lost_at: Some(8), ..GigeFaults::default() };
    let fake = Fake::start(GigeSettings { faults, ..GigeSettings::new(at, SERIAL) });
    let mut camera = open(driver(at));
    let took = lost(&mut camera, || {});
    assert!(took < Duration::from_millis(1500), "{took:?}");
    camera.reconnect().unwrap();
    assert!(!camera.is_lost());
    let mut stream = camera.arm().unwrap();
    let mut counts = vec![0; 64 * 48];
    let info = next(stream.as_mut(), &mut counts).unwrap();
    assert_eq!((info.exposure.0, info.status), (0, FrameStatus::Complete), "{:?}", fake.record.damages());
}

#[test]
fn another_camera_than_the_one_wanted_is_refused() {
    let _fake = Fake::start(GigeSettings::new(address(12, 1), "SIM-2"));
    let error = GenicamCamera::open(driver(address(12, 1))).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Identity, "{error}");
    let text = error.to_string();
    assert!(text.contains("SIM-1") && text.contains("SIM-2") && text.contains("camera R"), "{text}");
}

#[test]
fn two_cameras_at_once_see_the_same_pulses() {
    let table = OpticalTable::private().unwrap();
    let fakes = [1, 2].map(|number| {
        let settings = GigeSettings::new(address(13, number), SERIAL);
        Fake::start(GigeSettings { table: Some(table.clone()), ..settings })
    });
    let settings = sofiscope_hal::CameraSettings { trigger: TriggerMode::External, ..settings(64, 48, 5) };
    let mut cameras = [1, 2].map(|number| open(driver(address(13, number))));
    let streams = cameras.each_mut().map(|camera| {
        camera.configure(&settings).unwrap();
        camera.arm().unwrap()
    });
    let mut pulses = Pulses::new(table);
    sofiscope_hal::TriggerSource::start(&mut pulses, settings.period, Some(200)).unwrap();
    let grabbers = streams.map(|mut stream| {
        std::thread::spawn(move || {
            let mut counts = vec![0; settings.region.num_pixels()];
            let frames = (0..200).map(|_| {
                let info = next(stream.as_mut(), &mut counts).unwrap();
                assert_pixels(&info, &counts);
                info.exposure.0
            });
            frames.collect::<Vec<u64>>()
        })
    });
    for grabber in grabbers {
        assert_eq!(grabber.join().unwrap(), (0..200).collect::<Vec<u64>>());
    }
    assert!(fakes.iter().all(|fake| fake.record.damages().is_empty()));
}

#[test]
fn a_missed_pulse_shows_in_times_and_pixels() {
    let table = OpticalTable::private().unwrap();
    let faults = GigeFaults { missed_triggers: vec![7], ..GigeFaults::default() };
    let at = address(14, 1);
    let _fake =
        Fake::start(GigeSettings { table: Some(table.clone()), faults, ..GigeSettings::new(at, SERIAL) });
    let settings = sofiscope_hal::CameraSettings { trigger: TriggerMode::External, ..settings(64, 48, 10) };
    let mut camera = open(driver(at));
    camera.configure(&settings).unwrap();
    let mut stream = camera.arm().unwrap();
    let mut pulses = Pulses::new(table);
    sofiscope_hal::TriggerSource::start(&mut pulses, settings.period, Some(12)).unwrap();
    let mut counts = vec![0; settings.region.num_pixels()];
    let frames: Vec<(FrameInfo, u16)> =
        (0..11).map(|_| (next(stream.as_mut(), &mut counts).unwrap(), counts[0])).collect();
    // The counter does not know of the missed pulse: exposure 7 is the light of pulse 8.
    assert_eq!(frames[7].0.exposure.0, 7);
    assert_eq!(frames[7].1, count_of(8, 0));
    let gap_ns = frames[7].0.device_time.nanoseconds_since(frames[6].0.device_time);
    assert!((19_000_000..21_000_000).contains(&gap_ns), "{gap_ns}");
}

#[test]
fn properties_can_be_looked_at_and_some_changed() {
    let _fake = Fake::start(GigeSettings::new(address(15, 1), SERIAL));
    let mut camera = open(driver(address(15, 1)));
    let properties = camera.properties().unwrap();
    let find = |name: &str| properties.iter().find(|property| property.name == name).cloned();
    let exposure = find("ExposureTime").unwrap();
    assert_eq!((exposure.unit.as_str(), exposure.writable), ("us", false));
    assert_eq!(exposure.range, PropertyRange::Between { least: 10.0, greatest: 1e7 });
    assert_eq!(find("DeviceSerialNumber").unwrap().value, PropertyValue::Text(SERIAL.to_owned()));
    assert_eq!(find("DeviceTemperature").unwrap().value, PropertyValue::Number(31.5));
    assert_eq!(find("PtpStatus").unwrap().value, PropertyValue::Text("Disabled".to_owned()));
    assert!(find("PtpEnable").unwrap().writable);
    assert_eq!(find("ActionGroupKey"), None, "what the camera has not is not listed");
    camera.set_property("PtpEnable", &PropertyValue::Flag(true)).unwrap();
    let status = camera.properties().unwrap().into_iter().find(|property| property.name == "PtpStatus");
    assert_eq!(status.unwrap().value, PropertyValue::Text("Listening".to_owned()));
    for (name, value) in [
        ("PtpEnable", PropertyValue::Whole(1)),
        ("Width", PropertyValue::Whole(64)),
        ("NoSuchThing", PropertyValue::Flag(true)),
    ] {
        let error = camera.set_property(name, &value).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::OutOfRange, "{error}");
    }
}

#[test]
fn regions_are_read_where_they_are_asked_for() {
    let _fake = Fake::start(GigeSettings::new(address(16, 1), SERIAL));
    let mut camera = open(driver(address(16, 1)));
    let corner = Region { left: 192, top: 216, width: 64, height: 40 };
    let want = sofiscope_hal::CameraSettings { region: corner, ..settings(64, 40, 10) };
    assert_eq!(camera.configure(&want).unwrap(), want);
    let odd = Region { width: 62, ..corner };
    let error = camera.configure(&sofiscope_hal::CameraSettings { region: odd, ..want }).unwrap_err();
    assert!(error.to_string().contains("multiples of 4"), "{error}");
    let opposite = Region { left: 0, top: 0, width: 256, height: 256 };
    let want = sofiscope_hal::CameraSettings { region: opposite, ..want };
    assert_eq!(camera.configure(&want).unwrap(), want, "larger than what fits at the offset before");
}

#[test]
fn advice_names_what_the_person_can_do() {
    let _fake = Fake::start(GigeSettings::new(address(17, 1), SERIAL));
    let advice = open(driver(address(17, 1))).advice().join("\n");
    assert!(advice.contains("jumbo frames"), "packets of 1036 bytes: {advice}");
}
