//! The share of one dye's light from regions of a mixed sample in which no other dye is.
//!
//! Tiles of the regions have each a background of their own, as in a whole sample. A region without any dye gives one
//! background for all of them instead: then all light of the dye counts, and the error of that background, which all
//! tiles share, is in the stated error.
//!
//! In: mean images, where the dye is and where nothing is. Out: [`MeasuredShare`]. Never: counts a pixel twice.
//! Fails: [`ResponseError`].

use super::{
    HalfMeans, LARGEST_ERROR, Light, MeasuredShare, ResponseError, ResponseSettings, corrected_light,
};
use ndarray::Array2;

/// Smallest side of a region, pixels.
pub(super) const LEAST_SIDE: usize = 8;
/// Sides of tiles in large and in small regions, pixels.
const TILES: [usize; 2] = [8, 4];
/// So many large tiles are needed to find an error from; otherwise they are small.
const ENOUGH: usize = 16;
/// Fewest tiles that an error can be found from.
const LEAST_TILES: usize = 4;

/// A rectangle of pixels of camera R.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelArea {
    /// First row.
    pub top: usize,
    /// First column.
    pub left: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
}

/// Where the dye is and where nothing is.
#[derive(Debug, Clone, Copy)]
pub struct Marked<'a> {
    /// No other dye is there.
    pub dye: &'a [PixelArea],
    /// No dye is there; none for what surrounds the dye within its regions.
    pub background: Option<PixelArea>,
}

/// Sums over the pixels of a tile: T and both cameras, of even and odd frames.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    number: f64,
    t: [f64; 2],
    s: [f64; 2],
    /// T of one half times both cameras of the other half, both ways.
    mixed: f64,
    /// Both cameras of one half times those of the other, twice.
    squared: f64,
}

/// Means of T and of both cameras, of even and odd frames.
#[derive(Debug, Clone, Copy)]
struct Level {
    t: [f64; 2],
    s: [f64; 2],
}

impl Sums {
    fn add(&mut self, t: [f64; 2], s: [f64; 2]) {
        self.number += 1.0;
        for half in 0..2 {
            self.t[half] += t[half];
            self.s[half] += s[half];
        }
        self.mixed += t[0] * s[1] + t[1] * s[0];
        self.squared += 2.0 * s[0] * s[1];
    }

    fn with(self, other: Self, sign: f64) -> Self {
        let both = |a: [f64; 2], b: [f64; 2]| [a[0] + sign * b[0], a[1] + sign * b[1]];
        Self {
            number: self.number + sign * other.number,
            t: both(self.t, other.t),
            s: both(self.s, other.s),
            mixed: self.mixed + sign * other.mixed,
            squared: self.squared + sign * other.squared,
        }
    }

    fn level(&self) -> Level {
        let mean = |sums: [f64; 2]| sums.map(|sum| sum / self.number);
        Level { t: mean(self.t), s: mean(self.s) }
    }

    /// Products of what is above a level: T with both cameras, and both cameras with themselves.
    fn above(&self, level: &Level) -> [f64; 2] {
        let product = |a: [f64; 2], level_a: [f64; 2], half: usize| {
            let other = 1 - half;
            self.number * level_a[half] * level.s[other]
                - level_a[half] * self.s[other]
                - a[half] * level.s[other]
        };
        let both = |a, level_a| product(a, level_a, 0) + product(a, level_a, 1);
        let squared = self.squared + both(self.s, level.s);
        // What is left of large sums that are equal is rounding.
        let is_rounding = squared.abs() < 1e-11 * self.squared.abs();
        [self.mixed + both(self.t, level.t), if is_rounding { 0.0 } else { squared }]
    }
}

/// The share of the dye's light that reaches T, from the regions where only that dye is.
///
/// # Errors
/// [`ResponseError`] where regions are too small, too dark, or lie on each other.
pub fn transmitted_share_in(
    means: &HalfMeans,
    settings: &ResponseSettings<'_>,
    marked: &Marked<'_>,
) -> Result<MeasuredShare, ResponseError> {
    let mut light = corrected_light(means, settings)?;
    let areas = marked.dye.iter().chain(&marked.background);
    if marked.dye.is_empty() || areas.clone().any(|area| area.height.min(area.width) < LEAST_SIDE) {
        return Err(ResponseError::SmallRegion);
    }
    let (height, width) = light.is_good.dim();
    if areas.clone().any(|area| area.top + area.height > height || area.left + area.width > width) {
        return Err(ResponseError::SmallRegion);
    }
    if marked.background.is_some_and(|background| marked.dye.iter().any(|dye| dye.overlaps(&background))) {
        return Err(ResponseError::Overlap);
    }
    let pixels: usize = marked.dye.iter().map(|area| area.height * area.width).sum();
    let side = if pixels >= ENOUGH * TILES[0] * TILES[0] { TILES[0] } else { TILES[1] };
    let dye: Vec<Sums> = marked.dye.iter().flat_map(|area| light.tiles(area, side)).collect();
    let background: Vec<Sums> =
        marked.background.iter().flat_map(|area| light.tiles(area, TILES[1])).collect();
    if dye.len() < LEAST_TILES || (marked.background.is_some() && background.len() < LEAST_TILES) {
        return Err(ResponseError::SmallRegion);
    }
    if marked.background.is_some() { against_background(&dye, &background) } else { within(&dye) }
}

impl PixelArea {
    fn overlaps(&self, other: &Self) -> bool {
        self.top < other.top + other.height
            && other.top < self.top + self.height
            && self.left < other.left + other.width
            && other.left < self.left + self.width
    }
}

impl Light {
    /// Tiles of an area with pixels that no tile has had yet; each of them has several.
    fn tiles(&mut self, area: &PixelArea, side: usize) -> Vec<Sums> {
        let (bottom, right) = (area.top + area.height, area.left + area.width);
        let corners = (area.top..bottom)
            .step_by(side)
            .flat_map(|top| (area.left..right).step_by(side).map(move |left| (top, left)));
        let tiles = corners.map(|(top, left)| {
            let mut sums = Sums::default();
            for y in top..(top + side).min(bottom) {
                for x in left..(left + side).min(right) {
                    if std::mem::take(&mut self.is_good[[y, x]]) {
                        let at = |images: &[Array2<f64>; 2]| [images[0][[y, x]], images[1][[y, x]]];
                        sums.add(at(&self.transmitted), at(&self.total));
                    }
                }
            }
            sums
        });
        tiles.filter(|sums| sums.number >= 2.0).collect()
    }
}

/// Each tile has its own background.
fn within(dye: &[Sums]) -> Result<MeasuredShare, ResponseError> {
    let parts: Vec<[f64; 2]> = dye.iter().map(|sums| sums.above(&sums.level())).collect();
    let (error, freedom) = jackknife(&parts)?;
    checked(total(&parts), error * error, freedom)
}

/// All tiles have the background of a region.
fn against_background(dye: &[Sums], background: &[Sums]) -> Result<MeasuredShare, ResponseError> {
    let all = background.iter().fold(Sums::default(), |all, sums| all.with(*sums, 1.0));
    let level = all.level();
    let parts: Vec<[f64; 2]> = dye.iter().map(|sums| sums.above(&level)).collect();
    let (error, freedom) = jackknife(&parts)?;
    // What another background would have given: the same jackknife over the tiles of the background.
    let whole = dye.iter().fold(Sums::default(), |whole, sums| whole.with(*sums, 1.0));
    let without: Vec<f64> = background
        .iter()
        .map(|sums| {
            let [mixed, squared] = whole.above(&all.with(*sums, -1.0).level());
            mixed / squared
        })
        .collect();
    let of_background = spread(&without);
    let degrees = without.len() as f64 - 1.0;
    let variance = error * error + of_background;
    // Satterthwaite: two errors, each with as many degrees of freedom as it has.
    let freedom = variance * variance / (error.powi(4) / freedom + of_background * of_background / degrees);
    checked(total(&parts), variance, freedom)
}

fn total(parts: &[[f64; 2]]) -> [f64; 2] {
    parts.iter().fold([0.0; 2], |sum, part| [sum[0] + part[0], sum[1] + part[1]])
}

/// The standard error of the share, and how many tiles decide about it, less one.
fn jackknife(parts: &[[f64; 2]]) -> Result<(f64, f64), ResponseError> {
    let [mixed, squared] = total(parts);
    if squared <= 0.0 {
        return Err(ResponseError::NoLight);
    }
    let without: Vec<f64> = parts.iter().map(|part| (mixed - part[0]) / (squared - part[1])).collect();
    let deciding = squared * squared / parts.iter().map(|part| part[1] * part[1]).sum::<f64>();
    Ok((spread(&without).sqrt(), (deciding - 1.0).max(1.0)))
}

/// The variance of an estimate from what it is without each part.
fn spread(without: &[f64]) -> f64 {
    let number = without.len() as f64;
    let mean = without.iter().sum::<f64>() / number;
    without.iter().map(|value| (value - mean).powi(2)).sum::<f64>() * (number - 1.0) / number
}

fn checked([mixed, squared]: [f64; 2], variance: f64, freedom: f64) -> Result<MeasuredShare, ResponseError> {
    let (transmission, error) = (mixed / squared, variance.sqrt());
    if squared <= 0.0 || !error.is_finite() || error > LARGEST_ERROR {
        return Err(ResponseError::NoLight);
    }
    Ok(MeasuredShare { transmission, error, freedom: freedom.max(1.0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two dyes of known shares side by side on a background, without noise.
    fn two_dyes() -> HalfMeans {
        let image = |camera: usize, half: usize| {
            Array2::from_shape_fn((32, 64), |(y, x)| {
                let share = if x < 32 { 0.3 } else { 0.9 };
                let share = if camera == 1 { share } else { 1.0 - share };
                let is_dark = y < 8;
                let structure = if is_dark { 0.0 } else { ((y * 37 + x * 11) % 13) as f64 };
                [150.0, 900.0][camera] + share * (1.0 + half as f64) * structure
            })
        };
        std::array::from_fn(|camera| std::array::from_fn(|half| image(camera, half)))
    }

    fn area(top: usize, left: usize, height: usize, width: usize) -> PixelArea {
        PixelArea { top, left, height, width }
    }

    #[test]
    fn each_region_gives_the_share_of_its_own_dye() {
        let means = two_dyes();
        for background in [None, Some(area(0, 10, 8, 40))] {
            for (left, share) in [(2, 0.3), (36, 0.9)] {
                let dye = [area(9, left, 12, 20), area(20, left, 12, 20)];
                let marked = Marked { dye: &dye, background };
                let found = transmitted_share_in(&means, &ResponseSettings::default(), &marked).unwrap();
                assert!((found.transmission - share).abs() < 1e-9, "{found:?}");
            }
        }
    }

    #[test]
    fn a_region_that_is_marked_twice_counts_once() {
        let mut means = two_dyes();
        means[1][0][[12, 5]] += 5.0;
        let one = [area(9, 2, 16, 16)];
        let twice = [one[0], one[0]];
        let found = |dye: &[PixelArea]| {
            let marked = Marked { dye, background: None };
            transmitted_share_in(&means, &ResponseSettings::default(), &marked).unwrap()
        };
        let (once, again) = (found(&one), found(&twice));
        assert!((once.transmission - again.transmission).abs() < 1e-12 && once.error > 0.0);
        assert_eq!(once.freedom, again.freedom);
    }

    #[test]
    fn what_cannot_be_used_is_told_apart() {
        let means = two_dyes();
        let tried = |dye: &[PixelArea], background| {
            let marked = Marked { dye, background };
            transmitted_share_in(&means, &ResponseSettings::default(), &marked).unwrap_err()
        };
        assert_eq!(tried(&[], None), ResponseError::SmallRegion);
        assert_eq!(tried(&[area(9, 2, 7, 20)], None), ResponseError::SmallRegion);
        assert_eq!(tried(&[area(9, 50, 12, 20)], None), ResponseError::SmallRegion);
        assert_eq!(tried(&[area(9, 2, 12, 20)], Some(area(12, 12, 8, 8))), ResponseError::Overlap);
        assert_eq!(tried(&[area(0, 2, 8, 20)], None), ResponseError::NoLight);
    }
}
