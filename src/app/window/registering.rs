//! The registration of the cameras from frames of the live view.
//!
//! In: what the window asks, looks at the cameras. Out: [`RegistrationStatus`], a file, a registration for what comes next.
//! Never: holds up the live view, changes what is under way. Fails: not at all; what cannot be done is told with what to do.

use super::session::Known;
use super::shared::Shared;
use crate::app::AppError;
use crate::app::calibrate::found::{BEAD_NM, Cameras, Found, LARGE_RESIDUAL_NM, Method, find};
use crate::app::calibrate::frames::KeptFrames;
use crate::config::Registration;
use crate::sofi::registration::Interpolation;
use crate::viewer::bench::{
    Activity, FoundRegistration, Gravity, RegisterBy, RegistrationAsk, RegistrationStatus, RegistrationStep,
};
use arc_swap::{ArcSwap, ArcSwapOption};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Memory that frames may take until the registration is found.
const MOST_BYTES: usize = 1 << 30;
/// Time between two looks for a new frame.
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// The procedure as it stands.
#[derive(Default)]
pub(super) struct Registrar {
    step: ArcSwap<RegistrationStep>,
    /// What was found, and the instrument that it is of.
    found: ArcSwapOption<(Found, Arc<Known>)>,
    /// How often the procedure was begun or left: what belongs to an earlier time is not shown any more.
    round: AtomicU64,
    /// Only one changes the step at a time.
    changing: Mutex<()>,
}

impl Registrar {
    /// Another round: what is under way ends by itself, unseen.
    pub(super) fn leave(&self) -> u64 {
        let _one = self.changing.lock().unwrap_or_else(PoisonError::into_inner);
        self.found.store(None);
        self.step.store(Arc::default());
        self.round.fetch_add(1, Ordering::SeqCst) + 1
    }

    /// Shows a step of a round; false where the person has left it.
    fn show(&self, round: u64, step: RegistrationStep) -> bool {
        let _one = self.changing.lock().unwrap_or_else(PoisonError::into_inner);
        let is_current = self.round.load(Ordering::SeqCst) == round;
        if is_current {
            self.step.store(Arc::new(step));
        }
        is_current
    }

    /// Shows what a round has found.
    fn show_found(&self, round: u64, told: FoundRegistration, found: (Found, Arc<Known>)) {
        let _one = self.changing.lock().unwrap_or_else(PoisonError::into_inner);
        if self.round.load(Ordering::SeqCst) == round {
            self.found.store(Some(Arc::new(found)));
            self.step.store(Arc::new(RegistrationStep::Found(Arc::new(told))));
        }
    }

    /// How it stands, with the open instrument.
    pub(super) fn status(&self, known: Option<&Known>) -> RegistrationStatus {
        RegistrationStatus {
            step: self.step.load().as_ref().clone(),
            in_use: known.and_then(Known::registration_in_words),
            is_of_session: known.is_some_and(|known| known.registered.load().is_some()),
        }
    }
}

/// A registration that the next live view and run go by.
#[derive(Debug, Clone)]
pub(super) struct Used {
    /// The text of its file.
    pub(super) text: String,
    /// For people.
    pub(super) words: String,
}

/// For people.
pub(super) fn in_words(text: &str) -> String {
    match Registration::from_toml(text) {
        Ok(Registration { method, date, residual_px, pixel_pitch_nm, .. }) => {
            format!("{method}, {:.1} nm rms, {date}", residual_px * pixel_pitch_nm)
        }
        Err(_) => "a file that cannot be read".to_owned(),
    }
}

/// Does what the window asks.
pub(super) fn obey(shared: &Arc<Shared>, asked: RegistrationAsk) {
    match asked {
        RegistrationAsk::Begin { by, frames } => begin(shared, by, frames),
        RegistrationAsk::Discard => {
            shared.registrar.leave();
        }
        RegistrationAsk::Forget => {
            if let Some(known) = shared.known.load_full() {
                known.registered.store(None);
                shared
                    .tell(Gravity::Note, "the next live view and run go by the file of the instrument again");
            }
        }
        RegistrationAsk::Use(path) => {
            let owned = Arc::clone(shared);
            let keep = move || {
                if let Err(error) = use_found(&owned, &path) {
                    owned.tell(Gravity::Error, error.to_string());
                }
            };
            if let Err(error) = crate::pipeline::spawn("keep-registration", keep) {
                shared.tell(Gravity::Error, format!("no thread to write the registration: {error}"));
            }
        }
    }
}

fn begin(shared: &Arc<Shared>, by: RegisterBy, frames: usize) {
    let (Some(known), Activity::Live) = (shared.known.load_full(), shared.activity.load().as_ref()) else {
        let text = "cameras are registered from the live view: start it (L), then register them";
        return shared.tell(Gravity::Warning, text);
    };
    let round = shared.registrar.leave();
    let owned = Arc::clone(shared);
    let work = move || {
        let registrar = &owned.registrar;
        let found = gather(&owned, round, frames.max(2)).and_then(|frames| match frames {
            Some(frames) if registrar.show(round, RegistrationStep::Working) => {
                register(frames, by, &known).map(Some)
            }
            _ => Ok(None),
        });
        match found {
            Ok(Some((told, found))) => registrar.show_found(round, told, (found, known)),
            Ok(None) => {}
            Err(error) => {
                if registrar.show(round, RegistrationStep::Failed(error.to_string())) {
                    owned.tell(Gravity::Warning, format!("the cameras could not be registered: {error}"));
                }
            }
        }
    };
    if let Err(error) = crate::pipeline::spawn("register", work) {
        shared.tell(Gravity::Error, format!("no thread to register the cameras: {error}"));
    }
}

/// Frames of R and T of the live view, as it shows them; none where the person has left.
fn gather(shared: &Shared, round: u64, frames: usize) -> Result<Option<[KeptFrames; 2]>, AppError> {
    // What is shown already may be of an earlier live view.
    let mut last = shared.board.cameras.load().as_ref().map(|look| look.exposure);
    let (mut kept, mut taken) = (None, 0);
    let mut wanted = frames;
    while taken < wanted {
        if **shared.activity.load() != Activity::Live {
            return Err(AppError::usage(
                "the live view ended before there were enough frames; start it again (L)",
            ));
        }
        let look = shared.board.cameras.load_full().filter(|look| last != Some(look.exposure));
        if let Some(look) = look {
            let size = [look.height, look.width];
            let bytes = 4 * (look.height * look.width).max(1);
            // Frames of both cameras, two bytes a pixel; never fewer than tell noise from light.
            wanted = frames.min((MOST_BYTES / bytes).max(16));
            let [r, t]: &mut [KeptFrames; 2] =
                kept.get_or_insert_with(|| [KeptFrames::new(size), KeptFrames::new(size)]);
            let [of_r, of_t] = look.cameras.each_ref().map(|camera| Arc::clone(&camera.counts));
            if last.is_some_and(|last| look.exposure < last) || !(r.push(of_r) && t.push(of_t)) {
                return Err(AppError::usage(
                    "the live view began anew while frames were taken; register again",
                ));
            }
            last = Some(look.exposure);
            taken += 1;
        }
        if !shared.registrar.show(round, RegistrationStep::Gathering { taken, wanted }) {
            return Ok(None);
        }
        // Nothing will ever come: this is a pause between two looks.
        let _ = crossbeam_channel::after(LOOK_EVERY).recv();
    }
    Ok(kept)
}

fn register(
    mut frames: [KeptFrames; 2],
    by: RegisterBy,
    known: &Known,
) -> Result<(FoundRegistration, Found), AppError> {
    let method = match by {
        RegisterBy::Beads => Method::Beads,
        RegisterBy::Blinking => Method::Correlation,
    };
    let (pixel_pitch_nm, serials) = (known.instrument.pixel_pitch_nm(), known.serials());
    let found = find(&mut frames, method, Cameras { pixel_pitch_nm, serials, bead_nm: BEAD_NM })?;
    let registration = &found.registration;
    let (transform, residual_nm) = (&registration.transform, registration.residual_px * pixel_pitch_nm);
    let mut warnings = Vec::new();
    if residual_nm > LARGE_RESIDUAL_NM {
        warnings.push(format!(
            "the residual of {residual_nm:.1} nm is large; look at the picture, take more frames or other beads"
        ));
    }
    registration.settings(Interpolation::default()).map_err(|_| {
        AppError::data("the noise of camera T could not be found from these frames; take more frames")
    })?;
    let told = FoundRegistration {
        by,
        mirror: transform.mirror.name().to_owned(),
        shift_px: transform.central_shift(),
        rotation_deg: transform.rotation_deg(),
        scale: transform.scale(),
        residual_nm,
        points: registration.points.len(),
        points_left_out: registration.points_left_out,
        warnings,
        residual_map: Arc::new(found.residual_map()?),
    };
    Ok((told, found))
}

/// Writes what was found, and lets the next live view and run go by it.
fn use_found(shared: &Shared, path: &Path) -> Result<(), AppError> {
    let found = shared.registrar.found.load_full();
    let found = found.ok_or_else(|| {
        AppError::usage("no registration was found that could be used; register the cameras first")
    })?;
    let (found, known) = found.as_ref();
    for file in [path.to_owned(), path.with_extension("png")] {
        if file.exists() {
            return Err(AppError::Usage(format!(
                "{} exists; give the registration another name",
                file.display()
            )));
        }
    }
    found.write(path)?;
    let text = found.registration.to_toml();
    let words = in_words(&text);
    known.registered.store(Some(Arc::new(Used { text, words })));
    shared.registrar.leave();
    let text = format!("saved: {}; the next live view and run go by it", path.display());
    shared.tell(Gravity::Note, text);
    Ok(())
}
