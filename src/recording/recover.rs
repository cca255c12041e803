//! The end of a recording whose program was gone before it could write one.
//!
//! In: a directory. Out: a ledger that agrees with the frames, metadata that name their number, and a stop record.
//! Never: touches a pixel, invents a frame, changes a byte of a recording that needs nothing.
//! Fails: [`RecordingError`] when the recording is in use or too damaged; then nothing was written.
//!
//! Frames carry the facts of their rows with them, so rows that the crash took come back whole.

use super::RecordingError;
use super::direct::sync_directory;
use super::events::{self, EVENTS, Event, EventLog, StopRecord, StopStatus};
use super::finish::{MAX_PLANE_TIMES, describe};
use super::gate::Gate;
use super::ledger_file::LEDGER;
use super::lock::Lock;
use super::merge::{Changes, Merge};
use super::metadata::Metadata;
use super::reader::{ImagePages, checksum};
use super::tiff_pages::{FrameSize, TiffPages};
use super::zarr_pages::ZarrPages;
use crate::acquisition::LedgerRow;
use serde::Serialize;
use sofiscope_hal::Channel;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// What recovery came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// Nothing was to be done and nothing was changed.
    Sound,
    /// The recording is whole again, as far as it was committed.
    Repaired,
    /// Nothing was to be done, but frames are not what was recorded.
    Damaged,
}

/// What recovery found and did.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RecoverReport {
    /// What it came to.
    pub outcome: Outcome,
    /// Frames of R and T.
    pub frames: [u64; 2],
    /// Frames at the end that were linked and never reached the disk; they are left out.
    pub frames_cut: [u64; 2],
    /// Camera and page of other frames whose checksum is wrong.
    pub damaged: Vec<(Channel, u64)>,
    /// Rows written that the ledger did not have.
    pub rows_added: u64,
    /// Rows that said something else than the files.
    pub rows_changed: u64,
    /// Bytes at the end of the ledger that were no row.
    pub torn_bytes: u64,
}

impl std::fmt::Display for RecoverReport {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let outcome = match self.outcome {
            Outcome::Sound => "nothing to do",
            Outcome::Repaired => "repaired",
            Outcome::Damaged => "damaged",
        };
        let ([r, t], [r_cut, t_cut]) = (self.frames, self.frames_cut);
        write!(formatter, "{outcome}: {r} frames of camera R and {t} of camera T")?;
        write!(formatter, ", {} rows added, {} corrected", self.rows_added, self.rows_changed)?;
        if r_cut + t_cut > 0 {
            write!(formatter, ", {} frames that never reached the disk left out", r_cut + t_cut)?;
        }
        for (channel, page) in &self.damaged {
            write!(formatter, "\n  frame {page} of {channel} is not what was recorded")?;
        }
        Ok(())
    }
}

impl RecoverReport {
    /// For scripts: 0 when nothing was to be done, 3 when it is repaired, 1 when frames are damaged.
    #[must_use]
    pub fn exit_status(&self) -> u8 {
        match self.outcome {
            Outcome::Sound => 0,
            Outcome::Repaired => 3,
            Outcome::Damaged => 1,
        }
    }
}

/// Repairs a recording after a crash; a second time it changes nothing.
///
/// # Errors
/// [`RecordingError::InUse`] while it is being recorded; [`RecordingError::Damaged`] and
/// [`RecordingError::Storage`] for what cannot be repaired.
pub fn recover(directory: &Path) -> Result<RecoverReport, RecordingError> {
    let metadata = Metadata::read(directory)?;
    let lock = Lock::take(directory)?;
    let outcome = Recovery::of(directory, metadata, lock.durable()).and_then(Recovery::run);
    lock.release();
    outcome
}

struct Recovery {
    directory: PathBuf,
    metadata: Metadata,
    images: [ImagePages; 2],
    /// True where the chain of pages breaks off.
    is_broken: [bool; 2],
    events_end: u64,
    is_finished: bool,
    /// Frames that were durable before the crash; `None` where nothing says so.
    durable: Option<[u64; 2]>,
    report: RecoverReport,
}

impl Recovery {
    fn of(directory: &Path, metadata: Metadata, durable: Option<[u64; 2]>) -> Result<Self, RecordingError> {
        let (events, events_end) =
            if directory.join(EVENTS).exists() { events::read_torn(directory)? } else { (Vec::new(), 0) };
        let is_finished = events.last().is_some_and(|event| event.as_stop().is_some());
        if !is_finished {
            Channel::BOTH.into_iter().try_for_each(|channel| mend_shards(directory, &metadata, channel))?;
        }
        let image = |channel| open_readable(directory, &metadata, channel);
        let [(r, r_broken), (t, t_broken)] = [image(Channel::Reflected)?, image(Channel::Transmitted)?];
        let report = RecoverReport {
            outcome: Outcome::Sound,
            frames: [r.len(), t.len()],
            frames_cut: [0; 2],
            damaged: Vec::new(),
            rows_added: 0,
            rows_changed: 0,
            torn_bytes: 0,
        };
        Ok(Self {
            directory: directory.to_path_buf(),
            images: [r, t],
            is_broken: [r_broken, t_broken],
            is_finished,
            durable,
            events_end,
            metadata,
            report,
        })
    }

    fn run(mut self) -> Result<RecoverReport, RecordingError> {
        let mut is_changed = !self.is_finished;
        for channel in Channel::BOTH {
            is_changed |= self.check_frames(channel)?;
        }
        is_changed |= self.merge_ledger()?;
        for channel in Channel::BOTH {
            is_changed |= self.describe(channel)?;
        }
        if !self.is_finished {
            self.write_stop()?;
        }
        if is_changed {
            sync_directory(&self.directory, &Gate::default())?;
        }
        self.report.outcome = match (is_changed, self.report.damaged.is_empty()) {
            (true, _) => Outcome::Repaired,
            (false, true) => Outcome::Sound,
            (false, false) => Outcome::Damaged,
        };
        Ok(self.report)
    }

    /// Compares every frame with its checksum; leaves out the end from the first that a crash left half written.
    fn check_frames(&mut self, channel: Channel) -> Result<bool, RecordingError> {
        let index = channel.index();
        let camera = &self.metadata.cameras[index];
        let mut counts = vec![0_u16; camera.pixels()];
        let mut damaged = Vec::new();
        let image = &mut self.images[index];
        let all = image.len();
        for page in 0..all {
            let row = image.row(channel, page).ok().flatten();
            let is_read = image.read(page, &mut counts).is_ok();
            let found = crc32c::crc32c(bytemuck::cast_slice(&counts));
            if !is_read || row.as_ref().and_then(checksum) != Some(found) {
                damaged.push(page);
            }
        }
        let mut keep = all;
        while !self.is_finished && damaged.last().is_some_and(|page| page + 1 == keep) {
            keep -= 1;
            damaged.pop();
        }
        // A crash of the computer loses writes in any order, so what follows a frame that is lost goes with it;
        // but before the last sync a frame that is wrong has another reason.
        let first_lost = self
            .durable
            .filter(|_| !self.is_finished)
            .and_then(|durable| damaged.iter().copied().find(|page| *page >= durable[index]));
        keep = keep.min(first_lost.unwrap_or(keep));
        damaged.retain(|page| *page < keep);
        self.report.frames[index] = keep;
        self.report.frames_cut[index] = all - keep;
        self.report.damaged.extend(damaged.into_iter().map(|page| (channel, page)));
        match image {
            ImagePages::Tiff(pages) if keep < all => pages.keep(keep, frame_size(camera))?,
            ImagePages::Tiff(pages) if self.is_broken[index] => pages.end_chain()?,
            ImagePages::Zarr(pages) if keep < all => pages.keep(keep, camera)?,
            _ => {}
        }
        Ok(keep < all || self.is_broken[index])
    }

    /// Makes the ledger agree with the files; both passes see the same rows.
    fn merge_ledger(&mut self) -> Result<bool, RecordingError> {
        let changes = self.merge(|_| Ok(()))?;
        self.report.rows_added = changes.added;
        self.report.rows_changed = changes.changed;
        self.report.torn_bytes = changes.torn_bytes;
        if changes == Changes::default() {
            return Ok(false);
        }
        let path = self.directory.join(LEDGER);
        let new = self.directory.join("ledger.csv.new");
        let failed = |source| RecordingError::storage(&new, "write", source);
        let mut out = BufWriter::new(File::create(&new).map_err(failed)?);
        let mut line = LedgerRow::header() + "\n";
        self.merge(|row| {
            row.write_to(&mut line);
            let written = out.write_all(line.as_bytes());
            line.clear();
            written.map_err(failed)
        })?;
        out.write_all(line.as_bytes())
            .and_then(|()| out.into_inner().map_err(std::io::IntoInnerError::into_error))
            .and_then(|file| file.sync_all())
            .and_then(|()| fs::rename(&new, &path))
            .map_err(failed)?;
        Ok(true)
    }

    fn merge(
        &mut self,
        row: impl FnMut(&LedgerRow) -> Result<(), RecordingError>,
    ) -> Result<Changes, RecordingError> {
        Merge::of(&self.directory, &mut self.images, self.metadata.conditions)?.run(row)
    }

    /// Writes the metadata that an ended recording has.
    fn describe(&mut self, channel: Channel) -> Result<bool, RecordingError> {
        let image = &mut self.images[channel.index()];
        let path = image.path().to_path_buf();
        let ImagePages::Tiff(pages) = &*image else { return Ok(false) };
        let end = pages.end();
        let file_end =
            fs::metadata(&path).map_err(|source| RecordingError::storage(&path, "read", source))?.len();
        if pages.is_described() && (pages.len() > 0 || file_end == end) {
            return Ok(false);
        }
        let num_pages = pages.len();
        let mut times = Vec::new();
        if num_pages <= MAX_PLANE_TIMES as u64 {
            for page in 0..num_pages {
                let time = image.row(channel, page)?.and_then(|row| row.device_time);
                times.extend(time.map(|time| time.0));
            }
        }
        if num_pages == 0 {
            File::options()
                .write(true)
                .open(&path)
                .and_then(|file| file.set_len(end))
                .map_err(|source| RecordingError::storage(&path, "truncate", source))?;
        }
        describe(&path, &self.metadata, channel, num_pages, &times, end, &Gate::default())?;
        Ok(true)
    }

    fn write_stop(&self) -> Result<(), RecordingError> {
        let report = &self.report;
        let reason = format!(
            "the program ended without closing the recording; R has {} frames, T has {}; \
             {} rows were added to the ledger, {} changed, {} torn bytes removed",
            report.frames[0], report.frames[1], report.rows_added, report.rows_changed, report.torn_bytes
        );
        let mut events = EventLog::reopen(&self.directory, self.events_end)?;
        events.append(&Event::stop(&StopRecord { status: StopStatus::CrashRecovered, reason }))?;
        events.close()
    }
}

fn frame_size(camera: &super::CameraDescription) -> FrameSize {
    FrameSize { height: camera.height() as u64, width: camera.width() as u64 }
}

/// The images of one camera as far as they can be read, and whether they break off.
fn open_readable(
    directory: &Path,
    metadata: &Metadata,
    channel: Channel,
) -> Result<(ImagePages, bool), RecordingError> {
    let path = directory.join(metadata.image_name(channel));
    match metadata.format {
        super::Format::OmeTiff => {
            let size = frame_size(&metadata.cameras[channel.index()]);
            let (pages, fault) = TiffPages::open_readable(&path, size)?;
            Ok((ImagePages::Tiff(pages), fault.is_some()))
        }
        super::Format::OmeZarr => Ok((ImagePages::open(directory, metadata, channel)?, false)),
    }
}

/// Writes the indices of shards again that a crash of the computer left half written.
fn mend_shards(directory: &Path, metadata: &Metadata, channel: Channel) -> Result<(), RecordingError> {
    match metadata.format {
        super::Format::OmeTiff => Ok(()),
        super::Format::OmeZarr => {
            let camera = &metadata.cameras[channel.index()];
            ZarrPages::open(&directory.join(metadata.image_name(channel)), camera)?.mend(camera, channel)
        }
    }
}
