//! A drawing of fewer pixels, quick enough for a preview of a whole camera: camera pixels are averaged in squares.
//!
//! Each sub-position of the fine grid is averaged by itself, so that the result is a drawing as any other,
//! of a camera with fewer and larger pixels; unmixing and flattening work on it unchanged.
//!
//! In: results and the open subsequence, band by band. Out: a [`Drawing`]. Never: holds a full-size image.
//! Fails: not at all; squares without a valid pixel are NaN.

use super::drawing::{PixelMask, Reach, involved_masks, touches_mask};
use super::layout::{BAND_ROWS, Layout};
use super::plan::{PlacedSet, Plan};
use super::workers::Workers;
use ndarray::Array2;

/// The side of a square of camera pixels that become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Binning {
    /// Every pixel by itself.
    One,
    /// 2 x 2.
    Two,
    /// 4 x 4.
    Four,
    /// 8 x 8.
    Eight,
}

impl Binning {
    /// All of them, finest first.
    pub const ALL: [Self; 4] = [Self::One, Self::Two, Self::Four, Self::Eight];

    /// Camera pixels per side of a square.
    #[must_use]
    pub fn side(self) -> usize {
        match self {
            Self::One => 1,
            Self::Two => 2,
            Self::Four => 4,
            Self::Eight => 8,
        }
    }
}

/// What is drawn, beside the sums.
pub(super) struct Canvas<'a> {
    pub(super) plan: &'a Plan,
    pub(super) layout: &'a Layout,
    pub(super) masks: &'a [PixelMask],
    pub(super) binning: Binning,
    /// One over the total weight of the sums.
    pub(super) scale: f32,
}

/// Averages of all planes of one band: `planes x rows x columns`.
#[derive(Default)]
struct CoarseBand(Vec<f32>);

/// Images by plane: cumulants by spectral channel, means, variances.
pub(super) struct CoarseImages {
    pub(super) cumulants: Vec<Array2<f32>>,
    pub(super) means: Vec<Array2<f32>>,
    pub(super) variances: Vec<Array2<f32>>,
}

/// Draws from the sums that `sums_of` writes for each band.
pub(super) fn draw(
    canvas: &Canvas<'_>,
    workers: &impl Workers,
    sums_of: impl Fn(usize, &mut Vec<f32>) + Sync,
) -> CoarseImages {
    let mut bands: Vec<CoarseBand> = (0..canvas.layout.bands()).map(|_| CoarseBand::default()).collect();
    let planes = canvas.planes();
    workers.for_each(&mut bands, |band, coarse| {
        let mut sums = Vec::new();
        sums_of(band, &mut sums);
        coarse.0 = planes.iter().flat_map(|plane| canvas.average(plane, band, &sums)).collect();
    });
    canvas.assemble(&planes, &bands)
}

/// One plane of sums and which of its pixels are valid.
struct Plane<'a> {
    index: usize,
    sets: &'a [PlacedSet],
    reach: Reach,
    masks: Vec<&'a Array2<bool>>,
}

impl<'a> Canvas<'a> {
    /// Planes in the order of sub-position and spectral channel, then means, then variances.
    fn planes(&self) -> Vec<Plane<'a>> {
        let n = self.plan.order;
        let spectral = self.plan.algebra.coefficients(n);
        let channels = self.plan.algebra.channels();
        let mut planes = Vec::new();
        for term in &self.plan.groups[n] {
            for u in 0..spectral {
                let masks = involved_masks(self.plan, self.masks, u);
                let reach = Reach::of(&term.sets);
                planes.push(Plane { index: term.first + u, sets: &term.sets, reach, masks });
            }
        }
        let first = self.plan.accumulators(n);
        for index in 0..2 * channels {
            let masks = self.masks[index % channels].iter().collect();
            planes.push(Plane { index: first + index, sets: &[], reach: Reach::of(&[]), masks });
        }
        planes
    }

    fn rows(&self, band: usize) -> usize {
        self.layout.rows(band).len() / self.binning.side()
    }

    fn columns(&self) -> usize {
        self.layout.width / self.binning.side()
    }

    /// Averages one plane of one band.
    fn average(&self, plane: &Plane<'_>, band: usize, sums: &[f32]) -> Vec<f32> {
        let side = self.binning.side();
        let (rows, columns) = (self.rows(band), self.columns());
        let (mut totals, mut counts) = (vec![0.0_f32; rows * columns], vec![0_u32; rows * columns]);
        let valid_rows = plane.reach.rows(self.layout.height);
        let valid_columns = plane.reach.columns(self.layout.width);
        let valid_columns = valid_columns.start..valid_columns.end.min(columns * side);
        for (row, y) in self.layout.rows(band).enumerate().take(rows * side) {
            if !valid_rows.contains(&y) {
                continue;
            }
            let start = plane.index * self.layout.plane_len(band) + row * self.layout.stride;
            let line = &sums[start..start + self.layout.width];
            let place = row / side * columns;
            if plane.masks.is_empty() {
                add_line(line, valid_columns.clone(), side, &mut totals[place..], &mut counts[place..]);
                continue;
            }
            for x in valid_columns.clone().filter(|&x| !is_masked(plane, y, x)) {
                totals[place + x / side] += line[x];
                counts[place + x / side] += 1;
            }
        }
        let mean = |(total, count): (f32, u32)| {
            if count == 0 { f32::NAN } else { total * self.scale / count as f32 }
        };
        totals.into_iter().zip(counts).map(mean).collect()
    }

    fn assemble(&self, planes: &[Plane<'_>], bands: &[CoarseBand]) -> CoarseImages {
        let n = self.plan.order;
        let (height, width) = (self.layout.height / self.binning.side(), self.columns());
        let spectral = self.plan.algebra.coefficients(n);
        let channels = self.plan.algebra.channels();
        let mut cumulants = vec![Array2::from_elem((n * height, n * width), f32::NAN); spectral];
        let mut cameras = vec![Array2::from_elem((height, width), f32::NAN); 2 * channels];
        let rows_per_band = BAND_ROWS / self.binning.side();
        for (band, coarse) in bands.iter().enumerate() {
            let rows = self.rows(band);
            for number in 0..planes.len() {
                let fine = number < n * n * spectral;
                let (position, u) = if fine { (number / spectral, number % spectral) } else { (0, 0) };
                let fold = if fine { n } else { 1 };
                let image = if fine { &mut cumulants[u] } else { &mut cameras[number - n * n * spectral] };
                let plane = &coarse.0[number * rows * width..(number + 1) * rows * width];
                for (row, line) in plane.chunks_exact(width.max(1)).enumerate() {
                    let y = fold * (band * rows_per_band + row) + position / n * usize::from(fine);
                    for (x, value) in line.iter().enumerate() {
                        image[[y, fold * x + position % n * usize::from(fine)]] = *value;
                    }
                }
            }
        }
        let variances = cameras.split_off(channels);
        CoarseImages { cumulants, means: cameras, variances }
    }
}

/// Adds a line without masked pixels, square by square.
fn add_line(
    line: &[f32],
    valid: std::ops::Range<usize>,
    side: usize,
    totals: &mut [f32],
    counts: &mut [u32],
) {
    let mut x = valid.start;
    while x < valid.end {
        let square = x / side;
        let end = ((square + 1) * side).min(valid.end);
        totals[square] += line[x..end].iter().sum::<f32>();
        counts[square] += (end - x) as u32;
        x = end;
    }
}

fn is_masked(plane: &Plane<'_>, y: usize, x: usize) -> bool {
    if plane.sets.is_empty() {
        return plane.masks.iter().any(|mask| mask[[y, x]]);
    }
    touches_mask(&plane.masks, plane.sets, y, x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sofi::cumulant::{CumulantEngine, CumulantSettings, Exposure, Incomplete, Serial};

    fn engine(masked: bool) -> CumulantEngine<u16> {
        let (height, width) = (21, 30);
        let mut engine = CumulantEngine::new(CumulantSettings::new(2, 2, 20), height, width).unwrap();
        if masked {
            let mask = Array2::from_shape_fn((height, width), |(y, x)| (y, x) == (9, 12) || y == 3);
            engine.set_masks(vec![Some(mask), None]);
        }
        let mut state = 1_u32;
        for index in 0..50 {
            let mut plane = || -> Vec<u16> {
                (0..height * width)
                    .map(|_| {
                        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                        100 + (state >> 26) as u16
                    })
                    .collect()
            };
            let (r, t) = (plane(), plane());
            engine.push(&Serial, &[Exposure { index, planes: &[&r, &t] }]).unwrap();
        }
        engine
    }

    /// The mean of the valid pixels of each square of each sub-grid, the slow and obvious way.
    fn squares(image: &Array2<f32>, fold: usize, side: usize) -> Array2<f32> {
        let (height, width) = (image.nrows() / fold / side, image.ncols() / fold / side);
        Array2::from_shape_fn((height * fold, width * fold), |(y, x)| {
            let (p, q) = (y % fold, x % fold);
            let inside = (0..side * side).map(|k| (y / fold * side + k / side, x / fold * side + k % side));
            let values: Vec<f32> =
                inside.map(|(y, x)| image[[y * fold + p, x * fold + q]]).filter(|v| !v.is_nan()).collect();
            values.iter().sum::<f32>() / values.len() as f32
        })
    }

    #[test]
    fn squares_are_means_of_the_full_drawing() {
        for masked in [false, true] {
            let engine = engine(masked);
            let full = engine.draw(&Serial, Incomplete::Any).unwrap();
            for binning in Binning::ALL {
                let coarse = engine.draw_binned(&Serial, Incomplete::Any, binning).unwrap();
                assert_eq!((coarse.runs, coarse.samples), (full.runs, full.samples));
                let all = full
                    .cumulants
                    .iter()
                    .zip(&coarse.cumulants)
                    .map(|(f, c)| (squares(f, 2, binning.side()), c));
                let cameras = full.means.iter().chain(&full.variances);
                let coarse_cameras = coarse.means.iter().chain(&coarse.variances);
                let cameras = cameras.zip(coarse_cameras).map(|(f, c)| (squares(f, 1, binning.side()), c));
                for (expected, found) in all.chain(cameras) {
                    assert_eq!(expected.dim(), found.dim());
                    for (a, b) in expected.iter().zip(found) {
                        assert!(
                            a.is_nan() && b.is_nan() || (a - b).abs() <= 1e-4 * (1.0 + a.abs()),
                            "{a} {b}"
                        );
                    }
                }
            }
        }
    }
}
