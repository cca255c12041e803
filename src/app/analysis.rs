//! One analysis from the first frame to the last image, for files, the simulator and the demo alike.

use super::AppError;
use super::camera_maps::{MapsPlace, UsedMaps, used_maps};
use super::mixing::{contradiction_warnings, dyes, mixing, species};
use super::progress::Progress;
use super::registering::registered;
use super::widths::{Width, unlike_a_psf};
use crate::config::AnalysisSettings;
use crate::reconstruction::{
    AllCores, ChainSettings, Feed, FeedError, FlatteningKind, Quality, Stages, feed, finish_species, unmix,
};
use crate::sofi::cumulant::{Count, CumulantEngine, CumulantSettings, Drawing, Incomplete};
use crate::sofi::grid::VirtualPixelGrid;
use crate::sofi::linearization::LinearizationSettings;
use crate::sofi::psf::Psf;
use crate::sofi::psf_width::MeasuredWidth;
use crate::sofi::spectra::Species;
use crate::sofi::unmixing::UnmixingMatrix;
use sofiscope_hal::Region;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Exposures per subsequence in the paper (2000 frames in 10 runs).
const PAPER_SUBSEQUENCE: u64 = 200;

/// Pixel pitch of the paper's microscope, nanometers.
const PAPER_PITCH_NM: f64 = 108.0;

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
    /// What else the source knows of its cameras and dyes.
    pub(super) calibrations: Calibrations,
}

/// Calibrations that a source knows, beside its registration.
#[derive(Debug, Clone, Default)]
pub(super) struct Calibrations {
    /// Maps of the pixels of each camera; empty for none.
    pub(super) camera_maps: Vec<Option<MapsPlace>>,
    /// The part of the sensor that is read, of R and T, where known.
    pub(super) regions: [Option<Region>; 2],
    /// Text of measured shares of the dyes' light.
    pub(super) response: Option<String>,
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
    /// Maps of the pixels of each camera that are used; empty for none.
    pub(super) camera_maps: Vec<Option<UsedMaps>>,
    /// Text of the measured shares of the dyes' light that are used.
    pub(super) response: Option<String>,
    /// Width of the point-spread function of R and T on beads, camera pixels.
    pub(super) bead_widths: Option<[f64; 2]>,
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
    /// The same measured in the sub-grids of the data, where they are clear, whether it was used or not.
    pub(super) measured: Vec<Option<MeasuredWidth>>,
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
        let camera_maps = used_maps(&settings, &source)?;
        engine.cameras =
            camera_maps.iter().map(|used| used.as_ref().map(|used| Arc::clone(&used.maps))).collect();
        let registered = registered(&settings, &source, &camera_maps)?;
        engine.registration = registered.as_ref().map(|registered| registered.settings);
        warnings.extend(registered.iter().flat_map(|registered| registered.warnings.clone()));
        let bead_widths = registered.as_ref().and_then(|registered| registered.psf_sigma_px);
        let registration = registered.map(|registered| registered.text);
        let grid = engine.checked_grid().map_err(AppError::usage)?;
        if let Some(sigma_px) = settings.psf_sigma_px {
            Psf::gaussian(sigma_px).map_err(|error| unlike_a_psf(&error))?;
        }
        let (catalogue, response) = dyes(&settings, &source)?;
        let species = species(&settings, &source, &catalogue, &mut warnings)?;
        let matrix = mixing(&settings, &source, &species)?;
        let pixel_pitch_nm = settings.pixel_pitch_nm.or(source.pixel_pitch_nm).unwrap_or_else(|| {
            warnings.push(format!(
                "The files do not say how large a camera pixel is in the sample; {PAPER_PITCH_NM} nm is assumed. \
                 Give --pixel-nm to change it."
            ));
            PAPER_PITCH_NM
        });
        Ok(Self {
            settings,
            source,
            engine,
            grid,
            matrix,
            species,
            pixel_pitch_nm,
            warnings,
            registration,
            camera_maps,
            response,
            bead_widths,
        })
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
        let measured = self.measured_widths(&drawing, stages.as_ref());
        steps.push(("unmixing, flattening, linearization".to_owned(), begun.elapsed().as_secs_f64()));
        let mut warnings = self.warnings.clone();
        warnings.extend(subsequence_warnings(&self.engine, &feed, &drawing));
        warnings.extend(contradiction_warnings(&self, &drawing)?);
        warnings.extend(self.width_warnings(&measured));
        Ok(Analysis {
            prepared: self,
            drawing,
            stages,
            feed,
            widths,
            measured,
            steps,
            warnings,
            quality: None,
        })
    }

    /// Refuses cameras whose pixels never change.
    fn check_fluctuations(&self, drawing: &Drawing) -> Result<(), AppError> {
        for ((variance, mean), (role, path, _)) in
            drawing.variances.iter().zip(&drawing.means).zip(&self.source.inputs)
        {
            if !variance.iter().any(|&variance| variance > 0.0) {
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
        let unmixed = unmix(drawing, matrix, &self.settings.unmixing).map_err(AppError::data)?;
        let widths = self.widths(drawing, matrix, &unmixed);
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
        let seen: Vec<f64> = widths.iter().map(|width| width.seen_px).collect();
        let stages = finish_species(unmixed, &self.grid, &chain, &seen).map_err(AppError::data)?;
        Ok((Some(stages), widths))
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
