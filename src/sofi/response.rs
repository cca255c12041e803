//! The share of a dye's light on camera T, from a sample that holds no other dye (spec, mixing coefficients).
//!
//! Where nothing but one dye adds structure, the light of T is that share of the light of both, `T = a + T_i (R + T)`,
//! whatever the background `a` is. The share is the slope over the pixels of small tiles, each with a background of its
//! own; with a blank, an unstained sample, the background is known and evenly stained samples do as well.
//! The noise of a pixel is in both sides of the line. Frames of even and of odd number have different noise, so
//! products of one with the other have none of it: `T_i = sum(T_even S_odd + T_odd S_even) / sum(2 S_even S_odd)`.
//!
//! In: frames of both cameras, then what is to be taken off, and where T lies on R. Out: [`MeasuredShare`].
//! Never: keeps a frame, needs gains: shares are of counts, as the unmixing takes them.
//! Fails: [`ResponseError`].

mod regions;

pub use regions::{Marked, PixelArea, transmitted_share_in};

use crate::sofi::registration::Resampler;
use ndarray::{Array2, Zip};

/// Side of a tile, pixels.
const TILE: usize = 8;
/// Fewest tiles that an error can be found from.
const LEAST_TILES: usize = 4;
/// A standard error of the share above which it is of no use.
const LARGEST_ERROR: f64 = 0.1;

/// Why no share was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ResponseError {
    /// Too few frames.
    #[error("{0} frames are too few; record at least 4, in practice some hundred")]
    Frames(u64),
    /// Nothing is brighter than its surroundings.
    #[error(
        "nothing in this sample is clearly brighter than its background; record more frames or more light, \
         or give a blank for an evenly stained sample"
    )]
    NoLight,
    /// Sizes that differ.
    #[error("sample, blank and maps differ in size; record the same region")]
    Size,
    /// A region with too few pixels.
    #[error(
        "the regions are too small or outside of what both cameras see; mark at least {} x {} pixels within the image",
        regions::LEAST_SIDE,
        regions::LEAST_SIDE
    )]
    SmallRegion,
    /// A background in which the dye is.
    #[error("the background lies on a region of the dye; mark it where none of the dyes is")]
    Overlap,
}

/// Sums of a recording of both cameras.
#[derive(Debug, Clone)]
pub struct StainedSums {
    size: [usize; 2],
    /// By camera, R and T, and by even and odd frames.
    sums: [[Vec<u64>; 2]; 2],
    frames: u64,
}

/// Mean images of both cameras, R and T, over the even and over the odd frames, counts.
pub type HalfMeans = [[Array2<f64>; 2]; 2];

/// The share of a dye's light on camera T.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredShare {
    /// `T_i`; may lie outside 0 to 1 by its error.
    pub transmission: f64,
    /// One standard error, from how tiles differ.
    pub error: f64,
    /// How many tiles decide about it, less one: the degrees of freedom of its error.
    pub freedom: f64,
}

impl MeasuredShare {
    /// Half of the interval that holds the truth in 95 of 100 measurements: two standard errors if the error were
    /// certain, more for the few tiles of a small sample (Student; Fisher and Cornish 1960).
    #[must_use]
    pub fn uncertainty(&self) -> f64 {
        let z: f64 = 2.0;
        let first = (z.powi(3) + z) / (4.0 * self.freedom);
        let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / (96.0 * self.freedom.powi(2));
        (z + first + second) * self.error
    }
}

impl StainedSums {
    /// Nothing seen yet.
    #[must_use]
    pub fn new(size: [usize; 2]) -> Self {
        let zeros = || vec![0; size[0] * size[1]];
        Self { size, sums: [[zeros(), zeros()], [zeros(), zeros()]], frames: 0 }
    }

    /// Adds a frame of both cameras, row by row.
    ///
    /// # Panics
    /// When a frame has another size.
    pub fn push(&mut self, frames: [&[u16]; 2]) {
        let half = (self.frames % 2) as usize;
        for (sums, counts) in self.sums.iter_mut().zip(frames) {
            assert_eq!(counts.len(), sums[half].len(), "a frame of the same size");
            sums[half].iter_mut().zip(counts).for_each(|(sum, &count)| *sum += u64::from(count));
        }
        self.frames += 1;
    }

    /// Mean images of both halves.
    ///
    /// # Errors
    /// [`ResponseError::Frames`] below 4 frames.
    pub fn means(&self) -> Result<HalfMeans, ResponseError> {
        if self.frames < 4 {
            return Err(ResponseError::Frames(self.frames));
        }
        let frames = [self.frames.div_ceil(2), self.frames / 2];
        let [height, width] = self.size;
        Ok(self.sums.each_ref().map(|halves| {
            std::array::from_fn(|half| {
                let per_frame = 1.0 / frames[half] as f64;
                Array2::from_shape_fn((height, width), |(y, x)| {
                    halves[half][y * width + x] as f64 * per_frame
                })
            })
        }))
    }
}

/// What is taken off, where T lies, and which pixels are left out.
#[derive(Debug, Clone, Default)]
pub struct ResponseSettings<'a> {
    /// An unstained sample, recorded alike.
    pub blank: Option<&'a HalfMeans>,
    /// Counts without light of R and T, where known.
    pub offsets: [Option<&'a Array2<f32>>; 2],
    /// Pixels of R and T to leave out.
    pub masks: [Option<&'a Array2<bool>>; 2],
    /// T on the pixels of R; none where the cameras come aligned.
    pub resampler: Option<&'a Resampler>,
}

/// The share of the dye's light that reaches T.
///
/// # Errors
/// [`ResponseError`] where nothing is stained.
pub fn transmitted_share(
    means: &HalfMeans,
    settings: &ResponseSettings<'_>,
) -> Result<MeasuredShare, ResponseError> {
    let Light { transmitted, total, is_good } = corrected_light(means, settings)?;
    slope(&tiles(&transmitted, &total, &is_good, settings.blank.is_some()))
}

/// The light of T and of both cameras on the pixels of R, of even and odd frames.
struct Light {
    transmitted: [Array2<f64>; 2],
    total: [Array2<f64>; 2],
    /// Pixels that both cameras see well.
    is_good: Array2<bool>,
}

fn corrected_light(means: &HalfMeans, settings: &ResponseSettings<'_>) -> Result<Light, ResponseError> {
    let size = means[0][0].dim();
    let fits = |other: (usize, usize)| other == size;
    let blanks = settings.blank.iter().flat_map(|blank| blank.iter().flatten()).map(Array2::dim);
    let others = settings.offsets.iter().flatten().map(|map| map.dim());
    let masks = settings.masks.iter().flatten().map(|mask| mask.dim());
    let sampled = settings.resampler.map(|resampler| resampler.size().into());
    if !blanks.chain(others).chain(masks).chain(sampled).all(fits) {
        return Err(ResponseError::Size);
    }
    let corrected: [[Array2<f64>; 2]; 2] =
        std::array::from_fn(|camera| std::array::from_fn(|half| light(means, settings, camera, half)));
    let [reflected, transmitted] = &corrected;
    let (transmitted, missing) = match settings.resampler {
        None => (transmitted.clone(), settings.masks[1].cloned()),
        Some(resampler) => (
            transmitted.each_ref().map(|image| resampled(image, resampler)),
            resampler.missing(settings.masks[1]),
        ),
    };
    let is_good = Array2::from_shape_fn(size, |place| {
        let masked = |mask: Option<&Array2<bool>>| mask.is_some_and(|mask| mask[place]);
        !masked(settings.masks[0]) && !masked(missing.as_ref())
    });
    let total: [Array2<f64>; 2] = std::array::from_fn(|half| &reflected[half] + &transmitted[half]);
    Ok(Light { transmitted, total, is_good })
}

fn light(means: &HalfMeans, settings: &ResponseSettings<'_>, camera: usize, half: usize) -> Array2<f64> {
    let mut image = means[camera][half].clone();
    if let Some(blank) = settings.blank {
        image -= &blank[camera][half];
    } else if let Some(offset) = settings.offsets[camera] {
        Zip::from(&mut image).and(offset).for_each(|value, &offset| *value -= f64::from(offset));
    }
    image
}

/// An image of T on the pixels of R.
fn resampled(image: &Array2<f64>, resampler: &Resampler) -> Array2<f64> {
    Array2::from_shape_fn(image.dim(), |(y, x)| {
        let (first_column, across) = resampler.across(y as i64, x as i64);
        let columns = (first_column..).zip(across).filter(|(_, weight)| **weight != 0.0);
        columns
            .map(|(column, across)| {
                let (first_row, down) = resampler.down(y as i64, column);
                let rows = (first_row..).zip(down);
                let line: f64 =
                    rows.map(|(row, weight)| f64::from(*weight) * image[resampler.sensor(row, column)]).sum();
                f64::from(*across) * line
            })
            .sum()
    })
}

/// Products of T and of both cameras with both cameras, of one tile.
struct Tile {
    mixed: f64,
    squared: f64,
}

fn tiles(t: &[Array2<f64>; 2], s: &[Array2<f64>; 2], is_good: &Array2<bool>, is_blanked: bool) -> Vec<Tile> {
    let (height, width) = is_good.dim();
    let mut all = Vec::new();
    for top in (0..height).step_by(TILE) {
        for left in (0..width).step_by(TILE) {
            let places: Vec<(usize, usize)> = (top..(top + TILE).min(height))
                .flat_map(|y| (left..(left + TILE).min(width)).map(move |x| (y, x)))
                .filter(|&place| is_good[place])
                .collect();
            if places.len() < 2 {
                continue;
            }
            let values = |image: &Array2<f64>| {
                let mean = places.iter().map(|&place| image[place]).sum::<f64>() / places.len() as f64;
                let level = if is_blanked { 0.0 } else { mean };
                places.iter().map(|&place| image[place] - level).collect::<Vec<f64>>()
            };
            let ([t0, t1], [s0, s1]) = (t.each_ref().map(values), s.each_ref().map(values));
            let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            all.push(Tile { mixed: product(&t0, &s1) + product(&t1, &s0), squared: 2.0 * product(&s0, &s1) });
        }
    }
    all
}

/// The slope over all tiles, and its error from what it would be without each of them.
fn slope(tiles: &[Tile]) -> Result<MeasuredShare, ResponseError> {
    let (mixed, squared) =
        tiles.iter().fold((0.0, 0.0), |(mixed, squared), tile| (mixed + tile.mixed, squared + tile.squared));
    if tiles.len() < LEAST_TILES || squared <= 0.0 {
        return Err(ResponseError::NoLight);
    }
    let share = mixed / squared;
    // Delete-one jackknife, which does not forget how much a bright tile decides by itself.
    let without: Vec<f64> =
        tiles.iter().map(|tile| (mixed - tile.mixed) / (squared - tile.squared) - share).collect();
    let number = without.len() as f64;
    let mean = without.iter().sum::<f64>() / number;
    let spread: f64 = without.iter().map(|value| (value - mean).powi(2)).sum();
    let error = (spread * (number - 1.0) / number).sqrt();
    if !error.is_finite() || error > LARGEST_ERROR {
        return Err(ResponseError::NoLight);
    }
    // Tiles without light decide nothing.
    let deciding = squared * squared / tiles.iter().map(|tile| tile.squared * tile.squared).sum::<f64>();
    Ok(MeasuredShare { transmission: share, error, freedom: (deciding - 1.0).max(1.0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sums(share: f64, background: [f64; 2], is_structured: bool) -> HalfMeans {
        let mut sums = StainedSums::new([32, 40]);
        for frame in 0..6 {
            let image = |share: f64, background: f64| -> Vec<u16> {
                (0..32 * 40)
                    .map(|pixel| {
                        let structure = if is_structured { ((pixel * 37) % 11) as f64 } else { 5.0 };
                        (background + 1000.0 * share * structure + f64::from(frame % 2)) as u16
                    })
                    .collect()
            };
            let (r, t) = (image(1.0 - share, background[0]), image(share, background[1]));
            sums.push([&r, &t]);
        }
        sums.means().unwrap()
    }

    #[test]
    fn the_share_does_not_depend_on_the_background() {
        for share in [0.0, 0.02, 0.35, 0.98, 1.0] {
            let means = sums(share, [150.0, 900.0], true);
            let found = transmitted_share(&means, &ResponseSettings::default()).unwrap();
            assert!((found.transmission - share).abs() < 1e-3, "{found:?}");
            assert!(found.error < 1e-3, "{found:?}");
        }
    }

    #[test]
    fn an_evenly_stained_sample_needs_a_blank() {
        let means = sums(0.35, [150.0, 900.0], false);
        assert_eq!(transmitted_share(&means, &ResponseSettings::default()), Err(ResponseError::NoLight));
        let mut unstained = means.clone();
        let backgrounds = [150.0, 900.0];
        unstained
            .iter_mut()
            .zip(backgrounds)
            .for_each(|(halves, b)| halves.iter_mut().for_each(|h| h.fill(b)));
        let settings = ResponseSettings { blank: Some(&unstained), ..ResponseSettings::default() };
        let found = transmitted_share(&means, &settings).unwrap();
        assert!((found.transmission - 0.35).abs() < 1e-3, "{found:?}");
    }

    #[test]
    fn masked_pixels_do_not_count() {
        let mut means = sums(0.35, [150.0, 900.0], true);
        let mut mask = Array2::from_elem((32, 40), false);
        mask[[7, 9]] = true;
        means[1].iter_mut().for_each(|half| half[[7, 9]] = 60_000.0);
        let settings = ResponseSettings { masks: [None, Some(&mask)], ..ResponseSettings::default() };
        let found = transmitted_share(&means, &settings).unwrap();
        assert!((found.transmission - 0.35).abs() < 1e-3, "{found:?}");
    }
}
