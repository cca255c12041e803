//! A picture: 8-bit RGB pixels in rows.
//!
//! In: a color for every pixel. Out: the pixels, larger or smaller by a whole factor.
//! Never: interpolates when enlarging (a pixel stays a square). Fails: [`DisplayError::Size`].

use super::color::Rgb;
use super::error::DisplayError;
use serde::{Deserialize, Serialize};

/// The largest side a PNG file can have, in pixels.
const LARGEST_SIDE: usize = i32::MAX as usize;

/// An RGB picture; row-major, origin top-left, at least one pixel.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct RgbImage {
    height: usize,
    width: usize,
    pixels: Vec<Rgb>,
}

impl RgbImage {
    /// Makes a picture from the color of each position `(y, x)`.
    ///
    /// # Errors
    /// [`DisplayError::Size`] if a side is zero or too long for a PNG file.
    pub fn from_fn(
        height: usize,
        width: usize,
        mut color_at: impl FnMut(usize, usize) -> Rgb,
    ) -> Result<Self, DisplayError> {
        let sides = 1..=LARGEST_SIDE;
        if !sides.contains(&height) || !sides.contains(&width) || height.checked_mul(3 * width).is_none() {
            return Err(DisplayError::Size { height, width });
        }
        let positions = (0..height).flat_map(|y| (0..width).map(move |x| (y, x)));
        let pixels = positions.map(|(y, x)| color_at(y, x)).collect();
        Ok(Self { height, width, pixels })
    }

    /// Height in pixels.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Width in pixels.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Color at row `y` and column `x`; `None` outside.
    #[must_use]
    pub fn get(&self, y: usize, x: usize) -> Option<Rgb> {
        (y < self.height && x < self.width).then(|| self.pixels[y * self.width + x])
    }

    /// Sets the color at row `y` and column `x`; positions outside are ignored.
    pub fn set(&mut self, y: usize, x: usize, color: Rgb) {
        if y < self.height && x < self.width {
            self.pixels[y * self.width + x] = color;
        }
    }

    /// All bytes: red, green, blue of the first pixel of the first row and so on.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        self.pixels.as_flattened()
    }

    /// The picture `factor` times as large, each pixel a square of equal color.
    ///
    /// # Errors
    /// [`DisplayError::Size`] if `factor` is zero or the result too large.
    pub fn enlarged(&self, factor: usize) -> Result<Self, DisplayError> {
        let (height, width) = (self.height.saturating_mul(factor), self.width.saturating_mul(factor));
        Self::from_fn(height, width, |y, x| self.pixels[(y / factor) * self.width + x / factor])
    }

    /// The picture `factor` times as small, each pixel the mean of a square; an incomplete last row or
    /// column is left away.
    ///
    /// # Errors
    /// [`DisplayError::Size`] if `factor` is zero or larger than a side.
    pub fn reduced(&self, factor: usize) -> Result<Self, DisplayError> {
        let shrink = |side: usize| side.checked_div(factor).unwrap_or(0);
        Self::from_fn(shrink(self.height), shrink(self.width), |y, x| self.mean_of_square(y, x, factor))
    }

    /// The picture with its longer side brought near `side` pixels by a whole factor, and that factor:
    /// output pixels per input pixel.
    ///
    /// Small pictures grow to at most `side`; large ones shrink to at most twice `side`.
    ///
    /// # Errors
    /// [`DisplayError::Size`] if the result would be empty (a line one pixel wide and very long).
    pub fn fitted(&self, side: usize) -> Result<(Self, f64), DisplayError> {
        let longer = self.height.max(self.width);
        let smaller_by = longer.div_ceil(2 * side.max(1));
        if smaller_by > 1 {
            return Ok((self.reduced(smaller_by)?, 1.0 / smaller_by as f64));
        }
        let larger_by = (side / longer).max(1);
        Ok((self.enlarged(larger_by)?, larger_by as f64))
    }

    #[expect(clippy::cast_possible_truncation, reason = "a mean of bytes is a byte")]
    fn mean_of_square(&self, y: usize, x: usize, factor: usize) -> Rgb {
        let mut sum = [0_u64; 3];
        for row in y * factor..(y + 1) * factor {
            let start = row * self.width + x * factor;
            for color in &self.pixels[start..start + factor] {
                sum = std::array::from_fn(|c| sum[c] + u64::from(color[c]));
            }
        }
        let count = (factor * factor) as u64;
        sum.map(|channel| ((channel + count / 2) / count) as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient() -> RgbImage {
        RgbImage::from_fn(3, 5, |y, x| [y as u8 * 10, x as u8 * 10, 7]).unwrap()
    }

    #[test]
    fn enlarging_repeats_and_reducing_undoes_it() {
        let large = gradient().enlarged(4).unwrap();
        assert_eq!((large.height(), large.width()), (12, 20));
        assert_eq!(large.get(11, 7), gradient().get(2, 1));
        assert_eq!(large.reduced(4).unwrap(), gradient());
    }

    #[test]
    fn fitting_uses_whole_factors() {
        let (image, factor) = gradient().fitted(64).unwrap();
        assert_eq!((image.width(), factor), (60, 12.0));
        let (image, factor) = gradient().enlarged(100).unwrap().fitted(64).unwrap();
        assert_eq!((image.width(), factor), (125, 0.25));
    }

    #[test]
    fn impossible_sizes_are_refused() {
        assert!(RgbImage::from_fn(0, 4, |_, _| [0; 3]).is_err());
        assert!(gradient().enlarged(0).is_err());
        assert!(gradient().reduced(0).is_err());
        assert!(gradient().reduced(4).is_err());
        assert!(gradient().enlarged(usize::MAX).is_err());
        assert_eq!(gradient().get(3, 0), None);
    }
}
