//! A result drawn from the running state: fine-grid images with NaN where nothing can be computed.

use super::layout::Layout;
use super::plan::{PlacedSet, Plan};
use ndarray::Array2;

/// What to do with subsequences that are not complete.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Incomplete {
    /// Use those with at least half of their exposures, weighted by their exposures: the rule for results.
    AtLeastHalf,
    /// Use all with at least two exposures: for a preview of the open subsequence.
    Any,
}

/// Pixels of one channel to leave out, `(height, width)`, true where masked; `None` masks nothing.
pub type PixelMask = Option<Array2<bool>>;

/// Images drawn from an engine.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    /// One fine-grid image per spectral channel, `(n * height, n * width)`, counts to the n-th power.
    /// With two channels they stand in the order `u = 0..=n` of pixels taken from T.
    pub cumulants: Vec<Array2<f32>>,
    /// Mean image per channel, `(height, width)`, counts.
    pub means: Vec<Array2<f32>>,
    /// Temporal variance per channel, `(height, width)`, counts squared.
    pub variances: Vec<Array2<f32>>,
    /// Subsequences used.
    pub runs: u64,
    /// Exposures (with lags: time-shifted samples) used.
    pub samples: u64,
    /// Of these, samples of subsequences that were not complete.
    pub incomplete_samples: u64,
}

/// Images of one drawing.
pub(super) struct Images {
    pub(super) cumulants: Vec<Array2<f32>>,
    pub(super) means: Vec<Array2<f32>>,
    pub(super) variances: Vec<Array2<f32>>,
}

/// Expands summed results, divided by their total weight, to images.
pub(super) fn expand(
    plan: &Plan,
    layout: &Layout,
    masks: &[PixelMask],
    sums: &[Vec<f32>],
    weight: f64,
) -> Images {
    let scale = (1.0 / weight) as f32;
    let spectral = plan.algebra.coefficients(plan.order);
    let channels = plan.algebra.channels();
    let cumulants = (0..spectral).map(|u| fine_image(plan, layout, masks, sums, u, scale)).collect();
    let first = plan.accumulators(plan.order);
    let camera = |first: usize| {
        (0..channels)
            .map(|channel| camera_image(layout, &masks[channel], sums, first + channel, scale))
            .collect()
    };
    Images { cumulants, means: camera(first), variances: camera(first + channels) }
}

fn fine_image(
    plan: &Plan,
    layout: &Layout,
    masks: &[PixelMask],
    sums: &[Vec<f32>],
    spectral_channel: usize,
    scale: f32,
) -> Array2<f32> {
    let n = plan.order;
    let mut image = Array2::from_elem((n * layout.height, n * layout.width), f32::NAN);
    let involved = involved_masks(plan, masks, spectral_channel);
    for (position, term) in plan.groups[n].iter().enumerate() {
        let (p, q) = (position / n, position % n);
        let reach = Reach::of(&term.sets);
        for y in reach.rows(layout.height) {
            let line = line_of(layout, sums, term.first + spectral_channel, y);
            for x in reach.columns(layout.width) {
                if !touches_mask(&involved, &term.sets, y, x) {
                    image[[n * y + p, n * x + q]] = line[x] * scale;
                }
            }
        }
    }
    image
}

/// The masks of the channels that a spectral channel takes pixels from.
pub(super) fn involved_masks<'a>(
    plan: &Plan,
    masks: &'a [PixelMask],
    spectral_channel: usize,
) -> Vec<&'a Array2<bool>> {
    masks
        .iter()
        .zip(&plan.algebra.monomials(plan.order)[spectral_channel])
        .filter(|(_, exponent)| **exponent > 0)
        .filter_map(|(mask, _)| mask.as_ref())
        .collect()
}

fn camera_image(
    layout: &Layout,
    mask: &PixelMask,
    sums: &[Vec<f32>],
    plane: usize,
    scale: f32,
) -> Array2<f32> {
    Array2::from_shape_fn((layout.height, layout.width), |(y, x)| {
        let masked = mask.as_ref().is_some_and(|mask| mask[[y, x]]);
        if masked { f32::NAN } else { line_of(layout, sums, plane, y)[x] * scale }
    })
}

fn line_of<'a>(layout: &Layout, sums: &'a [Vec<f32>], plane: usize, y: usize) -> &'a [f32] {
    let band = layout.band_of(y);
    let start = plane * layout.plane_len(band) + (y - layout.rows(band).start) * layout.stride;
    &sums[band][start..start + layout.width]
}

/// Whether a pixel of any of the sets is masked.
pub(super) fn touches_mask(masks: &[&Array2<bool>], sets: &[PlacedSet], y: usize, x: usize) -> bool {
    let masked = |mask: &Array2<bool>, dy: i32, dx: i32| {
        let inside = y.checked_add_signed(dy as isize).zip(x.checked_add_signed(dx as isize));
        inside.is_some_and(|place| mask.get(place).copied().unwrap_or(false))
    };
    let touches = |mask: &Array2<bool>| {
        sets.iter().flat_map(|set| &set.elements).any(|element| masked(mask, element.dy, element.dx))
    };
    masks.iter().any(|mask| touches(mask))
}

/// Extent of the pixels of a sub-position around its base pixel.
pub(super) struct Reach {
    up: usize,
    down: usize,
    left: usize,
    right: usize,
}

impl Reach {
    pub(super) fn of(sets: &[PlacedSet]) -> Self {
        let elements = || sets.iter().flat_map(|set| &set.elements);
        let farthest =
            |distances: &mut dyn Iterator<Item = i32>| distances.max().unwrap_or(0).max(0) as usize;
        Self {
            up: farthest(&mut elements().map(|e| -e.dy)),
            down: farthest(&mut elements().map(|e| e.dy)),
            left: farthest(&mut elements().map(|e| -e.dx)),
            right: farthest(&mut elements().map(|e| e.dx)),
        }
    }

    pub(super) fn rows(&self, height: usize) -> std::ops::Range<usize> {
        self.up..height.saturating_sub(self.down)
    }

    pub(super) fn columns(&self, width: usize) -> std::ops::Range<usize> {
        self.left..width.saturating_sub(self.right)
    }
}
