//! One image becomes one picture.
//!
//! In: float images or raw counts, a colormap, contrast limits. Out: a picture of the same size.
//! Never: judges saturation on anything but raw counts. Fails: [`DisplayError`] for empty images and
//! masks that do not fit.

use ndarray::ArrayRef2;

use super::color::SATURATED_COLOR;
use super::colormap::{Colormap, color_in};
use super::contrast::Limits;
use super::error::DisplayError;
use super::picture::RgbImage;

/// Draws an image `(y, x)`; NaN becomes [`NAN_COLOR`](super::NAN_COLOR).
///
/// # Errors
/// [`DisplayError::Size`] if the image is empty.
pub fn render(image: &ArrayRef2<f32>, map: Colormap, limits: Limits) -> Result<RgbImage, DisplayError> {
    let table = map.table();
    let (height, width) = image.dim();
    RgbImage::from_fn(height, width, |y, x| color_in(table, limits.fraction(f64::from(image[(y, x)]))))
}

/// Draws raw camera counts `(y, x)`; pixels at or above `saturation_counts` become [`SATURATED_COLOR`].
///
/// # Errors
/// [`DisplayError::Size`] if the image is empty.
pub fn render_raw(
    counts: &ArrayRef2<u16>,
    map: Colormap,
    limits: Limits,
    saturation_counts: u16,
) -> Result<RgbImage, DisplayError> {
    let table = map.table();
    let (height, width) = counts.dim();
    RgbImage::from_fn(height, width, |y, x| match counts[(y, x)] {
        count if count >= saturation_counts => SATURATED_COLOR,
        count => color_in(table, limits.fraction(f64::from(count))),
    })
}

/// Paints [`SATURATED_COLOR`] over the pixels whose raw counts `(y, x)` reach `saturation_counts`.
///
/// The picture may be a whole number of times finer than the camera, as the image of order n is.
///
/// # Errors
/// [`DisplayError::Shape`] if the picture is not a whole multiple of the counts.
pub fn mark_saturated(
    picture: &mut RgbImage,
    counts: &ArrayRef2<u16>,
    saturation_counts: u16,
) -> Result<(), DisplayError> {
    let (found_height, found_width) = counts.dim();
    let (height, width) = (picture.height(), picture.width());
    let factor = height.checked_div(found_height).unwrap_or(0);
    if factor == 0 || (found_height * factor, found_width * factor) != (height, width) {
        return Err(DisplayError::Shape { what: "raw image", found_height, found_width, height, width });
    }
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        if counts[(y / factor, x / factor)] >= saturation_counts {
            picture.set(y, x, SATURATED_COLOR);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::super::color::NAN_COLOR;
    use super::*;

    const LIMITS: Limits = Limits { low: 0.0, high: 255.0 };

    #[test]
    fn values_and_holes() {
        let image = array![[0.0, 128.0, 300.0], [f32::NAN, -1.0, 255.0]];
        let picture = render(&image, Colormap::Gray, LIMITS).unwrap();
        assert_eq!(picture.get(0, 1), Some([128; 3]));
        assert_eq!(picture.get(0, 2), Some([255; 3]));
        assert_eq!(picture.get(1, 0), Some(NAN_COLOR));
    }

    #[test]
    fn saturation_is_judged_on_counts() {
        let counts = array![[10_u16, 4095], [4094, 255]];
        let mut raw = render_raw(&counts, Colormap::Gray, LIMITS, 4095).unwrap();
        assert_eq!(raw.get(0, 1), Some(SATURATED_COLOR));
        assert_eq!(raw.get(1, 0), Some([255; 3]));

        let mut fine = raw.enlarged(2).unwrap();
        mark_saturated(&mut fine, &counts, 4094).unwrap();
        assert_eq!(fine.get(3, 1), Some(SATURATED_COLOR));
        assert_eq!(fine.get(0, 0), Some([10; 3]));
        mark_saturated(&mut raw, &counts, 4095).unwrap();
        let wrong = array![[1_u16, 2, 3]];
        assert!(mark_saturated(&mut fine, &wrong, 1).is_err());
        assert!(mark_saturated(&mut fine, &ndarray::Array2::zeros((0, 0)), 1).is_err());
    }
}
