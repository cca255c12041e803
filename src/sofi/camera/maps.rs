//! The maps of one camera as the analysis needs them.
//!
//! In: offset, gain, read noise and faults of every pixel. Out: [`CameraMaps`], finite everywhere, and parts of it.
//! Never: has a number for a broken pixel that could spread to others.

use super::{median, robust_spread};
use ndarray::{Array2, s};

/// What is known of every pixel of a camera, `(height, width)`.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraMaps {
    offset: Array2<f32>,
    gain: Array2<f32>,
    read_variance: Array2<f32>,
    faults: Array2<u8>,
}

impl CameraMaps {
    /// Maps of one size: counts, counts per electron, counts squared, and bits of
    /// [`PixelFault`](super::PixelFault). What is not a number becomes that of the middle pixel.
    ///
    /// # Panics
    /// When the sizes differ.
    #[must_use]
    pub fn new(
        offset: Array2<f32>,
        gain: Array2<f32>,
        read_variance: Array2<f32>,
        faults: Array2<u8>,
    ) -> Self {
        let size = offset.dim();
        assert!(
            gain.dim() == size && read_variance.dim() == size && faults.dim() == size,
            "maps of one size"
        );
        let [offset, gain, read_variance] = [offset, gain, read_variance].map(|mut map| {
            if map.iter().any(|value| !value.is_finite()) {
                let good = map.iter().filter(|value| value.is_finite()).map(|&value| f64::from(value));
                let middle = median(good) as f32;
                map.mapv_inplace(|value| if value.is_finite() { value } else { middle });
            }
            map
        });
        Self { offset, gain, read_variance, faults }
    }

    /// Height and width, pixels.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        self.offset.dim().into()
    }

    /// Counts without light.
    #[must_use]
    pub fn offset(&self) -> &Array2<f32> {
        &self.offset
    }

    /// Counts per electron.
    #[must_use]
    pub fn gain(&self) -> &Array2<f32> {
        &self.gain
    }

    /// Variance without light, counts squared.
    #[must_use]
    pub fn read_variance(&self) -> &Array2<f32> {
        &self.read_variance
    }

    /// Faults as bits of [`PixelFault`](super::PixelFault), 0 for a good pixel.
    #[must_use]
    pub fn faults(&self) -> &Array2<u8> {
        &self.faults
    }

    /// Number of pixels that are left out.
    #[must_use]
    pub fn masked_pixels(&self) -> usize {
        self.faults.iter().filter(|fault| **fault != 0).count()
    }

    /// The pixels to leave out; none where all are good.
    #[must_use]
    pub fn mask(&self) -> Option<Array2<bool>> {
        (self.masked_pixels() > 0).then(|| self.faults.mapv(|fault| fault != 0))
    }

    /// Variance of the noise of a pixel with this mean, counts squared: `gain (mean - offset) + read^2`.
    #[inline]
    #[must_use]
    pub fn noise_variance(&self, place: (usize, usize), mean: f64) -> f64 {
        let light = mean - f64::from(self.offset[place]);
        (f64::from(self.gain[place]) * light + f64::from(self.read_variance[place])).max(0.0)
    }

    /// Gain, offset and variance without light of the middle pixel.
    #[must_use]
    pub fn typical(&self) -> [f64; 3] {
        [&self.gain, &self.offset, &self.read_variance]
            .map(|map| median(map.iter().map(|&value| f64::from(value))))
    }

    /// A part of the maps; `None` where it is not all inside.
    #[must_use]
    pub fn part(&self, [top, left]: [usize; 2], [height, width]: [usize; 2]) -> Option<Self> {
        let [all_rows, all_columns] = self.size();
        let (bottom, right) = (top.checked_add(height)?, left.checked_add(width)?);
        if bottom > all_rows || right > all_columns {
            return None;
        }
        let part = s![top..bottom, left..right];
        Some(Self {
            offset: self.offset.slice(part).to_owned(),
            gain: self.gain.slice(part).to_owned(),
            read_variance: self.read_variance.slice(part).to_owned(),
            faults: self.faults.slice(part).to_owned(),
        })
    }
}

/// Values nearer to their median the less certain they are, as pixels differ by less than the error of most gains.
///
/// With the spread `t` of the true values, found as what the spread of the estimates has beyond their errors `e`,
/// an estimate keeps the share `t^2 / (t^2 + e^2)` of its distance (empirical Bayes).
#[must_use]
pub fn pulled_together(values: &Array2<f32>, errors: &Array2<f32>) -> Array2<f32> {
    let good: Vec<f64> = values.iter().filter(|v| v.is_finite()).map(|&v| f64::from(v)).collect();
    let center = median(good.iter().copied());
    let typical_error = median(errors.iter().map(|&error| f64::from(error)));
    let spread = (robust_spread(&good).powi(2) - typical_error.powi(2)).max(0.0);
    Array2::from_shape_fn(values.dim(), |place| {
        let (value, error) = (f64::from(values[place]), f64::from(errors[place]));
        let share = if error > 0.0 { spread / (spread + error * error) } else { 1.0 };
        (center + share * (value - center)) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_numbers_become_those_of_the_middle() {
        let map = |value| Array2::from_elem((4, 4), value);
        let mut gain = map(2.0);
        gain[[1, 1]] = f32::NAN;
        let mut faults = Array2::zeros((4, 4));
        faults[[1, 1]] = 2;
        let maps = CameraMaps::new(map(100.0), gain, map(9.0), faults);
        assert_eq!(maps.gain()[[1, 1]], 2.0);
        assert!((maps.noise_variance((1, 1), 150.0) - 109.0).abs() < 1e-9);
        assert_eq!(maps.mask().unwrap().iter().filter(|masked| **masked).count(), 1);
        let part = maps.part([1, 1], [2, 3]).unwrap();
        assert_eq!((part.size(), part.faults()[[0, 0]]), ([2, 3], 2));
        assert_eq!(maps.part([2, 2], [3, 1]), None);
    }

    #[test]
    fn uncertain_gains_come_nearer_to_each_other_and_certain_ones_stay() {
        let values = Array2::from_shape_fn((20, 20), |(y, x)| {
            2.0 + 0.1 * (((y * 31 + x * 17) % 21) as f32 / 10.0 - 1.0)
        });
        let certain = pulled_together(&values, &Array2::from_elem((20, 20), 1e-6));
        assert!(certain.iter().zip(&values).all(|(a, b)| (a - b).abs() < 1e-5));
        let uncertain = pulled_together(&values, &Array2::from_elem((20, 20), 1.0));
        assert!(uncertain.iter().all(|value| (value - 2.0).abs() < 0.01));
    }
}
