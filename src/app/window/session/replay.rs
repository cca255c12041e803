//! Replays in the session: opened, played, and known to the window while they go on.
//!
//! In: a recording, a speed, a first exposure. Out: looks and numbers as of a run; [`UnderWay`] for the transport.
//! Never: loses a frame because the computer is slower than the wish. Fails: [`AppError`] of unreadable files.

use super::{RunOutline, Session};
use crate::acquisition::Patience;
use crate::app::AppError;
use crate::app::replay::{Playable, ReplayRequest, playable};
use crate::config::RawAnalysis;
use crate::replay::{ReplayControl, ReplayOptions, ReplaySpeed};
use crate::viewer::bench::{Activity, Gravity, ReplayStatus};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Shortest time between two pictures of the result.
const PICTURE_EVERY: Duration = Duration::from_millis(300);

/// The replay under way.
pub(in crate::app::window) struct UnderWay {
    pub(in crate::app::window) control: ReplayControl,
    pub(in crate::app::window) recording: PathBuf,
    /// The exposure of the recording with which it began.
    from: u64,
}

impl UnderWay {
    /// How it stands after so many exposures.
    pub(in crate::app::window) fn status(&self, played: u64) -> ReplayStatus {
        let (exposures, period) = self.control.extent();
        let speed = match self.control.speed() {
            ReplaySpeed::Max => f64::INFINITY,
            ReplaySpeed::Times(times) => times,
        };
        ReplayStatus {
            recording: self.recording.clone(),
            exposures,
            position: (self.from + played).min(exposures),
            period,
            speed,
            is_paused: self.control.is_paused(),
        }
    }
}

/// A speed in numbers; whatever is not a finite number above 0 is as fast as possible.
pub(in crate::app::window) fn speed_of(times: f64) -> ReplaySpeed {
    if times.is_finite() && times > 0.0 { ReplaySpeed::Times(times) } else { ReplaySpeed::Max }
}

impl Session {
    pub(super) fn replay(&mut self, recording: &Path, speed: f64, from: u64) -> Result<(), AppError> {
        let request = ReplayRequest {
            paths: &[recording.to_owned()],
            options: ReplayOptions { speed: speed_of(speed), start: from, ..ReplayOptions::default() },
            settings: RawAnalysis::default(),
            as_live: true,
        };
        let Playable { devices, mut options, event, prepared, simulated, description, control } =
            playable(request)?;
        self.shared.tell(Gravity::Note, format!("replay: {description}"));
        options.preview_every = Some(PICTURE_EVERY);
        // The speed may change on the way: what cannot be analyzed in time is played more slowly.
        options.patience = Patience::Patient;
        let outline = RunOutline {
            planned: event.exposures,
            series: 1,
            period: event.cameras.period,
            ..RunOutline::default()
        };
        let under_way = UnderWay { control, recording: recording.to_owned(), from };
        self.shared.is_simulated.store(simulated, Ordering::SeqCst);
        self.shared.replay.store(Some(Arc::new(under_way)));
        let label = if simulated { " (SIMULATED data)" } else { "" };
        let (mut acquired, _) = self.run_with(devices, options, vec![event], outline, &Activity::Replay);
        self.shared.replay.store(None);
        self.shared.tell(Gravity::Note, format!("replay{label}: {}", acquired.ended(simulated).line()));
        if let Some(result) = acquired.results.pop() {
            self.last_live = Some((result, prepared));
        }
        acquired.failure().map_or(Ok(()), Err)
    }
}
