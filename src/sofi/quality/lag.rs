//! Do both cameras see the same exposures? Blinking must be seen by both at lag zero.
//!
//! In: per exposure and camera, the means of blocks of pixels. Out: [`LagCorrelation`].
//! Never: pairs across a gap of exposures, keeps more than the exposures within the longest lag.
//! Fails: what chance could give is not called a shift.
//!
//! `c(l) = sum_b Cov(R_b(t), T_b(t + l)) / sqrt(sum_b Var R_b sum_b Var T_b)`, over blocks `b`, about the means of
//! each subsequence, so that bleaching does not correlate. Its standard error for traces that are white and
//! independent is `sqrt(sum_b Var R_b Var T_b / N) / sqrt(sum_b Var R_b sum_b Var T_b)` (Bartlett 1935).

use std::collections::VecDeque;

/// Longest lag either way, exposures.
pub const LONGEST_LAG: usize = 3;
const LAGS: usize = 2 * LONGEST_LAG + 1;

/// A peak below this many standard errors may be chance.
const CLEARLY: f64 = 5.0;

/// Correlation of the cameras against the exposures by which T is late.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LagCorrelation {
    /// Correlations for T late by `-3..=3` exposures.
    pub correlations: [f64; LAGS],
    /// Standard error of each where there is nothing in common.
    pub standard_error: f64,
}

impl LagCorrelation {
    /// The lag of the highest correlation, `-3..=3` exposures; positive when T shows later what R showed.
    #[must_use]
    pub fn peak(&self) -> i32 {
        let highest = (0..LAGS).max_by(|&a, &b| self.correlations[a].total_cmp(&self.correlations[b]));
        highest.map_or(0, |lag| lag as i32 - LONGEST_LAG as i32)
    }

    /// How far the peak stands above the next highest correlation, in standard errors of such a difference.
    #[must_use]
    pub fn significance(&self) -> f64 {
        let mut sorted = self.correlations;
        sorted.sort_by(f64::total_cmp);
        (sorted[LAGS - 1] - sorted[LAGS - 2]) / (self.standard_error * std::f64::consts::SQRT_2)
    }

    /// Whether the cameras are in step: `Some(true)` for a clear peak at zero, `Some(false)` for one elsewhere.
    #[must_use]
    pub fn in_step(&self) -> Option<bool> {
        (self.significance() >= CLEARLY).then(|| self.peak() == 0)
    }
}

/// Running sums of one block.
#[derive(Debug, Clone, Copy, Default)]
struct BlockSums {
    products: [f64; LAGS],
    /// Sums over the exposures that have a partner at each lag, for the means.
    reflected: [f64; LAGS],
    transmitted: [f64; LAGS],
    squares: [f64; 2],
    sums: [f64; 2],
}

/// One exposure of all blocks.
#[derive(Debug, Clone)]
struct Moment {
    exposure: u64,
    blocks: [Vec<f64>; 2],
}

/// Correlates while exposures come.
#[derive(Debug, Clone)]
pub struct LagCorrelator {
    recent: VecDeque<Moment>,
    /// First values of the subsequence, subtracted so that offsets cost no precision.
    reference: [Vec<f64>; 2],
    open: Vec<BlockSums>,
    pairs: [u64; LAGS],
    samples: u64,
    covariances: [f64; LAGS],
    variances: [f64; 2],
    variance_products: f64,
    total: u64,
}

impl LagCorrelator {
    /// Sums for this many blocks.
    #[must_use]
    pub fn new(blocks: usize) -> Self {
        Self {
            recent: VecDeque::with_capacity(LONGEST_LAG + 1),
            reference: [vec![0.0; blocks], vec![0.0; blocks]],
            open: vec![BlockSums::default(); blocks],
            pairs: [0; LAGS],
            samples: 0,
            covariances: [0.0; LAGS],
            variances: [0.0; 2],
            variance_products: 0.0,
            total: 0,
        }
    }

    /// Adds one exposure: means of the blocks of R and of T; exposures rise.
    ///
    /// # Panics
    /// When there are other numbers of blocks.
    pub fn push(&mut self, exposure: u64, blocks: [&[f64]; 2]) {
        assert!(blocks.iter().all(|blocks| blocks.len() == self.open.len()), "one value per block");
        if self.samples == 0 {
            self.reference = blocks.map(<[f64]>::to_vec);
        }
        while self.recent.len() > LONGEST_LAG
            || self.recent.front().is_some_and(|old| old.exposure + (LONGEST_LAG as u64) < exposure)
        {
            self.recent.pop_front();
        }
        let relative = |camera: usize| {
            blocks[camera].iter().zip(&self.reference[camera]).map(|(value, reference)| value - reference)
        };
        let now = Moment { exposure, blocks: [relative(0).collect(), relative(1).collect()] };
        for (block, sums) in self.open.iter_mut().enumerate() {
            for camera in 0..2 {
                let value = now.blocks[camera][block];
                sums.sums[camera] += value;
                sums.squares[camera] += value * value;
            }
        }
        self.samples += 1;
        // Lag l pairs R(t) with T(t + l): for l > 0 the older moment gives R.
        self.pair(&now, &now, LONGEST_LAG);
        let recent = std::mem::take(&mut self.recent);
        for old in &recent {
            let lag = (exposure - old.exposure) as usize;
            self.pair(old, &now, LONGEST_LAG + lag);
            self.pair(&now, old, LONGEST_LAG - lag);
        }
        self.recent = recent;
        self.recent.push_back(now);
    }

    fn pair(&mut self, reflected: &Moment, transmitted: &Moment, lag: usize) {
        self.pairs[lag] += 1;
        let values = reflected.blocks[0].iter().zip(&transmitted.blocks[1]);
        for (sums, (r, t)) in self.open.iter_mut().zip(values) {
            sums.products[lag] += r * t;
            sums.reflected[lag] += r;
            sums.transmitted[lag] += t;
        }
    }

    /// Ends a subsequence: its covariances about its own means are added to those before.
    pub fn close(&mut self) {
        if self.samples > LONGEST_LAG as u64 + 1 {
            let count = self.samples as f64;
            for sums in &self.open {
                let mut variances = [0.0; 2];
                for (camera, variance) in variances.iter_mut().enumerate() {
                    *variance = sums.squares[camera] / count - (sums.sums[camera] / count).powi(2);
                    self.variances[camera] += count * *variance;
                }
                self.variance_products += count * variances[0] * variances[1];
                for lag in (0..LAGS).filter(|&lag| self.pairs[lag] > 0) {
                    let pairs = self.pairs[lag] as f64;
                    let means = (sums.reflected[lag] / pairs) * (sums.transmitted[lag] / pairs);
                    self.covariances[lag] += count * (sums.products[lag] / pairs - means);
                }
            }
            self.total += self.samples;
        }
        self.open.fill(BlockSums::default());
        self.pairs = [0; LAGS];
        self.samples = 0;
        self.recent.clear();
    }

    /// The correlation over all closed subsequences; `None` while there is none, or where nothing varies.
    #[must_use]
    pub fn correlation(&self) -> Option<LagCorrelation> {
        let scale = (self.variances[0] * self.variances[1]).sqrt();
        if self.total == 0 || !(scale.is_finite() && scale > 0.0) {
            return None;
        }
        let correlations = self.covariances.map(|covariance| covariance / scale);
        // Variances are summed with their exposures as weight: one factor N goes for the mean over them.
        let standard_error = self.variance_products.sqrt() / scale;
        Some(LagCorrelation { correlations, standard_error })
    }
}

#[cfg(test)]
mod tests {
    use super::super::frc::tests::noise;
    use super::*;

    /// R sees blinking and its own noise, T the same `late` exposures later, on top of bleaching.
    fn correlated(late: i32, common: f32, gap: Option<u64>) -> LagCorrelation {
        let (blinking, own) = (noise(128, 1), [noise(128, 2), noise(128, 3)]);
        let mut correlator = LagCorrelator::new(16);
        for exposure in 10..110_u64 {
            if gap.is_some_and(|gap| exposure % 20 == gap) {
                continue;
            }
            let value = |camera: usize, block: usize| {
                let shown = exposure as i32 - late * camera as i32;
                let bleaching = 1000.0 * (-(exposure as f64) / 60.0).exp();
                let light =
                    common * blinking[[shown as usize, block]] + own[camera][[exposure as usize, block]];
                1e4 + bleaching + f64::from(light)
            };
            let blocks = [0, 1].map(|camera| (0..16).map(|block| value(camera, block)).collect::<Vec<_>>());
            correlator.push(exposure, [&blocks[0], &blocks[1]]);
            if (exposure + 1) % 10 == 0 {
                correlator.close();
            }
        }
        correlator.correlation().unwrap()
    }

    #[test]
    fn blinking_that_both_cameras_see_peaks_at_lag_zero() {
        let found = steady(0, 1.0, None);
        assert_eq!((found.peak(), found.in_step()), (0, Some(true)), "{found:?}");
        assert!((found.correlations[LONGEST_LAG] - 0.5).abs() < 0.05, "{found:?}");
    }

    #[test]
    fn a_camera_that_is_late_or_early_is_found() {
        for late in [-3, -1, 1, 2] {
            let found = steady(late, 1.0, Some(7));
            assert_eq!((found.peak(), found.in_step()), (late, Some(false)), "{found:?}");
        }
    }

    #[test]
    fn nothing_in_common_says_nothing_and_the_standard_error_is_right() {
        let found = steady(0, 0.0, None);
        assert_eq!(found.in_step(), None, "{found:?}");
        let worst = found.correlations.iter().fold(0.0_f64, |worst, c| worst.max(c.abs()));
        assert!(worst < 4.0 * found.standard_error && found.standard_error < 0.05, "{found:?}");
        assert_eq!(LagCorrelator::new(3).correlation(), None);
    }

    #[test]
    fn steep_bleaching_does_not_move_the_peak() {
        assert_eq!(correlated(0, 30.0, None).peak(), 0);
        assert_eq!(correlated(1, 30.0, None).peak(), 1);
    }

    /// As [`correlated`], without bleaching and with one long subsequence.
    fn steady(late: i32, common: f32, gap: Option<u64>) -> LagCorrelation {
        let (blinking, own) = (noise(128, 1), [noise(128, 2), noise(128, 3)]);
        let mut correlator = LagCorrelator::new(100);
        for exposure in (10..110_u64).filter(|exposure| gap.is_none_or(|gap| exposure % 20 != gap)) {
            let value = |camera: usize, block: usize| {
                let shown = (exposure as i32 - late * camera as i32) as usize;
                let light = common * blinking[[shown, block]] + own[camera][[exposure as usize, block]];
                1e4 + f64::from(light)
            };
            let blocks = [0, 1].map(|camera| (0..100).map(|block| value(camera, block)).collect::<Vec<_>>());
            correlator.push(exposure, [&blocks[0], &blocks[1]]);
        }
        correlator.close();
        correlator.correlation().unwrap()
    }
}
