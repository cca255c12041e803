//! The share of a dye's light that reaches camera T, from regions of the live view.
//!
//! In: what the window asks, looks at the cameras. Out: [`ColorsStatus`], a file, shares for what comes next.
//! Never: holds up the live view, changes what is under way. Fails: not at all; what cannot be done is told with what to do.

mod estimate;
mod file;
mod in_use;

pub(super) use in_use::{Measured, dyes_in_use};

use super::session::Known;
use super::shared::Shared;
use crate::app::AppError;
use crate::app::analysis::Prepared;
use crate::viewer::bench::{
    Activity, ColorsAsk, ColorsStatus, ColorsStep, FoundShare, Gravity, LiveSettings, MarkedRegions,
};
use arc_swap::{ArcSwap, ArcSwapOption};
use estimate::Gathered;
use file::Entry;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Time between two looks for a new frame.
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// The live view that frames are taken from.
pub(super) struct UnderLive {
    pub(super) settings: LiveSettings,
    pub(super) prepared: Prepared,
}

/// A share that can be used: what its file says of it, and the instrument that it is of.
struct Kept {
    entry: Entry,
    known: Arc<Known>,
}

/// The procedure as it stands.
#[derive(Default)]
pub(super) struct Colorist {
    step: ArcSwap<ColorsStep>,
    found: ArcSwapOption<Kept>,
    live: ArcSwapOption<UnderLive>,
    /// How often the procedure was begun or left: what belongs to an earlier time is not shown any more.
    round: AtomicU64,
    /// Only one changes the step at a time.
    changing: Mutex<()>,
}

impl Colorist {
    /// Another live view has begun.
    pub(super) fn watch(&self, live: UnderLive) {
        self.live.store(Some(Arc::new(live)));
    }

    /// Another round: what is under way ends by itself, unseen.
    pub(super) fn leave(&self) -> u64 {
        let _one = self.changing.lock().unwrap_or_else(PoisonError::into_inner);
        self.found.store(None);
        self.step.store(Arc::default());
        self.round.fetch_add(1, Ordering::SeqCst) + 1
    }

    /// Shows a step of a round; false where the person has left it.
    fn show(&self, round: u64, step: ColorsStep) -> bool {
        let _one = self.changing.lock().unwrap_or_else(PoisonError::into_inner);
        let is_current = self.round.load(Ordering::SeqCst) == round;
        if is_current {
            self.step.store(Arc::new(step));
        }
        is_current
    }

    /// Shows what a round has found.
    fn show_found(&self, round: u64, told: FoundShare, kept: Kept) {
        let _one = self.changing.lock().unwrap_or_else(PoisonError::into_inner);
        if self.round.load(Ordering::SeqCst) == round {
            self.found.store(Some(Arc::new(kept)));
            self.step.store(Arc::new(ColorsStep::Found(Arc::new(told))));
        }
    }

    /// How it stands, with the open instrument.
    pub(super) fn status(&self, known: Option<&Known>) -> ColorsStatus {
        ColorsStatus {
            step: self.step.load().as_ref().clone(),
            in_use: known.map(Known::dyes).unwrap_or_default(),
            is_of_session: known.is_some_and(|known| known.measured.load().is_some()),
        }
    }
}

/// Does what the window asks.
pub(super) fn obey(shared: &Arc<Shared>, asked: ColorsAsk) {
    match asked {
        ColorsAsk::Begin { dye, marked, frames } => begin(shared, dye, marked, frames),
        ColorsAsk::Discard => {
            shared.colorist.leave();
        }
        ColorsAsk::Forget => {
            if let Some(known) = shared.known.load_full() {
                known.measured.store(None);
                let text = "the next live view and run go by the instrument's own coefficients again";
                shared.tell(Gravity::Note, text);
            }
        }
        ColorsAsk::Use(path) => {
            let owned = Arc::clone(shared);
            let keep = move || {
                if let Err(error) = use_found(&owned, &path) {
                    owned.tell(Gravity::Error, error.to_string());
                }
            };
            if let Err(error) = crate::pipeline::spawn("keep-response", keep) {
                shared.tell(Gravity::Error, format!("no thread to write the response file: {error}"));
            }
        }
    }
}

fn begin(shared: &Arc<Shared>, dye: String, marked: MarkedRegions, frames: usize) {
    let (Some(known), Some(live), Activity::Live) =
        (shared.known.load_full(), shared.colorist.live.load_full(), shared.activity.load().as_ref())
    else {
        let text =
            "shares of light are measured in the live view: start it (L), then mark regions and measure";
        return shared.tell(Gravity::Warning, text);
    };
    let round = shared.colorist.leave();
    let owned = Arc::clone(shared);
    let work = move || {
        let colorist = &owned.colorist;
        let found = gather(&owned, round, frames.max(4)).and_then(|gathered| match gathered {
            Some(gathered) if colorist.show(round, ColorsStep::Working) => {
                estimate::estimate(&gathered, &dye, &marked, &live, &known).map(Some)
            }
            _ => Ok(None),
        });
        match found {
            Ok(Some((told, entry))) => colorist.show_found(round, told, Kept { entry, known }),
            Ok(None) => {}
            Err(error) => {
                if colorist.show(round, ColorsStep::Failed(error.to_string())) {
                    owned
                        .tell(Gravity::Warning, format!("the share of {dye} could not be measured: {error}"));
                }
            }
        }
    };
    if let Err(error) = crate::pipeline::spawn("measure-colors", work) {
        shared.tell(Gravity::Error, format!("no thread to measure the share: {error}"));
    }
}

/// Sums of frames of the live view; none where the person has left.
fn gather(shared: &Shared, round: u64, wanted: usize) -> Result<Option<Gathered>, AppError> {
    // What is shown already may be of an earlier live view.
    let mut last = shared.board.cameras.load().as_ref().map(|look| look.exposure);
    let mut gathered: Option<Gathered> = None;
    let mut taken = 0;
    while taken < wanted {
        if **shared.activity.load() != Activity::Live {
            return Err(AppError::usage(
                "the live view ended before there were enough frames; start it again (L)",
            ));
        }
        let look = shared.board.cameras.load_full().filter(|look| last != Some(look.exposure));
        if let Some(look) = look {
            let gathered = gathered.get_or_insert_with(|| Gathered::new([look.height, look.width]));
            if last.is_some_and(|last| look.exposure < last) || !gathered.push(&look) {
                return Err(AppError::usage(
                    "the live view began anew while frames were taken; measure again",
                ));
            }
            last = Some(look.exposure);
            taken += 1;
        }
        if !shared.colorist.show(round, ColorsStep::Gathering { taken, wanted }) {
            return Ok(None);
        }
        // Nothing will ever come: this is a pause between two looks.
        let _ = crossbeam_channel::after(LOOK_EVERY).recv();
    }
    Ok(gathered)
}

/// Writes what was found, and lets the next live view and run go by it.
fn use_found(shared: &Shared, path: &Path) -> Result<(), AppError> {
    let kept = shared.colorist.found.load_full();
    let kept = kept.ok_or_else(|| {
        AppError::usage("no share was found that could be used; mark regions and measure first")
    })?;
    let measured = Measured::with(&kept.entry, &kept.known)?;
    file::write_new(path, &measured.text)?;
    kept.known.measured.store(Some(Arc::new(measured)));
    shared.colorist.leave();
    let text = format!("saved: {}; the next live view and run go by it", path.display());
    shared.tell(Gravity::Note, text);
    Ok(())
}
