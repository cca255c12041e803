//! A pane as a picture: its part of the sample, its colors, its contrast, with divider and scale bar.
//!
//! In: what a pane shows. Out: [`RgbImage`] and its notes. Never: writes a file, draws on the window's thread.
//! Fails: [`DisplayError`] for a pane without pixels.

use super::plane::{Layer, Paint};
use super::renderer::{Rendered, Request, render};
use crate::display::{DisplayError, PngNotes, RgbImage};
use std::path::PathBuf;

/// The longer side of a picture has at least so many pixels, so that the scale bar can be read.
const LEAST_SIDE: usize = 800;

/// A pane that is to be kept as it is seen.
#[derive(Debug, Clone)]
pub struct AsSeen {
    /// What the pane shows.
    pub request: Request,
    /// What that is, for people.
    pub label: String,
    /// The file.
    pub path: PathBuf,
}

/// Draws the picture and says what it is; `is_simulated` goes into its title.
///
/// # Errors
/// [`DisplayError::Size`] for a pane without pixels.
pub fn draw(as_seen: &AsSeen, is_simulated: bool) -> Result<(RgbImage, PngNotes), DisplayError> {
    let mut request = as_seen.request.clone();
    let longer = request.size[0].max(request.size[1]).max(1);
    let times = LEAST_SIDE.div_ceil(longer);
    request.size = request.size.map(|side| side * times);
    let [columns, rows] = request.size;
    let rendered = render(&request);
    let mut picture = RgbImage::from_fn(rows, columns, |y, x| {
        let color = rendered.image[(x, y)];
        [color.r(), color.g(), color.b()]
    })?;
    if let Some((share, _)) = &request.split {
        let column = (share * columns as f64).round() as usize;
        (0..rows).for_each(|row| picture.set(row, column, [255; 3]));
    }
    let pixel_pitch_nm = request.part_um[2] * 1e3 / columns.max(1) as f64;
    picture.draw_scale_bar(pixel_pitch_nm);
    let mark = if is_simulated { "SIMULATED: " } else { "" };
    let title = format!("{mark}{}; {}", as_seen.label, legend(&request, &rendered));
    Ok((picture, PngNotes { title: Some(title), pixel_pitch_nm: Some(pixel_pitch_nm) }))
}

/// Every layer with its colors and the values that are black and white in it.
fn legend(request: &Request, rendered: &Rendered) -> String {
    let one = |(layer, limits): (&Layer, &crate::display::Limits)| {
        let colors = match layer.paint {
            Paint::Map(map) => map.name().to_owned(),
            Paint::Color(color) => crate::display::hex(color),
        };
        format!("{} in {colors} from {:.6} to {:.6}", layer.name, limits.low, limits.high)
    };
    let layers: Vec<String> = request.layers.iter().zip(&rendered.limits).map(one).collect();
    let beside = if request.split.is_some() { "; mean image on the left" } else { "" };
    format!("{}{beside}", layers.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::{Colormap, Contrast, Limits};
    use crate::viewer::plane::Pixels;
    use ndarray::Array2;
    use std::sync::Arc;

    fn seen(split: bool) -> AsSeen {
        let image = Array2::from_shape_fn((40, 80), |(_, x)| if x < 40 { 0.0 } else { 10.0 });
        let layer = Layer {
            name: "dye A unmixed".to_owned(),
            pixels: Pixels::Values(Arc::new(image)),
            pixel_pitch_nm: 50.0,
            paint: Paint::Map(Colormap::Gray),
            warp: None,
        };
        let request = Request {
            key: 1,
            split: split.then(|| (0.25, vec![layer.clone()])),
            layers: vec![layer],
            contrast: Contrast::Manual(Limits { low: 0.0, high: 20.0 }),
            // The right half and a little more.
            part_um: [1.0, 0.0, 3.0, 2.0],
            size: [300, 200],
            pace: std::time::Duration::ZERO,
        };
        AsSeen { request, label: "400 exposures".to_owned(), path: PathBuf::from("picture.png") }
    }

    #[test]
    fn the_picture_shows_the_part_in_its_contrast_with_a_scale_bar() {
        let (picture, notes) = draw(&seen(false), true).unwrap();
        assert_eq!((picture.width(), picture.height()), (900, 600), "enlarged by whole factors");
        assert_eq!(picture.get(100, 100), Some([0; 3]));
        assert_eq!(picture.get(100, 700), Some([128; 3]), "half of the way to white");
        assert!((notes.pixel_pitch_nm.unwrap() - 3000.0 / 900.0).abs() < 1e-9);
        let title = notes.title.unwrap();
        assert!(title.starts_with("SIMULATED: 400 exposures; dye A unmixed in gray from 0"), "{title}");
        // 500 nm are 150 pixels.
        let white = |y| (0..900).filter(|&x| picture.get(y, x) == Some([255; 3])).count();
        assert_eq!((0..600).rev().map(white).find(|&number| number > 0), Some(150));
    }

    #[test]
    fn the_divider_is_drawn() {
        let (picture, notes) = draw(&seen(true), false).unwrap();
        assert!((0..500).all(|row| picture.get(row, 225) == Some([255; 3])));
        assert!(notes.title.unwrap().ends_with("mean image on the left"));
    }
}
