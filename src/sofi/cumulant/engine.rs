//! The engine: exposures in, subsequence after subsequence, one bounded state.

use super::binned::{self, Binning, Canvas, CoarseImages};
use super::drawing::{Drawing, Images, Incomplete, PixelMask, expand};
use super::finalize::{add_results, result_planes};
use super::kernel::{Count, Planes};
use super::layout::Layout;
use super::moments::RunMoments;
use super::plan::Plan;
use super::registered::{Registered, TRANSMITTED};
use super::settings::{CumulantSettings, SettingsError};
use super::workers::Workers;
use crate::sofi::registration::{RegistrationSettings, TransformError};
use std::collections::VecDeque;

/// One exposure of all channels.
#[derive(Debug, Clone, Copy)]
pub struct Exposure<'a, T> {
    /// Exposures since the cameras were armed; rises from one to the next, gaps are exposures that were lost.
    pub index: u64,
    /// One row-major image of counts per channel, in the order R, T.
    pub planes: &'a [&'a [T]],
}

/// What became of one subsequence when it closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunSummary {
    /// Number of the subsequence.
    pub run: u64,
    /// Samples that it had.
    pub samples: u64,
    /// Whether it counts in the result: it has at least half of its exposures.
    pub used: bool,
}

/// Why exposures were refused; none of them has changed the state.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PushError {
    /// Exposures must come in the order of time.
    #[error("exposure {index} came after exposure {next} was expected; exposures must rise")]
    Order {
        /// Index that came.
        index: u64,
        /// Smallest index that would have fitted.
        next: u64,
    },
    /// The number of channels or of pixels differs from the settings.
    #[error("exposure {index} does not have {channels} channels of {width} x {height} pixels")]
    Shape {
        /// Index of the exposure.
        index: u64,
        /// Channels wanted.
        channels: usize,
        /// Height wanted, pixels.
        height: usize,
        /// Width wanted, pixels.
        width: usize,
    },
}

/// Why two states cannot become one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MergeError {
    /// The states were made with different settings, sizes or masks.
    #[error("the two states differ in settings, image size or masks")]
    Settings,
    /// The other state does not continue this one.
    #[error("the state to add begins at exposure {begin}, before the {end} at which this one ends")]
    Order {
        /// First exposure of the state to add.
        begin: u64,
        /// One past the last exposure of this state.
        end: u64,
    },
}

/// Running cumulants of a stream of exposures.
#[derive(Debug, Clone)]
pub struct CumulantEngine<T> {
    settings: CumulantSettings,
    plan: Plan,
    layout: Layout,
    registered: Option<Registered>,
    masks: Vec<PixelMask>,
    /// The subsequence that the stream entered in its middle; complete only after a merge with what came before.
    head: Option<RunMoments>,
    open: Option<RunMoments>,
    spare: Option<RunMoments>,
    /// Summed results per band, each subsequence weighted by its share of exposures.
    results: Vec<Vec<f32>>,
    used: Used,
    next: u64,
    recent: VecDeque<(u64, Vec<Vec<T>>)>,
    earliest: Vec<(u64, Vec<Vec<T>>)>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Used {
    runs: u64,
    samples: u64,
    incomplete_samples: u64,
}

impl<T: Count> CumulantEngine<T> {
    /// An empty state for images of `height` x `width` pixels.
    ///
    /// # Errors
    /// [`SettingsError`] when the settings cannot be used for images of this size.
    pub fn new(settings: CumulantSettings, height: usize, width: usize) -> Result<Self, SettingsError> {
        let grid = settings.checked_grid()?;
        if height < 4 || width < 4 {
            return Err(SettingsError::Size { height, width, order: settings.order });
        }
        let plan = Plan::new(&grid, settings.channels, &settings.relative_lags());
        let layout = Layout::new(height, width);
        for maps in settings.cameras.iter().flatten() {
            let (made_for, frames) = (maps.size(), [height, width]);
            if made_for != frames {
                return Err(SettingsError::MapSize { made_for, frames });
            }
        }
        let registered = settings.registration.as_ref().map(|wanted| registered(wanted, &settings, &layout));
        let mut engine = Self {
            registered: registered.transpose()?,
            masks: Vec::new(),
            head: None,
            open: None,
            spare: None,
            results: layout.zeroed(result_planes(&plan)),
            used: Used::default(),
            next: settings.first_exposure,
            recent: VecDeque::new(),
            earliest: Vec::new(),
            settings,
            plan,
            layout,
        };
        let masks = (0..engine.settings.channels).map(|channel| engine.settings.camera(channel)?.mask());
        engine.set_masks(masks.collect());
        Ok(engine)
    }

    /// Leaves masked pixels out of everything drawn from now on: what needs one of them is NaN.
    ///
    /// They take the place of those of the camera maps.
    /// Masks are of the cameras' own pixels, also of a camera that is registered onto the other.
    ///
    /// # Panics
    /// When there is not one mask per channel, or a mask has not the size of the images.
    pub fn set_masks(&mut self, masks: Vec<PixelMask>) {
        let size = (self.layout.height, self.layout.width);
        assert_eq!(masks.len(), self.settings.channels, "one mask per channel");
        assert!(masks.iter().flatten().all(|mask| mask.dim() == size), "masks of the images' size");
        self.masks = masks;
        if let Some(registered) = &self.registered {
            self.masks[TRANSMITTED] = registered.missing(self.masks[TRANSMITTED].as_ref());
        }
    }

    /// The settings of this engine.
    #[must_use]
    pub fn settings(&self) -> &CumulantSettings {
        &self.settings
    }

    /// The smallest exposure index that [`push`](Self::push) takes next.
    #[must_use]
    pub fn next_exposure(&self) -> u64 {
        self.next
    }

    /// Bytes of all sums and images held; does not grow with the number of exposures.
    #[must_use]
    pub fn state_bytes(&self) -> usize {
        let moments = [&self.head, &self.open, &self.spare].into_iter().flatten().map(RunMoments::bytes);
        let results = self.results.iter().map(|band| band.len() * size_of::<f32>());
        let frames = self.recent.iter().chain(&self.earliest).flat_map(|(_, planes)| planes);
        moments.chain(results).chain(frames.map(|plane| plane.len() * size_of::<T>())).sum()
    }

    /// Adds exposures in the order of time; returns the subsequences that closed.
    ///
    /// # Errors
    /// [`PushError`] when indices do not rise or an exposure has the wrong shape; then nothing is added.
    pub fn push(
        &mut self,
        workers: &impl Workers,
        exposures: &[Exposure<'_, T>],
    ) -> Result<Vec<RunSummary>, PushError> {
        self.check(exposures)?;
        let mut closed = Vec::new();
        let length = self.settings.subsequence;
        for run in exposures.chunk_by(|a, b| a.index / length == b.index / length) {
            self.enter_run(workers, run[0].index / length, &mut closed);
            self.add_to_open(workers, run);
            self.next = run[run.len() - 1].index + 1;
            if let Some(open) = &mut self.open {
                open.end = self.next;
            }
            if self.next.is_multiple_of(length) {
                self.close(workers, &mut closed);
            }
        }
        Ok(closed)
    }

    /// Draws the cumulants averaged over subsequences; `None` when no subsequence can be used yet.
    #[must_use]
    pub fn draw(&self, workers: &impl Workers, incomplete: Incomplete) -> Option<Drawing> {
        let mut results = self.results.clone();
        let mut used = self.used;
        for run in [&self.head, &self.open].into_iter().flatten() {
            if self.is_usable(run, incomplete) {
                self.add_run(workers, run, &mut results, &mut used);
            }
        }
        if used.samples == 0 {
            return None;
        }
        let weight = used.samples as f64 / self.settings.subsequence as f64;
        let Images { cumulants, means, variances } =
            expand(&self.plan, &self.layout, &self.masks, &results, weight);
        let Used { runs, samples, incomplete_samples } = used;
        Some(Drawing { cumulants, means, variances, runs, samples, incomplete_samples })
    }

    /// Draws with squares of camera pixels averaged, for a quick look at a large camera; see [`draw`](Self::draw).
    #[must_use]
    pub fn draw_binned(
        &self,
        workers: &impl Workers,
        incomplete: Incomplete,
        binning: Binning,
    ) -> Option<Drawing> {
        let open: Vec<&RunMoments> = [&self.head, &self.open]
            .into_iter()
            .flatten()
            .filter(|run| self.is_usable(run, incomplete))
            .collect();
        let mut used = self.used;
        open.iter().for_each(|run| self.count_run(run, &mut used));
        if used.samples == 0 {
            return None;
        }
        let weight = used.samples as f64 / self.settings.subsequence as f64;
        let canvas = Canvas {
            plan: &self.plan,
            layout: &self.layout,
            masks: &self.masks,
            binning,
            scale: (1.0 / weight) as f32,
        };
        let CoarseImages { cumulants, means, variances } = binned::draw(&canvas, workers, |band, sums| {
            sums.clone_from(&self.results[band]);
            for run in &open {
                add_results(&self.plan, &self.layout, run, self.weight_of(run), band, sums);
            }
        });
        let Used { runs, samples, incomplete_samples } = used;
        Some(Drawing { cumulants, means, variances, runs, samples, incomplete_samples })
    }

    /// Adds the state of a later part of the same stream, as if its exposures had been pushed here.
    ///
    /// # Errors
    /// [`MergeError`] when settings differ or the other state begins before this one ends.
    pub fn merge(&mut self, workers: &impl Workers, later: &Self) -> Result<Vec<RunSummary>, MergeError> {
        self.check_merge(later)?;
        let mut closed = Vec::new();
        let first = later.settings.first_exposure / self.settings.subsequence;
        let beyond_first = later.next / self.settings.subsequence > first;
        if let Some(head) = later.first_run() {
            self.enter_run(workers, first, &mut closed);
            self.add_samples_across(workers, later);
            let open = self.open.as_mut().expect("enter_run opens a subsequence");
            open.merge(head, workers, &self.plan, &self.layout);
        }
        if beyond_first {
            self.close(workers, &mut closed);
            self.open = later.open.clone().filter(|open| open.run > first);
        }
        self.next = later.next;
        self.add_results_of(later);
        self.remember_frames_of(later);
        Ok(closed)
    }

    fn check(&self, exposures: &[Exposure<'_, T>]) -> Result<(), PushError> {
        let (height, width) = (self.layout.height, self.layout.width);
        let mut next = self.next;
        for exposure in exposures {
            let index = exposure.index;
            if index < next {
                return Err(PushError::Order { index, next });
            }
            let channels = self.settings.channels;
            let fits = |plane: &&[T]| plane.len() == height * width;
            if exposure.planes.len() != channels || !exposure.planes.iter().all(fits) {
                return Err(PushError::Shape { index, channels, height, width });
            }
            next = index + 1;
        }
        Ok(())
    }

    /// Makes the given subsequence the open one, closing an older one.
    fn enter_run(&mut self, workers: &impl Workers, run: u64, closed: &mut Vec<RunSummary>) {
        if self.open.as_ref().is_some_and(|open| open.run != run) {
            self.close(workers, closed);
        }
        if self.open.is_none() {
            let begin = (run * self.settings.subsequence).max(self.settings.first_exposure);
            let (plan, layout, longest) = (&self.plan, &self.layout, self.settings.subsequence);
            let new = || RunMoments::new(plan, layout, longest, self.registered.as_ref());
            let mut moments = self.spare.take().unwrap_or_else(new);
            moments.restart(run, begin);
            self.open = Some(moments);
        }
    }

    fn close(&mut self, workers: &impl Workers, closed: &mut Vec<RunSummary>) {
        let Some(run) = self.open.take() else { return };
        if run.begin % self.settings.subsequence != 0 {
            self.head = Some(run);
            return;
        }
        let used = self.is_usable(&run, Incomplete::AtLeastHalf);
        if used {
            let mut results = std::mem::take(&mut self.results);
            let mut counts = self.used;
            self.add_run(workers, &run, &mut results, &mut counts);
            (self.results, self.used) = (results, counts);
        }
        closed.push(RunSummary { run: run.run, samples: run.samples, used });
        self.spare = Some(run);
    }

    /// Whether a subsequence has enough samples to count.
    fn is_usable(&self, run: &RunMoments, incomplete: Incomplete) -> bool {
        let at_least = match incomplete {
            Incomplete::Any => 2,
            Incomplete::AtLeastHalf => self.settings.subsequence.div_ceil(2).max(2),
        };
        run.samples + self.settings.lag_span() >= at_least && run.samples >= 2
    }

    fn add_run(&self, workers: &impl Workers, run: &RunMoments, results: &mut [Vec<f32>], used: &mut Used) {
        let weight = self.weight_of(run);
        workers.for_each(results, |band, sums| {
            add_results(&self.plan, &self.layout, run, weight, band, sums);
        });
        self.count_run(run, used);
    }

    /// The share of its exposures that a subsequence has.
    fn weight_of(&self, run: &RunMoments) -> f64 {
        run.samples as f64 / self.settings.subsequence as f64
    }

    fn count_run(&self, run: &RunMoments, used: &mut Used) {
        used.runs += 1;
        used.samples += run.samples;
        if run.samples + self.settings.lag_span() < self.settings.subsequence {
            used.incomplete_samples += run.samples;
        }
    }

    fn add_to_open(&mut self, workers: &impl Workers, exposures: &[Exposure<'_, T>]) {
        if self.settings.lag_span() == 0 {
            let samples: Vec<Planes<'_, T>> =
                exposures.iter().map(|exposure| exposure.planes.to_vec()).collect();
            if let Some(open) = &mut self.open {
                open.add(workers, &self.plan, &self.layout, &samples);
            }
            return;
        }
        let recent = std::mem::take(&mut self.recent);
        let kept: Vec<(u64, Vec<&[T]>)> = recent.iter().map(as_slices).collect();
        let pushed = exposures.iter().map(|exposure| (exposure.index, exposure.planes.to_vec()));
        let stream: Vec<(u64, Vec<&[T]>)> = kept.into_iter().chain(pushed).collect();
        self.add_lagged(workers, &stream, recent.len());
        self.recent = recent;
        self.remember(exposures);
    }

    /// Adds every sample whose last exposure stands at `first_new` or later in the stream.
    fn add_lagged(&mut self, workers: &impl Workers, stream: &[(u64, Vec<&[T]>)], first_new: usize) {
        let span = self.settings.lag_span() as usize;
        let length = self.settings.subsequence;
        let samples: Vec<Planes<'_, T>> = stream
            .windows(span + 1)
            .enumerate()
            .filter(|(start, _)| start + span >= first_new)
            .map(|(_, window)| window)
            .filter(|window| window[span].0 - window[0].0 == span as u64)
            .filter(|window| window[span].0 / length == window[0].0 / length)
            .map(|window| self.plan.lags.iter().flat_map(|&lag| window[lag as usize].1.clone()).collect())
            .collect();
        if let Some(open) = &mut self.open {
            open.add(workers, &self.plan, &self.layout, &samples);
        }
    }

    /// Keeps the exposures that samples across the next block, or a merge with earlier ones, will need.
    fn remember(&mut self, exposures: &[Exposure<'_, T>]) {
        let span = self.settings.lag_span() as usize;
        let owned = |exposure: &Exposure<'_, T>| {
            (exposure.index, exposure.planes.iter().map(|plane| plane.to_vec()).collect::<Vec<_>>())
        };
        let missing = span.saturating_sub(self.earliest.len());
        self.earliest.extend(exposures.iter().take(missing).map(owned));
        let last = exposures.len().saturating_sub(span);
        self.recent.extend(exposures[last..].iter().map(owned));
        self.recent.drain(..self.recent.len().saturating_sub(span));
    }

    fn check_merge(&self, later: &Self) -> Result<(), MergeError> {
        let same_start =
            CumulantSettings { first_exposure: self.settings.first_exposure, ..later.settings.clone() };
        if same_start != self.settings || later.layout != self.layout || later.masks != self.masks {
            return Err(MergeError::Settings);
        }
        let (begin, end) = (later.settings.first_exposure, self.next);
        if begin < end { Err(MergeError::Order { begin, end }) } else { Ok(()) }
    }

    /// The subsequence in which this state's stream begins, if it is not yet among the results.
    fn first_run(&self) -> Option<&RunMoments> {
        let first = self.settings.first_exposure / self.settings.subsequence;
        self.head.as_ref().or(self.open.as_ref().filter(|open| open.run == first))
    }

    fn add_samples_across(&mut self, workers: &impl Workers, later: &Self) {
        if self.settings.lag_span() == 0 {
            return;
        }
        let recent = std::mem::take(&mut self.recent);
        let stream: Vec<(u64, Vec<&[T]>)> = recent.iter().chain(&later.earliest).map(as_slices).collect();
        let across = self.settings.lag_span() as usize;
        let new = recent.len();
        // Windows inside the later state are already in its sums: only those that begin here are new.
        let end = stream.len().min(new + across);
        self.add_lagged(workers, &stream[..end], new);
        self.recent = recent;
    }

    fn add_results_of(&mut self, later: &Self) {
        for (ours, theirs) in self.results.iter_mut().zip(&later.results) {
            ours.iter_mut().zip(theirs).for_each(|(ours, theirs)| *ours += theirs);
        }
        self.used.runs += later.used.runs;
        self.used.samples += later.used.samples;
        self.used.incomplete_samples += later.used.incomplete_samples;
    }

    fn remember_frames_of(&mut self, later: &Self) {
        let span = self.settings.lag_span() as usize;
        self.recent.extend(later.recent.iter().cloned());
        self.recent.drain(..self.recent.len().saturating_sub(span));
        let missing = span.saturating_sub(self.earliest.len());
        self.earliest.extend(later.earliest.iter().take(missing).cloned());
    }
}

/// The registration made ready, if it is for frames of this size.
fn registered(
    wanted: &RegistrationSettings,
    settings: &CumulantSettings,
    layout: &Layout,
) -> Result<Registered, SettingsError> {
    let (made_for, frames) = (wanted.transform.size, [layout.height, layout.width]);
    if made_for != frames {
        return Err(TransformError::Size { made_for, frames }.into());
    }
    Ok(Registered::new(wanted, settings.order, settings.camera(TRANSMITTED))?)
}

fn as_slices<T>((index, planes): &(u64, Vec<Vec<T>>)) -> (u64, Vec<&[T]>) {
    (*index, planes.iter().map(Vec::as_slice).collect())
}
