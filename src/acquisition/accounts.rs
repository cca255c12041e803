//! The books of a run: what every camera gave and what every consumer got, with reasons for the difference.
//!
//! In: resolved exposures and what was done with them. Out: counts, and the list of losses as ranges.
//! Never: guesses. Fails: [`Accounts::balance`] names the first law that does not hold.

use super::{Analysis, ExposureRecord, Loss, PairState, Side};
use serde::Serialize;
use sofiscope_hal::Channel;
use std::collections::BTreeMap;

/// Consecutive exposures of one camera that were lost for the same reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct LossRange {
    /// The camera.
    pub channel: Channel,
    /// First exposure lost.
    pub first: u64,
    /// Last exposure lost.
    pub last: u64,
    /// Why.
    pub reason: Loss,
}

/// Counts by reason.
pub type Tally = BTreeMap<Loss, u64>;

/// The account of one camera.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct CameraAccount {
    /// Frames that came whole.
    pub received: u64,
    /// Frames that did not, by reason.
    pub lost: Tally,
    /// Frames that came twice; not among the received.
    pub duplicates: u64,
    /// Frames that came after their exposure was given up; not among the received.
    pub late: u64,
    /// Frames of extra triggers, which belong to no exposure; not among the received.
    pub extra: u64,
    /// Frames in the recording.
    pub recorded: u64,
    /// Frames received and not recorded, by reason.
    pub unrecorded: Tally,
}

/// The accounts of one run.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Accounts {
    /// Exposures since arming, as far as they are resolved.
    pub exposures: u64,
    /// R and T.
    pub cameras: [CameraAccount; 2],
    /// Exposures with a pair.
    pub pairs: u64,
    /// Exposures without, by reason.
    pub unpaired: Tally,
    /// Pairs that the analysis was given.
    pub pairs_analyzed: u64,
    /// Pairs that it was not given, by reason.
    pub analysis_left_out: Tally,
    /// Every loss, in order of exposure for each camera.
    pub losses: Vec<LossRange>,
}

impl Accounts {
    /// Enters one exposure.
    pub fn enter(&mut self, record: &ExposureRecord) {
        self.exposures += 1;
        for channel in Channel::BOTH {
            match record.side(channel) {
                Side::Frame(_) => self.cameras[channel.index()].received += 1,
                Side::Lost(reason, _) => self.lose(channel, record.exposure.0, *reason),
            }
        }
        match record.pair {
            PairState::Paired => self.pairs += 1,
            PairState::Not(reason) => *self.unpaired.entry(reason).or_default() += 1,
        }
        match record.analysis {
            Analysis::Analyzed => self.pairs_analyzed += 1,
            Analysis::LeftOut(reason) => *self.analysis_left_out.entry(reason).or_default() += 1,
            Analysis::None => {}
        }
    }

    /// Frames of a camera lost for any reason.
    #[must_use]
    pub fn lost(&self, channel: Channel) -> u64 {
        self.cameras[channel.index()].lost.values().sum()
    }

    /// Losses of both cameras by reason.
    #[must_use]
    pub fn lost_by_reason(&self) -> Tally {
        let mut all = self.cameras[0].lost.clone();
        for (&reason, &count) in &self.cameras[1].lost {
            *all.entry(reason).or_default() += count;
        }
        all
    }

    /// Checks that nothing is unaccounted for.
    ///
    /// # Errors
    /// The law that does not hold, with its numbers.
    pub fn balance(&self) -> Result<(), String> {
        let law = |name: &str, left: u64, right: u64| {
            if left == right { Ok(()) } else { Err(format!("{name}: {left} is not {right}")) }
        };
        for channel in Channel::BOTH {
            let camera = &self.cameras[channel.index()];
            law(
                &format!("{channel}, exposures = received + lost"),
                self.exposures,
                camera.received + self.lost(channel),
            )?;
            let listed = self.losses.iter().filter(|range| range.channel == channel);
            let listed: u64 = listed.map(|range| range.last - range.first + 1).sum();
            law(&format!("{channel}, lost = listed"), self.lost(channel), listed)?;
        }
        law("exposures = pairs + unpaired", self.exposures, self.pairs + self.unpaired.values().sum::<u64>())
    }

    fn lose(&mut self, channel: Channel, exposure: u64, reason: Loss) {
        *self.cameras[channel.index()].lost.entry(reason).or_default() += 1;
        let open = self.losses.iter_mut().rev().take(2).find(|range| range.channel == channel);
        match open {
            Some(range) if range.last + 1 == exposure && range.reason == reason => range.last = exposure,
            _ => self.losses.push(LossRange { channel, first: exposure, last: exposure, reason }),
        }
    }
}
