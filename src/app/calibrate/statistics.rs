//! What the frames of both cameras are like: mean, variance over time, grain.
//!
//! In: frames, read once. Out: [`Statistics`] per camera. Never: keeps a frame. Fails: [`AppError`] of the files.

use super::frames::Frames;
use crate::app::AppError;
use crate::sofi::registration::NoiseLine;
use ndarray::Array2;

/// What the frames of one camera are like.
pub(super) struct Statistics {
    pub(super) mean: Array2<f32>,
    /// Over time, counts squared.
    pub(super) variance: Array2<f32>,
    /// Mean square of what differs between neighboring pixels faster than light can, counts squared.
    grain: Array2<f32>,
}

/// Differences that smooth light hardly passes.
const GRAIN: [f64; 4] = [1.0, -3.0, 3.0, -1.0];

impl Statistics {
    /// The noise of pixels that blink, from what differs between neighbors in single frames.
    pub(super) fn noise_between_pixels(&self) -> Option<NoiseLine> {
        let (height, width) = self.grain.dim();
        // Every pixel's noise counts by its squared weight.
        let squares = GRAIN.map(|weight| weight * weight);
        let total: f64 = squares.iter().sum::<f64>().powi(2);
        let mean = Array2::from_shape_fn((height, width), |(y, x)| {
            let mut sum = 0.0;
            for (j, a) in squares.iter().enumerate() {
                for (i, b) in squares.iter().enumerate() {
                    sum += a * b * f64::from(self.mean[[y + j, x + i]]);
                }
            }
            (sum / total) as f32
        });
        let variance = self.grain.mapv(|square| (f64::from(square) / total) as f32);
        NoiseLine::fit(flat(&mean), flat(&variance))
    }
}

/// All pixels, row by row.
pub(super) fn flat(image: &Array2<f32>) -> &[f32] {
    image.as_slice().unwrap_or_default()
}

/// Reads all frames once.
pub(super) fn statistics<F: Frames>(stacks: &mut [F]) -> Result<[Statistics; 2], AppError> {
    let [height, width] = stacks[0].size();
    let of = |stack: &mut F| -> Result<Statistics, AppError> {
        let mut counts = vec![0u16; height * width];
        let (mut sums, mut squares) = (vec![0.0; counts.len()], vec![0.0; counts.len()]);
        let grain_size = (height.saturating_sub(3), width.saturating_sub(3));
        let mut grain = Array2::<f64>::zeros(grain_size);
        let mut frames = 0.0;
        stack.rewind()?;
        while stack.read_counts(&mut counts)? {
            frames += 1.0;
            for ((sum, square), &count) in sums.iter_mut().zip(&mut squares).zip(&counts) {
                let count = f64::from(count);
                *sum += count;
                *square += count * count;
            }
            add_grain(&counts, width, &mut grain);
        }
        let image = |value: &dyn Fn(usize) -> f64| {
            Array2::from_shape_fn((height, width), |(y, x)| value(y * width + x) as f32)
        };
        Ok(Statistics {
            mean: image(&|pixel| sums[pixel] / frames),
            variance: image(&|pixel| (squares[pixel] - sums[pixel] * sums[pixel] / frames) / (frames - 1.0)),
            grain: grain.mapv(|sum| (sum / frames) as f32),
        })
    };
    let [r, t] = stacks else { return Err(AppError::usage("a registration needs two cameras")) };
    Ok([of(r)?, of(t)?])
}

fn add_grain(counts: &[u16], width: usize, grain: &mut Array2<f64>) {
    let across: Vec<f32> = counts
        .windows(4)
        .map(|p| p.iter().zip(GRAIN).map(|(&count, weight)| f32::from(count) * weight as f32).sum())
        .collect();
    for ((y, x), sum) in grain.indexed_iter_mut() {
        let value: f32 =
            GRAIN.iter().enumerate().map(|(j, weight)| across[(y + j) * width + x] * *weight as f32).sum();
        *sum += f64::from(value * value);
    }
}
