//! Pairs the frames of both cameras by exposure, never by arrival.
//!
//! In: frames in any order. Out: every exposure once, in order, each side a frame or the reason for none.
//! Never: reads a clock, looks at pixels, loses a frame unsaid, pairs frames whose times disagree.
//! Fails: not at all; what does not fit is a [`Loss`] and a [`PairingEvent`].

use super::alignment::{Alignment, Times, Verdict, WITNESSES};
use super::{Frame, FrameFacts, Loss, PairState, Side};
use sofiscope_hal::{Channel, ExposureIndex};
use std::collections::VecDeque;
use std::time::Duration;

/// What a camera's grabber hands over.
#[derive(Debug, Clone)]
pub enum Grabbed {
    /// A frame with all its pixels.
    Frame(Frame),
    /// A frame that came and cannot be used.
    Lost(FrameFacts, Loss),
}

impl Grabbed {
    pub(super) fn facts(&self) -> FrameFacts {
        match self {
            Self::Frame(frame) => *frame.facts(),
            Self::Lost(facts, _) => *facts,
        }
    }
}

/// When an exposure counts as lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PairingSettings {
    /// Time from exposure to exposure.
    pub period: Duration,
    /// Exposures by which a frame may come later than its successor.
    pub reorder: u64,
    /// Exposures by which one camera may be ahead of the other before the other's frames count as lost;
    /// `None` where sources are patient.
    pub lead: Option<u64>,
}

/// Something about pairing that the operator must know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PairingEvent {
    /// A camera missed triggers and counted on; its exposures were renumbered from here.
    MissedTriggers {
        /// The camera.
        channel: Channel,
        /// First exposure that is renumbered.
        exposure: ExposureIndex,
        /// Triggers missed.
        triggers: u64,
    },
    /// A camera's clock was set; its times are compared anew from here.
    ClockStep {
        /// The camera.
        channel: Channel,
        /// First exposure with the new time.
        exposure: ExposureIndex,
        /// By how much, nanoseconds.
        nanoseconds: i64,
    },
}

/// One exposure, resolved.
#[derive(Debug, Clone)]
pub struct Resolved {
    /// The exposure.
    pub exposure: ExposureIndex,
    /// R and T.
    pub sides: [Side; 2],
    /// Whether they make a pair.
    pub pair: PairState,
}

/// Frames that came more than once or after their exposure was given up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Surplus {
    /// Frames of exposures that had one already.
    pub duplicates: u64,
    /// Frames that came too late.
    pub late: u64,
}

/// One camera's frames that wait for the other camera.
#[derive(Debug)]
struct Waiting {
    /// Frames by exposure, rising.
    frames: VecDeque<(u64, Grabbed)>,
    /// The newest exposure that ever came.
    newest: Option<u64>,
    /// Triggers that this camera missed without knowing.
    missed: u64,
    /// Why nothing comes any more.
    ended: Option<Loss>,
    surplus: Surplus,
}

/// The pairing of one run.
#[derive(Debug)]
pub struct Pairing {
    settings: PairingSettings,
    cameras: [Waiting; 2],
    next: u64,
    alignment: Alignment,
    events: VecDeque<PairingEvent>,
}

impl Pairing {
    /// A pairing that expects exposure 0; `frames` are as many as a camera can have out at once.
    #[must_use]
    pub fn new(settings: PairingSettings, frames: usize) -> Self {
        let camera = || Waiting {
            frames: VecDeque::with_capacity(frames),
            newest: None,
            missed: 0,
            ended: None,
            surplus: Surplus::default(),
        };
        Self {
            settings,
            cameras: [camera(), camera()],
            next: 0,
            alignment: Alignment::new(settings.period),
            events: VecDeque::new(),
        }
    }

    /// Takes what a camera delivered.
    pub fn offer(&mut self, grabbed: Grabbed) {
        let facts = grabbed.facts();
        let camera = &mut self.cameras[facts.channel.index()];
        let exposure = facts.info.exposure.0 + camera.missed;
        if exposure < self.next {
            camera.surplus.late += 1;
            return;
        }
        camera.newest = camera.newest.max(Some(exposure));
        let place = camera.frames.iter().rposition(|(other, _)| *other <= exposure).map_or(0, |p| p + 1);
        if place > 0 && camera.frames[place - 1].0 == exposure {
            camera.surplus.duplicates += 1;
            return;
        }
        camera.frames.insert(place, (exposure, grabbed));
    }

    /// Nothing more comes from this camera; frames that are missing at the end are lost for this reason.
    pub fn end(&mut self, channel: Channel, reason: Loss) {
        self.cameras[channel.index()].ended.get_or_insert(reason);
    }

    /// The next exposure, as soon as it is known what became of it.
    pub fn next_resolved(&mut self) -> Option<Resolved> {
        loop {
            let exposure = self.next;
            let newest = self.cameras.iter().filter_map(|camera| camera.newest).max()?;
            if exposure > newest {
                return None;
            }
            let missing = [self.missing(Channel::Reflected)?, self.missing(Channel::Transmitted)?];
            let pair = match (missing, self.times_of(exposure)) {
                ([None, None], Some(times)) => match self.judge(times)? {
                    Verdict::Missed { channel, triggers } => {
                        self.renumber(channel, triggers);
                        continue;
                    }
                    Verdict::Aligned | Verdict::ClockStep { .. } => PairState::Paired,
                    Verdict::Outlier | Verdict::Unclear => PairState::Not(Loss::Misaligned),
                },
                _ => PairState::Not(Loss::Unpaired),
            };
            let sides = [0, 1].map(|camera| self.take(camera, missing[camera]));
            self.next += 1;
            let both = sides.iter().all(|side| side.frame().is_some());
            let pair = if both { pair } else { PairState::Not(Loss::Unpaired) };
            return Some(Resolved { exposure: ExposureIndex(exposure), sides, pair });
        }
    }

    /// The next thing that the operator must know.
    pub fn next_event(&mut self) -> Option<PairingEvent> {
        self.events.pop_front()
    }

    /// Frames of a camera that belonged nowhere.
    #[must_use]
    pub fn surplus(&self, channel: Channel) -> Surplus {
        self.cameras[channel.index()].surplus
    }

    /// Outer `None`: not known yet. Inner: the reason why the next exposure has no frame, if it has none.
    fn missing(&self, channel: Channel) -> Option<Option<Loss>> {
        let exposure = self.next;
        let camera = &self.cameras[channel.index()];
        if camera.frames.front().is_some_and(|(first, _)| *first == exposure) {
            return Some(None);
        }
        let ahead = |newest: Option<u64>| newest.map_or(0, |newest| newest.saturating_sub(exposure));
        if ahead(camera.newest) >= self.settings.reorder.max(1) {
            return Some(Some(Loss::UpstreamGap));
        }
        if let Some(reason) = camera.ended {
            let was_passed = ahead(camera.newest) > 0;
            return Some(Some(if was_passed { Loss::UpstreamGap } else { reason }));
        }
        let other = ahead(self.cameras[channel.other().index()].newest);
        self.settings.lead.filter(|&lead| other >= lead).map(|_| Some(Loss::Timeout))
    }

    /// Judges the next exposure; `None` while later ones may still tell.
    fn judge(&mut self, times: Times) -> Option<Verdict> {
        let exposure = self.next;
        let mut verdict = self.alignment.judge(exposure, times, &[]);
        if verdict == Verdict::Unclear {
            let later = self.later_times();
            verdict = self.alignment.judge(exposure, times, &later);
            if verdict == Verdict::Unclear && self.more_may_come() {
                return None;
            }
        }
        match verdict {
            Verdict::Aligned => self.alignment.learn(exposure, times, verdict),
            Verdict::ClockStep { channel, nanoseconds } => {
                self.alignment.learn(exposure, times, verdict);
                let exposure = ExposureIndex(exposure);
                self.events.push_back(PairingEvent::ClockStep { channel, exposure, nanoseconds });
            }
            _ => {}
        }
        Some(verdict)
    }

    /// Times of the next exposures of which both frames are here.
    fn later_times(&self) -> Vec<Times> {
        let [reflected, transmitted] = &self.cameras;
        let mut later = Vec::with_capacity(WITNESSES);
        for (exposure, grabbed) in reflected.frames.iter().skip(1) {
            let Ok(place) = transmitted.frames.binary_search_by_key(exposure, |(other, _)| *other) else {
                continue;
            };
            later.push([time_of(grabbed), time_of(&transmitted.frames[place].1)]);
            if later.len() == WITNESSES {
                break;
            }
        }
        later
    }

    fn more_may_come(&self) -> bool {
        let patience = self.settings.lead.unwrap_or(self.settings.reorder).max(self.settings.reorder);
        let waited = |camera: &Waiting| camera.newest.unwrap_or(0) >= self.next + patience;
        let over = |camera: &Waiting| camera.ended.is_some();
        !self.cameras.iter().any(over) && !self.cameras.iter().all(waited)
    }

    fn renumber(&mut self, channel: Channel, triggers: u64) {
        let camera = &mut self.cameras[channel.index()];
        camera.missed += triggers;
        camera.newest = camera.newest.map(|newest| newest + triggers);
        camera.frames.iter_mut().for_each(|(exposure, _)| *exposure += triggers);
        let exposure = ExposureIndex(self.next);
        self.events.push_back(PairingEvent::MissedTriggers { channel, exposure, triggers });
    }

    fn times_of(&self, exposure: u64) -> Option<Times> {
        let time = |camera: &Waiting| {
            camera.frames.front().filter(|(first, _)| *first == exposure).map(|(_, grabbed)| time_of(grabbed))
        };
        Some([time(&self.cameras[0])?, time(&self.cameras[1])?])
    }

    fn take(&mut self, camera: usize, missing: Option<Loss>) -> Side {
        if let Some(reason) = missing {
            return Side::Lost(reason, None);
        }
        match self.cameras[camera].frames.pop_front() {
            Some((_, Grabbed::Frame(frame))) => Side::Frame(frame),
            Some((_, Grabbed::Lost(facts, reason))) => Side::Lost(reason, Some(facts)),
            None => Side::Lost(Loss::UpstreamGap, None),
        }
    }
}

fn time_of(grabbed: &Grabbed) -> sofiscope_hal::DeviceTime {
    grabbed.facts().info.device_time
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::pool::tests::facts;
    use proptest::prelude::*;
    use sofiscope_hal::DeviceTime;

    const PERIOD: Duration = Duration::from_millis(20);

    fn pairing(lead: Option<u64>) -> Pairing {
        Pairing::new(PairingSettings { period: PERIOD, reorder: 16, lead }, 64)
    }

    /// A frame whose only pixel says which exposure it truly is.
    fn frame(channel: Channel, numbered: u64, truly: u64) -> Grabbed {
        let mut facts = facts(channel, numbered);
        let drift = if channel == Channel::Transmitted { truly * 2_000 } else { 0 };
        facts.info.device_time = DeviceTime(truly * 20_000_000 + drift);
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
            let all =
                fates.iter().enumerate().map(|(exposure, &(copies, late))| (exposure as u64, copies, late));
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
                let Surplus { duplicates, late } = pairing.surplus(channel);
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
}
