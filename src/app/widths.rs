//! The width of each species' point-spread function, and where it comes from.
//!
//! In: cumulants of any moment, settings, beads. Out: [`Width`] per species. The cumulants are all that changes from
//! moment to moment, so live, replayed and offline analysis choose alike.
//! Never: takes a width that the optics rule out; hides where a width comes from. Fails: not at all.

use super::AppError;
use super::analysis::Prepared;
use crate::config::PsfSource;
use crate::reconstruction::Stages;
use crate::sofi::cumulant::Drawing;
use crate::sofi::psf::PsfError;
use crate::sofi::psf_width::{MeasuredWidth, from_sub_grids, with_pixels, without_pixels};
use crate::sofi::spectra::Species;
use crate::sofi::unmixing::{UnmixingMatrix, UnmixingMethod};
use ndarray::Array2;

/// Emission assumed for the point-spread function of unnamed dyes, nanometers.
const ASSUMED_EMISSION_NM: f64 = 600.0;
/// A width known worse than this is not used.
const MOST_RELATIVE_ERROR: f64 = 0.04;
/// Widths that differ by more than this share of those of the optics are worth a warning,
const UNLIKE_OPTICS: f64 = 0.05;
/// and by so many standard errors.
const ERRORS_APART: f64 = 3.0;
/// Widths that lenses and samples make of the width that the optics have at best.
const OVER_OPTICS: std::ops::RangeInclusive<f64> = 0.8..=1.6;
/// Widths where the optics are not known, camera pixels.
const WITHOUT_OPTICS_PX: std::ops::RangeInclusive<f64> = 0.3..=5.0;

/// Width of a point-spread function.
#[derive(Debug, Clone)]
pub(super) struct Width {
    /// Standard deviation, camera pixels, as the lens makes it: for linearization.
    pub(super) sigma_px: f64,
    /// Standard deviation, camera pixels, once pixels have integrated it: for flattening.
    pub(super) seen_px: f64,
    /// Where it comes from, for the report.
    pub(super) source: String,
}

impl Prepared {
    /// The width of each species' point-spread function in camera pixels: given; else from the optics where the settings
    /// leave it at that and the emission is known; else from its own sub-grids, from beads, from the sub-grids of the
    /// cameras, whichever is the first that is clear; else from the optics. `unmixed` are the species' images of this
    /// drawing.
    pub(super) fn widths(
        &self,
        drawing: &Drawing,
        matrix: &UnmixingMatrix,
        unmixed: &[Array2<f32>],
    ) -> Vec<Width> {
        if let Some(sigma_px) = self.settings.psf_sigma_px {
            let given = Width { sigma_px, seen_px: sigma_px, source: "given".to_owned() };
            return vec![given; self.species.len()];
        }
        let by_optics =
            |species: &Species| self.settings.psf == PsfSource::Optics && species.emission_nm.is_some();
        if self.species.iter().all(by_optics) {
            return self.species.iter().map(|species| self.by_optics(species)).collect();
        }
        let measured = self.in_sub_grids(drawing, matrix, unmixed);
        let cameras = if measured.iter().all(Option::is_some) { None } else { self.camera_widths(drawing) };
        let width = |(measured, species): (Option<MeasuredWidth>, &Species)| {
            if by_optics(species) {
                return self.by_optics(species);
            }
            measured
                .and_then(|seen| self.by_species(seen))
                .or_else(|| self.by_cameras(species, self.bead_widths, "beads of the registration"))
                .or_else(|| self.by_cameras(species, cameras, "sub-grid ratios of the cameras"))
                .unwrap_or_else(|| self.by_optics(species))
        };
        measured.into_iter().zip(&self.species).map(width).collect()
    }

    /// The widths that the sub-grids of the finished images show, where clear, the pixels' own width included.
    pub(super) fn measured_widths(
        &self,
        drawing: &Drawing,
        stages: Option<&Stages>,
    ) -> Vec<Option<MeasuredWidth>> {
        match (&self.matrix, stages) {
            (Some(matrix), Some(stages)) => self.in_sub_grids(drawing, matrix, &stages.unmixed),
            _ => Vec::new(),
        }
    }

    /// What the reader must know where the data show other widths than the optics that were used.
    pub(super) fn width_warnings(&self, measured: &[Option<MeasuredWidth>]) -> Vec<String> {
        if self.settings.psf != PsfSource::Optics || self.settings.psf_sigma_px.is_some() {
            return Vec::new();
        }
        let warning = |(species, seen): (&Species, &Option<MeasuredWidth>)| {
            let (emission_nm, width) = (species.emission_nm?, seen.and_then(MeasuredWidth::without_pixels)?);
            let optics_px = self.by_optics(species).sigma_px;
            let ratio = width.sigma_px / optics_px - 1.0;
            let is_clear = ratio.abs() > UNLIKE_OPTICS
                && (width.sigma_px - optics_px).abs() > ERRORS_APART * width.standard_error_px;
            is_clear.then(|| {
                format!(
                    "The sub-grids of {} show a point-spread function of {:.3} px (standard error {:.3} px), {:+.0} % from \
                     the {optics_px:.3} px of NA {} and {emission_nm} nm emission that were used; check the aperture, \
                     the pixel size and the focus, or use the measured width with --psf measured.",
                    species.name,
                    width.sigma_px,
                    width.standard_error_px,
                    100.0 * ratio,
                    self.settings.numerical_aperture,
                )
            })
        };
        self.species.iter().zip(measured).filter_map(warning).collect()
    }

    fn in_sub_grids(
        &self,
        drawing: &Drawing,
        matrix: &UnmixingMatrix,
        unmixed: &[Array2<f32>],
    ) -> Vec<Option<MeasuredWidth>> {
        // Images that were kept from going negative have no noise around zero, and their means are too large.
        let linear = match self.settings.unmixing {
            UnmixingMethod::NonNegative => {
                let kappa: Vec<_> = drawing.cumulants.iter().map(|image| image.view()).collect();
                matrix.unmix(&kappa).ok()
            }
            _ => None,
        };
        let images = linear.as_deref().unwrap_or(unmixed);
        let distances = self.grid.squared_distances();
        let measured = |(species, image): (&Species, &Array2<f32>)| {
            let seen = from_sub_grids(image, &distances).filter(is_clear)?;
            self.is_possible(species, seen.sigma_px).then_some(seen)
        };
        self.species.iter().zip(images).map(measured).collect()
    }

    fn by_species(&self, seen: MeasuredWidth) -> Option<Width> {
        let MeasuredWidth { sigma_px, standard_error_px } = seen.without_pixels()?;
        let (nm, error_nm) = (sigma_px * self.pixel_pitch_nm, standard_error_px * self.pixel_pitch_nm);
        let source = format!("measured from sub-grid ratios, {nm:.0} nm, standard error {error_nm:.1} nm");
        Some(Width { sigma_px, seen_px: seen.sigma_px, source })
    }

    /// Widths of R and T from their own cumulants, where both are clear.
    fn camera_widths(&self, drawing: &Drawing) -> Option<[f64; 2]> {
        let (reflected, transmitted) = match &drawing.cumulants[..] {
            [first, .., last] if self.source.inputs.len() == 2 => (first, last),
            _ => return None,
        };
        let distances = self.grid.squared_distances();
        let width = |image| from_sub_grids(image, &distances).filter(is_clear).map(|width| width.sigma_px);
        Some([width(reflected)?, width(transmitted)?])
    }

    /// The width of a species whose light two cameras of different widths share.
    fn by_cameras(&self, species: &Species, cameras: Option<[f64; 2]>, what: &str) -> Option<Width> {
        let [reflected, transmitted] = cameras?;
        let (r, t) = (species.response.reflection(), species.response.transmission());
        let seen_px = ((r * reflected.powi(2) + t * transmitted.powi(2)) / (r + t)).sqrt();
        let sigma_px = without_pixels(seen_px)?;
        let [nm, r_nm, t_nm] = [sigma_px, without_pixels(reflected)?, without_pixels(transmitted)?]
            .map(|width| width * self.pixel_pitch_nm);
        let source = format!("measured from {what}, {nm:.0} nm of {r_nm:.0} nm (R) and {t_nm:.0} nm (T)");
        self.is_possible(species, seen_px).then_some(Width { sigma_px, seen_px, source })
    }

    fn by_optics(&self, species: &Species) -> Width {
        let aperture = self.settings.numerical_aperture;
        let (emission_nm, assumed) = match species.emission_nm {
            Some(emission_nm) => (emission_nm, ""),
            None => (ASSUMED_EMISSION_NM, " assumed"),
        };
        let sigma_px = 0.21 * emission_nm / aperture / self.pixel_pitch_nm;
        let source = format!("NA {aperture}, {emission_nm} nm emission{assumed}");
        Width { sigma_px, seen_px: with_pixels(sigma_px), source }
    }

    /// Whether the optics can make such a width.
    fn is_possible(&self, species: &Species, seen_px: f64) -> bool {
        if species.emission_nm.is_none() {
            return WITHOUT_OPTICS_PX.contains(&seen_px);
        }
        OVER_OPTICS.contains(&(seen_px / self.by_optics(species).seen_px))
    }
}

fn is_clear(width: &MeasuredWidth) -> bool {
    width.relative_error() <= MOST_RELATIVE_ERROR
}

pub(super) fn unlike_a_psf(error: &PsfError) -> AppError {
    AppError::Usage(format!(
        "the point-spread function: {error}; check psf_sigma_px, or pixel_pitch_nm and numerical_aperture"
    ))
}
