//! Several images become one picture: colors add up, clipped at white.
//!
//! In: one image, color and pair of limits per channel. Out: a picture.
//! Never: guesses a missing value: a pixel that is NaN in any channel is drawn in
//! [`NAN_COLOR`], because the sum of the others would look like a measurement.
//! Fails: [`DisplayError::Shape`], [`DisplayError::Size`].

use ndarray::ArrayView2;

use super::color::{NAN_COLOR, Rgb};
use super::contrast::Limits;
use super::error::DisplayError;
use super::picture::RgbImage;

/// One channel of a composite.
#[derive(Clone, Copy, Debug)]
pub struct Layer<'a> {
    /// The image `(y, x)`.
    pub image: ArrayView2<'a, f32>,
    /// Its color at the upper limit.
    pub color: Rgb,
    /// Values drawn black and in full color.
    /// Start at zero for cumulants ([`Contrast::FromZero`](super::Contrast::FromZero)): the noise of an
    /// empty background would otherwise add up to gray.
    pub limits: Limits,
}

/// Adds the layers.
///
/// # Errors
/// [`DisplayError::Shape`] if the layers differ in size, [`DisplayError::Size`] if there are none or they are empty.
pub fn composite(layers: &[Layer<'_>]) -> Result<RgbImage, DisplayError> {
    let (height, width) = layers.first().map_or((0, 0), |layer| layer.image.dim());
    for layer in layers {
        let (found_height, found_width) = layer.image.dim();
        if (found_height, found_width) != (height, width) {
            return Err(DisplayError::Shape { what: "layer", found_height, found_width, height, width });
        }
    }
    RgbImage::from_fn(height, width, |y, x| sum_at(layers, y, x))
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the cast clips to 0..=255")]
fn sum_at(layers: &[Layer<'_>], y: usize, x: usize) -> Rgb {
    let mut sum = [0.0; 3];
    for layer in layers {
        let share = layer.limits.fraction(f64::from(layer.image[(y, x)]));
        if share.is_nan() {
            return NAN_COLOR;
        }
        sum = std::array::from_fn(|c| sum[c] + share * f64::from(layer.color[c]));
    }
    sum.map(|channel| channel.round() as u8)
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::super::color::{CYAN, MAGENTA, YELLOW};
    use super::*;

    #[test]
    fn known_planes_give_known_colors() {
        let planes =
            [array![[1.0, 0.0, 0.5, 1.0]], array![[0.0, 0.0, 0.0, 1.0]], array![[0.0, 0.0, 0.5, f32::NAN]]];
        let limits = Limits { low: 0.0, high: 1.0 };
        let layers: Vec<_> = planes
            .iter()
            .zip([CYAN, YELLOW, MAGENTA])
            .map(|(plane, color)| Layer { image: plane.view(), color, limits })
            .collect();
        let picture = composite(&layers).unwrap();
        assert_eq!(picture.bytes(), [CYAN, [0; 3], [128, 128, 255], NAN_COLOR].as_flattened());
        assert_eq!(composite(&layers[..2]).unwrap().get(0, 3), Some([255; 3]));
    }

    #[test]
    fn unequal_or_missing_layers_are_refused() {
        let (small, large) = (array![[1.0]], array![[1.0, 2.0]]);
        let limits = Limits { low: 0.0, high: 1.0 };
        let layer = |image| Layer { image, color: CYAN, limits };
        assert!(composite(&[layer(small.view()), layer(large.view())]).is_err());
        assert!(composite(&[]).is_err());
    }
}
