//! How good the live result is so far: a central part of the frames, through an engine of its own.
//!
//! In: the exposures of the live analysis. Out: a [`Quality`] after each subsequence that closed and counts.
//! Never: grows with the number of exposures, looks at more than the central part of large frames.
//! Fails: [`QualityError`] before the first exposure; [`PushError`] for exposures that do not fit.
//!
//! Each subsequence is summed by itself, so that its images can be compared with those of the others; only
//! running sums over subsequences stay. One more engine on a quarter of a million fine pixels at most costs
//! little beside that of the whole camera.

mod blocks;
mod drift;
mod findings;
mod noise;
mod partner;
mod settings;

pub use drift::{CameraDrift, MOST_DRIFT_PX};
pub use findings::{BleachingState, LagCheck, Quality, Resolution};
pub use settings::{QualityError, QualitySettings};

use super::AllCores;
use crate::pipeline::Publisher;
use crate::sofi::camera::CameraMaps;
use crate::sofi::cumulant::{
    CumulantEngine, CumulantSettings, Drawing, Exposure, Incomplete, PushError, SettingsError,
};
use crate::sofi::flattening::{Flattening, PsfWidth, flatten};
use crate::sofi::quality::{
    BinnedTrace, FourierRingCorrelation, LagCorrelator, Offset, RunningImage, balance_sub_grids,
    decorrelation, fit_bleaching, fourier_ring_correlation,
};
use blocks::{block_means, central};
use drift::DriftWatch;
use ndarray::Array2;
use noise::blinking_to_noise;
use partner::Partner;
use std::ops::Range;
use std::sync::Arc;

/// Side of the part that is looked at, camera pixels, unless asked otherwise.
pub const CENTRAL_SIDE: usize = 256;

/// Watches the quality of a stream of exposures.
#[derive(Debug)]
pub struct QualityMonitor {
    settings: QualitySettings,
    rows: Range<usize>,
    columns: Range<usize>,
    /// The part of the other camera that shows the same, where cameras do not come aligned.
    partner: Option<Partner>,
    /// For two cameras.
    drift: Option<DriftWatch>,
    engine: CumulantEngine<u16>,
    open: Option<u64>,
    distances: Array2<f64>,
    /// The central part of a block of exposures, channel by channel, 0 for pixels that are left out.
    central: Vec<Vec<u16>>,
    /// Pixels of each channel's central part that are left out.
    left_out: Vec<Vec<usize>>,
    channels: Vec<RunningImage>,
    species: Vec<RunningImage>,
    exposures: u64,
    traces: Vec<BinnedTrace>,
    lag: LagCorrelator,
    saturated: Vec<Vec<bool>>,
    history: Vec<Quality>,
    publisher: Option<Publisher<Option<Quality>>>,
}

impl QualityMonitor {
    /// Nothing seen yet.
    ///
    /// # Errors
    /// [`QualityError`] for settings that cannot be used.
    pub fn new(mut settings: QualitySettings) -> Result<Self, QualityError> {
        let grid = settings.cumulants.checked_grid()?;
        let channels = settings.cumulants.channels;
        let rows = central(settings.height, settings.central_side);
        let columns = central(settings.width, settings.central_side);
        let partner = Partner::of(&mut settings.cumulants, &rows, &columns)?;
        let begin_of = |channel: usize| match &partner {
            Some(partner) if channel == Partner::CHANNEL => partner.begin,
            _ => [rows.start, columns.start],
        };
        let left_out = crop_maps(&mut settings.cumulants, begin_of, [rows.len(), columns.len()])?;
        let engine = CumulantEngine::new(settings.cumulants.clone(), rows.len(), columns.len())?;
        let registration = settings.cumulants.registration.as_ref().map(|found| found.transform);
        let drift = (channels == 2).then(|| DriftWatch::new(registration, [rows.len(), columns.len()]));
        if let Some(matrix) = &settings.matrix {
            let (rows, order) = (matrix.spectral_channels(), matrix.order());
            let fits = order == settings.cumulants.order
                && rows.last().is_some_and(|last| last.iter().all(|&channel| channel + 1 == channels));
            if !fits {
                return Err(QualityError::Matrix { rows: rows.len(), order });
            }
        }
        if let Some(offsets) = &settings.offset_counts
            && offsets.len() != channels
        {
            return Err(QualityError::Offsets { given: offsets.len(), channels });
        }
        let blocks = rows.len().div_ceil(blocks::SIDE) * columns.len().div_ceil(blocks::SIDE);
        let species = settings.matrix.as_ref().map_or(0, |matrix| matrix.species().len());
        let pixels = rows.len() * columns.len();
        let fine = (settings.cumulants.order * rows.len(), settings.cumulants.order * columns.len());
        Ok(Self {
            engine,
            open: None,
            distances: grid.squared_distances(),
            central: vec![Vec::new(); channels],
            left_out,
            channels: Vec::new(),
            species: (0..species).map(|_| RunningImage::new(fine)).collect(),
            exposures: 0,
            traces: vec![BinnedTrace::default(); channels],
            lag: LagCorrelator::new(blocks),
            saturated: vec![vec![false; pixels]; channels],
            history: Vec::new(),
            publisher: None,
            settings,
            rows,
            columns,
            partner,
            drift,
        })
    }

    /// The same, telling a viewer the newest quality after each subsequence.
    #[must_use]
    pub fn publishing(mut self, publisher: Publisher<Option<Quality>>) -> Self {
        self.publisher = Some(publisher);
        self
    }

    /// Adds exposures in the order of time, frames of the whole camera.
    ///
    /// # Errors
    /// [`PushError`] for exposures that do not rise or have another shape.
    pub fn push(&mut self, exposures: &[Exposure<'_, u16>]) -> Result<(), PushError> {
        let length = self.settings.cumulants.subsequence;
        for run in exposures.chunk_by(|a, b| a.index / length == b.index / length) {
            let number = run[0].index / length;
            if self.open.is_some_and(|open| open != number) {
                self.close();
            }
            if self.open.is_none() {
                self.begin(number);
            }
            self.add(run)?;
            if self.engine.next_exposure().is_multiple_of(length) {
                self.close();
            }
        }
        Ok(())
    }

    /// The newest quality; none before the first subsequence has closed.
    #[must_use]
    pub fn newest(&self) -> Option<&Quality> {
        self.history.last()
    }

    /// Quality after each subsequence.
    #[must_use]
    pub fn into_history(self) -> Vec<Quality> {
        self.history
    }

    fn begin(&mut self, number: u64) {
        let first_exposure = number * self.settings.cumulants.subsequence;
        let settings = CumulantSettings { first_exposure, ..self.settings.cumulants.clone() };
        self.engine = CumulantEngine::new(settings, self.rows.len(), self.columns.len())
            .expect("the same settings were taken before");
        self.open = Some(number);
        self.saturated.iter_mut().for_each(|pixels| pixels.fill(false));
    }

    /// Adds exposures of one subsequence.
    fn add(&mut self, run: &[Exposure<'_, u16>]) -> Result<(), PushError> {
        self.check(run)?;
        let mut central = std::mem::take(&mut self.central);
        self.crop(run, &mut central);
        let pixels = self.rows.len() * self.columns.len();
        let planes: Vec<Vec<&[u16]>> = (0..run.len())
            .map(|frame| central.iter().map(|plane| &plane[frame * pixels..(frame + 1) * pixels]).collect())
            .collect();
        let exposures: Vec<Exposure<'_, u16>> = run
            .iter()
            .zip(&planes)
            .map(|(exposure, planes)| Exposure { index: exposure.index, planes })
            .collect();
        self.engine.push(&AllCores, &exposures)?;
        for exposure in &exposures {
            self.look_at(exposure);
        }
        self.central = central;
        Ok(())
    }

    fn check(&self, run: &[Exposure<'_, u16>]) -> Result<(), PushError> {
        let QualitySettings { height, width, .. } = self.settings;
        let channels = self.settings.cumulants.channels;
        let fits = |plane: &&[u16]| plane.len() == height * width;
        match run.iter().find(|e| e.planes.len() != channels || !e.planes.iter().all(fits)) {
            Some(&Exposure { index, .. }) => Err(PushError::Shape { index, channels, height, width }),
            None => Ok(()),
        }
    }

    fn crop(&self, run: &[Exposure<'_, u16>], central: &mut [Vec<u16>]) {
        let width = self.settings.width;
        for (channel, to) in central.iter_mut().enumerate() {
            to.clear();
            for exposure in run {
                let partner = self.partner.as_ref().filter(|_| channel == Partner::CHANNEL);
                let [top, left] = partner.map_or([self.rows.start, self.columns.start], |p| p.begin);
                for y in top..top + self.rows.len() {
                    let row = y * width + left..y * width + left + self.columns.len();
                    to.extend_from_slice(&exposure.planes[channel][row]);
                }
                let begin = to.len() - self.rows.len() * self.columns.len();
                for pixel in self.left_out.get(channel).into_iter().flatten() {
                    to[begin + pixel] = 0;
                }
            }
        }
    }

    /// Traces, blocks and saturation of one exposure's central part.
    fn look_at(&mut self, exposure: &Exposure<'_, u16>) {
        let means = |(channel, plane): (usize, &&[u16])| match &self.partner {
            Some(partner) if channel == Partner::CHANNEL => {
                block_means(&partner.moved(plane), self.columns.len())
            }
            _ => block_means(plane, self.columns.len()),
        };
        let blocks: Vec<Vec<f64>> = exposure.planes.iter().enumerate().map(means).collect();
        for (channel, (plane, trace)) in exposure.planes.iter().zip(&mut self.traces).enumerate() {
            let sum: u64 = plane.iter().map(|&count| u64::from(count)).sum();
            let good = plane.len() - self.left_out.get(channel).map_or(0, Vec::len);
            trace.push(exposure.index, sum as f64 / good.max(1) as f64);
        }
        if let [reflected, transmitted] = &blocks[..] {
            self.lag.push(exposure.index, [reflected, transmitted]);
        }
        if let (Some(drift), &[reflected, transmitted]) = (&mut self.drift, exposure.planes) {
            drift.push([reflected, transmitted]);
        }
        let limit = self.settings.saturation_counts;
        for (plane, saturated) in exposure.planes.iter().zip(&mut self.saturated) {
            if plane.iter().fold(0, |highest, &count| highest.max(count)) >= limit {
                saturated.iter_mut().zip(*plane).for_each(|(is, &count)| *is |= count >= limit);
            }
        }
    }

    /// Ends the open subsequence; it counts if it has at least half of its exposures.
    fn close(&mut self) {
        self.open = None;
        self.lag.close();
        if let Some(drift) = &mut self.drift {
            drift.close();
        }
        let Some(drawing) = self.engine.draw(&AllCores, Incomplete::AtLeastHalf) else { return };
        self.exposures += drawing.samples;
        self.channels.resize_with(drawing.cumulants.len(), || RunningImage::new(drawing.cumulants[0].dim()));
        self.channels.iter_mut().zip(&drawing.cumulants).for_each(|(sums, image)| sums.push(image));
        if let Some(matrix) = &self.settings.matrix {
            let kappa: Vec<_> = drawing.cumulants.iter().map(|image| image.view()).collect();
            match matrix.unmix(&kappa) {
                Ok(images) => self.species.iter_mut().zip(&images).for_each(|(sums, image)| sums.push(image)),
                Err(error) => tracing::warn!(%error, "no quality per species"),
            }
        }
        let quality = self.assess(&drawing);
        if let Some(publisher) = &mut self.publisher {
            publisher.publish(Some(quality.clone()));
        }
        self.history.push(quality);
    }

    fn assess(&self, drawing: &Drawing) -> Quality {
        let snr = |images: &[RunningImage]| images.iter().map(RunningImage::signal_to_noise).collect();
        let images = if self.species.is_empty() { &self.channels } else { &self.species };
        let share = |pixels: &Vec<bool>| {
            pixels.iter().filter(|&&saturated| saturated).count() as f64 / pixels.len() as f64
        };
        let dead = |(variances, saturated): (&Array2<f32>, &Vec<bool>)| {
            let still = variances.iter().zip(saturated);
            still.filter(|(variance, saturated)| **variance == 0.0 && !**saturated).count() as u64
        };
        Quality {
            subsequences: self.channels.first().map_or(0, RunningImage::count),
            exposures: self.exposures,
            subsequence_exposures: self.settings.cumulants.subsequence,
            snr_channels: snr(&self.channels),
            snr_species: snr(&self.species),
            blinking_to_noise: (0..drawing.means.len())
                .map(|channel| self.blinking(drawing, channel))
                .collect(),
            resolution: images.iter().map(|image| self.resolution(image)).collect(),
            bleaching: (0..self.traces.len()).map(|channel| self.bleaching(channel)).collect(),
            lag: self.lag.correlation().map(LagCheck::from),
            drift: self.drift.as_ref().and_then(DriftWatch::newest),
            saturated_share: self.saturated.iter().map(share).collect(),
            dead_pixels: drawing.variances.iter().zip(&self.saturated).map(dead).collect(),
        }
    }

    /// Both halves are flattened by the same factors, found on the mean of all subsequences.
    fn resolution(&self, image: &RunningImage) -> Resolution {
        if image.count() < 2 {
            return Resolution::default();
        }
        let order = self.settings.cumulants.order;
        let flat = flatten(image.mean(), &self.distances, Flattening::EqualMeans(PsfWidth::Estimated));
        let scales = flat.map_or_else(|_| Array2::ones((order, order)), |(_, report)| report.scales);
        let [mut first, mut second] = image.halves().each_ref().map(|half| scaled(half, &scales));
        if let Some(scales) = balance_sub_grids(&first, &second, order) {
            (first, second) = (scaled(&first, &scales), scaled(&second, &scales));
        }
        let curve = fourier_ring_correlation(&first, &second);
        let is_pixel_limited = curve.as_ref().is_some_and(FourierRingCorrelation::reaches_limit);
        let fine = curve.as_ref().and_then(|curve| curve.resolution_px);
        let camera_px = fine.or(is_pixel_limited.then_some(2.0)).map(|fine| fine / order as f64);
        let nm = camera_px.zip(self.settings.pixel_pitch_nm).map(|(pixels, pitch)| pixels * pitch);
        let whole = decorrelation(&scaled(image.mean(), &scales));
        let decorrelation_camera_px = whole.map(|found| found.resolution_px / order as f64);
        Resolution { camera_px, nm, is_pixel_limited, decorrelation_camera_px, curve }
    }

    /// Not for a camera that is registered, as its noise is another one then.
    fn blinking(&self, drawing: &Drawing, channel: usize) -> Option<f64> {
        let maps = self.settings.cumulants.camera(channel)?;
        let is_registered = self.partner.is_some() && channel == Partner::CHANNEL;
        let (mean, variance) = (&drawing.means[channel], &drawing.variances[channel]);
        (!is_registered).then(|| blinking_to_noise(mean, variance, drawing.samples, maps)).flatten()
    }

    fn bleaching(&self, channel: usize) -> Option<BleachingState> {
        let offsets = self.settings.offset_counts.as_ref();
        let offset = offsets.map_or(Offset::Fitted, |offsets| Offset::Known(offsets[channel]));
        let found = fit_bleaching(&self.traces[channel].points(), offset)?;
        Some(BleachingState {
            half_time_exposures: found.half_time,
            half_time_s: self.settings.period.map(|period| found.half_time * period.as_secs_f64()),
            half_time_range_exposures: found.half_time_range,
            left: found.left,
        })
    }
}

/// Makes camera maps those of the central part; gives the pixels that are left out, by channel.
fn crop_maps(
    cumulants: &mut CumulantSettings,
    begin_of: impl Fn(usize) -> [usize; 2],
    size: [usize; 2],
) -> Result<Vec<Vec<usize>>, SettingsError> {
    for (channel, camera) in cumulants.cameras.iter_mut().enumerate() {
        let Some(maps) = camera else { continue };
        let too_small = SettingsError::MapSize { made_for: maps.size(), frames: size };
        *maps = Arc::new(maps.part(begin_of(channel), size).ok_or(too_small)?);
    }
    let left_out = |maps: &Arc<CameraMaps>| {
        let faults = maps.faults().iter().enumerate();
        faults.filter(|(_, fault)| **fault != 0).map(|(pixel, _)| pixel).collect()
    };
    Ok((0..cumulants.channels)
        .map(|channel| cumulants.camera(channel).map_or_else(Vec::new, left_out))
        .collect())
}

/// Sub-grid by sub-grid times its factor.
fn scaled(image: &Array2<f32>, scales: &Array2<f64>) -> Array2<f32> {
    let (n, _) = scales.dim();
    Array2::from_shape_fn(image.dim(), |(y, x)| image[[y, x]] * scales[[y % n, x % n]] as f32)
}
