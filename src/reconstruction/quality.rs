//! How good the live result is so far: a central part of the frames, through an engine of its own.
//!
//! In: the exposures of the live analysis. Out: a [`Quality`] after each subsequence that closed and counts.
//! Never: grows with the number of exposures, looks at more than the central part of large frames.
//! Fails: [`QualityError`] before the first exposure; [`PushError`] for exposures that do not fit.
//!
//! Each subsequence is summed by itself, so that its images can be compared with those of the others; only
//! running sums over subsequences stay. One more engine on a quarter of a million fine pixels at most costs
//! little beside that of the whole camera.

use super::AllCores;
use crate::pipeline::Publisher;
use crate::sofi::cumulant::{
    CumulantEngine, CumulantSettings, Drawing, Exposure, Incomplete, PushError, SettingsError,
};
use crate::sofi::flattening::{Flattening, PsfWidth, flatten};
use crate::sofi::quality::{
    BinnedTrace, FourierRingCorrelation, LagCorrelation, LagCorrelator, Offset, RunningImage,
    balance_sub_grids, fit_bleaching, fourier_ring_correlation, subsequences_for_resolution,
    subsequences_for_signal_to_noise,
};
use crate::sofi::unmixing::UnmixingMatrix;
use ndarray::Array2;
use serde::Serialize;
use std::ops::Range;
use std::time::Duration;

/// Side of the part that is looked at, camera pixels, unless asked otherwise.
pub const CENTRAL_SIDE: usize = 256;

/// Side of the blocks whose traces are correlated between the cameras, camera pixels.
const BLOCK_SIDE: usize = 8;

/// How quality is watched.
#[derive(Debug, Clone)]
pub struct QualitySettings {
    /// The cumulants, as the live analysis computes them.
    pub cumulants: CumulantSettings,
    /// Height of the frames, camera pixels.
    pub height: usize,
    /// Width of the frames, camera pixels.
    pub width: usize,
    /// Longest side of the central part that is looked at, camera pixels.
    pub central_side: usize,
    /// Dyes, if images per species are wanted.
    pub matrix: Option<UnmixingMatrix>,
    /// Counts at which a pixel is saturated.
    pub saturation_counts: u16,
    /// Counts that do not bleach (camera offset and background) per channel, where known.
    pub offset_counts: Option<Vec<f64>>,
    /// Pixel pitch in the sample, nanometers, if known.
    pub pixel_pitch_nm: Option<f64>,
    /// Time from exposure to exposure, if known.
    pub period: Option<Duration>,
}

impl QualitySettings {
    /// For frames of this size, with nothing known of dyes, pixel pitch, time and offset.
    #[must_use]
    pub fn new(cumulants: CumulantSettings, height: usize, width: usize) -> Self {
        Self {
            cumulants,
            height,
            width,
            central_side: CENTRAL_SIDE,
            matrix: None,
            saturation_counts: u16::MAX,
            offset_counts: None,
            pixel_pitch_nm: None,
            period: None,
        }
    }
}

/// Why quality cannot be watched.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum QualityError {
    /// The cumulant settings, or the size of the central part, cannot be used.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The dyes do not belong to these cumulants.
    #[error(
        "the unmixing is for {rows} spectral channels of order {order}, not for those of these cumulants"
    )]
    Matrix {
        /// Spectral channels of the matrix.
        rows: usize,
        /// Order of the matrix.
        order: usize,
    },
    /// There is not one offset per channel.
    #[error("{given} offsets were given for {channels} channels")]
    Offsets {
        /// Offsets given.
        given: usize,
        /// Channels.
        channels: usize,
    },
}

/// Quality after a number of subsequences; `None` wherever the data cannot tell yet.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Quality {
    /// Subsequences that count.
    pub subsequences: u64,
    /// Exposures in them.
    pub exposures: u64,
    /// Exposures per subsequence.
    pub subsequence_exposures: u64,
    /// Signal-to-noise per spectral channel: median over the bright pixels of mean over standard error;
    /// noise alone gives about 1.6.
    pub snr_channels: Vec<Option<f64>>,
    /// The same per species (bright: above half of the 99.5th percentile); empty without dyes.
    pub snr_species: Vec<Option<f64>>,
    /// Resolution by Fourier ring correlation per species, or per spectral channel without dyes.
    pub resolution: Vec<Resolution>,
    /// Bleaching per channel, R and T.
    pub bleaching: Vec<Option<BleachingState>>,
    /// Whether both cameras see the same exposures; for two channels.
    pub lag: Option<LagCheck>,
    /// Share of the pixels, per channel, that were saturated at least once in the newest subsequence.
    pub saturated_share: Vec<f64>,
    /// Pixels per channel that did not change at all in the newest subsequence.
    pub dead_pixels: Vec<u64>,
}

/// The finest detail on which both halves of the subsequences agree.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Resolution {
    /// Camera pixels.
    pub camera_px: Option<f64>,
    /// Nanometers, if the pixel pitch is known.
    pub nm: Option<f64>,
    /// Whether both halves agree down to two fine pixels, so that the resolution is at least as good as it says.
    pub is_pixel_limited: bool,
    /// The correlation, on the fine grid; left out of reports for its length.
    #[serde(skip)]
    pub curve: Option<FourierRingCorrelation>,
}

/// How the light of one camera bleaches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BleachingState {
    /// Exposures until half of the signal is gone.
    pub half_time_exposures: f64,
    /// Seconds until then, if the period is known.
    pub half_time_s: Option<f64>,
    /// One standard deviation below and above, exposures; no upper bound is `null` in reports.
    pub half_time_range_exposures: [f64; 2],
    /// Signal now over signal at the begin.
    pub left: f64,
}

/// Correlation of both cameras against the lag of T.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LagCheck {
    /// Lag of the highest correlation, -3 to 3 exposures; must be 0.
    pub peak: i32,
    /// How far it stands above the next, standard errors.
    pub significance: f64,
    /// Whether the cameras are in step, where the data can tell.
    pub in_step: Option<bool>,
    /// Correlations for T late by -3 to 3 exposures.
    pub correlations: [f64; 7],
}

impl From<LagCorrelation> for LagCheck {
    fn from(found: LagCorrelation) -> Self {
        let (peak, significance, in_step) = (found.peak(), found.significance(), found.in_step());
        Self { peak, significance, in_step, correlations: found.correlations }
    }
}

impl Quality {
    /// Exposures still needed until every species (spectral channel without dyes) has this signal-to-noise.
    ///
    /// By the square root law, with bleaching where it was found; `None` when it is never reached.
    #[must_use]
    pub fn exposures_for_snr(&self, wanted: f64) -> Option<u64> {
        let all = if self.snr_species.is_empty() { &self.snr_channels } else { &self.snr_species };
        let half_times = self.bleaching.iter().flatten().map(|bleaching| bleaching.half_time_exposures);
        let constant = half_times
            .reduce(f64::min)
            .map(|half_time| half_time / std::f64::consts::LN_2 / self.subsequence_exposures as f64);
        self.still(
            all.iter()
                .map(|snr| subsequences_for_signal_to_noise((*snr)?, self.subsequences, wanted, constant)),
        )
    }

    /// Exposures still needed until every image is resolved to this many camera pixels; `None` when that is
    /// never reached or nothing can be said yet.
    #[must_use]
    pub fn exposures_for_resolution(&self, wanted_camera_px: f64, order: usize) -> Option<u64> {
        let wanted = wanted_camera_px * order as f64;
        self.still(self.resolution.iter().map(|resolution| {
            subsequences_for_resolution(resolution.curve.as_ref()?, self.subsequences, wanted)
        }))
    }

    fn still(&self, subsequences: impl Iterator<Item = Option<u64>>) -> Option<u64> {
        let slowest = subsequences.collect::<Option<Vec<u64>>>()?.into_iter().max()?;
        Some((slowest - self.subsequences) * self.subsequence_exposures)
    }
}

/// Watches the quality of a stream of exposures.
#[derive(Debug)]
pub struct QualityMonitor {
    settings: QualitySettings,
    rows: Range<usize>,
    columns: Range<usize>,
    engine: CumulantEngine<u16>,
    open: Option<u64>,
    distances: Array2<f64>,
    /// The central part of a block of exposures, channel by channel.
    central: Vec<Vec<u16>>,
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
    pub fn new(settings: QualitySettings) -> Result<Self, QualityError> {
        let grid = settings.cumulants.checked_grid()?;
        let channels = settings.cumulants.channels;
        let rows = central(settings.height, settings.central_side);
        let columns = central(settings.width, settings.central_side);
        let engine = CumulantEngine::new(settings.cumulants.clone(), rows.len(), columns.len())?;
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
        let blocks = rows.len().div_ceil(BLOCK_SIDE) * columns.len().div_ceil(BLOCK_SIDE);
        let species = settings.matrix.as_ref().map_or(0, |matrix| matrix.species().len());
        let pixels = rows.len() * columns.len();
        let fine = (settings.cumulants.order * rows.len(), settings.cumulants.order * columns.len());
        Ok(Self {
            engine,
            open: None,
            distances: grid.squared_distances(),
            central: vec![Vec::new(); channels],
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
                for y in self.rows.clone() {
                    let row = y * width + self.columns.start..y * width + self.columns.end;
                    to.extend_from_slice(&exposure.planes[channel][row]);
                }
            }
        }
    }

    /// Traces, blocks and saturation of one exposure's central part.
    fn look_at(&mut self, exposure: &Exposure<'_, u16>) {
        let blocks: Vec<Vec<f64>> =
            exposure.planes.iter().map(|plane| block_means(plane, self.columns.len())).collect();
        for (plane, trace) in exposure.planes.iter().zip(&mut self.traces) {
            let sum: u64 = plane.iter().map(|&count| u64::from(count)).sum();
            trace.push(exposure.index, sum as f64 / plane.len() as f64);
        }
        if let [reflected, transmitted] = &blocks[..] {
            self.lag.push(exposure.index, [reflected, transmitted]);
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
            resolution: images.iter().map(|image| self.resolution(image)).collect(),
            bleaching: (0..self.traces.len()).map(|channel| self.bleaching(channel)).collect(),
            lag: self.lag.correlation().map(LagCheck::from),
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
        Resolution { camera_px, nm, is_pixel_limited, curve }
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

/// Sub-grid by sub-grid times its factor.
fn scaled(image: &Array2<f32>, scales: &Array2<f64>) -> Array2<f32> {
    let (n, _) = scales.dim();
    Array2::from_shape_fn(image.dim(), |(y, x)| image[[y, x]] * scales[[y % n, x % n]] as f32)
}

/// The middle of a side, at most this long.
fn central(side: usize, longest: usize) -> Range<usize> {
    let length = side.min(longest);
    let start = (side - length) / 2;
    start..start + length
}

/// Means of blocks of pixels, row by row; those at the lower and right border may be smaller.
fn block_means(plane: &[u16], width: usize) -> Vec<f64> {
    let across = width.div_ceil(BLOCK_SIDE);
    let mut means = Vec::with_capacity(across * plane.len().div_ceil(width * BLOCK_SIDE));
    for rows in plane.chunks(width * BLOCK_SIDE) {
        let mut sums = vec![0_u64; across];
        for row in rows.chunks(width) {
            for (sum, part) in sums.iter_mut().zip(row.chunks(BLOCK_SIDE)) {
                *sum += u64::from(part.iter().map(|&count| u32::from(count)).sum::<u32>());
            }
        }
        let height = rows.len() / width;
        let pixels = |block: usize| height * BLOCK_SIDE.min(width - block * BLOCK_SIDE);
        means.extend(sums.iter().enumerate().map(|(block, &sum)| sum as f64 / pixels(block) as f64));
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_central_part_lies_in_the_middle() {
        assert_eq!(central(2048, 256), 896..1152);
        assert_eq!(central(72, 256), 0..72);
    }

    #[test]
    fn blocks_at_the_border_are_means_too() {
        let plane: Vec<u16> = (0..90).map(|pixel| if pixel % 9 < 8 { 10 } else { 20 }).collect();
        assert_eq!(block_means(&plane, 9), [10.0, 20.0, 10.0, 20.0]);
    }
}
