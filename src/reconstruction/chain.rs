//! Steps 3 to 5 of the paper: from drawn cumulants to unmixed, flattened and linearized images per species.

use crate::sofi::cumulant::Drawing;
use crate::sofi::flattening::{Flattening, FlatteningError, FlatteningReport, PsfWidth, flatten};
use crate::sofi::grid::VirtualPixelGrid;
use crate::sofi::linearization::{LinearizationError, LinearizationSettings, linearize};
use crate::sofi::unmixing::{UnmixingError, UnmixingMatrix, UnmixingMethod};
use ndarray::Array2;
use rayon::prelude::*;

/// How the sub-grids of the fine image get equal weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FlatteningKind {
    /// Equal means on all sub-grids, the paper's choice.
    #[default]
    EqualMeans,
    /// The distance factor of a Gaussian point-spread function (Eq. S6).
    DistanceFactor,
}

/// What the chain needs to know beside the cumulants.
#[derive(Debug, Clone)]
pub struct ChainSettings {
    /// Mixing of species into spectral channels.
    pub matrix: UnmixingMatrix,
    /// How the mixing is inverted.
    pub method: UnmixingMethod,
    /// How sub-grids are weighted.
    pub flattening: FlatteningKind,
    /// How each species is linearized; [`reconstruct`] takes the width for flattening from here as well.
    pub linearization: Vec<LinearizationSettings>,
}

/// Images after each step, one per species, on the fine grid.
#[derive(Debug, Clone)]
pub struct Stages {
    /// Step 3, counts to the n-th power.
    pub unmixed: Vec<Array2<f32>>,
    /// Step 4, counts to the n-th power.
    pub flattened: Vec<Array2<f32>>,
    /// What flattening did to each species.
    pub flattening: Vec<FlatteningReport>,
    /// Step 5, proportional to brightness in counts.
    pub linearized: Vec<Array2<f32>>,
}

/// Why a step could not be done.
#[derive(Debug, thiserror::Error)]
pub enum ReconstructionError {
    /// The mixing cannot be inverted.
    #[error(transparent)]
    Unmixing(#[from] UnmixingError),
    /// Sub-grids could not be weighted.
    #[error(transparent)]
    Flattening(#[from] FlatteningError),
    /// An image could not be linearized.
    #[error(transparent)]
    Linearization(#[from] LinearizationError),
    /// The number of linearization settings is not the number of species.
    #[error("{species} species need as many linearization settings, not {settings}")]
    Settings {
        /// Species in the matrix.
        species: usize,
        /// Settings given.
        settings: usize,
    },
}

/// Unmixes, flattens and linearizes drawn cumulants.
///
/// # Errors
/// [`ReconstructionError`] of the first step that cannot be done.
pub fn reconstruct(
    drawing: &Drawing,
    grid: &VirtualPixelGrid,
    settings: &ChainSettings,
) -> Result<Stages, ReconstructionError> {
    let widths: Vec<f64> = settings.linearization.iter().map(|species| species.psf.sigma()).collect();
    finish_species(unmix(drawing, &settings.matrix, &settings.method)?, grid, settings, &widths)
}

/// Step 3 alone: one image per species.
///
/// # Errors
/// [`ReconstructionError::Unmixing`].
pub fn unmix(
    drawing: &Drawing,
    matrix: &UnmixingMatrix,
    method: &UnmixingMethod,
) -> Result<Vec<Array2<f32>>, ReconstructionError> {
    let kappa: Vec<_> = drawing.cumulants.iter().map(|image| image.view()).collect();
    Ok(matrix.unmix_with(method, &kappa)?)
}

/// Steps 4 and 5 for images of species that are unmixed already; `seen_sigma_px` are the widths that the distance factors
/// of their sub-grids follow, standard deviation in camera pixels, the pixels' own width included.
///
/// # Errors
/// [`ReconstructionError`] of the first step that cannot be done.
pub fn finish_species(
    unmixed: Vec<Array2<f32>>,
    grid: &VirtualPixelGrid,
    settings: &ChainSettings,
    seen_sigma_px: &[f64],
) -> Result<Stages, ReconstructionError> {
    let species = unmixed.len();
    for settings in [settings.linearization.len(), seen_sigma_px.len()] {
        if settings != species {
            return Err(ReconstructionError::Settings { species, settings });
        }
    }
    let distances = grid.squared_distances();
    let finish = |((image, linearization), &seen): ((&Array2<f32>, &LinearizationSettings), &f64)| {
        let width = PsfWidth::Known(seen);
        let kind = match settings.flattening {
            FlatteningKind::EqualMeans => Flattening::EqualMeans(width),
            FlatteningKind::DistanceFactor => Flattening::DistanceFactor(width),
        };
        let (flat, report) = flatten(image, &distances, kind)?;
        let linear = linearize(&flat, grid.order(), linearization)?;
        Ok::<_, ReconstructionError>((flat, report, linear))
    };
    let finished: Vec<_> = unmixed
        .par_iter()
        .zip(&settings.linearization)
        .zip(seen_sigma_px)
        .map(finish)
        .collect::<Result<_, _>>()?;
    let mut stages =
        Stages { unmixed, flattened: Vec::new(), flattening: Vec::new(), linearized: Vec::new() };
    for (flat, report, linear) in finished {
        stages.flattened.push(flat);
        stages.flattening.push(report);
        stages.linearized.push(linear);
    }
    Ok(stages)
}
