//! The recording under way, owned by one thread.
//!
//! In: [`ExposureRecord`]s. Out: groups of frames committed to the files of both cameras, and their rows.
//! Never: copies frames that are whole pages, keeps a frame longer than its group.
//! Fails: once; from then on every frame goes to the ledger as lost, and finishing still works.

use super::RecordingError;
use super::begin::{ensure_planned_space, write_new};
use super::direct::sync_directory;
use super::ending::Ending;
use super::events::{Event, EventLog, StopRecord, StopStatus};
use super::finish::MAX_PLANE_TIMES;
use super::gate::{Change, Gate, Operation};
use super::group::{Pending, lose, lose_beyond, write_images};
use super::ledger_file::{LEDGER, LedgerFile};
use super::lock::{Lock, note_durable};
use super::metadata::{METADATA, Metadata, RecordingPlan};
use super::presence::Presence;
use super::summary::RecordingSummary;
use super::sync::{Pace, SyncFile, SyncRequest, Syncer, sync};
use super::writer::ImageWriter;
use crate::acquisition::{ExposureRecord, Frame, FrameFacts, LedgerRow, Loss, RowState, Side};
use crate::files::free_bytes;
use serde_json::json;
use sofiscope_hal::Channel;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A group is committed when one camera has this much in it.
const GROUP_BYTES: u64 = 16 << 20;
/// Or this many exposures, with or without frames.
const GROUP_EXPOSURES: usize = 4096;
/// While more waits to be pushed, the oldest exposure of a group is at most this old.
const GROUP_AGE: Duration = Duration::from_millis(50);
/// Closing takes this long at most, and then goes on without anybody who waits.
const CLOSING_TIME: Duration = Duration::from_secs(30);
/// A run ends when less than this is free.
const LOW_WATER_BYTES: u64 = 2 << 30;
/// Or less than what the cameras deliver in this time.
const LOW_WATER_SECONDS: u64 = 5;

/// A recording under way. Dropped without [`finish`](Recording::finish), it is as after a crash:
/// what was committed is readable, and [`recover`](super::recover) writes the end.
#[derive(Debug)]
pub struct Recording {
    directory: PathBuf,
    metadata: Metadata,
    gate: Gate,
    images: [ImageWriter; 2],
    ledger: LedgerFile,
    events: EventLog,
    syncer: Syncer,
    /// Ledger and events, for syncing.
    texts: [SyncFile; 2],
    lock: Lock,
    presence: Presence,
    pending: Vec<Pending>,
    pending_bytes: [u64; 2],
    pending_since: Option<Instant>,
    /// Why nothing more is recorded, and what the ledger says of it.
    failed: Option<(Loss, String)>,
    tally: RecordingSummary,
    times: [Vec<u64>; 2],
}

/// Room on the disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpaceLeft {
    /// Bytes that this recording can still write.
    pub bytes: u64,
    /// Time until they are used up at the rate of the cameras; `None` for cameras without a period.
    pub seconds: Option<f64>,
}

impl Recording {
    /// Creates the directory with everything that is known before the first frame.
    ///
    /// # Errors
    /// [`RecordingError::Exists`], [`RecordingError::Space`] when the plan does not fit with 5 % to spare,
    /// [`RecordingError::Refused`], [`RecordingError::Storage`].
    pub fn create(plan: &RecordingPlan) -> Result<Self, RecordingError> {
        Self::create_through(plan, jiff::Timestamp::now(), Gate::default(), Pace::default())
    }

    pub(super) fn create_through(
        plan: &RecordingPlan,
        created: jiff::Timestamp,
        gate: Gate,
        pace: Pace,
    ) -> Result<Self, RecordingError> {
        let metadata = Metadata::of(plan, created)?;
        ensure_planned_space(plan)?;
        let directory = &plan.directory;
        gate.pass(Operation::Write, directory).and_then(|()| fs::create_dir(directory)).map_err(
            |source| match source.kind() {
                io::ErrorKind::AlreadyExists => RecordingError::Exists { path: directory.clone() },
                _ => RecordingError::storage(directory, "create", source),
            },
        )?;
        gate.note(Change::Directory, directory);
        Self::fill(plan, metadata, gate, pace).inspect_err(|_| {
            // Nothing was recorded in what this call made.
            let _ = fs::remove_dir_all(directory);
        })
    }

    fn fill(
        plan: &RecordingPlan,
        metadata: Metadata,
        gate: Gate,
        pace: Pace,
    ) -> Result<Self, RecordingError> {
        let directory = &plan.directory;
        let lock = Lock::take(directory)?;
        let lock_file = lock.file()?;
        gate.note(Change::Created, &lock_file.0);
        note_durable(&lock_file, [0; 2], &gate)
            .map_err(|source| RecordingError::storage(&lock_file.0, "write", source))?;
        let text = serde_json::to_string_pretty(&metadata)
            .map_err(|error| RecordingError::storage(directory, "describe", error.into()))?;
        write_new(&directory.join(METADATA), &(text + "\n"), &gate)?;
        for (name, text) in &plan.provenance {
            write_new(&directory.join(name), text, &gate)?;
        }
        let image = |channel| ImageWriter::create(directory, &metadata, channel, gate.clone());
        let images = [image(Channel::Reflected)?, image(Channel::Transmitted)?];
        let ledger = LedgerFile::create(directory, gate.clone())?;
        let events = EventLog::create(directory, gate.clone())?;
        let texts = [ledger.sync_file()?, events.sync_file()?];
        let files: Vec<_> = images.iter().flat_map(ImageWriter::sync_files).chain(texts.clone()).collect();
        // What never changes again, the heads of the files, is durable before the first frame.
        files.iter().chain([&lock_file]).try_for_each(|file| sync(file, &gate))?;
        let names = Channel::BOTH.map(|channel| directory.join(metadata.image_name(channel)));
        let recording = Self {
            presence: Presence::of([directory.clone(), directory.join(LEDGER)].into_iter().chain(names))?,
            images,
            ledger,
            events,
            syncer: Syncer::start(lock_file, gate.clone(), pace)
                .map_err(|source| RecordingError::storage(directory, "start syncing", source))?,
            texts,
            lock,
            pending: Vec::new(),
            pending_bytes: [0; 2],
            pending_since: None,
            failed: None,
            tally: RecordingSummary::empty(directory),
            times: [Vec::new(), Vec::new()],
            directory: directory.clone(),
            metadata,
            gate,
        };
        sync_directory(directory, &recording.gate)?;
        if let Some(parent) = std::path::absolute(directory).ok().as_deref().and_then(Path::parent) {
            sync_directory(parent, &recording.gate)?;
        }
        Ok(recording)
    }

    /// Takes the next exposure; its frames are kept until the group is committed, at about 16 MiB per camera.
    ///
    /// # Errors
    /// As [`commit`](Recording::commit).
    pub fn push(&mut self, record: &ExposureRecord) -> Result<(), RecordingError> {
        let sides = Channel::BOTH.map(|channel| self.side(record, channel));
        let [(row_r, frame_r), (row_t, frame_t)] = sides;
        self.push_pending(Pending { rows: [row_r, row_t], frames: [frame_r, frame_t] })
    }

    pub(super) fn push_pending(&mut self, exposure: Pending) -> Result<(), RecordingError> {
        for (bytes, frame) in self.pending_bytes.iter_mut().zip(&exposure.frames) {
            *bytes += frame.as_ref().map_or(0, |frame| frame.bytes().len() as u64);
        }
        self.pending_since.get_or_insert_with(Instant::now);
        self.pending.push(exposure);
        let is_full = self.pending_bytes.iter().any(|bytes| *bytes >= GROUP_BYTES);
        if is_full || self.pending.len() >= GROUP_EXPOSURES { self.commit() } else { Ok(()) }
    }

    /// The row of one side as far as it is known before writing, and the frame if it can be recorded.
    fn side(&self, record: &ExposureRecord, channel: Channel) -> (LedgerRow, Option<Frame>) {
        let (state, facts, frame) = match record.side(channel) {
            Side::Lost(loss, facts) => (RowState::Lost(*loss), *facts, None),
            Side::Frame(frame) => {
                let fits = frame.counts().len() == self.metadata.cameras[channel.index()].pixels();
                let state = if fits { RowState::Unrecorded } else { RowState::Lost(Loss::SizeMismatch) };
                (state, Some(*frame.facts()), fits.then(|| frame.clone()))
            }
        };
        let facts: Option<FrameFacts> = facts;
        let row = LedgerRow {
            exposure: record.exposure,
            channel,
            state,
            id: facts.map(|facts| (facts.info.block_id, facts.info.epoch)),
            device_time: facts.map(|facts| facts.info.device_time),
            host_time: facts.map(|facts| facts.received),
            pair: record.pair,
            analysis: record.analysis,
            conditions: facts.map(|facts| facts.conditions).unwrap_or_default(),
        };
        (row, frame)
    }

    /// Commits what is pending when no exposure is `waiting` to be pushed, or the oldest has waited for 50 ms:
    /// a disk that keeps up gets each exposure at once, and one that does not gets larger groups.
    ///
    /// # Errors
    /// As [`commit`](Recording::commit).
    pub fn settle(&mut self, waiting: usize) -> Result<(), RecordingError> {
        match self.pending_since {
            Some(since) if waiting == 0 || since.elapsed() >= GROUP_AGE => self.commit(),
            _ => Ok(()),
        }
    }

    /// Writes what is pending: pixels, then the pointers that make readers see them, then the rows.
    ///
    /// # Errors
    /// [`RecordingError::Storage`] once, when writing or syncing has failed; the files are closed then, the rows say
    /// what is lost, and every later frame is lost for the same reason without another error.
    pub fn commit(&mut self) -> Result<(), RecordingError> {
        self.pending_since = None;
        self.pending_bytes = [0; 2];
        let mut group = std::mem::take(&mut self.pending);
        let outcome = match self.failed.as_ref().map(|(loss, _)| *loss) {
            Some(loss) => {
                lose(&mut group, loss);
                Ok(())
            }
            None => self.write(&mut group),
        };
        let written = self.write_rows(&group);
        group.clear();
        self.pending = group;
        match outcome.and(written) {
            Err(error) if self.failed.is_none() => Err(self.give_up(error)),
            // Rows that the disk refuses wait for the next time.
            _ => Ok(()),
        }
    }

    /// Writes the frames of a group; where that fails, their rows say so.
    fn write(&mut self, group: &mut [Pending]) -> Result<(), RecordingError> {
        let before: u64 = self.images.iter().map(ImageWriter::bytes).sum();
        let outcome = match self.syncer.failure() {
            Some(error) => Err(error),
            None => write_images(&mut self.images, group),
        };
        match outcome {
            Ok(()) => {
                let after: u64 = self.images.iter().map(ImageWriter::bytes).sum();
                self.sync_if_due(after - before);
                Ok(())
            }
            Err(error) => {
                let pages = Channel::BOTH.map(|channel| self.images[channel.index()].pages());
                lose_beyond(group, pages, error.loss());
                Err(error)
            }
        }
    }

    fn write_rows(&mut self, group: &[Pending]) -> Result<(), RecordingError> {
        for exposure in group {
            self.tally.count(&exposure.rows);
            for (row, times) in exposure.rows.iter().zip(&mut self.times) {
                if matches!(row.state, RowState::Recorded { .. }) && times.len() < MAX_PLANE_TIMES {
                    times.extend(row.device_time.map(|time| time.0));
                }
            }
        }
        let rows: Vec<LedgerRow> = group.iter().flat_map(|exposure| exposure.rows).collect();
        self.ledger.write(&rows)
    }

    fn sync_if_due(&mut self, bytes: u64) {
        let files: Vec<_> =
            self.images.iter().flat_map(ImageWriter::sync_files).chain(self.texts.clone()).collect();
        // Small frames fill shards faster than time passes, and each keeps a descriptor.
        let is_due = self.syncer.is_due(bytes) || files.len() > 64;
        let frames = self.images.each_ref().map(ImageWriter::pages);
        if is_due && self.syncer.request(SyncRequest { files, frames }) {
            self.images.iter_mut().for_each(ImageWriter::sync_requested);
        }
    }

    /// Ends recording of frames after a failure and gives back what is reserved, so that the ledger has room.
    fn give_up(&mut self, error: RecordingError) -> RecordingError {
        let error = error.at_rate(self.metadata.bytes_per_second());
        self.tally.stop.status = StopStatus::Fail;
        self.failed = Some((error.loss(), error.to_string()));
        for image in &mut self.images {
            if let Err(cut) = image.cut() {
                tracing::warn!(%cut, "room reserved for frames stays reserved");
            }
        }
        let mut details = serde_json::Map::new();
        details.insert("error".to_owned(), json!(error.to_string()));
        details.insert("loss".to_owned(), json!(error.loss()));
        let rows = self.ledger.write(&[]);
        if let Err(log) = rows.and(self.events.append(&Event::now("recording-failed", details))) {
            tracing::warn!(%log, "the failure is not in the files of the recording");
        }
        error
    }

    /// Why nothing more is recorded, if so.
    #[must_use]
    pub fn failure(&self) -> Option<&str> {
        self.failed.as_ref().map(|(_, text)| text.as_str())
    }

    /// Appends an event to the log, which has it when this returns.
    ///
    /// # Errors
    /// [`RecordingError::Storage`]; the recording goes on.
    pub fn append(&mut self, event: &Event) -> Result<(), RecordingError> {
        self.events.append(event)
    }

    /// Room on the disk, with what is reserved for this recording.
    ///
    /// # Errors
    /// [`RecordingError::Storage`] when the disk does not answer.
    pub fn space_left(&self) -> Result<SpaceLeft, RecordingError> {
        let reserved: u64 = self.images.iter().map(ImageWriter::reserve).sum();
        let bytes = free_bytes(&self.directory)? + reserved;
        let rate = self.metadata.bytes_per_second();
        Ok(SpaceLeft { bytes, seconds: (rate > 0).then(|| bytes as f64 / rate as f64) })
    }

    /// As [`space_left`](Recording::space_left), refused at low water: then it is time to finish.
    ///
    /// # Errors
    /// [`RecordingError::Space`] below the larger of 2 GiB and 5 seconds; else as `space_left`.
    pub fn ensure_space(&self) -> Result<SpaceLeft, RecordingError> {
        let left = self.space_left()?;
        let needed_bytes = LOW_WATER_BYTES.max(LOW_WATER_SECONDS * self.metadata.bytes_per_second());
        if left.bytes >= needed_bytes {
            return Ok(left);
        }
        Err(RecordingError::Space { path: self.directory.clone(), needed_bytes, free_bytes: left.bytes })
    }

    /// That the directory and its files are still where they were created; to be asked a few times per second.
    ///
    /// # Errors
    /// [`RecordingError::Gone`]; then it is time to finish.
    pub fn ensure_present(&self) -> Result<(), RecordingError> {
        self.presence.ensure()
    }

    /// What is recorded so far.
    #[must_use]
    pub fn summary(&self) -> &RecordingSummary {
        &self.tally
    }

    /// Commits what is pending and closes everything; after a failure the stop record says `fail`.
    ///
    /// # Errors
    /// [`RecordingError::Storage`] when ledger or stop record could not be written; the frames are readable.
    /// [`RecordingError::Hangs`] when the disk does not answer for 30 s.
    pub fn finish(self, stop: StopRecord) -> Result<RecordingSummary, RecordingError> {
        self.finish_within(stop, CLOSING_TIME)
    }

    pub(super) fn finish_within(
        mut self,
        stop: StopRecord,
        time: Duration,
    ) -> Result<RecordingSummary, RecordingError> {
        let directory = self.directory.clone();
        super::ending::within(time, &directory, move || {
            let fault = self.commit().err().map(|error| error.to_string());
            let fault = self.failed.map(|(_, text)| text).or(fault);
            Ending {
                directory: self.directory,
                metadata: self.metadata,
                gate: self.gate,
                images: self.images,
                ledger: self.ledger,
                events: self.events,
                syncer: self.syncer,
                lock: self.lock,
                tally: self.tally,
                times: self.times,
                fault,
            }
            .run(stop)
        })
    }
}
