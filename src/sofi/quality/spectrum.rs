//! From images to spectra: the part that can be transformed, its window, its frequencies.

use ndarray::{Array2, ArrayRef2, s};
use rustfft::{FftPlanner, num_complex::Complex32};

/// A line at the border with a larger share of missing pixels is cut off.
const MOST_MISSING: f64 = 0.1;

/// The largest central part of an image that misses nothing at its border and is quick to transform.
pub(super) fn usable_part(image: &ArrayRef2<f32>) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
    let (rows, columns) = valid_rectangle(image);
    (quick_part(rows), quick_part(columns))
}

/// Rows and columns that are left when lines with many missing pixels are cut off the border.
pub(super) fn valid_rectangle(image: &ArrayRef2<f32>) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
    let (mut rows, mut columns) = (0..image.nrows(), 0..image.ncols());
    while !rows.is_empty() && !columns.is_empty() {
        let row = |y: usize| missing(image.slice(s![y, columns.clone()]).iter());
        let column = |x: usize| missing(image.slice(s![rows.clone(), x]).iter());
        let borders = [row(rows.start), row(rows.end - 1), column(columns.start), column(columns.end - 1)];
        let worst = (0..4).max_by(|&a, &b| borders[a].total_cmp(&borders[b])).unwrap_or(0);
        if borders[worst] <= MOST_MISSING {
            break;
        }
        match worst {
            0 => rows.start += 1,
            1 => rows.end -= 1,
            2 => columns.start += 1,
            _ => columns.end -= 1,
        }
    }
    (rows, columns)
}

fn missing<'a>(pixels: impl ExactSizeIterator<Item = &'a f32>) -> f64 {
    let count = pixels.len() as f64;
    pixels.filter(|value| !value.is_finite()).count() as f64 / count
}

/// The largest central part whose length has no prime factor above 7.
pub(super) fn quick_part(range: std::ops::Range<usize>) -> std::ops::Range<usize> {
    let is_quick = |length: usize| {
        let rest = [2, 3, 5, 7].into_iter().fold(length, |mut rest, prime| {
            while rest > 0 && rest.is_multiple_of(prime) {
                rest /= prime;
            }
            rest
        });
        rest == 1
    };
    let length = (1..=range.len()).rev().find(|&length| is_quick(length)).unwrap_or(0);
    let start = range.start + (range.len() - length) / 2;
    start..start + length
}

/// The image about its mean, in units of its standard deviation, falling to zero at the edges.
pub(super) fn windowed(image: &ArrayRef2<f32>) -> Option<Array2<f32>> {
    let finite = || image.iter().filter(|value| value.is_finite()).map(|&value| f64::from(value));
    let count = finite().count() as f64;
    let mean = finite().sum::<f64>() / count;
    let deviation = (finite().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
    if !(deviation.is_finite() && deviation > 0.0) {
        return None;
    }
    let (vertical, horizontal) = (hann(image.nrows()), hann(image.ncols()));
    Some(Array2::from_shape_fn(image.dim(), |(y, x)| {
        let value = f64::from(image[[y, x]]);
        let value = if value.is_finite() { (value - mean) / deviation } else { 0.0 };
        (value * vertical[y] * horizontal[x]) as f32
    }))
}

/// The window of Hann, `sin^2`: images have steep spectra, and what flatter windows leak over from coarse structure
/// is the same in both halves and would pass for agreement on fine structure.
pub(super) fn hann(length: usize) -> Vec<f64> {
    (0..length).map(|i| (std::f64::consts::PI * (i as f64 + 0.5) / length as f64).sin().powi(2)).collect()
}

/// Frequency of a place in a spectrum, cycles per pixel, from −1/2 to 1/2.
pub(super) fn signed_frequency(index: usize, length: usize) -> f64 {
    let index = if index > length / 2 { index as f64 - length as f64 } else { index as f64 };
    index / length as f64
}

/// Transforms `first + i second`.
pub(super) fn transform_both(first: &Array2<f32>, second: &Array2<f32>) -> Array2<Complex32> {
    let (height, width) = first.dim();
    let mut rows: Vec<Complex32> =
        first.iter().zip(second).map(|(&first, &second)| Complex32::new(first, second)).collect();
    let mut planner = FftPlanner::new();
    planner.plan_fft_forward(width).process(&mut rows);
    let rows = Array2::from_shape_fn((width, height), |(x, y)| rows[y * width + x]);
    let mut columns = rows.into_raw_vec_and_offset().0;
    planner.plan_fft_forward(height).process(&mut columns);
    Array2::from_shape_fn((height, width), |(y, x)| columns[x * height + y])
}
