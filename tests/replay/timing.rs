//! Frames come when they came: intervals, jitter, gaps, at any speed, with pauses. No test waits.

use crate::common::{LEN, armed, is_recorded, received_ns, recording, replay};
use sofiscope::recording::Format;
use sofiscope::replay::{ReplayOptions, ReplaySpeed};
use sofiscope_hal::{Camera, Channel, Clock, ErrorKind, ManualClock};
use std::sync::Arc;
use std::time::Duration;

const EXPOSURES: u64 = 70;

fn first_ns() -> u64 {
    let first = |channel| (0..EXPOSURES).find(|exposure| is_recorded(channel, *exposure)).unwrap();
    Channel::BOTH.map(|channel| received_ns(channel, first(channel))).into_iter().min().unwrap()
}

#[test]
fn intervals_jitter_and_gaps_are_those_of_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    recording(&path, Format::OmeTiff, EXPOSURES);
    for speed in [1, 4] {
        let clock = Arc::new(ManualClock::default());
        clock.advance(Duration::from_secs(3));
        let begin_ns = clock.now().0;
        let options = ReplayOptions {
            speed: ReplaySpeed::Times(speed as f64),
            clock: Arc::clone(&clock) as Arc<dyn Clock>,
            ..ReplayOptions::default()
        };
        let mut replay = replay(std::slice::from_ref(&path), options);
        let mut streams = replay.cameras.each_mut().map(armed);
        let mut counts = vec![0; LEN];
        // The frames of both cameras in the order in which they were received.
        let mut order: Vec<(u64, Channel, u64)> = Channel::BOTH
            .into_iter()
            .flat_map(|channel| (0..EXPOSURES).map(move |exposure| (channel, exposure)))
            .filter(|(channel, exposure)| is_recorded(*channel, *exposure))
            .map(|(channel, exposure)| (received_ns(channel, exposure), channel, exposure))
            .collect();
        order.sort_by_key(|(received, ..)| *received);
        for (received, channel, exposure) in order {
            let due_ns = begin_ns + (received - first_ns()).div_ceil(speed);
            let stream = &mut streams[channel.index()];
            if clock.now().0 + 10 < due_ns {
                let early = Duration::from_nanos(due_ns - clock.now().0 - 5);
                assert_eq!(stream.next_frame(&mut counts, early).unwrap_err().kind(), ErrorKind::Timeout);
                assert_eq!(clock.now().0, due_ns - 5, "a timeout takes its time and no more");
            }
            let info = stream.next_frame(&mut counts, Duration::from_secs(1)).unwrap();
            assert_eq!((info.exposure.0, clock.now().0), (exposure, due_ns), "{channel} at speed {speed}");
        }
        for stream in &mut streams {
            let end = stream.next_frame(&mut counts, Duration::from_secs(1)).unwrap_err();
            assert_eq!(end.kind(), ErrorKind::Ended);
        }
    }
}

#[test]
fn pauses_and_speeds_take_effect_in_the_middle() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    recording(&path, Format::OmeZarr, EXPOSURES);
    let clock = Arc::new(ManualClock::default());
    let options = ReplayOptions {
        speed: ReplaySpeed::Times(1.0),
        clock: Arc::clone(&clock) as Arc<dyn Clock>,
        ..ReplayOptions::default()
    };
    let mut replay = replay(&[path], options);
    let mut stream = armed(&mut replay.cameras[0]);
    let mut counts = vec![0; LEN];
    let second = Duration::from_secs(1);
    let received = |exposure| received_ns(Channel::Reflected, exposure);
    stream.next_frame(&mut counts, second).unwrap();
    let at = clock.now().0;
    replay.control.pause();
    assert!(replay.control.is_paused());
    assert_eq!(stream.next_frame(&mut counts, second).unwrap_err().kind(), ErrorKind::Timeout);
    replay.control.resume();
    stream.next_frame(&mut counts, second).unwrap();
    assert_eq!(clock.now().0 - at, second.as_nanos() as u64 + received(1) - received(0));
    replay.control.set_speed(ReplaySpeed::Times(0.5));
    let at = clock.now().0;
    stream.next_frame(&mut counts, second).unwrap();
    assert_eq!(clock.now().0 - at, 2 * (received(2) - received(1)));
    replay.control.set_speed(ReplaySpeed::Max);
    let at = clock.now().0;
    assert_eq!(stream.next_frame(&mut counts, second).unwrap().exposure.0, 3);
    assert_eq!(clock.now().0, at);
    replay.control.set_speed(ReplaySpeed::Times(1.0));
    assert_eq!(stream.next_frame(&mut counts, second).unwrap().exposure.0, 4);
    assert_eq!(clock.now().0 - at, received(4) - received(3));
    // What is finished at a stop still comes.
    clock.advance(Duration::from_nanos(received(7) - received(4) + 1));
    replay.cameras[0].stop().unwrap();
    assert_eq!(stream.next_frame(&mut counts, second).unwrap().exposure.0, 6);
    assert_eq!(stream.next_frame(&mut counts, second).unwrap().exposure.0, 7);
    assert_eq!(stream.next_frame(&mut counts, second).unwrap_err().kind(), ErrorKind::Ended);
}
