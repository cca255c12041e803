//! A recording in the other format: the same pixels, rows and events.
//!
//! In: a finished recording. Out: a new one beside it; its ledger has the same rows.
//! Never: changes the source, copies a frame whose checksum is wrong. Fails: [`RecordingError`].

use super::gate::Gate;
use super::group::Pending;
use super::sync::Pace;
use super::{Event, Format, RecordedRun, Recording, RecordingError, RecordingPlan, RecordingSummary, open};
use crate::acquisition::{Frame, FrameFacts, LedgerRow, RowState};
use sofiscope_hal::{Channel, FrameInfo, FrameStatus};
use std::path::Path;

/// Files kept beside the frames are read up to this size.
const MAX_PROVENANCE_BYTES: u64 = 64 << 20;

/// Writes the recording in `from` to the new `directory` in `format`.
///
/// # Errors
/// [`RecordingError::Refused`] for a recording that was not finished or recovered, [`RecordingError::BadCrc`] for
/// damaged frames; else as reading and recording.
pub fn export(from: &Path, format: Format, directory: &Path) -> Result<RecordingSummary, RecordingError> {
    let mut run = open(from)?;
    let Some(stop) = run.stop() else {
        let reason = "it was never finished; recover it first".to_owned();
        return Err(RecordingError::Refused { path: from.to_path_buf(), reason });
    };
    let plan = plan_of(&run, format, directory)?;
    let mut recording =
        Recording::create_through(&plan, run.metadata().created, Gate::default(), Pace::default())?;
    let events = run.events().len().saturating_sub(1);
    for event in &run.events()[..events] {
        recording.append(event)?;
    }
    let mut rows = run.rows()?;
    while let Some(r) = rows.next().transpose()? {
        let Some(t) = rows.next().transpose()? else {
            return Err(RecordingError::damaged(from, "ledger.csv", "the last exposure has one row"));
        };
        let frames = [frame(&mut run, &r)?, frame(&mut run, &t)?];
        recording.push_pending(Pending { rows: [r, t], frames })?;
    }
    let mut details = serde_json::Map::new();
    details.insert("from".to_owned(), from.display().to_string().into());
    recording.append(&Event::now("exported", details))?;
    recording.finish(stop)
}

fn plan_of(run: &RecordedRun, format: Format, directory: &Path) -> Result<RecordingPlan, RecordingError> {
    let metadata = run.metadata();
    let text = |name: &String| {
        let text = super::metadata::read_text(&run.directory().join(name), MAX_PROVENANCE_BYTES)?;
        Ok((name.clone(), text))
    };
    Ok(RecordingPlan {
        directory: directory.to_path_buf(),
        format,
        cameras: metadata.cameras.clone(),
        planned_exposures: metadata.planned_exposures,
        simulated: metadata.simulated,
        conditions: metadata.conditions,
        provenance: metadata.provenance.iter().map(text).collect::<Result<_, RecordingError>>()?,
    })
}

/// The frame of a row, if it is recorded.
fn frame(run: &mut RecordedRun, row: &LedgerRow) -> Result<Option<Frame>, RecordingError> {
    let RowState::Recorded { page, .. } = row.state else { return Ok(None) };
    let mut counts = vec![0; run.metadata().cameras[row.channel.index()].pixels()];
    run.read_checked(row.channel, page, &mut counts)?;
    let (Some((block_id, epoch)), Some(device_time), Some(received)) =
        (row.id, row.device_time, row.host_time)
    else {
        let field = format!("ledger.csv, exposure {}", row.exposure.0);
        return Err(RecordingError::damaged(run.directory(), field, "a recorded frame without its times"));
    };
    let channel: Channel = row.channel;
    let info =
        FrameInfo { exposure: row.exposure, block_id, epoch, device_time, status: FrameStatus::Complete };
    let facts = FrameFacts { channel, info, received, conditions: row.conditions };
    Ok(Some(Frame::of_counts(facts, &counts)))
}
