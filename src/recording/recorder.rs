//! The recording under way, owned by one thread.
//!
//! In: [`ExposureRecord`]s. Out: groups of frames committed to the files of both cameras, and their rows.
//! Never: copies frames that are whole pages, keeps a frame longer than its group.
//! Fails: once; from then on every frame goes to the ledger as lost, and finishing still works.

use super::RecordingError;
use super::direct::{Gate, Operation, sync_directory};
use super::events::{Event, EventLog, StopRecord, StopStatus};
use super::finish::{MAX_PLANE_TIMES, finish_image};
use super::group::{Pending, lose, lose_beyond, write_images};
use super::ledger_file::LedgerFile;
use super::lock::Lock;
use super::metadata::{METADATA, Metadata, RecordingPlan, stride};
use super::summary::RecordingSummary;
use super::sync::Syncer;
use super::writer::ImageWriter;
use crate::acquisition::{ExposureRecord, Frame, FrameFacts, LedgerRow, Loss, RowState, Side};
use crate::files::free_bytes;
use serde_json::json;
use sofiscope_hal::Channel;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A group is committed when one camera has this much in it.
const GROUP_BYTES: u64 = 16 << 20;
/// Or this many exposures, with or without frames.
const GROUP_EXPOSURES: usize = 4096;
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
    lock: Lock,
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
        Self::create_through(plan, jiff::Timestamp::now(), Gate::default())
    }

    pub(super) fn create_through(
        plan: &RecordingPlan,
        created: jiff::Timestamp,
        gate: Gate,
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
        Self::fill(plan, metadata, gate).inspect_err(|_| {
            // Nothing was recorded in what this call made.
            let _ = fs::remove_dir_all(directory);
        })
    }

    fn fill(plan: &RecordingPlan, metadata: Metadata, gate: Gate) -> Result<Self, RecordingError> {
        let directory = &plan.directory;
        let lock = Lock::take(directory)?;
        let text = serde_json::to_string_pretty(&metadata)
            .map_err(|error| RecordingError::storage(directory, "describe", error.into()))?;
        write_new(&directory.join(METADATA), &(text + "\n"), &gate)?;
        for (name, text) in &plan.provenance {
            write_new(&directory.join(name), text, &gate)?;
        }
        let image = |channel| ImageWriter::create(directory, &metadata, channel, gate.clone());
        let images = [image(Channel::Reflected)?, image(Channel::Transmitted)?];
        let recording = Self {
            images,
            ledger: LedgerFile::create(directory, gate.clone())?,
            events: EventLog::create(directory, gate.clone())?,
            syncer: Syncer::start(gate.clone())
                .map_err(|source| RecordingError::storage(directory, "start syncing", source))?,
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
        };
        (row, frame)
    }

    /// Since when the oldest exposure waits to be committed.
    #[must_use]
    pub fn pending_since(&self) -> Option<Instant> {
        self.pending_since
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
        let files: Vec<_> = self.images.iter().flat_map(ImageWriter::sync_files).collect();
        // Small frames fill shards faster than time passes, and each keeps a descriptor.
        let is_due = self.syncer.is_due(bytes) || files.len() > 64;
        if is_due && self.syncer.request(files) {
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

    /// What is recorded so far.
    #[must_use]
    pub fn summary(&self) -> &RecordingSummary {
        &self.tally
    }

    /// Commits what is pending and closes everything; after a failure the stop record says `fail`.
    ///
    /// # Errors
    /// [`RecordingError::Storage`] when ledger or stop record could not be written; the frames are readable.
    pub fn finish(mut self, stop: StopRecord) -> Result<RecordingSummary, RecordingError> {
        let mut fault = self.commit().err().map(|error| error.to_string());
        for channel in Channel::BOTH {
            let image = &mut self.images[channel.index()];
            let times = &self.times[channel.index()];
            if let Err(error) = finish_image(image, &self.metadata, channel, times, &self.gate) {
                fault.get_or_insert(error.to_string());
            }
        }
        let files = self.images.iter().flat_map(ImageWriter::sync_files).collect();
        if let Err(error) = self.syncer.finish(files) {
            fault.get_or_insert(error.to_string());
        }
        let fault = self.failed.map(|(_, text)| text).or(fault);
        self.tally.stop = match fault {
            None => stop,
            Some(fault) => {
                StopRecord { status: StopStatus::Fail, reason: format!("{}: {fault}", stop.reason) }
            }
        };
        let ledger = self.ledger.write(&[]).and_then(|()| self.ledger.close());
        self.events.append(&Event::stop(&self.tally.stop))?;
        self.events.close()?;
        ledger?;
        self.lock.release();
        sync_directory(&self.directory, &self.gate)?;
        Ok(self.tally)
    }
}

fn ensure_planned_space(plan: &RecordingPlan) -> Result<(), RecordingError> {
    let Some(planned) = plan.planned_exposures else { return Ok(()) };
    let per_exposure: u64 = plan.cameras.iter().map(stride).sum();
    let needed_bytes = planned.saturating_mul(per_exposure).saturating_mul(105) / 100;
    let free_bytes = free_bytes(&plan.directory)?;
    if free_bytes >= needed_bytes {
        return Ok(());
    }
    Err(RecordingError::Space { path: plan.directory.clone(), needed_bytes, free_bytes })
}

fn write_new(path: &Path, text: &str, gate: &Gate) -> Result<(), RecordingError> {
    use std::io::Write;
    gate.pass(Operation::Write, path)
        .and_then(|()| fs::OpenOptions::new().write(true).create_new(true).open(path))
        .and_then(|mut file| file.write_all(text.as_bytes()).and_then(|()| file.sync_all()))
        .map_err(|source| RecordingError::storage(path, "write", source))
}
