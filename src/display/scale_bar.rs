//! A scale bar: its length, its label, its place in a picture.
//!
//! In: a picture and the pitch of its pixels. Out: the picture with a bar in the lower right corner.
//! Never: covers more than a third of the width. Fails: never; where no bar fits, none is drawn.

use super::font;
use super::picture::RgbImage;

/// A length drawn in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaleBar {
    /// Length in the sample, in nanometers: 1, 2 or 5 times a power of ten.
    pub length_nm: f64,
    /// The same length in pixels of the picture, rounded.
    pub length_px: usize,
    /// The length with its unit, e.g. `2 µm`.
    pub label: String,
}

impl ScaleBar {
    /// Chooses the longest 1-2-5 length of at most a quarter of `width_px` pixels of `pixel_pitch_nm` nanometers.
    ///
    /// `None` if the pitch is not a positive number or the bar would be shorter than two pixels.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "at most a quarter of the width"
    )]
    pub fn choose(width_px: usize, pixel_pitch_nm: f64) -> Option<Self> {
        let length_nm = nice_length_at_most(width_px as f64 * pixel_pitch_nm / 4.0)?;
        let length_px = (length_nm / pixel_pitch_nm).round() as usize;
        (length_px >= 2).then(|| Self { length_nm, length_px, label: label(length_nm) })
    }
}

impl RgbImage {
    /// Draws a scale bar with its label, white with a dark rim, in the lower right corner.
    ///
    /// Returns what was drawn; `None`, and an unchanged picture, if no bar with its label fits.
    pub fn draw_scale_bar(&mut self, pixel_pitch_nm: f64) -> Option<ScaleBar> {
        let bar = ScaleBar::choose(self.width(), pixel_pitch_nm)?;
        let size = self.width().min(self.height()) / 180 + 1;
        let (label_width, label_height) = font::extent(&bar.label, size);
        let margin = 5 * size;
        let thickness = 2 * size;
        let block = bar.length_px.max(label_width);
        if block + 2 * margin > self.width()
            || 2 * margin + thickness + label_height + 2 * size > self.height()
        {
            return None;
        }
        let center = self.width() - margin - block / 2;
        let (top, left) = (self.height() - margin - thickness, center - bar.length_px / 2);
        let text_top = top - 2 * size - label_height;
        let mut marks = font::pixels(&bar.label, size, text_top, center - label_width / 2);
        marks.extend((top..top + thickness).flat_map(|y| (left..left + bar.length_px).map(move |x| (y, x))));
        self.draw_with_rim(&marks, size);
        Some(bar)
    }

    fn draw_with_rim(&mut self, marks: &[(usize, usize)], rim: usize) {
        let rim = rim.div_ceil(2);
        for &(y, x) in marks {
            for (dy, dx) in (0..=2 * rim).flat_map(|dy| (0..=2 * rim).map(move |dx| (dy, dx))) {
                self.set((y + dy).wrapping_sub(rim), (x + dx).wrapping_sub(rim), [0; 3]);
            }
        }
        for &(y, x) in marks {
            self.set(y, x, [255; 3]);
        }
    }
}

/// The largest of 1, 2 and 5 times a power of ten that is at most `length`; `None` unless `length` is positive.
#[must_use]
pub fn nice_length_at_most(length: f64) -> Option<f64> {
    if !(length.is_finite() && length > 0.0) {
        return None;
    }
    let power = 10_f64.powf(length.log10().floor());
    // The margin keeps 1000 at 1000 although its logarithm may be rounded down.
    let fits = |&factor: &f64| factor * power <= length * (1.0 + 1e-9);
    [10.0, 5.0, 2.0, 1.0].into_iter().find(fits).map(|factor| factor * power)
}

fn label(length_nm: f64) -> String {
    match length_nm {
        nm if nm >= 999_999.0 => format!("{} mm", rounded(nm / 1e6)),
        nm if nm >= 999.0 => format!("{} µm", rounded(nm / 1e3)),
        nm => format!("{} nm", rounded(nm)),
    }
}

fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_one_two_or_five() {
        for (length, expected) in [(1.0, 1.0), (999.0, 500.0), (1000.0, 1000.0), (0.3, 0.2), (4999.9, 2000.0)]
        {
            let found = nice_length_at_most(length).unwrap();
            assert!((found / expected - 1.0_f64).abs() < 1e-12, "{length} {found}");
        }
        assert_eq!(nice_length_at_most(0.0), None);
        assert_eq!(nice_length_at_most(f64::NAN), None);
    }

    #[test]
    fn bar_of_a_typical_field() {
        let bar = ScaleBar::choose(128, 54.0).unwrap();
        assert_eq!((bar.length_nm, bar.length_px, bar.label.as_str()), (1000.0, 19, "1 µm"));
        assert_eq!(ScaleBar::choose(4096, 54.0).unwrap().label, "50 µm");
        assert_eq!(ScaleBar::choose(64, 20.0).unwrap().label, "200 nm");
        assert_eq!(ScaleBar::choose(128, -1.0), None);
        assert_eq!(ScaleBar::choose(4, 54.0), None);
    }

    #[test]
    fn drawn_bar_has_its_length_and_leaves_the_rest_alone() {
        let mut picture = RgbImage::from_fn(512, 512, |_, _| [40; 3]).unwrap();
        let bar = picture.draw_scale_bar(13.5).unwrap();
        let white = |y: usize| (0..512).filter(|&x| picture.get(y, x) == Some([255; 3])).count();
        let last_row = (0..512).rev().find(|&y| white(y) > 0).unwrap();
        assert_eq!(white(last_row), bar.length_px);
        assert_eq!(white(200), 0);
        let mut tiny = RgbImage::from_fn(9, 9, |_, _| [40; 3]).unwrap();
        assert_eq!(tiny.draw_scale_bar(100.0), None);
    }
}
