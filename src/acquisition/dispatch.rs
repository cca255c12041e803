//! The pairing thread: frames of both cameras in, exposures to recording and analysis, the books kept.
//!
//! In: two queues of [`Grabbed`]. Out: [`FramePair`]s to the analysis, [`ExposureRecord`]s to the recording,
//! [`Progress`] to whoever looks. Never: waits for a consumer that is live, copies pixels.
//! Fails: consumers that are gone or full cost frames, with a reason each.

use super::{
    Accounts, Analysis, ExposureRecord, Frame, Grabbed, Loss, LossRange, PairState, Pairing, PairingEvent,
    Pressure, PressureGauge, Resolved, Shedding, Side, Tally,
};
use crate::pipeline::{Bell, Publisher, Received, Receiver, Refused, Sender};
use sofiscope_hal::{Channel, ExposureIndex};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How often progress is shown.
const SHOW_EVERY: Duration = Duration::from_millis(50);

/// Longest sleep without looking whether the cameras have ended.
const TURN: Duration = Duration::from_millis(20);

/// Both frames of one exposure.
#[derive(Debug, Clone)]
pub struct FramePair {
    /// The exposure.
    pub exposure: ExposureIndex,
    /// R and T.
    pub frames: [Frame; 2],
}

/// Pairs that the analysis is not to have.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LeaveOut {
    /// Exposures that it had not in the run that is repeated, and why.
    pub exposures: BTreeMap<u64, Loss>,
    /// Pairs with a larger focus error, nanometers, or without a lock, are left out.
    pub focus_gate_nm: Option<f64>,
}

impl LeaveOut {
    /// Why the analysis is not to have this pair, if so.
    fn reason(&self, exposure: ExposureIndex, frames: [&Frame; 2]) -> Option<Loss> {
        let is_sharp = |gate_nm: f64| {
            let errors = frames.map(|frame| frame.facts().conditions.focus_nm);
            errors.iter().all(|error| error.is_some_and(|error_nm| error_nm.abs() <= gate_nm))
        };
        if self.focus_gate_nm.is_some_and(|gate_nm| !is_sharp(gate_nm)) {
            return Some(Loss::OutOfFocus);
        }
        self.exposures.get(&exposure.0).copied()
    }
}

/// What is shown while a run goes on.
#[derive(Debug, Clone, Default)]
pub struct Progress {
    /// Exposures resolved.
    pub exposures: u64,
    /// Frames received of each camera.
    pub received: [u64; 2],
    /// Frames lost, both cameras, by reason.
    pub lost: Tally,
    /// Pairs.
    pub pairs: u64,
    /// Pairs given to the analysis.
    pub pairs_analyzed: u64,
    /// Pairs that the analysis was not given.
    pub analysis_left_out: u64,
    /// Frames that the recording did not get.
    pub unrecorded: u64,
    /// How full the queues to recording and analysis are, 0 to 1.
    pub fill: [f64; 2],
    /// Who goes without.
    pub pressure: Pressure,
}

/// What the thread leaves at its end.
#[derive(Debug, Clone, Default)]
pub struct DispatchReport {
    /// The books.
    pub accounts: Accounts,
    /// What happened to pairing.
    pub events: Vec<PairingEvent>,
    /// Pairs that a full queue kept from the analysis while the preview was not yet shut out; always 0, as the
    /// preview must go first.
    pub lost_beside_preview: u64,
}

/// Shortest time between two pairs for whoever looks while somebody is short of time.
const LOOK_UNDER_PRESSURE: Duration = Duration::from_secs(1);

/// Pairs now and then for whoever looks at the cameras: one a second while the analysis is short of time, as a picture
/// that stands still looks like a camera that does, and none while the recording is.
#[derive(Debug)]
pub struct Tap {
    /// To the thread that looks; it has one place, and a pair that finds it taken is not looked at.
    pub to_look: Sender<FramePair>,
    /// Shortest time between two pairs.
    pub every: Duration,
    /// When the last one went.
    pub last: Option<Instant>,
}

impl Tap {
    fn offer(&mut self, exposure: ExposureIndex, [reflected, transmitted]: [&Frame; 2], pressure: Pressure) {
        let every = match pressure {
            Pressure::None => self.every,
            Pressure::NoPreview => self.every.max(LOOK_UNDER_PRESSURE),
            Pressure::NoAnalysis => return,
        };
        if self.last.is_some_and(|last| last.elapsed() < every) {
            return;
        }
        let frames = [reflected.clone(), transmitted.clone()];
        // Whoever looks takes what it can: this is no loss.
        if self.to_look.send(FramePair { exposure, frames }).is_ok() {
            self.last = Some(Instant::now());
        }
    }
}

/// The work of the pairing thread.
#[derive(Debug)]
pub struct Dispatch {
    /// From the grabbers, R and T; both ring the same bell.
    pub from_grabbers: [Receiver<Grabbed>; 2],
    /// The bell of both queues.
    pub bell: Bell,
    /// The pairing.
    pub pairing: Pairing,
    /// To the analysis, if there is one.
    pub to_analysis: Option<Sender<FramePair>>,
    /// To the recording, if there is one.
    pub to_recording: Option<Sender<ExposureRecord>>,
    /// To whoever looks at the cameras.
    pub to_look: Option<Tap>,
    /// Pairs that the analysis is not to have.
    pub leave_out: LeaveOut,
    /// Who goes without, for the preview to see.
    pub gauge: PressureGauge,
    /// What is shown.
    pub progress: Publisher<Progress>,
    /// Frames that never came after this was set were stopped, not lost by the camera.
    pub stop: Arc<AtomicBool>,
}

/// What changes while the thread works.
#[derive(Debug, Default)]
struct Books {
    accounts: Accounts,
    shedding: Shedding,
    pressure: Pressure,
    /// Records without frames that wait until the recording has room.
    pending: VecDeque<ExposureRecord>,
    events: Vec<PairingEvent>,
    lost_beside_preview: u64,
}

impl Dispatch {
    /// Works until both grabbers are gone and every exposure is resolved.
    pub fn run(mut self) -> DispatchReport {
        let mut books = Books::default();
        let mut shown = Instant::now();
        loop {
            let open = self.take_in();
            while let Some(resolved) = self.pairing.next_resolved() {
                self.give_out(resolved, &mut books);
            }
            while let Some(event) = self.pairing.next_event() {
                tracing::warn!(?event, "pairing");
                books.events.push(event);
            }
            if shown.elapsed() >= SHOW_EVERY {
                self.show(&books);
                shown = Instant::now();
            }
            if !open {
                break;
            }
            let queues = &self.from_grabbers;
            self.bell.wait_until(TURN, || queues.iter().any(|queue| !queue.is_empty()));
        }
        self.flush_pending(&mut books);
        self.close_books(books)
    }

    /// Offers everything that has come; says whether anything can still come.
    fn take_in(&mut self) -> bool {
        let mut open = false;
        for (channel, queue) in Channel::BOTH.into_iter().zip(&mut self.from_grabbers) {
            // At most as much as is there now, so that neither camera starves the other.
            for _ in 0..queue.len().max(1) {
                match queue.try_receive() {
                    Received::Value(grabbed) => {
                        self.pairing.offer(grabbed);
                        open = true;
                    }
                    Received::Empty => {
                        open = true;
                        break;
                    }
                    Received::Closed => {
                        let stopped = self.stop.load(Ordering::Acquire);
                        let reason = if stopped { Loss::Stopping } else { Loss::UpstreamGap };
                        self.pairing.end(channel, reason);
                        break;
                    }
                }
            }
        }
        open
    }

    fn give_out(&mut self, resolved: Resolved, books: &mut Books) {
        self.flush_pending(books);
        let [recording, analysis] = self.fill();
        // Rows that still wait mean that the recording has just lost frames, however empty its queue is by now.
        let recording = if books.pending.is_empty() { recording } else { 1.0 };
        books.pressure = books.shedding.step(recording, analysis);
        self.gauge.set(books.pressure);
        let analysis = self.analyze(&resolved, books.pressure);
        if let Some(tap) = &mut self.to_look
            && let ([Side::Frame(reflected), Side::Frame(transmitted)], PairState::Paired) =
                (&resolved.sides, resolved.pair)
        {
            tap.offer(resolved.exposure, [reflected, transmitted], books.pressure);
        }
        if analysis == Analysis::LeftOut(Loss::QueueFull) && books.pressure == Pressure::None {
            books.lost_beside_preview += 1;
        }
        let Resolved { exposure, sides, pair } = resolved;
        let record = ExposureRecord { exposure, sides, pair, analysis };
        books.accounts.enter(&record);
        if self.to_recording.is_some() {
            self.record(record, books);
        }
    }

    fn analyze(&mut self, resolved: &Resolved, pressure: Pressure) -> Analysis {
        let [Side::Frame(reflected), Side::Frame(transmitted)] = &resolved.sides else {
            return Analysis::None;
        };
        let (Some(queue), PairState::Paired) = (&mut self.to_analysis, resolved.pair) else {
            return Analysis::None;
        };
        // First: a pair without focus is never to be analyzed, whatever else kept it out.
        if let Some(reason) = self.leave_out.reason(resolved.exposure, [reflected, transmitted]) {
            return Analysis::LeftOut(reason);
        }
        if pressure == Pressure::NoAnalysis {
            return Analysis::LeftOut(Loss::ShedByPolicy);
        }
        let frames = [reflected.clone(), transmitted.clone()];
        match queue.send(FramePair { exposure: resolved.exposure, frames }) {
            Ok(()) => Analysis::Analyzed,
            Err(Refused::Full(_)) => Analysis::LeftOut(Loss::QueueFull),
            Err(Refused::Closed(_)) => Analysis::LeftOut(Loss::Stopping),
        }
    }

    fn record(&mut self, record: ExposureRecord, books: &mut Books) {
        if books.pending.is_empty() {
            let Some(queue) = &mut self.to_recording else { return };
            match queue.send(record) {
                Ok(()) => {}
                Err(Refused::Full(record)) => postpone(record, Loss::QueueFull, books),
                Err(Refused::Closed(record)) => count_unrecorded(&record, Loss::IoError, &mut books.accounts),
            }
        } else {
            postpone(record, Loss::QueueFull, books);
        }
    }

    fn flush_pending(&mut self, books: &mut Books) {
        let Some(queue) = &mut self.to_recording else { return };
        while let Some(record) = books.pending.pop_front() {
            match queue.send(record) {
                Ok(()) => {}
                Err(Refused::Full(record)) => {
                    books.pending.push_front(record);
                    break;
                }
                Err(Refused::Closed(_)) => books.pending.clear(),
            }
        }
    }

    fn fill(&self) -> [f64; 2] {
        [
            self.to_recording.as_ref().map_or(0.0, Sender::fill),
            self.to_analysis.as_ref().map_or(0.0, Sender::fill),
        ]
    }

    fn show(&mut self, books: &Books) {
        let accounts = &books.accounts;
        let unrecorded = accounts.cameras.iter().flat_map(|camera| camera.unrecorded.values());
        let progress = Progress {
            exposures: accounts.exposures,
            received: [0, 1].map(|camera| accounts.cameras[camera].received),
            lost: accounts.lost_by_reason(),
            pairs: accounts.pairs,
            pairs_analyzed: accounts.pairs_analyzed,
            analysis_left_out: accounts.analysis_left_out.values().sum(),
            unrecorded: unrecorded.sum(),
            fill: self.fill(),
            pressure: books.pressure,
        };
        self.progress.publish(progress);
    }

    fn close_books(mut self, mut books: Books) -> DispatchReport {
        // Whatever the recording could not take by now is told to it with patience: it has only rows left to write.
        while !books.pending.is_empty() && self.to_recording.as_ref().is_some_and(|queue| !queue.is_closed())
        {
            self.flush_pending(&mut books);
            std::thread::yield_now();
        }
        for channel in Channel::BOTH {
            let surplus = self.pairing.surplus(channel);
            let account = &mut books.accounts.cameras[channel.index()];
            (account.duplicates, account.late) = (surplus.duplicates, surplus.late);
            account.extra = surplus.extra;
        }
        self.show(&books);
        DispatchReport {
            accounts: books.accounts,
            events: books.events,
            lost_beside_preview: books.lost_beside_preview,
        }
    }
}

/// Lets the frames go and keeps the row for later.
fn postpone(mut record: ExposureRecord, reason: Loss, books: &mut Books) {
    count_unrecorded(&record, reason, &mut books.accounts);
    for side in &mut record.sides {
        if let Side::Frame(frame) = side {
            *side = Side::Lost(reason, Some(*frame.facts()));
        }
    }
    books.pending.push_back(record);
}

fn count_unrecorded(record: &ExposureRecord, reason: Loss, accounts: &mut Accounts) {
    for channel in Channel::BOTH {
        if record.side(channel).frame().is_some() {
            *accounts.cameras[channel.index()].unrecorded.entry(reason).or_default() += 1;
        }
    }
}

impl DispatchReport {
    /// Losses of one camera.
    pub fn losses(&self, channel: Channel) -> impl Iterator<Item = LossRange> + '_ {
        self.accounts.losses.iter().copied().filter(move |range| range.channel == channel)
    }
}
