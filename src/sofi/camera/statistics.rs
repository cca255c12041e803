//! Mean and variance of every pixel over a recording, one frame after another.
//!
//! Variances are those within blocks of [`BLOCK`] frames, so that a lamp that drifts more slowly does not count.
//! What all pixels do together faster than that, the flicker of the lamp, is found from the means of frames.
//! Sums within a block are whole numbers, so nothing is lost to rounding, whatever the offset.
//!
//! In: frames of counts. Out: [`PixelMoments`]. Never: grows with the number of frames. Fails: never; without two
//! frames in a block there is no variance.

use ndarray::Array2;

/// Frames of a block.
const BLOCK: u32 = 32;

/// Running sums of one recording.
#[derive(Debug, Clone)]
pub struct PixelStatistics {
    size: [usize; 2],
    saturation: u16,
    /// Frames of the open block.
    open: u32,
    sums: Vec<u32>,
    squares: Vec<u64>,
    /// Over the blocks that closed.
    totals: Vec<f64>,
    deviations: Vec<f64>,
    saturated: Vec<u32>,
    frames: u64,
    freedom: u64,
    /// Means of the frames of the open block.
    frame_means: Vec<f64>,
    frame_deviations: f64,
}

/// What a recording says of every pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct PixelMoments {
    /// Frames seen.
    pub frames: u64,
    /// Degrees of freedom of each variance.
    pub freedom: u64,
    /// Mean, counts.
    pub mean: Array2<f32>,
    /// Variance over time, counts squared, without what all pixels do together.
    pub variance: Array2<f32>,
    /// Share of the frames in which a pixel was saturated.
    pub saturated_share: Array2<f32>,
    /// Standard deviation of the light of single frames as a share of it; 0 where it is not seen.
    pub flicker: f64,
}

impl PixelStatistics {
    /// Nothing seen yet; a pixel is saturated from `saturation` counts on.
    #[must_use]
    pub fn new(size: [usize; 2], saturation: u16) -> Self {
        let pixels = size[0] * size[1];
        Self {
            size,
            saturation,
            open: 0,
            sums: vec![0; pixels],
            squares: vec![0; pixels],
            totals: vec![0.0; pixels],
            deviations: vec![0.0; pixels],
            saturated: vec![0; pixels],
            frames: 0,
            freedom: 0,
            frame_means: Vec::new(),
            frame_deviations: 0.0,
        }
    }

    /// Adds a frame, row by row.
    ///
    /// # Panics
    /// When the frame has another size.
    pub fn push(&mut self, counts: &[u16]) {
        assert_eq!(counts.len(), self.sums.len(), "a frame of the same size");
        let mut total = 0;
        for ((&count, sum), (square, saturated)) in
            counts.iter().zip(&mut self.sums).zip(self.squares.iter_mut().zip(&mut self.saturated))
        {
            *sum += u32::from(count);
            *square += u64::from(count) * u64::from(count);
            *saturated += u32::from(count >= self.saturation);
            total += u64::from(count);
        }
        self.frame_means.push(total as f64 / counts.len() as f64);
        self.frames += 1;
        self.open += 1;
        if self.open == BLOCK {
            self.close();
        }
    }

    fn close(&mut self) {
        if self.open == 0 {
            return;
        }
        let frames = f64::from(self.open);
        for ((sum, square), (total, deviation)) in
            self.sums.iter_mut().zip(&mut self.squares).zip(self.totals.iter_mut().zip(&mut self.deviations))
        {
            *total += f64::from(*sum);
            *deviation += *square as f64 - f64::from(*sum).powi(2) / frames;
            (*sum, *square) = (0, 0);
        }
        let mean = self.frame_means.iter().sum::<f64>() / frames;
        self.frame_deviations += self.frame_means.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        self.frame_means.clear();
        self.freedom += u64::from(self.open - 1);
        self.open = 0;
    }

    /// What the frames say; `offset` is the mean of every pixel without light, needed for the flicker of flats.
    #[must_use]
    pub fn finish(mut self, offset: Option<&Array2<f32>>) -> PixelMoments {
        self.close();
        let width = self.size[1];
        let per_frame = 1.0 / self.frames.max(1) as f64;
        let per_freedom = 1.0 / self.freedom.max(1) as f64;
        let image = |value: &dyn Fn(usize) -> f64| {
            Array2::from_shape_fn((self.size[0], width), |(y, x)| value(y * width + x) as f32)
        };
        let mean = image(&|pixel| self.totals[pixel] * per_frame);
        let pixels = self.totals.len().max(1) as f64;
        let mean_variance = self.deviations.iter().sum::<f64>() * per_freedom / pixels;
        let flicker = offset.map_or(0.0, |offset| {
            let light = mean.iter().zip(offset).map(|(m, o)| f64::from(m - o)).sum::<f64>() / pixels;
            // The mean of a frame varies by the noise of its pixels as well.
            let common = self.frame_deviations * per_freedom - mean_variance / pixels;
            if light > 0.0 { common.max(0.0).sqrt() / light } else { 0.0 }
        });
        let variance = image(&|pixel| {
            let light = offset.map_or(0.0, |offset| {
                f64::from(mean[[pixel / width, pixel % width]] - offset[[pixel / width, pixel % width]])
            });
            self.deviations[pixel] * per_freedom - (flicker * light).powi(2)
        });
        PixelMoments {
            frames: self.frames,
            freedom: self.freedom,
            saturated_share: image(&|pixel| f64::from(self.saturated[pixel]) * per_frame),
            mean,
            variance,
            flicker,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that look random, from -1 to 1, of variance 1/3.
    fn noise(state: &mut u64) -> f64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    #[test]
    fn mean_and_variance_are_those_of_two_passes_where_light_is_steady() {
        let (mut state, pixels) = (5, 12);
        let frames: Vec<Vec<u16>> = (0..32)
            .map(|_| {
                (0..pixels).map(|p| (20_000.0 + 50.0 * p as f64 + 30.0 * noise(&mut state)) as u16).collect()
            })
            .collect();
        let mut statistics = PixelStatistics::new([3, 4], u16::MAX);
        frames.iter().for_each(|frame| statistics.push(frame));
        let found = statistics.finish(None);
        for pixel in 0..pixels {
            let values: Vec<f64> = frames.iter().map(|frame| f64::from(frame[pixel])).collect();
            let mean = values.iter().sum::<f64>() / 32.0;
            let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / 31.0;
            let place = [pixel / 4, pixel % 4];
            assert!((f64::from(found.mean[place]) - mean).abs() < 1e-2);
            assert!((f64::from(found.variance[place]) / variance - 1.0).abs() < 1e-6);
        }
        assert_eq!((found.frames, found.freedom), (32, 31));
    }

    #[test]
    fn a_lamp_that_drifts_and_flickers_adds_nothing() {
        let (mut state, pixels) = (7, 4096);
        let mut statistics = PixelStatistics::new([64, 64], u16::MAX);
        for frame in 0..640 {
            let lamp = 1000.0 * (1.0 + 0.1 * f64::from(frame) / 640.0 + 0.02 * noise(&mut state));
            let frame: Vec<u16> =
                (0..pixels).map(|_| (100.5 + lamp + 30.0 * noise(&mut state)) as u16).collect();
            statistics.push(&frame);
        }
        let found = statistics.finish(Some(&Array2::from_elem((64, 64), 100.0)));
        let variance = found.variance.iter().map(|&v| f64::from(v)).sum::<f64>() / f64::from(pixels);
        let expected = 300.0 + 1.0 / 12.0;
        assert!((variance / expected - 1.0).abs() < 0.01, "{variance}");
        assert!((found.flicker / (0.02 / 3f64.sqrt()) - 1.0).abs() < 0.2, "{}", found.flicker);
    }

    #[test]
    fn saturated_frames_are_counted() {
        let mut statistics = PixelStatistics::new([1, 2], 4095);
        for frame in 0..40 {
            statistics.push(&[if frame < 10 { 4095 } else { 100 }, 4094]);
        }
        let found = statistics.finish(None);
        assert_eq!(found.saturated_share, ndarray::array![[0.25, 0.0]]);
    }
}
