//! The judge: exactly what the simulated cameras did.
//!
//! In: incidents from the streams. Out: lists of exposures, readable at any time.
//! Never: keeps anything for exposures that went well, beyond their number.
//!
//! Law: `begun = intact + lost` as soon as the stream has ended or was dropped.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sofiscope_hal::{Channel, ExposureIndex};

/// Incidents for which memory is taken at arming; more of them take more memory on the way.
const RESERVED: usize = 1 << 16;

/// What befell an exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum IncidentKind {
    /// The frame never arrived.
    Dropped,
    /// The frame never arrived, and neither did its neighbors.
    DroppedInBurst,
    /// The reader was slow and the driver's buffers were full.
    Overrun,
    /// The frame came without some of its packets.
    Incomplete,
    /// The frame came with another size.
    WrongSize,
    /// The camera did not see the trigger.
    MissedTrigger,
    /// Counter and clock went back together, so the driver could not number the frame.
    Unplaceable,
    /// The stream was dropped before the frame was read.
    Unread,
    /// The frame was delivered twice.
    Duplicated,
    /// The frame was delivered after later ones, by a delay of its own.
    Late,
    /// The camera exposed once more, half a period before this exposure.
    ExtraTrigger,
    /// The camera's clock jumped before this exposure.
    ClockStep,
    /// The camera's counter began anew with this exposure.
    CounterRestart,
    /// Nothing came from this exposure on.
    Stalled,
    /// The camera was gone from this exposure on.
    Died,
}

impl IncidentKind {
    /// Whether the exposure never reached the reader intact.
    #[must_use]
    pub fn loses(self) -> bool {
        match self {
            Self::Dropped
            | Self::DroppedInBurst
            | Self::Overrun
            | Self::Incomplete
            | Self::WrongSize
            | Self::MissedTrigger
            | Self::Unplaceable
            | Self::Unread => true,
            Self::Duplicated
            | Self::Late
            | Self::ExtraTrigger
            | Self::ClockStep
            | Self::CounterRestart
            | Self::Stalled
            | Self::Died => false,
        }
    }
}

/// One thing that happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Incident {
    /// The exposure, counted in triggers since arming: that of the sample, not of the camera's counter.
    pub exposure: u64,
    /// What happened.
    pub kind: IncidentKind,
}

/// What one camera did since it was last armed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Record {
    /// Exposures that began.
    pub begun: u64,
    /// Exposures of which an intact frame reached the reader.
    pub intact: u64,
    /// Frames that reached the reader again.
    pub duplicates: u64,
    /// Frames that belong to no exposure and reached the reader: those of extra triggers.
    pub extra: u64,
    /// Everything else, in the order in which it happened.
    pub incidents: Vec<Incident>,
}

impl Record {
    pub(super) fn note(&mut self, exposure: u64, kind: IncidentKind) {
        self.incidents.push(Incident { exposure, kind });
    }
}

/// The record of one run, shared by the stream that writes and the oracle that reads.
#[derive(Debug, Clone, Default)]
pub(super) struct SharedRecord(Arc<Mutex<Record>>);

impl SharedRecord {
    /// An empty record with memory for many incidents.
    pub(super) fn reserved() -> Self {
        let record = Record { incidents: Vec::with_capacity(RESERVED), ..Record::default() };
        Self(Arc::new(Mutex::new(record)))
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Record> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Knows what the cameras did since each was last armed.
#[derive(Debug, Clone, Default)]
pub struct Oracle {
    runs: Arc<Mutex<[SharedRecord; 2]>>,
}

impl Oracle {
    /// Everything about one camera.
    #[must_use]
    pub fn record(&self, channel: Channel) -> Record {
        self.run(channel).lock().clone()
    }

    /// Exposures that began.
    #[must_use]
    pub fn begun(&self, channel: Channel) -> u64 {
        self.run(channel).lock().begun
    }

    /// Number of exposures of which an intact frame reached the reader.
    #[must_use]
    pub fn intact(&self, channel: Channel) -> u64 {
        self.run(channel).lock().intact
    }

    /// Frames that reached the reader again.
    #[must_use]
    pub fn duplicates(&self, channel: Channel) -> u64 {
        self.run(channel).lock().duplicates
    }

    /// Exposures with an incident of this kind, in order.
    #[must_use]
    pub fn exposures(&self, channel: Channel, kind: IncidentKind) -> Vec<u64> {
        self.sorted(channel, |found| found == kind)
    }

    /// Exposures that began and of which no intact frame reached the reader, in order.
    #[must_use]
    pub fn lost(&self, channel: Channel) -> Vec<u64> {
        self.sorted(channel, IncidentKind::loses)
    }

    /// Triggers that the camera did not see, in order.
    #[must_use]
    pub fn missed_triggers(&self, channel: Channel) -> Vec<u64> {
        self.exposures(channel, IncidentKind::MissedTrigger)
    }

    /// Frames of extra triggers that reached the reader.
    #[must_use]
    pub fn extra(&self, channel: Channel) -> u64 {
        self.run(channel).lock().extra
    }

    /// First exposure of which nothing came any more because the camera stalled or died.
    #[must_use]
    pub fn silent_from(&self, channel: Channel) -> Option<u64> {
        let silent = |kind| matches!(kind, IncidentKind::Stalled | IncidentKind::Died);
        self.sorted(channel, silent).first().copied()
    }

    /// The true exposure of a frame that the camera counts as `numbered`: later by the triggers it missed, earlier
    /// by the extra ones. The frame of an extra trigger counts as the exposure after it.
    #[must_use]
    pub fn true_exposure(&self, channel: Channel, numbered: ExposureIndex) -> ExposureIndex {
        let missed = self.missed_triggers(channel).into_iter().map(|at| (at, true));
        let extra = self.exposures(channel, IncidentKind::ExtraTrigger).into_iter().map(|at| (at, false));
        let mut slips: Vec<(u64, bool)> = missed.chain(extra).collect();
        slips.sort_unstable();
        let mut exposure = numbered.0;
        for (at, is_missed) in slips {
            if is_missed {
                exposure += u64::from(at <= exposure);
            } else {
                exposure -= u64::from(exposure > at);
            }
        }
        ExposureIndex(exposure)
    }

    /// Begins the record of a camera that is being armed.
    pub(super) fn begin(&self, channel: Channel) -> SharedRecord {
        let record = SharedRecord::reserved();
        self.runs.lock().unwrap_or_else(PoisonError::into_inner)[channel.index()] = record.clone();
        record
    }

    fn run(&self, channel: Channel) -> SharedRecord {
        self.runs.lock().unwrap_or_else(PoisonError::into_inner)[channel.index()].clone()
    }

    fn sorted(&self, channel: Channel, wanted: impl Fn(IncidentKind) -> bool) -> Vec<u64> {
        let run = self.run(channel);
        let record = run.lock();
        let found = record.incidents.iter().filter(|incident| wanted(incident.kind));
        let mut exposures: Vec<u64> = found.map(|incident| incident.exposure).collect();
        exposures.sort_unstable();
        exposures
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_after_missed_triggers_belong_to_later_exposures() {
        let oracle = Oracle::default();
        let record = oracle.begin(Channel::Transmitted);
        for missed in [3, 5] {
            record.lock().note(missed, IncidentKind::MissedTrigger);
        }
        let truth: Vec<u64> =
            (0..6).map(|k| oracle.true_exposure(Channel::Transmitted, ExposureIndex(k)).0).collect();
        assert_eq!(truth, [0, 1, 2, 4, 6, 7]);
        assert_eq!(oracle.lost(Channel::Transmitted), [3, 5]);
        record.lock().note(7, IncidentKind::ExtraTrigger);
        let truth: Vec<u64> =
            (4..8).map(|k| oracle.true_exposure(Channel::Transmitted, ExposureIndex(k)).0).collect();
        assert_eq!(truth, [6, 7, 7, 8]);
        assert_eq!(oracle.true_exposure(Channel::Reflected, ExposureIndex(4)), ExposureIndex(4));
    }
}
