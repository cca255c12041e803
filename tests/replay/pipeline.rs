//! What the pairing makes of a replay is what it made of the cameras.

use crate::common::{FORMATS, LEN, PERIOD, armed, is_recorded, pixels, plan, record, recording, replay};
use sofiscope::acquisition::{
    Conditions, Frame, FrameFacts, Grabbed, Loss, PairState, Pairing, PairingSettings,
};
use sofiscope::recording::Recording;
use sofiscope::replay::ReplayOptions;
use sofiscope_hal::{Channel, ErrorKind, HostTime};
use std::path::Path;
use std::time::Duration;

/// Replays a directory through the pairing, both cameras in turn; gives the pairs, and the exposures in all.
fn pairs(path: &Path) -> (Vec<u64>, u64) {
    let mut replay = replay(&[path.to_path_buf()], ReplayOptions::default());
    let settings = PairingSettings { period: PERIOD, reorder: 8, lead: None };
    let mut pairing = Pairing::new(settings, 512);
    let mut streams = replay.cameras.each_mut().map(armed);
    let mut has_ended = [false; 2];
    let mut counts = vec![0; LEN];
    let (mut pairs, mut exposures) = (Vec::new(), 0);
    while has_ended != [true; 2] {
        for channel in Channel::BOTH {
            match streams[channel.index()].next_frame(&mut counts, Duration::from_secs(1)) {
                Ok(info) => {
                    let facts = FrameFacts {
                        channel,
                        info,
                        received: HostTime(0),
                        conditions: Conditions::default(),
                    };
                    pairing.offer(Grabbed::Frame(Frame::of_counts(facts, &counts)));
                }
                Err(error) => {
                    assert_eq!(error.kind(), ErrorKind::Ended);
                    has_ended[channel.index()] = true;
                    pairing.end(channel, Loss::UpstreamGap);
                }
            }
        }
        while let Some(resolved) = pairing.next_resolved() {
            assert_eq!(resolved.exposure.0, exposures);
            exposures += 1;
            if resolved.pair == PairState::Paired {
                for (side, channel) in resolved.sides.iter().zip(Channel::BOTH) {
                    let frame = side.frame().unwrap();
                    assert!(frame.counts() == pixels(channel, resolved.exposure.0));
                }
                pairs.push(resolved.exposure.0);
            }
        }
    }
    (pairs, exposures)
}

fn recorded_pairs(exposures: u64) -> Vec<u64> {
    let both = |exposure| Channel::BOTH.into_iter().all(|channel| is_recorded(channel, exposure));
    (0..exposures).filter(|exposure| both(*exposure)).collect()
}

#[test]
fn the_same_pairs_and_the_same_gaps_come_again() {
    for format in FORMATS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run");
        recording(&path, format, 300);
        assert_eq!(pairs(&path), (recorded_pairs(300), 300), "{format:?}");
    }
}

#[test]
fn a_recording_that_was_cut_short_is_replayed_as_far_as_it_goes() {
    for format in FORMATS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run");
        let mut recording = Recording::create(&plan(&path, format)).unwrap();
        for exposure in 0..100 {
            recording.push(&record(exposure)).unwrap();
            if exposure == 69 {
                recording.commit().unwrap();
            }
        }
        // As after a crash: what was not committed is gone.
        drop(recording);
        assert_eq!(pairs(&path), (recorded_pairs(70), 70), "{format:?}");
    }
}
