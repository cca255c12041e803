//! Measures the width of the point-spread function where it matters: in the data themselves, or on beads.
//!
//! In: one species' (or channel's) image on the `n`-fold grid before flattening, with `D(p, q)`, the summed squared pair
//! distance at each sub-position; or beads of one camera.
//! Out: [`MeasuredWidth`], standard deviation in camera pixels, as the camera sees it: the pixels' own width included.
//! Flattening needs that one; linearization the one [`without_pixels`], which is also what the optics tell.
//! Never: trusts one part of the image for all of it; the error comes from what happens when parts are left out.
//! Fails: not at all; a width that the data do not show is nothing.
//!
//! The means of the sub-grids stand in the ratios of their distance factors (Eq. S6): `ln mean = c - D / (2 n sigma^2)`,
//! where each mean is of the same camera pixels. Sub-grids end at different distances from the border, and where the
//! border is dark, means of all their pixels would make sub-grid (0, 0) brighter: by 4 % on 72 x 72 pixels, which
//! widens the result by 2 to 4 %. So only camera pixels with a value at every sub-position count.
//! A Gaussian integrated over pixels is nearly one of `sigma^2 + 1/12`; what is left changes the width by less than 0.5 %.

use ndarray::{Array2, ArrayRef2, s};

use super::registration::Bead;

/// Tiles along each side of an image that are left out one after another.
const TILES: usize = 5;
/// Of noise that neighbors do not share, tiles that fade into each other see less: the mean of the squares of their
/// shares is 2/3 along either axis.
const PER_SHARED_TILE: f64 = 1.5;
/// A sub-grid's share counts as clearly positive from this many of its standard errors.
const CLEARLY_POSITIVE: f64 = 3.0;
/// Fewer beads than this tell no width.
const FEWEST_BEADS: usize = 5;
/// Standard deviation over median absolute deviation of a Gaussian.
const PER_DEVIATION: f64 = 1.4826;
/// Standard error of a median over that of a mean, for Gaussians: `sqrt(pi / 2)`.
const PER_MEAN: f64 = 1.2533;

/// Variance of a square of one pixel along one axis, camera pixels squared.
const PIXEL_VARIANCE: f64 = 1.0 / 12.0;

/// A width and how well it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredWidth {
    /// Standard deviation of the Gaussian, camera pixels.
    pub sigma_px: f64,
    /// Standard error of it, camera pixels.
    pub standard_error_px: f64,
}

impl MeasuredWidth {
    /// Standard error over width.
    #[must_use]
    pub fn relative_error(&self) -> f64 {
        self.standard_error_px / self.sigma_px
    }

    /// The width before pixels integrate it; nothing for one that is narrower than the pixels.
    #[must_use]
    pub fn without_pixels(self) -> Option<Self> {
        let sigma_px = without_pixels(self.sigma_px)?;
        // d sqrt(s^2 - c) = (s / sqrt(s^2 - c)) ds
        Some(Self { sigma_px, standard_error_px: self.standard_error_px * self.sigma_px / sigma_px })
    }
}

/// The width that a Gaussian of standard deviation `sigma_px` has once pixels have integrated it, camera pixels.
#[must_use]
pub fn with_pixels(sigma_px: f64) -> f64 {
    (sigma_px * sigma_px + PIXEL_VARIANCE).sqrt()
}

/// The inverse of [`with_pixels`]; nothing for a width below that of a pixel.
#[must_use]
pub fn without_pixels(seen_px: f64) -> Option<f64> {
    let variance = seen_px * seen_px - PIXEL_VARIANCE;
    (variance > 0.0).then(|| variance.sqrt())
}

/// From the sub-grids of an image, the side of `distances` being the order `n`.
///
/// Nothing where fewer than two distances have a clearly positive share of the signal, where the means do not fall with
/// the distance, or where leaving out one of 25 tiles undoes either. Structure that goes on to the border of a small image
/// makes the error too large (1 % on 60 pixels), not the width.
#[must_use]
pub fn from_sub_grids(image: &ArrayRef2<f32>, distances: &Array2<f64>) -> Option<MeasuredWidth> {
    let order = distances.nrows();
    if order < 2 || distances.ncols() != order {
        return None;
    }
    let tiles = tile_sums(image, order);
    let mut whole = Sums::new(order);
    tiles.iter().for_each(|tile| whole.add(tile));
    let without: Vec<Sums> =
        tiles.iter().filter(|tile| !tile.is_empty()).map(|tile| whole.without(tile)).collect();
    if without.len() < 2 {
        return None;
    }
    let clear: Vec<usize> = (0..order * order)
        .filter(|&place| {
            // Shares, as bright structures in few tiles move the means of all sub-grids together.
            let error = jackknife(without.iter().map(|sums| sums.share(place)));
            let share = whole.share(place);
            whole.total() > 0.0 && share > 0.0 && share >= CLEARLY_POSITIVE * error
        })
        .collect();
    let sigma = |sums: &Sums| sums.sigma(&clear, distances);
    let sigma_px = sigma(&whole)?;
    let others = without.iter().map(sigma).collect::<Option<Vec<f64>>>()?;
    Some(MeasuredWidth { sigma_px, standard_error_px: jackknife(others.iter().copied()) })
}

/// From the beads of one camera: the median of their widths, the beads' own size taken off
/// (`d^2 / 20` for the variance of a ball of diameter `d`, camera pixels, along one axis; 0 for points).
#[must_use]
pub fn from_beads(beads: &[Bead], diameter_px: f64) -> Option<MeasuredWidth> {
    if beads.len() < FEWEST_BEADS {
        return None;
    }
    let mut widths: Vec<f64> = beads.iter().map(|bead| bead.sigma).collect();
    let middle = median(&mut widths)?;
    let mut deviations: Vec<f64> = widths.iter().map(|width| (width - middle).abs()).collect();
    let spread = PER_DEVIATION * median(&mut deviations)?;
    let variance = middle * middle - diameter_px * diameter_px / 20.0;
    (variance > 0.0).then(|| MeasuredWidth {
        sigma_px: variance.sqrt(),
        standard_error_px: PER_MEAN * spread / (beads.len() as f64).sqrt() * middle / variance.sqrt(),
    })
}

/// Sums of each sub-grid over the same camera pixels, those with a value at every sub-position.
#[derive(Debug, Clone)]
struct Sums {
    order: usize,
    sum: Vec<f64>,
    /// Weight of the camera pixels in it, for each sub-position once.
    camera_pixels: f64,
}

impl Sums {
    fn new(order: usize) -> Self {
        Self { order, sum: vec![0.0; order * order], camera_pixels: 0.0 }
    }

    fn add(&mut self, other: &Self) {
        self.sum.iter_mut().zip(&other.sum).for_each(|(sum, other)| *sum += other);
        self.camera_pixels += other.camera_pixels;
    }

    fn without(&self, tile: &Self) -> Self {
        let sum = self.sum.iter().zip(&tile.sum).map(|(sum, other)| sum - other).collect();
        Self { sum, order: self.order, camera_pixels: self.camera_pixels - tile.camera_pixels }
    }

    fn is_empty(&self) -> bool {
        self.camera_pixels == 0.0
    }

    fn total(&self) -> f64 {
        self.sum.iter().sum()
    }

    fn share(&self, place: usize) -> f64 {
        self.sum[place] / self.total()
    }

    /// Least squares of the logarithm against `D`.
    fn sigma(&self, clear: &[usize], distances: &Array2<f64>) -> Option<f64> {
        let at = |place: usize| distances[[place / self.order, place % self.order]];
        let points: Vec<(f64, f64)> = clear.iter().map(|&place| (at(place), self.sum[place].ln())).collect();
        let count = points.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
        let (mean_x, mean_y) = (mean(|point| point.0), mean(|point| point.1));
        let covariance: f64 = points.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
        let variance: f64 = points.iter().map(|(x, _)| (x - mean_x).powi(2)).sum();
        let slope = covariance / variance;
        // Without two different distances, or with a sum that is not positive, the slope is NaN.
        (slope < 0.0).then(|| (-1.0 / (2.0 * self.order as f64 * slope)).sqrt())
    }
}

/// Sums of the tiles of an image. Tiles fade into each other, as a sharp edge across a structure would give one sub-grid
/// half a pixel of it more than another, in one tile for what the next one lacks.
fn tile_sums(image: &ArrayRef2<f32>, order: usize) -> Vec<Sums> {
    let mut tiles = vec![Sums::new(order); TILES * TILES];
    let (rows, columns) = (image.nrows() / order, image.ncols() / order);
    let along_y: Vec<_> = (0..rows * order).map(|y| between_tiles(y, rows * order)).collect();
    let along_x: Vec<_> = (0..columns * order).map(|x| between_tiles(x, columns * order)).collect();
    for y in 0..rows {
        for x in 0..columns {
            let positions = image.slice(s![y * order..(y + 1) * order, x * order..(x + 1) * order]);
            if !positions.iter().all(|value| value.is_finite()) {
                continue;
            }
            for ((p, q), &value) in positions.indexed_iter() {
                for (tile_y, weight_y) in along_y[y * order + p] {
                    for (tile_x, weight_x) in along_x[x * order + q] {
                        let tile = &mut tiles[tile_y * TILES + tile_x];
                        tile.camera_pixels += weight_y * weight_x;
                        tile.sum[p * order + q] += weight_y * weight_x * f64::from(value);
                    }
                }
            }
        }
    }
    tiles
}

/// The two tiles that share a place along an axis, and their shares.
fn between_tiles(place: usize, length: usize) -> [(usize, f64); 2] {
    let last = (TILES - 1) as f64;
    let at = ((place as f64 + 0.5) / length as f64 * TILES as f64 - 0.5).clamp(0.0, last);
    let tile = (at.floor() as usize).min(TILES - 2);
    let share = at - tile as f64;
    [(tile, 1.0 - share), (tile + 1, share)]
}

/// Standard error from the values without each of the tiles.
fn jackknife(without: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = without.clone().count() as f64;
    let mean = without.clone().sum::<f64>() / count;
    let squares: f64 = without.map(|value| (value - mean).powi(2)).sum();
    PER_SHARED_TILE * (squares * (count - 1.0) / count).sqrt()
}

fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, SQRT_2};

    use ndarray::array;
    use proptest::prelude::*;

    use super::*;
    use crate::sofi::flattening::{estimate_sigma, gaussian_distance_factor};
    use crate::sofi::grid::{Combinations, VirtualPixelGrid};

    /// Grain between -1 and 1.
    fn grain(y: usize, x: usize) -> f64 {
        let mixed = (y * 7919 + x).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
        (mixed % 2001) as f64 / 1000.0 - 1.0
    }

    /// Structure that fades to the border, with the distance factors of a Gaussian, and noise of the given size.
    fn image(distances: &Array2<f64>, sigma: f64, noise: f64) -> Array2<f32> {
        let order = distances.nrows();
        Array2::from_shape_fn((60 * order, 80 * order), |(y, x)| {
            let place = |fine: usize| (fine as f64 + 0.5) / order as f64;
            let (from_top, from_left) = (place(y), place(x));
            let fading = ((from_top * PI / 60.0).sin() * (from_left * PI / 80.0).sin()).powi(2);
            let structure = fading * (2.0 + (from_top * 0.31).sin() + (from_left * 0.23).cos());
            let factor = gaussian_distance_factor(distances[[y % order, x % order]], order, sigma);
            (structure * factor + noise * grain(y, x)) as f32
        })
    }

    fn distances(order: usize) -> Array2<f64> {
        VirtualPixelGrid::new(order, Combinations::AllClosest).unwrap().squared_distances()
    }

    #[test]
    fn the_width_is_found_at_every_order_and_agrees_with_the_plain_estimate() {
        for order in 2..=4 {
            for sigma in [0.8, 1.0, 1.6] {
                let image = image(&distances(order), sigma, 0.0);
                let found = from_sub_grids(&image, &distances(order)).unwrap();
                assert!((found.sigma_px - sigma).abs() < 1e-4, "{order} {sigma} {found:?}");
                assert!(found.relative_error() < 2e-4, "{order} {sigma} {found:?}");
                let plain = estimate_sigma(&image, &distances(order)).unwrap();
                assert!((found.sigma_px - plain).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn noise_shows_in_the_error_and_the_error_holds() {
        let image = image(&distances(2), 1.0, 1.0);
        let found = from_sub_grids(&image, &distances(2)).unwrap();
        println!("{found:?}");
        assert!((0.001..0.1).contains(&found.standard_error_px));
        assert!((found.sigma_px - 1.0).abs() < 4.0 * found.standard_error_px);
    }

    #[test]
    fn a_single_bright_structure_is_enough() {
        let lines = image(&distances(2), 1.1, 0.0);
        let image = Array2::from_shape_fn(lines.dim(), |(y, x)| {
            if (y / 2).abs_diff(x / 3) < 4 { lines[[y, x]] } else { (0.02 * grain(y, x)) as f32 }
        });
        let found = from_sub_grids(&image, &distances(2)).unwrap();
        assert!((found.sigma_px - 1.1).abs() < 0.03 && found.relative_error() < 0.03, "{found:?}");
    }

    #[test]
    fn images_that_show_no_width_have_none() {
        let noise = Array2::from_shape_fn((80, 80), |(y, x)| grain(y, x) as f32);
        let distances = distances(2);
        let nothing = from_sub_grids(&Array2::zeros((0, 0)), &distances);
        let rising = Array2::from_shape_fn((80, 80), |(y, x)| distances[[y % 2, x % 2]] as f32);
        let missing = Array2::from_elem((80, 80), f32::NAN);
        let mut spot = Array2::<f32>::zeros((80, 80));
        spot[[10, 10]] = 1.0;
        assert!(nothing.is_none());
        for image in [noise, rising, missing, spot] {
            assert!(from_sub_grids(&image, &distances).is_none());
        }
        assert!(from_sub_grids(&Array2::ones((40, 40)), &array![[1.0]]).is_none());
        assert!(from_sub_grids(&Array2::ones((40, 40)), &Array2::zeros((2, 3))).is_none());
    }

    /// Share of a Gaussian around `center` that falls on the pixel at `pixel`.
    fn in_pixel(pixel: f64, center: f64, sigma: f64) -> f64 {
        let below = |edge: f64| 0.5 * libm::erf((edge - center) / (sigma * SQRT_2));
        below(pixel + 0.5) - below(pixel - 0.5)
    }

    /// The cumulants of order 2 of emitters on a crooked line, pair by pair, seen through pixels; a dark border where
    /// pairs that leave the `side` x `side` camera have no value.
    fn line_of_emitters(side: usize, sigma: f64) -> Array2<f32> {
        let grid = VirtualPixelGrid::new(2, Combinations::AllClosest).unwrap();
        let emitters: Vec<(f64, f64, f64)> = (0..200)
            .map(|k| {
                (
                    8.0 + 0.08 * f64::from(k),
                    9.0 + 0.07 * f64::from(k) + grain(3, k as usize),
                    2.0 + grain(k as usize, 5),
                )
            })
            .collect();
        let pixel =
            |y: f64, x: f64, at: &(f64, f64, f64)| in_pixel(y, at.0, sigma) * in_pixel(x, at.1, sigma);
        Array2::from_shape_fn((2 * side, 2 * side), |(y, x)| {
            let sets = &grid.sub_grids()[y % 2 * 2 + x % 2].sets;
            let place = |offset: &crate::sofi::grid::Offset| {
                ((y / 2) as f64 + f64::from(offset.dy), (x / 2) as f64 + f64::from(offset.dx))
            };
            let inside = |(y, x): (f64, f64)| y.min(x) >= 0.0 && y.max(x) < side as f64;
            if !sets.iter().flatten().all(|offset| inside(place(offset))) {
                return f32::NAN;
            }
            let product = |set: &[crate::sofi::grid::Offset], at: &(f64, f64, f64)| {
                set.iter().map(|offset| pixel(place(offset).0, place(offset).1, at)).product::<f64>()
            };
            let sum: f64 =
                emitters.iter().map(|at| at.2 * sets.iter().map(|set| product(set, at)).sum::<f64>()).sum();
            (1e4 * sum / sets.len() as f64) as f32
        })
    }

    #[test]
    fn a_gaussian_that_pixels_integrate_is_found_whatever_the_dark_border() {
        for sigma in [0.8, 0.95, 1.3] {
            for side in [32, 48] {
                let image = line_of_emitters(side, sigma);
                let found = from_sub_grids(&image, &distances(2)).unwrap();
                let off = found.sigma_px / with_pixels(sigma) - 1.0;
                let lens = found.without_pixels().unwrap().sigma_px / sigma - 1.0;
                println!("{sigma} {side}: {:+.3} %, lens {:+.3} %", 100.0 * off, 100.0 * lens);
                assert!(off.abs() < 0.005 && lens.abs() < 0.007, "{sigma} {side}: {off} {lens}");
                // What the means of all pixels of each sub-grid would have told.
                let plain = estimate_sigma(&image, &distances(2)).unwrap();
                assert!(plain / with_pixels(sigma) - 1.0 > 0.02);
            }
        }
    }

    #[test]
    fn pixels_are_taken_off_and_put_on() {
        let seen = MeasuredWidth { sigma_px: with_pixels(0.9), standard_error_px: 0.01 };
        let lens = seen.without_pixels().unwrap();
        assert!((lens.sigma_px - 0.9).abs() < 1e-12);
        let slope = without_pixels(seen.sigma_px + 1e-6).unwrap() - lens.sigma_px;
        assert!((lens.standard_error_px / 0.01 - slope / 1e-6).abs() < 1e-4);
        assert_eq!(without_pixels(0.28), None);
    }

    #[test]
    fn beads_give_the_median_of_their_widths_less_their_size() {
        let bead = |sigma: f64| Bead { y: 0.0, x: 0.0, sigma, height: 100.0 };
        let mut beads: Vec<Bead> = (0..40).map(|k| bead(1.2 + 0.002 * f64::from(k % 5 - 2))).collect();
        beads.push(bead(2.9));
        let found = from_beads(&beads, 0.0).unwrap();
        assert!((found.sigma_px - 1.2).abs() < 1e-3 && found.standard_error_px < 2e-3, "{found:?}");
        let smaller = from_beads(&beads, 1.85).unwrap();
        assert!((smaller.sigma_px - (1.44_f64 - 1.85 * 1.85 / 20.0).sqrt()).abs() < 1e-3);
        assert!(from_beads(&beads[..4], 0.0).is_none() && from_beads(&beads, 100.0).is_none());
    }

    proptest! {
        #[test]
        fn brightness_does_not_matter_and_missing_pixels_do_no_harm(
            sigma in 0.7..2.0_f64, scale in 1e-3..1e6_f64, hole in 0..4000_usize,
        ) {
            let distances = distances(2);
            let even = Array2::from_shape_fn((80, 100), |(y, x)| {
                (scale * gaussian_distance_factor(distances[[y % 2, x % 2]], 2, sigma)) as f32
            });
            let mut holed = even.clone();
            holed.iter_mut().skip(hole).take(500).for_each(|value| *value = f32::NAN);
            for image in [even, holed] {
                let found = from_sub_grids(&image, &distances).unwrap();
                prop_assert!((found.sigma_px - sigma).abs() < 1e-4);
            }
        }
    }
}
