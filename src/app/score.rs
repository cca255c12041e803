//! `score`: the images of an analysis against the ground truth of their simulation.
//!
//! In: images by species and stage, the truth. Out: crosstalk, resolution, signal-to-noise, separation of patches.
//! Never: guesses which image belongs to which species, compares images that do not lie on the grid of the truth.
//! Fails: [`AppError`] for images that do not fit the truth; a number that has no meaning for a scene is left out
//! with a note.

mod read;
mod tables;

use serde::Serialize;
use sofiscope_sim::score::{crosstalk_percent, patch_score, resolution_nm, signal_to_noise};
use sofiscope_sim::{Plane, Truth};

use super::AppError;
use crate::config::Catalogue;

pub use read::{ScoreArguments, run, score_result};
pub use tables::text;

/// Peaks are fitted up to 4 camera pixels beside a filament; a wider one is no peak but the slope of something else.
const WIDEST_PX: f64 = 8.0;

/// A stage of the analysis whose images are scored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Cumulants by species.
    Unmixed,
    /// With equal means on all sub-grids.
    Flattened,
    /// Deconvolved, n-th root taken, reconvolved.
    Linearized,
}

impl Stage {
    /// All stages in the order of the analysis.
    pub const ALL: [Self; 3] = [Self::Unmixed, Self::Flattened, Self::Linearized];

    /// Its name in files and reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Unmixed => "unmixed",
            Self::Flattened => "flattened",
            Self::Linearized => "linearized",
        }
    }
}

/// The images of one stage, one per species.
#[derive(Debug, Clone, Copy)]
pub struct StageImages<'a> {
    /// The stage.
    pub stage: Stage,
    /// Pixels of each image row by row, in the order of the species given beside them; NaN where there is no value.
    pub planes: &'a [&'a [f32]],
}

/// Images of an analysis, all of one size.
#[derive(Debug, Clone, Copy)]
pub struct Images<'a> {
    /// Names of the species in the order of the planes.
    pub species: &'a [String],
    /// Rows of each plane, a whole multiple of those of the truth.
    pub height: usize,
    /// Columns of each plane.
    pub width: usize,
    /// The stages there are, at least one.
    pub stages: &'a [StageImages<'a>],
}

/// One value for each stage, `None` where there is no image or the value has no meaning.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ByStage<T> {
    /// Of the unmixed images.
    pub unmixed: Option<T>,
    /// Of the flattened images.
    pub flattened: Option<T>,
    /// Of the linearized images.
    pub linearized: Option<T>,
}

impl<T> Default for ByStage<T> {
    fn default() -> Self {
        Self { unmixed: None, flattened: None, linearized: None }
    }
}

impl<T> ByStage<T> {
    /// The value of a stage.
    #[must_use]
    pub fn get(&self, stage: Stage) -> Option<&T> {
        match stage {
            Stage::Unmixed => self.unmixed.as_ref(),
            Stage::Flattened => self.flattened.as_ref(),
            Stage::Linearized => self.linearized.as_ref(),
        }
    }

    fn set(&mut self, stage: Stage, value: T) {
        match stage {
            Stage::Unmixed => self.unmixed = Some(value),
            Stage::Flattened => self.flattened = Some(value),
            Stage::Linearized => self.linearized = Some(value),
        }
    }
}

/// Row = species, column = image, in percent of the species' own image.
pub type Matrix = Vec<Vec<f64>>;

/// What the crosstalk was measured on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// Pixels on one species and far from the others, above the background.
    Structures,
    /// Centers of the patches of a grid.
    Patches,
}

/// How well the patches of a grid are told apart.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Separation {
    /// Share of the patches, 0 to 1, that are brightest in the image of their own species.
    pub correct_fraction: f64,
    /// The same for the patches of each species; `None` for a species without a patch.
    pub correct_fraction_by_species: Vec<Option<f64>>,
    /// Patches that were counted.
    pub num_patches: usize,
}

/// Numbers of the paper for the same fluorophores.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PaperTable {
    /// Which table of its supporting information.
    pub table: &'static str,
    /// Its crosstalk, in the order of the species of this score.
    pub crosstalk_percent: Matrix,
}

/// Scores of one analysis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Score {
    /// Name of the scene.
    pub scene: String,
    /// Seed of the simulation.
    pub seed: u64,
    /// Frames simulated.
    pub frames: u64,
    /// Species in the order of all rows and columns: that of the truth.
    pub species: Vec<String>,
    /// Fine pixels per camera pixel along each side.
    pub fold: usize,
    /// What the crosstalk was measured on.
    pub measure: Measure,
    /// Crosstalk by stage: row = species, column = image, percent.
    pub crosstalk_percent: ByStage<Matrix>,
    /// The largest entry beside the diagonal, by magnitude.
    pub worst_crosstalk_percent: ByStage<f64>,
    /// Full width at half maximum of the filaments of each species, nanometers; `None` where no peak was found.
    pub resolution_nm: ByStage<Vec<Option<f64>>>,
    /// Signal above background over the spread of the background, of each species in its own image;
    /// `None` for a background without any spread.
    pub snr: ByStage<Vec<Option<f64>>>,
    /// For scenes of patches: how well they are told apart.
    pub separation: ByStage<Separation>,
    /// The numbers of the paper, where it has some for these fluorophores.
    pub paper: Option<PaperTable>,
    /// What is left out above, and why.
    pub notes: Vec<String>,
}

/// Scores images in memory against the truth.
///
/// Images may come in any order of species; rows and columns of the score have the order of the truth.
///
/// # Errors
/// A data error when the species are not those of the truth, when sizes do not fit,
/// or when no stage has a crosstalk at all.
pub fn score_images(truth: &Truth, images: &Images<'_>) -> Result<Score, AppError> {
    let order = order_of_truth(truth, images.species)?;
    let fold = fold(truth, images)?;
    let mut score = empty_score(truth, fold);
    for stage in images.stages {
        if stage.planes.len() != order.len() {
            let (found, expected) = (stage.planes.len(), order.len());
            let name = stage.stage.name();
            return Err(AppError::data(format!("{found} {name} images were given for {expected} species")));
        }
        let plane = |&index: &usize| Plane {
            pixels: stage.planes[index],
            height: images.height,
            width: images.width,
            fold,
        };
        let planes: Vec<Plane<'_>> = order.iter().map(plane).collect();
        match score.measure {
            Measure::Structures => score_structures(truth, stage.stage, &planes, &mut score),
            Measure::Patches => score_patches(truth, stage.stage, &planes, &mut score),
        }
    }
    if Stage::ALL.iter().all(|&stage| score.crosstalk_percent.get(stage).is_none()) {
        let why =
            if score.notes.is_empty() { "no image was given".to_owned() } else { score.notes.join("; ") };
        return Err(AppError::data(format!("nothing can be scored: {why}")));
    }
    Ok(score)
}

fn empty_score(truth: &Truth, fold: usize) -> Score {
    let is_patches = !truth.patches.is_empty();
    let species: Vec<String> = truth.species.iter().map(|species| species.name.clone()).collect();
    Score {
        scene: truth.scene.clone(),
        seed: truth.seed,
        frames: truth.frames,
        fold,
        measure: if is_patches { Measure::Patches } else { Measure::Structures },
        crosstalk_percent: ByStage::default(),
        worst_crosstalk_percent: ByStage::default(),
        resolution_nm: ByStage::default(),
        snr: ByStage::default(),
        separation: ByStage::default(),
        paper: if is_patches { None } else { tables::paper(&species) },
        notes: Vec::new(),
        species,
    }
}

fn score_structures(truth: &Truth, stage: Stage, planes: &[Plane<'_>], score: &mut Score) {
    let name = stage.name();
    match crosstalk_percent(truth, planes) {
        Ok(matrix) => set_crosstalk(score, stage, matrix),
        Err(error) => score.notes.push(format!("no crosstalk of the {name} images: {error}")),
    }
    match resolution_nm(truth, planes) {
        Ok(widths) => {
            let widest_nm = WIDEST_PX * truth.pixel_pitch_nm;
            let peak = |width: f64| (width <= widest_nm).then_some(width);
            score.resolution_nm.set(stage, widths.into_iter().map(peak).collect());
        }
        Err(error) => score.notes.push(format!("no resolution of the {name} images: {error}")),
    }
    match signal_to_noise(truth, planes) {
        Ok(ratios) => {
            let finite = |ratio: f64| ratio.is_finite().then_some(ratio);
            score.snr.set(stage, ratios.into_iter().map(finite).collect());
        }
        Err(error) => score.notes.push(format!("no signal-to-noise ratio of the {name} images: {error}")),
    }
}

fn score_patches(truth: &Truth, stage: Stage, planes: &[Plane<'_>], score: &mut Score) {
    match patch_score(truth, planes) {
        Ok(patches) => {
            let finite = |share: f64| share.is_finite().then_some(share);
            let by_species = patches.correct_fraction_by_species.into_iter().map(finite).collect();
            score.separation.set(
                stage,
                Separation {
                    correct_fraction: patches.correct_fraction,
                    correct_fraction_by_species: by_species,
                    num_patches: patches.num_patches,
                },
            );
            set_crosstalk(score, stage, patches.crosstalk_percent);
        }
        Err(error) => score.notes.push(format!("no separation of the {} images: {error}", stage.name())),
    }
}

fn set_crosstalk(score: &mut Score, stage: Stage, matrix: Matrix) {
    let others = matrix.iter().enumerate().flat_map(|(row, entries)| {
        entries.iter().enumerate().filter(move |(column, _)| *column != row).map(|(_, &entry)| entry)
    });
    if let Some(worst) = others.max_by(|a, b| a.abs().total_cmp(&b.abs())) {
        score.worst_crosstalk_percent.set(stage, worst);
    }
    score.crosstalk_percent.set(stage, matrix);
}

/// For each species of the truth the place of its image.
fn order_of_truth(truth: &Truth, species: &[String]) -> Result<Vec<usize>, AppError> {
    let catalogue = Catalogue::built_in();
    let given: Vec<String> = species.iter().map(|name| key(&catalogue, name)).collect();
    let wanted: Vec<String> = truth.species.iter().map(|species| key(&catalogue, &species.name)).collect();
    let places: Vec<usize> =
        wanted.iter().filter_map(|name| given.iter().position(|given| given == name)).collect();
    let mut distinct = places.clone();
    distinct.sort_unstable();
    distinct.dedup();
    if distinct.len() == wanted.len() && given.len() == wanted.len() {
        return Ok(places);
    }
    let names: Vec<&str> = truth.species.iter().map(|species| species.name.as_str()).collect();
    Err(AppError::data(format!(
        "the images are of {}, but the scene {} has {}. Analyze with --species \"{}\", or choose the truth that \
         belongs to these images.",
        or_none(&species.join(", ")),
        truth.scene,
        names.join(", "),
        names.join(",")
    )))
}

fn or_none(names: &str) -> &str {
    if names.is_empty() { "no species" } else { names }
}

/// What two names of the same fluorophore have in common.
fn key(catalogue: &Catalogue, name: &str) -> String {
    let full = catalogue.fluorophore(name).map_or(name, |fluorophore| fluorophore.name());
    full.chars().filter(|letter| letter.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Fine pixels per camera pixel, equal along both sides.
fn fold(truth: &Truth, images: &Images<'_>) -> Result<usize, AppError> {
    let (rows, columns) = (truth.height_px, truth.width_px);
    let fold = images.height.checked_div(rows).unwrap_or(0);
    let fits = |side: usize, full: usize| fold.checked_mul(side) == Some(full);
    if fold > 0 && fits(rows, images.height) && fits(columns, images.width) {
        return Ok(fold);
    }
    Err(AppError::data(format!(
        "the images have {} x {} pixels, which is no whole multiple of the {rows} x {columns} pixels of the \
         scene {}. Choose the truth that belongs to these images.",
        images.height, images.width, truth.scene
    )))
}
