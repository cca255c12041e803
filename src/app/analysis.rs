//! One analysis from the first frame to the last image, for files, the simulator and the demo alike.

use super::AppError;
use super::progress::Progress;
use super::registering::registered;
use crate::config::{AnalysisSettings, Catalogue};
use crate::reconstruction::{
    AllCores, ChainSettings, Feed, FeedError, FlatteningKind, Quality, Stages, feed, reconstruct,
};
use crate::sofi::cumulant::{Count, CumulantEngine, CumulantSettings, Drawing, Incomplete};
use crate::sofi::flattening::estimate_sigma;
use crate::sofi::grid::VirtualPixelGrid;
use crate::sofi::linearization::LinearizationSettings;
use crate::sofi::psf::{Psf, PsfError};
use crate::sofi::spectra::Species;
use crate::sofi::unmixing::{UnmixingError, UnmixingMatrix};
use ndarray::array;
use std::time::{Duration, Instant};

/// Exposures per subsequence in the paper (2000 frames in 10 runs).
const PAPER_SUBSEQUENCE: u64 = 200;

/// Pixel pitch of the paper's microscope, nanometers.
const PAPER_PITCH_NM: f64 = 108.0;

/// Emission assumed for the point-spread function of unnamed dyes, nanometers.
const ASSUMED_EMISSION_NM: f64 = 600.0;

/// Most points of the bleaching curve.
pub(super) const TRACE_POINTS: u64 = 500;

/// Where frames come from.
#[derive(Debug, Clone)]
pub(super) struct Source {
    /// Role, path and sample type of each channel.
    pub(super) inputs: Vec<(String, String, String)>,
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) frames: u64,
    /// Size of a camera pixel in the sample, nanometers, if the source knows it.
    pub(super) pixel_pitch_nm: Option<f64>,
    /// Time from exposure to exposure, milliseconds, if the source knows it.
    pub(super) exposure_ms: Option<f64>,
    pub(super) simulated: bool,
    /// Species that the source knows, instead of names to look up.
    pub(super) species: Option<Vec<Species>>,
    /// Serial numbers of cameras R and T, where known.
    pub(super) serials: [Option<String>; 2],
    /// Text of the registration that the source knows.
    pub(super) registration: Option<String>,
}

/// Settings that fit a source: everything that can be refused before the first frame.
#[derive(Debug, Clone)]
pub(super) struct Prepared {
    pub(super) settings: AnalysisSettings,
    pub(super) source: Source,
    pub(super) engine: CumulantSettings,
    pub(super) grid: VirtualPixelGrid,
    pub(super) matrix: Option<UnmixingMatrix>,
    pub(super) species: Vec<Species>,
    pub(super) pixel_pitch_nm: f64,
    pub(super) warnings: Vec<String>,
    /// Text of the registration that is used.
    pub(super) registration: Option<String>,
}

/// Width of a point-spread function.
#[derive(Debug, Clone)]
pub(super) struct Width {
    /// Standard deviation, camera pixels.
    pub(super) sigma_px: f64,
    /// Where it comes from, for the report.
    pub(super) source: String,
}

/// Everything that one analysis found.
#[derive(Debug, Clone)]
pub(super) struct Analysis {
    pub(super) prepared: Prepared,
    pub(super) drawing: Drawing,
    pub(super) stages: Option<Stages>,
    pub(super) feed: Feed,
    /// Width of the point-spread function per species.
    pub(super) widths: Vec<Width>,
    /// Seconds of each step.
    pub(super) steps: Vec<(String, f64)>,
    pub(super) warnings: Vec<String>,
    /// What the live analysis found of its quality; none for stacks that are analyzed without it.
    pub(super) quality: Option<Quality>,
}

impl Prepared {
    /// Checks settings against a source.
    pub(super) fn new(settings: AnalysisSettings, source: Source) -> Result<Self, AppError> {
        let mut warnings = Vec::new();
        let mut engine = engine_settings(&settings, &source)?;
        let registered = registered(&settings, &source)?;
        engine.registration = registered.as_ref().map(|registered| registered.settings);
        warnings.extend(registered.iter().flat_map(|registered| registered.warnings.clone()));
        let registration = registered.map(|registered| registered.text);
        let grid = engine.checked_grid().map_err(AppError::usage)?;
        if let Some(sigma_px) = settings.psf_sigma_px {
            Psf::gaussian(sigma_px).map_err(|error| unlike_a_psf(&error))?;
        }
        let species = species(&settings, &source, &mut warnings)?;
        let matrix = mixing(&settings, &source, &species)?;
        let pixel_pitch_nm = settings.pixel_pitch_nm.or(source.pixel_pitch_nm).unwrap_or_else(|| {
            warnings.push(format!(
                "The files do not say how large a camera pixel is in the sample; {PAPER_PITCH_NM} nm is assumed. \
                 Give --pixel-nm to change it."
            ));
            PAPER_PITCH_NM
        });
        Ok(Self { settings, source, engine, grid, matrix, species, pixel_pitch_nm, warnings, registration })
    }

    /// Runs the analysis on frames that `read` supplies, see [`feed`].
    pub(super) fn run<T: Count + Default>(
        self,
        read: impl FnMut(u64, &mut [Vec<T>]) -> Result<usize, AppError> + Send,
    ) -> Result<Analysis, AppError> {
        let Source { height, width, frames, .. } = self.source;
        let mut engine = CumulantEngine::<T>::new(self.engine.clone(), height, width).map_err(|error| {
            AppError::Data(format!("{}: {error}; export a larger region", self.source.inputs[0].1))
        })?;
        let begun = Instant::now();
        let mut progress = Progress::begin("cumulants", frames);
        let trace_every = frames.div_ceil(TRACE_POINTS);
        let fed = feed(&mut engine, height * width, trace_every, read, |frames| progress.advance(frames));
        progress.finish();
        let feed = fed.map_err(|error| match error {
            FeedError::Source(error) => error,
            FeedError::Push(error) => AppError::data(error),
        })?;
        self.finish(&engine, feed, begun.elapsed())
    }

    /// The images of an engine that has had all its exposures; `took` is the time that they needed.
    pub(super) fn finish<T: Count>(
        self,
        engine: &CumulantEngine<T>,
        feed: Feed,
        took: Duration,
    ) -> Result<Analysis, AppError> {
        let drawing = engine.draw(&AllCores, Incomplete::AtLeastHalf).ok_or_else(|| {
            AppError::Data(
                "no subsequence has half of its exposures; choose a shorter --subsequence".to_owned(),
            )
        })?;
        let mut steps = vec![("cumulants".to_owned(), took.as_secs_f64())];
        self.check_fluctuations(&drawing)?;
        let begun = Instant::now();
        let (stages, widths) = self.stages(&drawing)?;
        steps.push(("unmixing, flattening, linearization".to_owned(), begun.elapsed().as_secs_f64()));
        let mut warnings = self.warnings.clone();
        warnings.extend(subsequence_warnings(&self.engine, &feed, &drawing));
        Ok(Analysis { prepared: self, drawing, stages, feed, widths, steps, warnings, quality: None })
    }

    /// Refuses cameras whose pixels never change.
    fn check_fluctuations(&self, drawing: &Drawing) -> Result<(), AppError> {
        for ((variance, mean), (role, path, _)) in
            drawing.variances.iter().zip(&drawing.means).zip(&self.source.inputs)
        {
            if variance.iter().all(|&variance| variance <= 0.0) {
                let count = mean.iter().fold(f32::NEG_INFINITY, |most, &value| most.max(value));
                return Err(AppError::Data(format!(
                    "{role} {path}: no pixel ever changes (counts up to {count}), so there is nothing to analyze; \
                     check that the camera was not dark, saturated or frozen"
                )));
            }
        }
        Ok(())
    }

    /// Everything after the cumulants.
    pub(super) fn stages(&self, drawing: &Drawing) -> Result<(Option<Stages>, Vec<Width>), AppError> {
        let Some(matrix) = &self.matrix else { return Ok((None, Vec::new())) };
        let widths = self.widths(drawing, matrix);
        let linearization = widths
            .iter()
            .map(|width| {
                Ok(LinearizationSettings {
                    psf: Psf::gaussian(width.sigma_px).map_err(|error| unlike_a_psf(&error))?,
                    iterations: self.settings.iterations,
                    acceleration: self.settings.acceleration,
                    reconvolution: self.settings.reconvolution,
                })
            })
            .collect::<Result<Vec<_>, AppError>>()?;
        let chain = ChainSettings {
            matrix: matrix.clone(),
            method: self.settings.unmixing.clone(),
            flattening: if self.settings.distance_factor {
                FlatteningKind::DistanceFactor
            } else {
                FlatteningKind::EqualMeans
            },
            linearization,
        };
        let stages = reconstruct(drawing, &self.grid, &chain).map_err(AppError::data)?;
        Ok((Some(stages), widths))
    }

    /// The width of each species' point-spread function in camera pixels: given, from optics, or from the data.
    pub(super) fn widths(&self, drawing: &Drawing, matrix: &UnmixingMatrix) -> Vec<Width> {
        let aperture = self.settings.numerical_aperture;
        let from_optics = |emission_nm: f64| 0.21 * emission_nm / aperture / self.pixel_pitch_nm;
        let kappa: Vec<_> = drawing.cumulants.iter().map(|image| image.view()).collect();
        self.species
            .iter()
            .enumerate()
            .map(|(index, species)| {
                if let Some(sigma_px) = self.settings.psf_sigma_px {
                    return Width { sigma_px, source: "given".to_owned() };
                }
                if let Some(emission_nm) = species.emission_nm {
                    let source = format!("NA {aperture}, {emission_nm} nm emission");
                    return Width { sigma_px: from_optics(emission_nm), source };
                }
                let unmixed = matrix.unmix(&kappa).ok().map(|mut images| images.swap_remove(index));
                let estimate = unmixed.and_then(|i| estimate_sigma(&i, &self.grid.squared_distances()).ok());
                match estimate.filter(|sigma| (0.3..5.0).contains(sigma)) {
                    Some(sigma_px) => Width { sigma_px, source: "from the sub-grids of the data".to_owned() },
                    None => {
                        let source = format!("NA {aperture}, {ASSUMED_EMISSION_NM} nm emission assumed");
                        Width { sigma_px: from_optics(ASSUMED_EMISSION_NM), source }
                    }
                }
            })
            .collect()
    }
}

fn engine_settings(settings: &AnalysisSettings, source: &Source) -> Result<CumulantSettings, AppError> {
    let frames = source.frames;
    if frames < 2 {
        return Err(AppError::Data(format!(
            "{} has {frames} frame; cumulants need a time series of at least 2, in practice some hundred",
            source.inputs[0].1
        )));
    }
    let subsequence = settings.subsequence.unwrap_or(PAPER_SUBSEQUENCE.min(frames));
    if subsequence > frames {
        return Err(AppError::Usage(format!(
            "a subsequence of {subsequence} exposures is longer than the {frames} frames of {}; \
             choose --subsequence {frames} or less",
            source.inputs[0].1
        )));
    }
    Ok(CumulantSettings {
        combinations: settings.combinations,
        lags: settings.lags.clone(),
        ..CumulantSettings::new(settings.order, source.inputs.len(), subsequence)
    })
}

/// The species to unmix: those named, those that the source knows, or one unnamed one behind a single camera.
fn species(
    settings: &AnalysisSettings,
    source: &Source,
    warnings: &mut Vec<String>,
) -> Result<Vec<Species>, AppError> {
    if settings.species.is_empty() {
        if let Some(species) = &source.species {
            return Ok(species.clone());
        }
        if source.inputs.len() == 1 {
            return Ok(vec![Species::new("sample", 0.0).map_err(AppError::usage)?]);
        }
        warnings.push(
            "No dyes were named, so nothing was unmixed: give --species and --dichroic for species images."
                .to_owned(),
        );
        return Ok(Vec::new());
    }
    let Some(dichroic) = &settings.dichroic else {
        if source.inputs.len() == 1 && settings.species.len() == 1 {
            let catalogue = Catalogue::built_in();
            let dye = catalogue.fluorophore(&settings.species[0]).map_err(AppError::usage)?;
            let one = Species::new(dye.name(), 0.0).map_err(AppError::usage)?;
            return Ok(vec![Species { emission_nm: dye.emission_nm(), ..one }]);
        }
        let known: Vec<_> = Catalogue::built_in().dichroics().iter().map(|d| d.name().to_owned()).collect();
        return Err(AppError::Usage(format!(
            "species were named without the dichroic between the cameras; give --dichroic, one of: {}",
            known.join(", ")
        )));
    };
    Catalogue::built_in().species(&settings.species, dichroic).map_err(AppError::usage)
}

fn mixing(
    settings: &AnalysisSettings,
    source: &Source,
    species: &[Species],
) -> Result<Option<UnmixingMatrix>, AppError> {
    match (source.inputs.len(), species.len()) {
        (_, 0) => Ok(None),
        (1, 1) => {
            let name = [species[0].name.clone()];
            let all_light = array![[1.0]];
            let matrix = UnmixingMatrix::from_proportions(settings.order, &name, &all_light);
            matrix.map(Some).map_err(AppError::usage)
        }
        (1, several) => Err(AppError::Usage(format!(
            "{several} species cannot be told apart with one camera; give the transmission stack as well, \
             or name one species"
        ))),
        _ => UnmixingMatrix::new(settings.order, species)
            .map(Some)
            .map_err(|error| inseparable(&error, settings.dichroic.as_deref())),
    }
}

fn unlike_a_psf(error: &PsfError) -> AppError {
    AppError::Usage(format!(
        "the point-spread function: {error}; check psf_sigma_px, or pixel_pitch_nm and numerical_aperture"
    ))
}

/// The error of the unmixing with what can be done about it.
fn inseparable(error: &UnmixingError, dichroic: Option<&str>) -> AppError {
    AppError::Usage(match error {
        UnmixingError::TooManySpecies { species, spectral_channels } => format!(
            "{species} species cannot be told apart by {spectral_channels} spectral channels; \
             choose --order {} or name at most {spectral_channels}",
            species - 1
        ),
        UnmixingError::Indistinguishable { .. } => {
            let behind = dichroic.map_or(String::new(), |name| format!(" behind {name}"));
            format!("{error}{behind}; name only one of them or use another dichroic")
        }
        other => other.to_string(),
    })
}

/// What the reader must know about subsequences that were left out or counted in part.
fn subsequence_warnings(engine: &CumulantSettings, feed: &Feed, drawing: &Drawing) -> Vec<String> {
    let mut warnings = Vec::new();
    let excluded: u64 = feed.closed.iter().filter(|run| !run.used).map(|run| run.samples).sum();
    let rest = feed.exposures % engine.subsequence;
    if excluded > 0 {
        warnings.push(format!(
            "{excluded} frames are in subsequences with too many lost exposures and do not count."
        ));
    }
    if rest > 0 && drawing.incomplete_samples > 0 {
        warnings.push(format!(
            "The last subsequence has {rest} of {} exposures and counts with that weight.",
            engine.subsequence
        ));
    } else if rest > 0 {
        warnings.push(format!(
            "The last {rest} frames are less than half a subsequence of {} and do not count.",
            engine.subsequence
        ));
    }
    warnings
}
