//! Pairs the frames of both cameras by exposure, never by arrival.
//!
//! In: frames in any order. Out: every exposure once, in order, each side a frame or the reason for none.
//! Never: reads a clock, looks at pixels, loses a frame unsaid, pairs frames whose times disagree.
//! Fails: not at all; what does not fit is a [`Loss`] and a [`PairingEvent`].

use super::alignment::{Alignment, Times, Verdict, WITNESSES, Witness};
use super::start::{self, START_FRAMES};
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
    /// A camera exposed without a trigger and counted it; its exposures were renumbered from here.
    ExtraTriggers {
        /// The camera.
        channel: Channel,
        /// First exposure that is renumbered.
        exposure: ExposureIndex,
        /// Exposures too many.
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
    /// Frames of extra triggers, which belong to no exposure.
    pub extra: u64,
}

/// One camera's frames that wait for the other camera.
#[derive(Debug)]
struct Waiting {
    /// Frames by exposure, rising.
    frames: VecDeque<(u64, Grabbed)>,
    /// The newest exposure that ever came.
    newest: Option<u64>,
    /// Triggers that this camera missed without knowing, less those that it saw without there being any.
    slip: i64,
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
    /// Whether the first frames have been compared, or never will be.
    is_started: bool,
    events: VecDeque<PairingEvent>,
}

impl Pairing {
    /// A pairing that expects exposure 0; `frames` are as many as a camera can have out at once.
    #[must_use]
    pub fn new(settings: PairingSettings, frames: usize) -> Self {
        let camera = || Waiting {
            frames: VecDeque::with_capacity(frames),
            newest: None,
            slip: 0,
            ended: None,
            surplus: Surplus::default(),
        };
        Self {
            settings,
            cameras: [camera(), camera()],
            next: 0,
            alignment: Alignment::new(settings.period),
            // Only frames of sources that do not wait arrive when they are made.
            is_started: settings.lead.is_none(),
            events: VecDeque::new(),
        }
    }

    /// Takes what a camera delivered.
    pub fn offer(&mut self, grabbed: Grabbed) {
        let facts = grabbed.facts();
        let camera = &mut self.cameras[facts.channel.index()];
        let exposure = facts.info.exposure.0.checked_add_signed(camera.slip);
        let Some(exposure) = exposure.filter(|&exposure| exposure >= self.next) else {
            camera.surplus.late += 1;
            return;
        };
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
        if !self.is_started && !self.start() {
            return None;
        }
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
                        self.renumber_later(channel, triggers);
                        continue;
                    }
                    Verdict::Extra { channel, triggers } => {
                        self.renumber_earlier(channel, triggers);
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
        let mut verdict = self.alignment.judge(times, &[]);
        if verdict == Verdict::Unclear {
            let later = self.later_times();
            verdict = self.alignment.judge(times, &later);
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

    /// Compares the first frames of both cameras, as soon as there are enough; says whether pairing may begin.
    fn start(&mut self) -> bool {
        let has_enough = |camera: &Waiting| camera.frames.len() >= START_FRAMES;
        if self.cameras.iter().all(has_enough) {
            let first = self.cameras.each_ref().map(|camera| {
                let frame = |(number, grabbed): &(u64, Grabbed)| {
                    let facts = grabbed.facts();
                    (*number, facts.info.device_time, facts.received)
                };
                camera.frames.iter().take(START_FRAMES).map(frame).collect()
            });
            if let Some(start) = start::compare(&first, self.settings.period) {
                for channel in Channel::BOTH {
                    let missed = start.missed[channel.index()];
                    if missed > 0 {
                        self.renumber_later(channel, missed);
                    }
                }
                self.alignment.begin_after(start.before);
            }
            self.is_started = true;
        }
        let longest = self.settings.lead.unwrap_or(0);
        let is_over = |camera: &Waiting| camera.ended.is_some() || camera.newest >= Some(longest);
        self.is_started |= self.cameras.iter().any(is_over);
        self.is_started
    }

    /// The next exposures of which both frames are here.
    fn later_times(&self) -> Vec<Witness> {
        let [reflected, transmitted] = &self.cameras;
        let mut later = Vec::with_capacity(WITNESSES);
        for (exposure, grabbed) in reflected.frames.iter().skip(1) {
            let Ok(place) = transmitted.frames.binary_search_by_key(exposure, |(other, _)| *other) else {
                continue;
            };
            later.push((*exposure, [time_of(grabbed), time_of(&transmitted.frames[place].1)]));
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

    /// This camera missed triggers: its frames belong to later exposures.
    fn renumber_later(&mut self, channel: Channel, triggers: u64) {
        let camera = &mut self.cameras[channel.index()];
        camera.slip += triggers.cast_signed();
        camera.newest = camera.newest.map(|newest| newest + triggers);
        camera.frames.iter_mut().for_each(|(exposure, _)| *exposure += triggers);
        let exposure = ExposureIndex(self.next);
        self.events.push_back(PairingEvent::MissedTriggers { channel, exposure, triggers });
    }

    /// This camera exposed too often: its frames belong to earlier exposures, and the first ones to none.
    fn renumber_earlier(&mut self, channel: Channel, triggers: u64) {
        let next = self.next;
        let camera = &mut self.cameras[channel.index()];
        camera.slip -= triggers.cast_signed();
        camera.newest = camera.newest.map(|newest| newest.saturating_sub(triggers));
        while camera.frames.front().is_some_and(|(exposure, _)| *exposure < next + triggers) {
            camera.frames.pop_front();
            camera.surplus.extra += 1;
        }
        camera.frames.iter_mut().for_each(|(exposure, _)| *exposure -= triggers);
        let exposure = ExposureIndex(next);
        self.events.push_back(PairingEvent::ExtraTriggers { channel, exposure, triggers });
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
mod tests;
