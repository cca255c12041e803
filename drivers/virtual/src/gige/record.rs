//! What the camera did to its own frames: the judge in tests.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What happened to a frame on its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Fate {
    /// Some packets were never sent.
    Damaged,
    /// No packet was sent.
    Lost,
    /// The trigger was not seen, or came while an exposure was going on: there was no frame.
    Missed,
}

/// A frame to which something happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Damage {
    /// Acquisitions before this one.
    pub run: u64,
    /// Exposures since the acquisition began.
    pub exposure: u64,
    /// Id that the frame had, or would have had.
    pub block_id: u16,
    /// What happened.
    pub fate: Fate,
}

#[derive(Debug, Default)]
struct Entries {
    damages: Vec<Damage>,
    sent: u64,
    resent_packets: u64,
}

/// What the camera did, shared with whoever judges.
#[derive(Debug, Clone, Default)]
pub struct GigeRecord(Arc<Mutex<Entries>>);

impl GigeRecord {
    fn entries(&self) -> MutexGuard<'_, Entries> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Everything that happened to frames, in their order.
    #[must_use]
    pub fn damages(&self) -> Vec<Damage> {
        self.entries().damages.clone()
    }

    /// Frames of which every packet was sent.
    #[must_use]
    pub fn sent(&self) -> u64 {
        self.entries().sent
    }

    /// Packets that were sent again because they were asked for.
    #[must_use]
    pub fn resent_packets(&self) -> u64 {
        self.entries().resent_packets
    }

    pub(super) fn note(&self, damage: Damage) {
        self.entries().damages.push(damage);
    }

    pub(super) fn note_sent(&self) {
        self.entries().sent += 1;
    }

    pub(super) fn note_resent(&self, packets: u64) {
        self.entries().resent_packets += packets;
    }
}
