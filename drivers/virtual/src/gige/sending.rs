//! Sends the packets of frames, with everything that can happen to packets on their way.

use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;

use super::control::Body;
use super::gvsp::Packets;
use super::setup::Setup;
use super::{Damage, Fate};

/// Delays between packets that are shorter than this are summed up.
const SHORTEST_WAIT: Duration = Duration::from_micros(100);

/// What a chance decides.
#[derive(Clone, Copy)]
enum Chance {
    Loss,
    Doubling,
    Shuffle,
    SecondLoss,
}

/// A number that depends on nothing but its arguments (splitmix64), uniform below `below`.
fn chance(seed: u64, chance: Chance, frame: u64, packet: u32, below: u64) -> u64 {
    let mut mixed = seed;
    for part in [chance as u64, frame, u64::from(packet)] {
        mixed = mixed.wrapping_add(part).wrapping_add(0x9E37_79B9_7F4A_7C15);
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^= mixed >> 31;
    }
    mixed % below.max(1)
}

/// Sends the frames of one acquisition.
pub(super) struct Sending<'a> {
    body: &'a Body,
    run: u64,
    destination: SocketAddr,
    delay: Duration,
    order: Vec<u32>,
    packet: Vec<u8>,
}

impl<'a> Sending<'a> {
    pub(super) fn new(body: &'a Body, run: u64, setup: Setup) -> Self {
        let destination = SocketAddr::from(setup.destination);
        Self { body, run, destination, delay: setup.packet_delay, order: Vec::new(), packet: Vec::new() }
    }

    /// Sends a frame, or what the faults leave of it, and notes what was not sent.
    pub(super) fn send(&mut self, frame: &Arc<Packets>, exposure: u64) {
        self.body.keep(frame.clone());
        let lost = self.line_up(frame, exposure);
        let begun = crate::monotonic();
        let order = std::mem::take(&mut self.order);
        for (place, &number) in order.iter().enumerate() {
            frame.write(number, &mut self.packet);
            // A packet that does not get through is lost, as on a real line.
            let _lost = self.body.stream.send_to(&self.packet, self.destination);
            self.wait(begun + self.delay * u32::try_from(place).unwrap_or(u32::MAX));
        }
        self.order = order;
        let fate = match lost {
            0 => return self.body.record.note_sent(),
            lost if lost == frame.num_packets() => Fate::Lost,
            _ => Fate::Damaged,
        };
        self.body.record.note(Damage { run: self.run, exposure, block_id: frame.block_id, fate });
    }

    /// Which packets are sent, in which order; returns how many are not.
    fn line_up(&mut self, frame: &Packets, exposure: u64) -> u32 {
        let faults = &self.body.settings.faults;
        let seed = self.body.settings.seed;
        let num_packets = frame.num_packets();
        self.order.clear();
        if faults.lost_frames.contains(&exposure)
            || faults.lost_bursts.iter().any(|burst| burst.contains(&exposure))
        {
            return num_packets;
        }
        let happens = |what, number, per_thousand: u32| {
            per_thousand > 0 && chance(seed, what, exposure, number, 1000) < u64::from(per_thousand)
        };
        let mut lost = 0;
        for number in 0..num_packets {
            if happens(Chance::Loss, number, faults.lost_packets_per_thousand) {
                lost += 1;
                continue;
            }
            let copies =
                1 + usize::from(happens(Chance::Doubling, number, faults.doubled_packets_per_thousand));
            self.order.extend(std::iter::repeat_n(number, copies));
        }
        if faults.shuffled_packets > 1 {
            for window in self.order.chunks_mut(faults.shuffled_packets) {
                window.sort_by_key(|&number| chance(seed, Chance::Shuffle, exposure, number, u64::MAX));
            }
        }
        lost
    }

    /// Keeps the pace of the packet delay.
    fn wait(&self, until: Duration) {
        let wait = until.saturating_sub(crate::monotonic());
        if wait > SHORTEST_WAIT {
            std::thread::park_timeout(wait);
        }
    }
}

/// Sends packets of a frame that was kept; they may be lost again.
pub(super) fn send_again(body: &Body, frame: &Packets, numbers: RangeInclusive<u32>) {
    let destination = body.state().registers.setup().destination;
    let faults = &body.settings.faults;
    let last = (*numbers.end()).min(frame.num_packets() - 1);
    let mut packet = Vec::new();
    let mut sent = 0;
    for number in *numbers.start()..=last {
        let draw = chance(body.settings.seed, Chance::SecondLoss, frame.time_ns, number, 1000);
        if draw < u64::from(faults.lost_packets_per_thousand) {
            continue;
        }
        frame.write(number, &mut packet);
        let _lost = body.stream.send_to(&packet, destination);
        sent += 1;
    }
    body.record.note_resent(sent);
}
