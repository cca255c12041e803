//! What is really in the sample, stored beside the frames as `truth.json`.
//!
//! In: a world, or JSON. Out: everything a score needs, in pixels of camera R.
//! Never: holds pixels. Fails: [`TruthError`] for JSON that is no such truth.

use serde::{Deserialize, Serialize};

use crate::geometry::{Line, Nearest, between};
use crate::scene::{CameraModel, Photophysics, Shape, View};
use crate::world::{World, is_target};

/// Version of the format of `truth.json`.
const FORMAT: u32 = 1;

/// Why a text is no ground truth.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// The text is not JSON, or lacks something.
    #[error("not a ground truth: {0}")]
    Json(#[from] serde_json::Error),
    /// The file is of another version of the program.
    #[error("ground truth of format {0}, but this program reads format {FORMAT}")]
    Format(u32),
    /// A value makes no sense.
    #[error("`{key}` is {found}; simulate the scene again")]
    Value {
        /// Dotted key.
        key: String,
        /// The value found.
        found: String,
    },
}

/// The ground truth of one simulated measurement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Version of this format.
    pub format: u32,
    /// Name of the scene.
    pub scene: String,
    /// Seed of the world.
    pub seed: u64,
    /// Number of exposures.
    pub frames: u64,
    /// Length of an exposure, milliseconds.
    pub exposure_ms: f64,
    /// Rows of each camera.
    pub height_px: usize,
    /// Columns of each camera.
    pub width_px: usize,
    /// Pixel pitch in the sample, nanometers.
    pub pixel_pitch_nm: f64,
    /// Numerical aperture of the objective.
    pub numerical_aperture: f64,
    /// Background photons per pixel and exposure on cameras R and T.
    pub background_photons: [f64; 2],
    /// Cameras R and T.
    pub cameras: [CameraModel; 2],
    /// Where camera T sees a point of camera R.
    pub view: View,
    /// The same as rows `[a_y, a_x, b]`: `y_T = a_y * y_R + a_x * x_R + b`, then for `x_T`.
    pub transmitted_from_reflected: [[f64; 3]; 2],
    /// The species in the order of the scene.
    pub species: Vec<SpeciesTruth>,
    /// The patches of a patch grid; empty for other scenes.
    pub patches: Vec<PatchTruth>,
}

/// One species of the sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpeciesTruth {
    /// Name.
    pub name: String,
    /// Share of the light that reaches camera T.
    pub transmission: f64,
    /// Share of the light that reaches camera R.
    pub reflection: f64,
    /// Wavelength of the emission, nanometers.
    pub emission_nm: f64,
    /// Standard deviation of the PSF on camera R, pixels.
    pub sigma_px: f64,
    /// Number of emitters.
    pub num_emitters: u64,
    /// Photons per exposure in the on-state, unless a patch says otherwise.
    pub i_on_photons: f64,
    /// Share of the time in the on-state, unless a patch says otherwise.
    pub on_ratio: f64,
    /// Blinking times, unless a patch says otherwise.
    pub photophysics: Photophysics,
    /// Mean time until bleaching, seconds.
    pub tau_bleach_s: Option<f64>,
    /// Where the emitters sit.
    pub shapes: Vec<Shape>,
    /// Emitter positions `[y, x]` of steady species (beads); empty for others.
    pub positions_px: Vec<[f64; 2]>,
}

/// One patch of a patch grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PatchTruth {
    /// Index of its species.
    pub species: usize,
    /// Center `[y, x]`.
    pub center_px: [f64; 2],
    /// Radius.
    pub radius_px: f64,
    /// Photons per exposure in the on-state.
    pub i_on_photons: f64,
    /// Share of the time in the on-state.
    pub on_ratio: f64,
}

impl Truth {
    pub(crate) fn new(world: &World) -> Self {
        let scene = world.scene();
        let share_t = scene.background_transmission();
        let background = scene.background_photons_per_exposure();
        Self {
            format: FORMAT,
            scene: scene.name().into(),
            seed: world.seed(),
            frames: scene.frames(),
            exposure_ms: scene.exposure_ms(),
            height_px: scene.height_px(),
            width_px: scene.width_px(),
            pixel_pitch_nm: scene.optics().pixel_pitch_nm,
            numerical_aperture: scene.optics().numerical_aperture,
            background_photons: [background * (1.0 - share_t), background * share_t],
            cameras: *scene.cameras(),
            view: *scene.view(),
            transmitted_from_reflected: scene
                .view()
                .transmitted_from_reflected(scene.height_px(), scene.width_px()),
            species: (0..scene.species().len()).map(|i| species_truth(world, i)).collect(),
            patches: patch_truths(world),
        }
    }

    /// The text of `truth.json`.
    ///
    /// # Errors
    /// Only when memory runs out; all values are plain numbers.
    pub fn to_json(&self) -> Result<String, TruthError> {
        Ok(serde_json::to_string_pretty(self)?)
    }

    /// Reads the text of `truth.json`.
    ///
    /// # Errors
    /// When the text is not JSON, lacks a key, is of another format, or holds impossible sizes.
    pub fn from_json(text: &str) -> Result<Self, TruthError> {
        let truth: Self = serde_json::from_str(text)?;
        if truth.format != FORMAT {
            return Err(TruthError::Format(truth.format));
        }
        truth.check()?;
        Ok(truth)
    }

    fn check(&self) -> Result<(), TruthError> {
        let value = |key: &str, found: String| Err(TruthError::Value { key: key.into(), found });
        if self.pixel_pitch_nm.is_nan() || self.pixel_pitch_nm <= 0.0 {
            return value("pixel_pitch_nm", self.pixel_pitch_nm.to_string());
        }
        if self.species.is_empty() {
            return value("species", "empty".into());
        }
        match self.patches.iter().find(|patch| patch.species >= self.species.len()) {
            Some(patch) => value("patches.species", patch.species.to_string()),
            None => Ok(()),
        }
    }

    /// Distance in camera pixels of the point `(y, x)` of camera R from the nearest place of a species:
    /// from the axis of filaments, curves and rings; from the edge of areas and patches, 0 inside.
    ///
    /// Infinite for a species that is not there.
    #[must_use]
    pub fn distance_px(&self, species: usize, y: f64, x: f64) -> f64 {
        self.outline(species).distance([y, x])
    }

    /// The places of one species, prepared for many questions.
    pub(crate) fn outline(&self, species: usize) -> Outline<'_> {
        let shapes = self.species.get(species).map_or(&[][..], |species| &species.shapes);
        Outline {
            axes: shapes.iter().filter_map(Shape::axis).collect(),
            areas: shapes.iter().filter(|shape| shape.axis().is_none()).collect(),
            patches: self.patches.iter().filter(|patch| patch.species == species).collect(),
        }
    }
}

/// The places of one species.
#[derive(Debug)]
pub(crate) struct Outline<'t> {
    axes: Vec<Line>,
    areas: Vec<&'t Shape>,
    patches: Vec<&'t PatchTruth>,
}

impl Outline<'_> {
    /// As [`Truth::distance_px`].
    pub(crate) fn distance(&self, point: [f64; 2]) -> f64 {
        let areas = self.areas.iter().map(|shape| shape.distance_from_area(point));
        let patches =
            self.patches.iter().map(|patch| (between(patch.center_px, point) - patch.radius_px).max(0.0));
        let axis = self.nearest_axis(point).map_or(f64::INFINITY, |nearest| nearest.distance);
        areas.chain(patches).fold(axis, f64::min)
    }

    /// The nearest place on an axis, if the species has any.
    pub(crate) fn nearest_axis(&self, point: [f64; 2]) -> Option<Nearest> {
        self.axes.iter().map(|axis| axis.nearest(point)).min_by(|a, b| a.distance.total_cmp(&b.distance))
    }
}

fn species_truth(world: &World, index: usize) -> SpeciesTruth {
    let species = &world.scene().species()[index];
    let own = || world.emitters().iter().filter(move |emitter| emitter.species == index);
    SpeciesTruth {
        name: species.name.clone(),
        transmission: species.transmission,
        reflection: species.reflection,
        emission_nm: species.emission_nm,
        sigma_px: species.sigma_px(world.scene().optics()),
        num_emitters: own().count() as u64,
        i_on_photons: species.i_on_photons,
        on_ratio: species.photophysics.on_ratio(),
        photophysics: species.photophysics,
        tau_bleach_s: species.tau_bleach_s,
        shapes: species.shapes.clone(),
        positions_px: if is_target(species.photophysics) {
            own().map(|emitter| emitter.position_px).collect()
        } else {
            Vec::new()
        },
    }
}

fn patch_truths(world: &World) -> Vec<PatchTruth> {
    let pitch_nm = world.scene().optics().pixel_pitch_nm;
    let radius_px = world.scene().patch_grid().map_or(0.0, |grid| grid.radius_nm / pitch_nm);
    world
        .patches()
        .iter()
        .map(|patch| PatchTruth {
            species: patch.species,
            center_px: patch.center_px,
            radius_px,
            i_on_photons: patch.photons,
            on_ratio: patch.on_ratio,
        })
        .collect()
}
