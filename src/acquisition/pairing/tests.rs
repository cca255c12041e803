//! Pairing against every order of delivery, slips of either camera, and cameras that fall silent.

use super::*;
use crate::acquisition::pool::tests::facts;
use proptest::prelude::*;
use sofiscope_hal::{DeviceTime, HostTime};

const PERIOD: Duration = Duration::from_millis(20);

fn pairing(lead: Option<u64>) -> Pairing {
    Pairing::new(PairingSettings { period: PERIOD, reorder: 16, lead }, 64)
}

/// A frame whose only pixel says which exposure it truly is.
fn frame(channel: Channel, numbered: u64, truly: u64) -> Grabbed {
    let mut facts = facts(channel, numbered);
    let drift = if channel == Channel::Transmitted { truly * 2_000 } else { 0 };
    facts.info.device_time = DeviceTime(truly * 20_000_000 + drift);
    facts.received = HostTime(truly * 20_000_000 + 1000 + truly % 3 * 500_000);
    Grabbed::Frame(Frame::of_counts(facts, &[truly as u16]))
}

fn drain(pairing: &mut Pairing) -> Vec<Resolved> {
    std::iter::from_fn(|| pairing.next_resolved()).collect()
}

fn truth_of(side: &Side) -> Option<u64> {
    side.frame().map(|frame| u64::from(frame.counts()[0]))
}

fn assert_pairs_are_true(resolved: &[Resolved]) {
    for one in resolved.iter().filter(|one| one.pair == PairState::Paired) {
        let [r, t] = [0, 1].map(|camera| truth_of(&one.sides[camera]));
        assert!(r.is_some() && r == t, "{one:?}");
    }
}

/// Exposures that one camera delivers, in the order of delivery.
fn deliveries() -> impl Strategy<Value = Vec<u64>> {
    let fate = prop_oneof![90 => Just(1_usize), 6 => Just(0), 4 => Just(2)];
    prop::collection::vec((fate, 0_u64..8), 1..200).prop_map(|fates| {
        let all = fates.iter().enumerate().map(|(exposure, &(copies, late))| (exposure as u64, copies, late));
        let mut sent: Vec<_> =
            all.flat_map(|(exposure, copies, late)| vec![(exposure + late, exposure); copies]).collect();
        sent.sort_unstable();
        sent.into_iter().map(|(_, exposure)| exposure).collect()
    })
}

proptest! {
    #[test]
    fn every_exposure_is_resolved_once_and_no_pair_is_wrong(
        reflected in deliveries(),
        transmitted in deliveries(),
        batch in 1_usize..20,
    ) {
        let mut pairing = pairing(None);
        let mut resolved = Vec::new();
        let sent = [(Channel::Reflected, &reflected), (Channel::Transmitted, &transmitted)];
        let longest = reflected.len().max(transmitted.len());
        for begin in (0..longest).step_by(batch) {
            for (channel, exposures) in sent {
                for &exposure in exposures.iter().skip(begin).take(batch) {
                    pairing.offer(frame(channel, exposure, exposure));
                }
                resolved.extend(drain(&mut pairing));
            }
        }
        Channel::BOTH.into_iter().for_each(|channel| pairing.end(channel, Loss::Stopping));
        resolved.extend(drain(&mut pairing));
        let last = reflected.iter().chain(&transmitted).max();
        prop_assert_eq!(resolved.len() as u64, last.map_or(0, |last| last + 1));
        for (expected, one) in (0..).zip(&resolved) {
            prop_assert_eq!(one.exposure, ExposureIndex(expected));
            for (channel, exposures) in sent {
                let here = exposures.contains(&expected).then_some(expected);
                prop_assert_eq!(truth_of(&one.sides[channel.index()]), here);
            }
        }
        assert_pairs_are_true(&resolved);
        for (channel, exposures) in sent {
            let mut distinct = exposures.clone();
            distinct.sort_unstable();
            distinct.dedup();
            let Surplus { duplicates, late, extra } = pairing.surplus(channel);
            prop_assert_eq!(extra, 0);
            prop_assert_eq!(duplicates + late, (exposures.len() - distinct.len()) as u64);
        }
    }
}

#[test]
fn a_missed_trigger_never_makes_a_wrong_pair_and_costs_one_exposure() {
    for (channel, missed_at) in
        [(Channel::Transmitted, 40), (Channel::Reflected, 1), (Channel::Transmitted, 97)]
    {
        let mut pairing = pairing(Some(32));
        let mut resolved = Vec::new();
        for exposure in 0..100 {
            pairing.offer(frame(channel.other(), exposure, exposure));
            let truly = exposure + u64::from(exposure >= missed_at);
            if truly < 100 {
                pairing.offer(frame(channel, exposure, truly));
            }
            resolved.extend(drain(&mut pairing));
        }
        Channel::BOTH.into_iter().for_each(|channel| pairing.end(channel, Loss::Stopping));
        resolved.extend(drain(&mut pairing));
        assert_pairs_are_true(&resolved);
        let pairs = resolved.iter().filter(|one| one.pair == PairState::Paired).count();
        if missed_at < 90 {
            assert_eq!(pairs, 99, "{channel} missed the trigger of exposure {missed_at}");
            let event =
                PairingEvent::MissedTriggers { channel, exposure: ExposureIndex(missed_at), triggers: 1 };
            assert_eq!(pairing.next_event(), Some(event));
        } else {
            assert_eq!(pairs as u64, missed_at);
        }
    }
}

#[test]
fn a_camera_that_falls_silent_does_not_hold_the_other_for_ever() {
    let mut pairing = pairing(Some(32));
    pairing.offer(frame(Channel::Transmitted, 0, 0));
    for exposure in 0..100 {
        pairing.offer(frame(Channel::Reflected, exposure, exposure));
    }
    let resolved = drain(&mut pairing);
    assert_eq!(resolved.len(), 68);
    assert!(matches!(resolved[1].sides[1], Side::Lost(Loss::Timeout, None)));
    pairing.offer(frame(Channel::Transmitted, 1, 1));
    assert_eq!(pairing.surplus(Channel::Transmitted).late, 1);
}

#[test]
fn unusable_frames_keep_their_place_and_their_reason() {
    let mut pairing = pairing(None);
    pairing.offer(Grabbed::Lost(facts(Channel::Reflected, 0), Loss::Incomplete));
    pairing.offer(frame(Channel::Transmitted, 0, 0));
    let resolved = pairing.next_resolved().unwrap();
    assert!(matches!(resolved.sides[0], Side::Lost(Loss::Incomplete, Some(_))));
    assert_eq!(resolved.pair, PairState::Not(Loss::Unpaired));
}

/// One camera sees every trigger once; the other gives `frames`: number, true exposure, and whether it is an extra one
/// somewhat before that exposure.
fn paired_with(channel: Channel, frames: &[(u64, u64, bool)], lead: Option<u64>) -> (Pairing, Vec<Resolved>) {
    let mut pairing = pairing(lead);
    let mut resolved = Vec::new();
    let mut own = frames.iter().peekable();
    for exposure in 0..100 {
        pairing.offer(frame(channel.other(), exposure, exposure));
        while let Some(&(numbered, truly, extra)) = own.next_if(|(_, truly, _)| *truly <= exposure) {
            let mut grabbed = frame(channel, numbered, truly);
            if let (true, Grabbed::Frame(frame)) = (extra, &mut grabbed) {
                let mut facts = *frame.facts();
                facts.info.device_time.0 -= 9_000_000;
                *frame = Frame::of_counts(facts, &[u16::MAX]);
            }
            pairing.offer(grabbed);
        }
        resolved.extend(drain(&mut pairing));
    }
    Channel::BOTH.into_iter().for_each(|channel| pairing.end(channel, Loss::Stopping));
    resolved.extend(drain(&mut pairing));
    assert_pairs_are_true(&resolved);
    (pairing, resolved)
}

fn num_pairs(resolved: &[Resolved]) -> usize {
    resolved.iter().filter(|one| one.pair == PairState::Paired).count()
}

#[test]
fn extra_triggers_cost_no_pair_and_make_none_wrong() {
    for channel in Channel::BOTH {
        for at in [1, 2, 20, 21, 50] {
            let before = (0..at).map(|exposure| (exposure, exposure, false));
            let after = (at..100).map(|exposure| (exposure + 1, exposure, false));
            let frames: Vec<_> = before.chain([(at, at, true)]).chain(after).collect();
            for lead in [None, Some(32)] {
                let (mut pairing, resolved) = paired_with(channel, &frames, lead);
                let lost = 100 - num_pairs(&resolved);
                assert!(lost == 0 || at < 8 && lost <= 2, "{channel}, extra at {at}, {lead:?}: {lost}");
                let event = pairing.next_event();
                assert!(event.is_some(), "the operator is told: {channel} {at}");
                if at > 8 {
                    let exposure = ExposureIndex(at);
                    assert_eq!(event, Some(PairingEvent::ExtraTriggers { channel, exposure, triggers: 1 }));
                    assert_eq!(pairing.surplus(channel).extra, 1);
                }
            }
        }
    }
}

#[test]
fn a_trigger_missed_at_the_very_start_is_seen_by_arrivals() {
    for channel in Channel::BOTH {
        for missed in [1, 2, 5] {
            let frames: Vec<_> = (missed..100).map(|exposure| (exposure - missed, exposure, false)).collect();
            let (mut pairing, resolved) = paired_with(channel, &frames, Some(32));
            assert_eq!(num_pairs(&resolved) as u64, 100 - missed);
            let exposure = ExposureIndex(0);
            let event = PairingEvent::MissedTriggers { channel, exposure, triggers: missed };
            assert_eq!(pairing.next_event(), Some(event));
        }
    }
}
