//! Where a spot is on an image, to a small part of a pixel, and how much it looks like one.
//!
//! In: counts. Out: [`Measured`], every number of it finite. Never: allocates after [`SpotFinder::new`], knows of
//! cameras or time. Fails: never; without a spot there is no shape and no signal.
//!
//! The center is the fixed point of a centroid under a Gaussian weight as wide as the spot: what lies farther
//! away cannot pull it, and its noise is close to that of a fit, about σ/√photons. The background is the mean of
//! pixels near the median of the image, so it may hold no more than half of the image in spots.

#[cfg(test)]
mod tests;
mod weights;

use std::ops::Range;

use weights::Weights;

/// Pixels from which the background is estimated.
const SAMPLES: usize = 1024;
/// Steps towards the fixed point; each takes about all of the way.
const MOST_STEPS: u32 = 20;
/// A step that is no step any more, pixels.
const STILL_PX: f64 = 1e-4;
/// A spot must stand out of the noise this many times.
const SIGNIFICANT: f64 = 6.0;
/// Pixels this many deviations above the background hold light.
const LIT: f64 = 4.0;
/// Share of the light of a Gaussian within 2 σ of its center: 1 − exp(−2).
const WITHIN_2_SIGMA: f64 = 0.864_664_716_763_387_3;

/// What changes with the focus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SpotMethod {
    /// The column of the only spot.
    Centroid,
    /// The distance from a spot in the left half to one in the right half.
    TwoSpots,
}

/// What an image with spots looks like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpotForm {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Expected width of a spot (σ of a Gaussian), pixels, above zero.
    pub sigma_px: f64,
    /// Count of a saturated pixel.
    pub saturation_counts: u16,
}

/// What was found on an image; all numbers are finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// Column of the spot from the left edge of the image, or distance of the spots, pixels; 0 without a spot.
    pub signal: f64,
    /// Light within 3 σ of the spot or spots above the background, counts, never negative.
    pub light: f64,
    /// Share of the pixels above half of the maximum that are saturated.
    pub saturated: f64,
    /// 1 for a lone Gaussian of the expected width, 0 for none; less with light elsewhere, another width, or
    /// near the edge.
    pub shape: f64,
}

/// Finds spots on images of one form.
#[derive(Debug, Clone)]
pub struct SpotFinder {
    method: SpotMethod,
    form: SpotForm,
    /// Pixels that are asked for the background.
    stride: usize,
    samples: Vec<u16>,
    sums: Vec<f64>,
    weights: Weights,
}

/// Level where no light is, and its deviation.
#[derive(Debug, Clone, Copy)]
struct Background {
    level: f64,
    deviation: f64,
}

/// A spot in one part of the image.
#[derive(Debug, Clone, Copy)]
struct Spot {
    x: f64,
    light: f64,
    saturated: usize,
    bright: usize,
    shape: f64,
}

impl SpotFinder {
    /// Takes all the memory it will need.
    ///
    /// # Panics
    /// Without pixels, with less than two columns, or with a width that is not above zero and finite.
    #[must_use]
    pub fn new(method: SpotMethod, form: SpotForm) -> Self {
        let SpotForm { width, height, sigma_px, .. } = form;
        assert!(width > 1 && height > 0, "an image has pixels, in two halves");
        assert!(sigma_px > 0.0 && sigma_px.is_finite(), "a spot has a width");
        let stride = stride(width, height);
        Self {
            method,
            form,
            stride,
            samples: Vec::with_capacity((width * height).div_ceil(stride)),
            sums: vec![0.0; width.max(height)],
            weights: Weights::new(width, height),
        }
    }

    /// What is on an image.
    ///
    /// # Panics
    /// Unless there is one count for each pixel of the form.
    pub fn measure(&mut self, counts: &[u16]) -> Measured {
        let SpotForm { width, height, .. } = self.form;
        assert_eq!(counts.len(), width * height, "one count for each pixel");
        let background = self.background(counts);
        match self.method {
            SpotMethod::Centroid => {
                let spot = self.spot_in(counts, 0..width, background);
                Measured {
                    signal: if spot.shape > 0.0 { spot.x } else { 0.0 },
                    light: spot.light,
                    saturated: share(spot.saturated, spot.bright),
                    shape: spot.shape,
                }
            }
            SpotMethod::TwoSpots => {
                let left = self.spot_in(counts, 0..width / 2, background);
                let right = self.spot_in(counts, width / 2..width, background);
                let shape = left.shape.min(right.shape);
                Measured {
                    signal: if shape > 0.0 { right.x - left.x } else { 0.0 },
                    light: left.light + right.light,
                    saturated: share(left.saturated, left.bright).max(share(right.saturated, right.bright)),
                    shape,
                }
            }
        }
    }

    fn background(&mut self, counts: &[u16]) -> Background {
        self.samples.clear();
        self.samples.extend(counts.iter().step_by(self.stride));
        let last = self.samples.len() - 1;
        let (below, median, _) = self.samples.select_nth_unstable(last / 2);
        let median = f64::from(*median);
        // Spots only brighten, so the noise is told by the darker side: 16 % lie more than one deviation below.
        let low = match below.len() {
            0 => median,
            number => f64::from(*below.select_nth_unstable(number * 32 / 100).1),
        };
        let deviation = (median - low).max(0.5);
        let near = self.samples.iter().map(|&count| f64::from(count));
        let near = near.filter(|count| (count - median).abs() <= 2.5 * deviation);
        let (sum, number) = near.fold((0.0, 0.0), |(sum, number), count| (sum + count, number + 1.0));
        Background { level: sum / number, deviation }
    }

    fn spot_in(&mut self, counts: &[u16], columns: Range<usize>, background: Background) -> Spot {
        let (x, y) = self.brightest_place(counts, &columns);
        let sigma = self.form.sigma_px;
        let part = Part { counts, width: self.form.width, height: self.form.height, columns, background };
        let mut place = weights::Place { x, y };
        let mut found = self.weights.moments(&part, place, sigma);
        for _ in 0..MOST_STEPS {
            // Under a weight as wide as the spot the centroid shows half of the way.
            let step = found.offset().map(|(x, y)| (2.0 * x, 2.0 * y));
            let Some(next) = step.and_then(|step| part.moved(place, step, sigma)) else { break };
            let still = (next.x - place.x).abs().max((next.y - place.y).abs()) < STILL_PX;
            place = next;
            found = self.weights.moments(&part, place, sigma);
            if still {
                break;
            }
        }
        self.judged(&part, place, &found)
    }

    /// The middle of the brightest columns, and of the brightest rows among them.
    fn brightest_place(&mut self, counts: &[u16], columns: &Range<usize>) -> (f64, f64) {
        let (width, height) = (self.form.width, self.form.height);
        let reach = (self.form.sigma_px.ceil() as usize).clamp(1, width.max(height));
        let sums = &mut self.sums[..columns.len()];
        sums.fill(0.0);
        for line in counts.chunks_exact(width) {
            for (sum, &count) in sums.iter_mut().zip(&line[columns.clone()]) {
                *sum += f64::from(count);
            }
        }
        let x = columns.start + brightest(sums, reach);
        let near = x.saturating_sub(reach).max(columns.start)..(x + reach + 1).min(columns.end);
        let sums = &mut self.sums[..height];
        for (sum, line) in sums.iter_mut().zip(counts.chunks_exact(width)) {
            *sum = line[near.clone()].iter().map(|&count| f64::from(count)).sum();
        }
        (x as f64, brightest(sums, reach) as f64)
    }

    fn judged(&self, part: &Part<'_>, place: weights::Place, found: &weights::Moments) -> Spot {
        let SpotForm { sigma_px, saturation_counts, .. } = self.form;
        let (light, bright, saturated) = part.light_near(place, 3.0 * sigma_px, saturation_counts);
        let noise = part.background.deviation * found.squares.sqrt();
        let shape = if found.light > SIGNIFICANT * noise {
            let alone = (part.share_near(place, 2.0 * sigma_px) / WITHIN_2_SIGMA).min(1.0);
            let inside = found.weight / (std::f64::consts::TAU * sigma_px * sigma_px);
            alone * found.width_match(sigma_px) * (2.0 * inside - 1.0).clamp(0.0, 1.0)
        } else {
            0.0
        };
        Spot { x: place.x, light, saturated, bright, shape }
    }
}

/// A part of an image with all its rows.
struct Part<'a> {
    counts: &'a [u16],
    width: usize,
    height: usize,
    columns: Range<usize>,
    background: Background,
}

impl Part<'_> {
    /// A place after a step, if it is still in the part; a step is at most a width.
    fn moved(&self, place: weights::Place, (x, y): (f64, f64), sigma: f64) -> Option<weights::Place> {
        let place =
            weights::Place { x: place.x + x.clamp(-sigma, sigma), y: place.y + y.clamp(-sigma, sigma) };
        let is_inside = place.x >= self.columns.start as f64 - 0.5
            && place.x <= self.columns.end as f64 - 0.5
            && place.y >= -0.5
            && place.y <= self.height as f64 - 0.5;
        is_inside.then_some(place)
    }

    fn columns_near(&self, x: f64, reach: f64) -> Range<usize> {
        window(x, reach, self.columns.clone())
    }

    fn rows_near(&self, y: f64, reach: f64) -> Range<usize> {
        window(y, reach, 0..self.height)
    }

    fn row(&self, row: usize, columns: Range<usize>) -> &[u16] {
        &self.counts[row * self.width..][columns]
    }

    /// Light above the background near a place, pixels above half of the maximum there, saturated ones of them.
    fn light_near(&self, place: weights::Place, reach: f64, saturation: u16) -> (f64, usize, usize) {
        let columns = self.columns_near(place.x, reach);
        let rows = self.rows_near(place.y, reach);
        let (mut sum, mut greatest) = (0.0, 0);
        for row in rows.clone() {
            let line = self.row(row, columns.clone());
            sum += line.iter().map(|&count| f64::from(count)).sum::<f64>();
            greatest = line.iter().fold(greatest, |greatest, &count| greatest.max(count));
        }
        let half = f64::midpoint(f64::from(greatest), self.background.level);
        let (mut bright, mut saturated) = (0, 0);
        for row in rows.clone() {
            for &count in self.row(row, columns.clone()) {
                bright += usize::from(f64::from(count) > half);
                saturated += usize::from(count >= saturation);
            }
        }
        let pixels = (columns.len() * rows.len()) as f64;
        ((sum - pixels * self.background.level).max(0.0), bright.max(saturated), saturated)
    }

    /// Share of the light of the whole part that is near a place.
    fn share_near(&self, place: weights::Place, reach: f64) -> f64 {
        let Background { level, deviation } = self.background;
        let least = (level + LIT * deviation).clamp(0.0, f64::from(u16::MAX)) as u16;
        let lit = |line: &[u16]| -> f64 {
            // No branches, so that the compiler does many pixels at once.
            let excess = |count: u16| if count > least { f64::from(count) - level } else { 0.0 };
            line.iter().map(|&count| excess(count)).sum()
        };
        let all: f64 = (0..self.height).map(|row| lit(self.row(row, self.columns.clone()))).sum();
        let near = self.rows_near(place.y, reach).map(|row| {
            let across = reach * reach - (row as f64 - place.y).powi(2);
            lit(self.row(row, self.columns_near(place.x, across.max(0.0).sqrt())))
        });
        if all > 0.0 { near.sum::<f64>() / all } else { 0.0 }
    }
}

/// Pixels within `reach` of `center`, within `all`.
fn window(center: f64, reach: f64, all: Range<usize>) -> Range<usize> {
    let start = ((center - reach).ceil().max(0.0) as usize).clamp(all.start, all.end);
    let end = ((center + reach).floor() + 1.0).max(0.0) as usize;
    start..end.clamp(start, all.end.max(start))
}

/// The middle of the brightest stretch of `2·reach + 1` values, cut off at both ends.
fn brightest(sums: &[f64], reach: usize) -> usize {
    let stretch = |place: usize| place.saturating_sub(reach)..(place + reach + 1).min(sums.len());
    let mean = |place: usize| {
        let stretch = &sums[stretch(place)];
        stretch.iter().sum::<f64>() / stretch.len() as f64
    };
    let mut best = (0, f64::NEG_INFINITY);
    for place in 0..sums.len() {
        let mean = mean(place);
        if mean > best.1 {
            best = (place, mean);
        }
    }
    best.0
}

/// A stride through the image that meets all columns.
fn stride(width: usize, height: usize) -> usize {
    let wanted = (width * height / SAMPLES).max(1);
    (wanted..2 * wanted).find(|&stride| greatest_divisor(stride, width) == 1).unwrap_or(1)
}

fn greatest_divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { greatest_divisor(b, a % b) }
}

fn share(some: usize, all: usize) -> f64 {
    if all == 0 { 0.0 } else { some as f64 / all as f64 }
}
