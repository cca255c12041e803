//! Bleaching: an exponential through the mean counts.
//!
//! In: mean counts against exposures. Out: [`Bleaching`]. Never: grows with the number of exposures.
//! Fails: `None` for traces that do not fall clearly.
//!
//! `I(t) = A exp(-t / tau) + C`. For every `tau` of a logarithmic grid, `A` and `C` follow by linear least squares
//! (variable projection; Golub and Pereyra 1973), and the grid is refined around the best.
//! Several dyes that bleach differently fall in no single exponential; the fit is then an average.
//! Blinking makes neighboring exposures alike, which looks like a trend; means of blocks are fitted, as these are
//! independent of each other where a block is longer than a blink.

/// Most points of a trace.
const MOST_POINTS: usize = 512;

/// Most blocks that are fitted.
const MOST_BLOCKS: usize = 48;

/// Grid points of the time constant, per refinement.
const GRID: usize = 60;

/// An exponential must explain this many times the variance that chance would give it.
const CLEARLY: f64 = 12.0;

/// A trace of bounded length: when it is full, neighbors are averaged and every point spans twice as much.
#[derive(Debug, Clone)]
pub struct BinnedTrace {
    width: u64,
    /// Bin, sum of values and number of values.
    bins: Vec<(u64, f64, f64)>,
}

impl Default for BinnedTrace {
    fn default() -> Self {
        Self { width: 1, bins: Vec::with_capacity(MOST_POINTS) }
    }
}

impl BinnedTrace {
    /// Adds the value of an exposure; exposures rise, some may be missing.
    pub fn push(&mut self, exposure: u64, value: f64) {
        let bin = exposure / self.width;
        match self.bins.last_mut() {
            Some((last, sum, count)) if *last == bin => (*sum, *count) = (*sum + value, *count + 1.0),
            _ => self.bins.push((bin, value, 1.0)),
        }
        if self.bins.len() == MOST_POINTS {
            self.coarsen();
        }
    }

    /// Middle of each bin, exposures, and its mean.
    #[must_use]
    pub fn points(&self) -> Vec<(f64, f64)> {
        let middle = |bin: u64| bin as f64 * self.width as f64 + (self.width - 1) as f64 / 2.0;
        self.bins.iter().map(|&(bin, sum, count)| (middle(bin), sum / count)).collect()
    }

    fn coarsen(&mut self) {
        self.width *= 2;
        let fine = std::mem::replace(&mut self.bins, Vec::with_capacity(MOST_POINTS));
        for (bin, sum, count) in fine {
            match self.bins.last_mut() {
                Some(last) if last.0 == bin / 2 => (last.1, last.2) = (last.1 + sum, last.2 + count),
                _ => self.bins.push((bin / 2, sum, count)),
            }
        }
    }
}

/// What does not bleach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Offset {
    /// Counts of camera and background, known.
    Known(f64),
    /// Found by the fit; needs a trace over about a time constant or more.
    Fitted,
}

/// An exponential decay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bleaching {
    /// Exposures until half of the signal is gone.
    pub half_time: f64,
    /// Shortest and longest half-time that fit nearly as well (one standard deviation); infinite if unbounded.
    pub half_time_range: [f64; 2],
    /// Counts of signal, without the offset, at the first point.
    pub signal: f64,
    /// Counts that do not bleach.
    pub offset: f64,
    /// Signal at the last point over that at the first.
    pub left: f64,
}

/// Fits an exponential to points of time and counts, times rising.
#[must_use]
pub fn fit_bleaching(points: &[(f64, f64)], offset: Offset) -> Option<Bleaching> {
    let (first, last) = (points.first()?.0, points.last()?.0);
    let span = last - first;
    let points = &block_means(points)[..];
    if points.len() < 6 || span <= 0.0 {
        return None;
    }
    let freedom = points.len() as f64 - if offset == Offset::Fitted { 3.0 } else { 2.0 };
    let fit = |tau: f64| Line::fit(points, first, tau, offset);
    let (mut low, mut high) = (span / 100.0, span * 30.0);
    let mut best = low;
    for _ in 0..4 {
        let ratio = (high / low).powf(1.0 / (GRID - 1) as f64);
        let grid = (0..GRID).map(|step| low * ratio.powi(step as i32));
        best = grid.min_by(|a, b| fit(*a).residual.total_cmp(&fit(*b).residual))?;
        (low, high) = ((best / ratio).max(span / 100.0), (best * ratio).min(span * 30.0));
    }
    let line = fit(best);
    let variance = line.residual / freedom;
    let flat = flat_residual(points);
    let explained = (flat - line.residual) / (freedom.min(2.0) * variance).max(f64::MIN_POSITIVE);
    if line.slope <= 0.0 || explained < CLEARLY {
        return None;
    }
    let is_near = |tau: f64| fit(tau).residual <= line.residual + variance;
    let edge = |step: f64| {
        let mut tau = best;
        while is_near(tau) && (span / 1000.0..span * 300.0).contains(&tau) {
            tau *= step;
        }
        tau
    };
    let (shortest, longest) = (edge(0.98), edge(1.02));
    let half = std::f64::consts::LN_2;
    let longest = if longest < span * 300.0 { longest } else { f64::INFINITY };
    if offset == Offset::Fitted && longest.is_infinite() {
        // A slow decay to an unknown offset may be any decay to any offset.
        return None;
    }
    Some(Bleaching {
        half_time: best * half,
        half_time_range: [shortest * half, longest * half],
        signal: line.slope,
        offset: line.offset,
        left: (-span / best).exp(),
    })
}

/// Means of neighbors, at most [`MOST_BLOCKS`].
fn block_means(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mean = |block: &[(f64, f64)]| {
        let count = block.len() as f64;
        let (times, counts) = block.iter().fold((0.0, 0.0), |sum, point| (sum.0 + point.0, sum.1 + point.1));
        (times / count, counts / count)
    };
    points.chunks(points.len().div_ceil(MOST_BLOCKS).max(1)).map(mean).collect()
}

fn flat_residual(points: &[(f64, f64)]) -> f64 {
    let mean = points.iter().map(|point| point.1).sum::<f64>() / points.len() as f64;
    points.iter().map(|point| (point.1 - mean).powi(2)).sum()
}

/// `counts = slope * exp(-t / tau) + offset` for one `tau`.
struct Line {
    slope: f64,
    offset: f64,
    residual: f64,
}

impl Line {
    fn fit(points: &[(f64, f64)], first: f64, tau: f64, offset: Offset) -> Self {
        let decay = |time: f64| (-(time - first) / tau).exp();
        let count = points.len() as f64;
        let (mut x_mean, mut y_mean) = (0.0, 0.0);
        if offset == Offset::Fitted {
            x_mean = points.iter().map(|&(time, _)| decay(time)).sum::<f64>() / count;
            y_mean = points.iter().map(|&(_, counts)| counts).sum::<f64>() / count;
        } else if let Offset::Known(known) = offset {
            y_mean = known;
        }
        let (mut xx, mut xy) = (0.0, 0.0);
        for &(time, counts) in points {
            let x = decay(time) - x_mean;
            xx += x * x;
            xy += x * (counts - y_mean);
        }
        let slope = xy / xx.max(f64::MIN_POSITIVE);
        let offset = y_mean - slope * x_mean;
        let residual =
            points.iter().map(|&(time, counts)| (counts - offset - slope * decay(time)).powi(2)).sum();
        Self { slope, offset, residual }
    }
}

#[cfg(test)]
mod tests {
    use super::super::frc::tests::noise;
    use super::*;

    fn trace(tau: f64, amplitude: f64, offset: f64, noise_level: f64) -> Vec<(f64, f64)> {
        let noise = noise(64, 1);
        let mut trace = BinnedTrace::default();
        for (exposure, noise) in noise.iter().enumerate() {
            let decay = (-(exposure as f64) / tau).exp();
            trace.push(exposure as u64, amplitude * decay + offset + noise_level * f64::from(*noise));
        }
        trace.points()
    }

    #[test]
    fn a_known_exponential_is_found_with_and_without_its_offset() {
        let points = trace(1500.0, 50.0, 110.0, 5.0);
        assert!(points.len() < MOST_POINTS);
        for offset in [Offset::Known(110.0), Offset::Fitted] {
            let found = fit_bleaching(&points, offset).unwrap();
            let half_time = 1500.0 * std::f64::consts::LN_2;
            assert!((found.half_time / half_time - 1.0).abs() < 0.05, "{found:?}");
            let [shortest, longest] = found.half_time_range;
            assert!(shortest < found.half_time && found.half_time < longest && longest < 1.2 * half_time);
            assert!((found.offset - 110.0).abs() < 2.0 && (found.signal - 50.0).abs() < 2.0, "{found:?}");
            assert!((found.left - (-4095.0_f64 / 1500.0).exp()).abs() < 0.01, "{found:?}");
        }
    }

    #[test]
    fn a_trace_that_does_not_fall_has_no_half_time() {
        assert_eq!(fit_bleaching(&trace(1e12, 50.0, 110.0, 5.0), Offset::Fitted), None);
        assert_eq!(fit_bleaching(&trace(1500.0, -50.0, 110.0, 5.0), Offset::Fitted), None);
        assert_eq!(fit_bleaching(&[], Offset::Fitted), None);
        assert_eq!(fit_bleaching(&[(1.0, 2.0); 9], Offset::Fitted), None);
    }

    #[test]
    fn blinking_is_not_taken_for_bleaching() {
        // Neighbors are alike over some exposures, and nothing falls: 400 exposures, 40 times.
        let traces = 40;
        let white: Vec<f32> = noise(128, 2).into_iter().collect();
        let found = (0..traces).filter(|trace| {
            let mut alike = 0.0;
            let points: Vec<(f64, f64)> = (0..400)
                .map(|exposure| {
                    alike = 0.6 * alike + f64::from(white[trace * 400 + exposure]);
                    (exposure as f64, 110.0 + 3.0 * alike)
                })
                .collect();
            fit_bleaching(&points, Offset::Fitted).is_some()
        });
        assert!(found.count() <= 1);
    }

    #[test]
    fn a_long_trace_keeps_its_means_in_bounded_memory() {
        let mut trace = BinnedTrace::default();
        (0..100_000).for_each(|exposure| trace.push(exposure, exposure as f64));
        let points = trace.points();
        assert!(points.len() < MOST_POINTS);
        assert!(points.iter().take(points.len() - 1).all(|(time, value)| (time - value).abs() < 1e-6));
    }
}
