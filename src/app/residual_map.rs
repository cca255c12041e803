//! A picture of how well points of both cameras fall onto each other.
//!
//! In: the mean image of camera R and a registration. Out: the image in gray with a stroke per point, from its place
//! along its residual, magnified; green where it is small, red where it is large.
//! Never: hides a point. Fails: [`DisplayError`] for images without pixels.

use crate::config::Registration;
use crate::display::{Colormap, Contrast, DisplayError, Rgb, RgbImage, render};
use ndarray::Array2;

/// Pixels of the picture for 1 nm of residual.
const PIXELS_PER_NM: f64 = 1.0;
/// A residual that is drawn all red, nanometers.
const RED_NM: f64 = 20.0;
/// Pictures of small frames are enlarged to about this side.
const SIDE: usize = 512;

/// Draws the picture.
pub(super) fn residual_map(
    mean: &Array2<f32>,
    registration: &Registration,
) -> Result<RgbImage, DisplayError> {
    let limits = Contrast::default().limits(mean.iter());
    let gray = render(mean, Colormap::Gray, limits)?;
    let factor = (SIDE / mean.nrows().max(mean.ncols()).max(1)).max(1);
    let mut picture = gray.enlarged(factor)?;
    for (place, residual_px) in registration.residuals() {
        let residual = residual_px.map(|pixels| pixels * registration.pixel_pitch_nm);
        let length_nm = residual[0].hypot(residual[1]);
        let from = place.map(|pixels| (pixels + 0.5) * factor as f64);
        let to = [from[0] + PIXELS_PER_NM * residual[0], from[1] + PIXELS_PER_NM * residual[1]];
        stroke(&mut picture, from, to, color(length_nm));
    }
    Ok(picture)
}

fn color(length_nm: f64) -> Rgb {
    let share = (length_nm / RED_NM).min(1.0);
    [(255.0 * share) as u8, (255.0 * (1.0 - share)) as u8, 40]
}

/// A square at the beginning and a line.
fn stroke(picture: &mut RgbImage, from: [f64; 2], to: [f64; 2], color: Rgb) {
    let mut dot = |y: f64, x: f64| {
        if y >= 0.0 && x >= 0.0 {
            picture.set(y as usize, x as usize, color);
        }
    };
    for dy in -1..=1 {
        for dx in -1..=1 {
            dot(from[0] + f64::from(dy), from[1] + f64::from(dx));
        }
    }
    let steps = (to[0] - from[0]).abs().max((to[1] - from[1]).abs()).ceil().min(4096.0) as u32;
    for step in 0..=steps {
        let share = f64::from(step) / f64::from(steps.max(1));
        dot(from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1]));
    }
}
