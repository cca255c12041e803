//! A scene file, read once and believed afterwards.
//!
//! In: TOML text with units in its key names. Out: a [`Scene`] with every value inside its limits.
//! Never: guesses what the sample is, accepts an unknown key, reads a file.
//! Fails: [`SceneError`] with all faults at once, each with line, key and remedy.
//!
//! Photon numbers are photons that *reach* the cameras; the quantum efficiency of a camera defaults to 1,
//! so unless a scene sets it they are *detected* photons, as in the paper.

mod drawing;
mod fault;
mod parts;
mod pixels;
mod shape;
mod shipped;
#[cfg(test)]
mod tests;

use sofiscope_form::{Faults, Form};

pub(crate) use drawing::cells;
pub use fault::SceneError;
pub use parts::{CameraModel, Mirror, Optics, PatchGrid, Photophysics, Species, View};
pub use pixels::PixelSpread;
pub use shape::Shape;
pub use sofiscope_form::Fault;

/// A scene file longer than this is refused unread.
const MAX_TEXT_BYTES: usize = 1 << 20;
/// A scene with more emitters than this is refused.
pub(crate) const MAX_EMITTERS: u64 = 1_000_000;
/// A scene whose emitters shine in more exposures in all is refused; each takes 8 bytes.
const MAX_LIT_EXPOSURES: f64 = 1.5e8;
/// A scene whose spots need more profile values on one camera is refused; each takes 4 bytes.
const MAX_PROFILE_VALUES: f64 = 1.5e8;
const MAX_FRAMES: u64 = 1_000_000;
const MAX_SIDE_PX: u64 = 4096;
const MIN_SIDE_PX: u64 = 8;
const MAX_SIGMA_PX: f64 = 20.0;

/// A validated scene: the sample, the optics and both cameras.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    name: String,
    about: String,
    frames: u64,
    exposure_ms: f64,
    height_px: usize,
    width_px: usize,
    seed: u64,
    optics: Optics,
    background_photons_per_exposure: f64,
    background_transmission: f64,
    cameras: [CameraModel; 2],
    view: View,
    species: Vec<Species>,
    patch_grid: Option<PatchGrid>,
}

impl Scene {
    /// Reads a scene from the text of its file.
    ///
    /// # Errors
    /// All faults of the text at once: syntax, missing and unknown keys, values outside their limits,
    /// parts that contradict each other, scenes too large to simulate.
    pub fn from_toml(text: &str) -> Result<Self, SceneError> {
        if text.len() > MAX_TEXT_BYTES {
            let message = format!("is {} bytes long", text.len());
            return Err(SceneError::single("", message, "give a file of at most 1 MiB"));
        }
        let faults = Faults::new(text);
        let scene = sofiscope_form::read(&faults, read_scene);
        let list = faults.into_list();
        scene.filter(|_| list.is_empty()).ok_or(SceneError { faults: list })
    }

    /// The same scene with another number of frames; what all of them share stays the same.
    ///
    /// # Errors
    /// When `frames` is 0, above one million, or makes the scene too large.
    pub fn with_frames(&self, frames: u64) -> Result<Self, SceneError> {
        let scene = Self { frames, ..self.clone() };
        if !(1..=MAX_FRAMES).contains(&frames) {
            let remedy = "give a whole number from 1 to 1000000";
            return Err(SceneError::single("frames", format!("is {frames}"), remedy));
        }
        match scene.excess() {
            Some(message) => Err(SceneError::single("frames", message, "give fewer frames")),
            None => Ok(scene),
        }
    }

    /// Name of the scene.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What the scene shows, in words.
    #[must_use]
    pub fn about(&self) -> &str {
        &self.about
    }

    /// Number of exposures, at least 1.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Length of an exposure in milliseconds; exposures follow each other without a gap.
    #[must_use]
    pub fn exposure_ms(&self) -> f64 {
        self.exposure_ms
    }

    /// Rows of each camera.
    #[must_use]
    pub fn height_px(&self) -> usize {
        self.height_px
    }

    /// Columns of each camera.
    #[must_use]
    pub fn width_px(&self) -> usize {
        self.width_px
    }

    /// Pixels of one frame.
    #[must_use]
    pub fn num_pixels(&self) -> usize {
        self.height_px * self.width_px
    }

    /// The seed the file proposes.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Objective and pixels.
    #[must_use]
    pub fn optics(&self) -> &Optics {
        &self.optics
    }

    /// Background photons per pixel and exposure, of both cameras together.
    #[must_use]
    pub fn background_photons_per_exposure(&self) -> f64 {
        self.background_photons_per_exposure
    }

    /// Share of the background that reaches camera T; the rest reaches camera R.
    #[must_use]
    pub fn background_transmission(&self) -> f64 {
        self.background_transmission
    }

    /// Camera models, reflected and transmitted.
    #[must_use]
    pub fn cameras(&self) -> &[CameraModel; 2] {
        &self.cameras
    }

    /// Where camera T sees a point of camera R.
    #[must_use]
    pub fn view(&self) -> &View {
        &self.view
    }

    /// All species, at least one unless the scene is empty.
    #[must_use]
    pub fn species(&self) -> &[Species] {
        &self.species
    }

    /// The patch grid, if the scene has one.
    #[must_use]
    pub fn patch_grid(&self) -> Option<&PatchGrid> {
        self.patch_grid.as_ref()
    }

    fn num_emitters(&self, species: &Species) -> u64 {
        let pitch_nm = self.optics.pixel_pitch_nm;
        species.shapes.iter().fold(0, |sum: u64, shape| sum.saturating_add(shape.num_emitters(pitch_nm)))
    }

    /// Why this scene is too large to simulate, if it is.
    fn excess(&self) -> Option<String> {
        let in_patches = self.patch_grid.as_ref().map_or(0, |grid| {
            let [rows, columns] = grid.size();
            rows.saturating_mul(columns).saturating_mul(grid.emitters_per_patch)
        });
        let mut emitters = in_patches;
        let mut lit = in_patches as f64 * self.frames as f64;
        for species in &self.species {
            let number = self.num_emitters(species);
            emitters = emitters.saturating_add(number);
            lit += number as f64 * self.lit_exposures(species);
        }
        if emitters > MAX_EMITTERS {
            return Some(format!("gives {emitters} emitters, above {MAX_EMITTERS}"));
        }
        // A row and a column profile, each ten standard deviations long.
        let values = emitters as f64 * (20.0 * self.widest_sigma_px() + 2.0);
        if values > MAX_PROFILE_VALUES {
            return Some(format!("gives {emitters} emitters with spots too wide to keep in memory"));
        }
        (lit > MAX_LIT_EXPOSURES).then(|| format!("lets emitters shine in {lit:.1e} exposures, above 1.5e8"))
    }

    /// Standard deviation of the widest spot on either camera.
    fn widest_sigma_px(&self) -> f64 {
        let sigmas = self.species.iter().map(|species| species.sigma_px(&self.optics));
        sigmas.fold(0.0, f64::max) * self.view.scale.max(1.0)
    }

    /// Mean number of exposures in which an emitter shines at all.
    fn lit_exposures(&self, species: &Species) -> f64 {
        let kinetics = species.kinetics(self.exposure_ms);
        let alive = kinetics.bleaching.unwrap_or(f64::INFINITY).min(self.frames as f64);
        match kinetics.switching {
            // Steady light that never ends is computed once.
            None if kinetics.bleaching.is_none() => 0.0,
            None => alive,
            Some(switching) => {
                let dark = (1.0 - switching.on_ratio()) * libm::exp(-1.0 / switching.off);
                alive * (1.0 - dark)
            }
        }
    }
}

fn read_scene(form: &Form<'_>) -> Scene {
    let exposure_ms = form.number("exposure_ms", 1e-3..=1e6);
    let height_px = form.whole("height_px", MIN_SIDE_PX..=MAX_SIDE_PX) as usize;
    let width_px = form.whole("width_px", MIN_SIDE_PX..=MAX_SIDE_PX) as usize;
    let optics = read_optics(form);
    let (cameras, view) = read_cameras(form);
    let field = [[-0.5, -0.5], [height_px as f64 - 0.5, width_px as f64 - 0.5]];
    let patch_grid = form.table("patch_grid").map(|grid_form| {
        let grid = PatchGrid::read(&grid_form);
        grid_form.finish();
        grid
    });
    let species = read_species(form, exposure_ms, field, patch_grid.as_ref());
    check_emptiness(form, !species.is_empty());
    let scene = Scene {
        name: form.text("name"),
        about: form.prose("about"),
        frames: form.whole("frames", 1..=MAX_FRAMES),
        exposure_ms,
        height_px,
        width_px,
        seed: form.whole("seed", 0..=i64::MAX as u64),
        optics,
        background_photons_per_exposure: form.number("background_photons_per_exposure", 0.0..=1e6),
        background_transmission: form.number_or("background_transmission", 0.5, 0.0..=1.0),
        cameras,
        view,
        species,
        patch_grid,
    };
    check_species(form, &scene);
    scene
}

fn read_optics(form: &Form<'_>) -> Optics {
    let Some(table) = form.table("optics") else {
        if !form.has("optics") {
            form.fault("optics", "is missing", "add a table `[optics]`");
        }
        return Optics { pixel_pitch_nm: 100.0, numerical_aperture: 1.0 };
    };
    let optics = Optics::read(&table);
    table.finish();
    optics
}

/// Keys of `[camera]` hold for both cameras, those of its two inner tables for one.
fn read_cameras(form: &Form<'_>) -> ([CameraModel; 2], View) {
    let Some(shared_form) = form.table("camera") else {
        return ([CameraModel::default(); 2], View::default());
    };
    let shared = CameraModel::read(&shared_form, CameraModel::default());
    let (mut cameras, mut view) = ([shared; 2], View::default());
    for (camera, key) in cameras.iter_mut().zip(["reflected", "transmitted"]) {
        let Some(own_form) = shared_form.table(key) else {
            continue;
        };
        *camera = CameraModel::read(&own_form, shared);
        if key == "transmitted"
            && let Some(view_form) = own_form.table("view")
        {
            view = View::read(&view_form);
            view_form.finish();
        }
        own_form.finish();
    }
    shared_form.finish();
    (cameras, view)
}

fn read_species(
    form: &Form<'_>,
    exposure_ms: f64,
    field: [[f64; 2]; 2],
    patch_grid: Option<&PatchGrid>,
) -> Vec<Species> {
    let mut all: Vec<Species> = Vec::new();
    for species_form in form.tables("species") {
        let species = Species::read(&species_form, exposure_ms, field);
        if species.shapes.is_empty() && patch_grid.is_none() {
            species_form.fault(
                "filament",
                "is missing, and so is every other shape",
                "add `[[species.filament]]`, curve, ring, disc, blob, drawing or random, or a `[patch_grid]`",
            );
        }
        if all.iter().any(|other| other.name == species.name) {
            species_form.fault("name", "is taken by another species", "give each its own name");
        }
        let steady = species.photophysics == Photophysics::Steady;
        if steady && patch_grid.is_some_and(|grid| grid.on_ratio.is_some()) {
            let remedy = "give tau_on_ms and tau_off_ms, or remove `patch_grid.on_ratio`";
            species_form.fault("steady", "contradicts `patch_grid.on_ratio`", remedy);
        }
        all.push(species);
        species_form.finish();
    }
    all
}

/// A scene without a sample, for darks and flats, says so.
fn check_emptiness(form: &Form<'_>, has_species: bool) {
    match (form.flag("empty"), has_species) {
        (false, false) => form.fault(
            "species",
            "has no entry",
            "add a table `[[species]]` for each fluorophore, or `empty = true` for darks and flats",
        ),
        (true, true) => form.fault("empty", "contradicts `species`", "remove one of the two"),
        _ => {}
    }
}

/// Checks that need the whole scene.
fn check_species(form: &Form<'_>, scene: &Scene) {
    let sigma_px = scene.widest_sigma_px();
    if sigma_px > MAX_SIGMA_PX {
        let message = format!("gives spots of {sigma_px:.1} px standard deviation");
        form.fault("optics", message, "give a larger pitch or aperture, for 20 px at most");
    }
    if let Some(message) = scene.excess() {
        form.fault("species", message, "give fewer frames, lower densities or smaller shapes");
    }
}
