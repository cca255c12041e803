//! Pictures of the size of the screen, made on a thread of their own; the newest request wins.
//!
//! In: [`Request`]s. Out: [`Rendered`] pictures. Never: is waited for by the window, draws what nobody asked for.
//! Fails: not at all; without its thread there are no pictures, and the window says so.

use super::plane::{Layer, Paint, Pixels};
use crate::display::{Contrast, Limits, NAN_COLOR, Rgb, SATURATED_COLOR};
use crate::pipeline::spawn;
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use egui::{Color32, ColorImage};

/// Source pixels that one pixel of the screen is the mean of, at most, along each side.
const MOST_MEAN: usize = 8;

/// A picture that is wanted.
#[derive(Debug, Clone)]
pub struct Request {
    /// Tells which request a picture belongs to.
    pub key: u64,
    /// What is shown.
    pub layers: Vec<Layer>,
    /// What is shown left of the divider, and where that is, 0 to 1 of the picture's width.
    pub split: Option<(f64, Vec<Layer>)>,
    /// The contrast of all layers.
    pub contrast: Contrast,
    /// Part of the sample that the picture covers: left, top, width, height in micrometers.
    pub part_um: [f64; 4],
    /// Columns and rows of the picture.
    pub size: [usize; 2],
    /// The window draws the picture after this time.
    pub pace: std::time::Duration,
}

/// A picture that is there.
#[derive(Debug, Clone)]
pub struct Rendered {
    /// That of its request.
    pub key: u64,
    /// The picture.
    pub image: ColorImage,
    /// Part of the sample that it covers, as asked for.
    pub part_um: [f64; 4],
    /// Limits that the contrast came to, layer by layer.
    pub limits: Vec<Limits>,
}

/// The window's end of the renderer.
#[derive(Debug)]
pub struct Renderer {
    requests: Option<Sender<(Request, egui::Context)>>,
    pictures: Receiver<Rendered>,
}

impl Renderer {
    /// Starts the thread; it ends with the renderer.
    #[must_use]
    pub fn start() -> Self {
        let (requests, work) = bounded::<(Request, egui::Context)>(1);
        let (done, pictures) = bounded(1);
        let run = move || {
            while let Ok((request, context)) = work.recv() {
                if done.send(render(&request)).is_err() {
                    return;
                }
                context.request_repaint_after(request.pace);
            }
        };
        let requests = match spawn("viewer-render", run) {
            Ok(_) => Some(requests),
            Err(error) => {
                tracing::error!("no thread to draw pictures: {error}");
                None
            }
        };
        Self { requests, pictures }
    }

    /// Asks for a picture; false when the thread is busy with another one: ask again at the next look.
    pub fn ask(&self, request: Request, context: &egui::Context) -> bool {
        let Some(requests) = &self.requests else { return false };
        match requests.try_send((request, context.clone())) {
            Ok(()) => true,
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => false,
        }
    }

    /// The newest picture, once.
    #[must_use]
    pub fn take(&self) -> Option<Rendered> {
        self.pictures.try_iter().last()
    }
}

/// Makes a picture.
#[must_use]
pub fn render(request: &Request) -> Rendered {
    let [columns, rows] = request.size;
    let limits = |layers: &[Layer]| -> Vec<Limits> {
        layers.iter().map(|layer| layer.pixels.limits(request.contrast)).collect()
    };
    let own_limits = limits(&request.layers);
    let divider = request.split.as_ref().map_or(0, |(share, _)| (share * columns as f64).round() as usize);
    let mut pixels = vec![Color32::BLACK; columns * rows];
    if let Some((_, left)) = &request.split {
        // The mean image has limits of its own: it is another quantity.
        let contrast = Contrast::Percentile { low: 1.0, high: 99.8 };
        let limits: Vec<_> = left.iter().map(|layer| layer.pixels.limits(contrast)).collect();
        paint(&mut pixels, request, left, &limits, 0..divider);
    }
    paint(&mut pixels, request, &request.layers, &own_limits, divider..columns);
    let image = ColorImage::new([columns, rows], pixels);
    Rendered { key: request.key, image, part_um: request.part_um, limits: own_limits }
}

/// Rows or columns of an image that each row or column of the picture shows.
fn sources(from_um: f64, length_um: f64, number: usize, pitch_nm: f64, limit: usize) -> Vec<(usize, usize)> {
    let step = length_um / number.max(1) as f64 * 1e3 / pitch_nm;
    let begin = from_um * 1e3 / pitch_nm;
    (0..number)
        .map(|place| {
            let first = begin + place as f64 * step;
            if first + step <= 0.0 || first >= limit as f64 {
                return (0, 0);
            }
            if step <= 1.0 {
                let middle = ((first + 0.5 * step).max(0.0) as usize).min(limit - 1);
                return (middle, middle + 1);
            }
            let start = first.max(0.0) as usize;
            let end = ((first + step) as usize).clamp(start + 1, limit);
            (start, end.min(start + MOST_MEAN).max(start + 1))
        })
        .collect()
}

fn paint(
    pixels: &mut [Color32],
    request: &Request,
    layers: &[Layer],
    limits: &[Limits],
    within: std::ops::Range<usize>,
) {
    let [columns, rows] = request.size;
    let [left, top, width, height] = request.part_um;
    let plans: Vec<_> = layers
        .iter()
        .map(|layer| {
            let (image_rows, image_columns) = layer.pixels.size();
            let pitch = layer.pixel_pitch_nm;
            (
                sources(top, height, rows, pitch, image_rows),
                sources(left, width, columns, pitch, image_columns),
            )
        })
        .collect();
    let warped: Vec<_> = layers
        .iter()
        .map(|layer| layer.warp.map(|_| Warped::of(layer, request.part_um, request.size)))
        .collect();
    for row in 0..rows {
        for column in within.clone() {
            let mut color = [0.0_f32; 3];
            let (mut is_inside, mut is_unknown, mut is_saturated) = (false, true, false);
            for (((layer, limits), (down, across)), warped) in
                layers.iter().zip(limits).zip(&plans).zip(&warped)
            {
                let ((top, bottom), (left, right)) = match warped {
                    Some(warped) => warped.sources(layer, row, column),
                    None => (down[row], across[column]),
                };
                if top == bottom || left == right {
                    continue;
                }
                is_inside = true;
                let (value, saturated) = mean(&layer.pixels, top..bottom, left..right);
                is_saturated |= saturated;
                if value.is_nan() {
                    continue;
                }
                is_unknown = false;
                let shade = shade(layer.paint, limits.fraction(f64::from(value)));
                for (sum, part) in color.iter_mut().zip(shade) {
                    *sum += part;
                }
            }
            let place = &mut pixels[row * columns + column];
            *place = match (is_inside, is_saturated, is_unknown) {
                (false, ..) => Color32::from_gray(18),
                (_, true, _) => opaque(SATURATED_COLOR),
                (_, _, true) => opaque(NAN_COLOR),
                _ => {
                    let [red, green, blue] = color.map(|part| part.min(255.0).round() as u8);
                    Color32::from_rgb(red, green, blue)
                }
            };
        }
    }
}

/// Where a layer that is mapped onto another has the pixels of the picture.
struct Warped {
    /// Corner of the picture, `[y, x]` in pixels of what it is drawn on.
    corner: [f64; 2],
    /// Pixels for one pixel of the picture, `[y, x]`.
    step: [f64; 2],
}

impl Warped {
    fn of(layer: &Layer, [left, top, width, height]: [f64; 4], [columns, rows]: [usize; 2]) -> Self {
        let pixels = |um: f64| um * 1e3 / layer.pixel_pitch_nm;
        let step = [pixels(height) / rows.max(1) as f64, pixels(width) / columns.max(1) as f64];
        Self { corner: [pixels(top), pixels(left)], step }
    }

    /// Rows and columns of the layer that one pixel of the picture shows; empty beside the layer.
    fn sources(&self, layer: &Layer, row: usize, column: usize) -> ((usize, usize), (usize, usize)) {
        let [y, x] = [(0, row), (1, column)]
            .map(|(axis, place)| self.corner[axis] + (place as f64 + 0.5) * self.step[axis]);
        let Some(middle) = layer.pixel(y, x) else { return ((0, 0), (0, 0)) };
        let (rows, columns) = layer.pixels.size();
        let around = |middle: usize, step: f64, limit: usize| {
            let side = (step as usize).clamp(1, MOST_MEAN);
            let begin = middle.saturating_sub((side - 1) / 2);
            (begin, (begin + side).min(limit))
        };
        (around(middle.0, self.step[0], rows), around(middle.1, self.step[1], columns))
    }
}

/// The mean of a few pixels, and whether one of them is saturated.
fn mean(pixels: &Pixels, rows: std::ops::Range<usize>, columns: std::ops::Range<usize>) -> (f32, bool) {
    let (mut sum, mut number, mut saturated) = (0.0, 0_u32, false);
    for row in rows {
        for column in columns.clone() {
            let value = pixels.value(row, column);
            if let Pixels::Counts { saturation: Some(limit), .. } = pixels {
                saturated |= value >= f32::from(*limit);
            }
            if !value.is_nan() {
                sum += value;
                number += 1;
            }
        }
    }
    (if number == 0 { f32::NAN } else { sum / number as f32 }, saturated)
}

fn shade(paint: Paint, fraction: f64) -> [f32; 3] {
    match paint {
        Paint::Map(map) => {
            let place = (fraction * 255.0).round().clamp(0.0, 255.0) as usize;
            map.table()[place].map(f32::from)
        }
        Paint::Color(color) => color.map(|part| f32::from(part) * fraction as f32),
    }
}

fn opaque([red, green, blue]: Rgb) -> Color32 {
    Color32::from_rgb(red, green, blue)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::{Colormap, render as render_whole};
    use crate::reconstruction::PixelMap;
    use ndarray::Array2;
    use std::sync::Arc;

    fn layer(image: Array2<f32>, paint: Paint) -> Layer {
        let pixels = Pixels::Values(Arc::new(image));
        Layer { name: "image".to_owned(), pixels, pixel_pitch_nm: 1000.0, paint, warp: None }
    }

    fn request(layers: Vec<Layer>, part_um: [f64; 4], size: [usize; 2]) -> Request {
        let contrast = Contrast::Manual(Limits { low: 0.0, high: 20.0 });
        Request { key: 7, layers, split: None, contrast, part_um, size, pace: std::time::Duration::ZERO }
    }

    #[test]
    fn pixel_for_pixel_it_is_the_picture_of_the_files() {
        let mut image = Array2::from_shape_fn((4, 5), |(y, x)| (y * 5 + x) as f32);
        image[[1, 2]] = f32::NAN;
        let limits = Limits { low: 0.0, high: 20.0 };
        let expected = render_whole(&image, Colormap::Viridis, limits).unwrap();
        let layers = vec![layer(image, Paint::Map(Colormap::Viridis))];
        let rendered = render(&request(layers, [0.0, 0.0, 5.0, 4.0], [5, 4]));
        for y in 0..4 {
            for x in 0..5 {
                assert_eq!(rendered.image[(x, y)], opaque(expected.get(y, x).unwrap()), "{y} {x}");
            }
        }
        assert_eq!((rendered.key, rendered.limits), (7, vec![limits]));
    }

    #[test]
    fn parts_are_enlarged_and_large_images_averaged() {
        let image = Array2::from_shape_fn((8, 8), |(y, x)| if (y + x) % 2 == 0 { 20.0 } else { 0.0 });
        let white = Paint::Color([255, 255, 255]);
        let whole = render(&request(vec![layer(image.clone(), white)], [0.0, 0.0, 8.0, 8.0], [4, 4]));
        assert!(whole.image.pixels.iter().all(|pixel| *pixel == Color32::from_rgb(128, 128, 128)));
        let part = render(&request(vec![layer(image, white)], [2.0, 2.0, 2.0, 2.0], [4, 4]));
        assert_eq!(part.image[(0, 0)], Color32::from_rgb(255, 255, 255));
        assert_eq!(part.image[(1, 1)], part.image[(0, 0)]);
        assert_eq!(part.image[(2, 0)], Color32::from_rgb(0, 0, 0));
    }

    #[test]
    fn a_mapped_layer_is_drawn_where_the_map_says() {
        let mut seen_by_r = Array2::zeros((6, 8));
        seen_by_r[[2, 5]] = 20.0;
        // T is mirrored and sees everything one row lower: (2, 5) of R is (3, 2) of T.
        let mut seen_by_t = Array2::zeros((6, 8));
        seen_by_t[[3, 2]] = 20.0;
        let map = PixelMap { matrix: [[1.0, 0.0], [0.0, -1.0]], shift: [1.0, 7.0] };
        let t = Layer { warp: Some(map), ..layer(seen_by_t, Paint::Color([255, 0, 255])) };
        assert_eq!(t.at([5.5, 2.5]), Some((2, 3, 20.0)));
        assert_eq!(t.at([5.5, 5.5]), None, "that row of T is beyond its sensor");
        let layers = vec![layer(seen_by_r, Paint::Color([0, 255, 0])), t.clone()];
        let both = render(&request(layers, [0.0, 0.0, 8.0, 6.0], [16, 12]));
        for (x, y) in [(10, 4), (11, 5)] {
            assert_eq!(both.image[(x, y)], Color32::WHITE, "both at the same place");
        }
        let alone = render(&request(vec![t], [0.0, 0.0, 8.0, 6.0], [8, 6]));
        assert_eq!(alone.image[(5, 5)], Color32::from_gray(18), "nothing is made up beside the sensor");
        let bright = alone.image.pixels.iter().filter(|pixel| **pixel == Color32::from_rgb(255, 0, 255));
        assert_eq!(bright.count(), 1);
    }

    #[test]
    fn colors_add_up_beside_the_mean_and_saturation_is_of_raw_counts() {
        let bright = || Array2::from_elem((2, 4), 20.0);
        let layers =
            vec![layer(bright(), Paint::Color([0, 255, 0])), layer(bright(), Paint::Color([255, 0, 255]))];
        let mut both = request(layers, [0.0, 0.0, 4.0, 2.0], [4, 2]);
        both.split = Some((0.5, vec![layer(Array2::from_elem((2, 4), f32::NAN), Paint::Color([255; 3]))]));
        let rendered = render(&both);
        assert_eq!(rendered.image[(3, 1)], Color32::from_rgb(255, 255, 255));
        assert_eq!(rendered.image[(1, 1)], opaque(NAN_COLOR));
        let counts = Arc::new(vec![10, 20, 30, 40]);
        let pixels = Pixels::Counts { counts, width: 2, saturation: Some(30) };
        let camera = Layer { pixels, ..layer(bright(), Paint::Map(Colormap::Gray)) };
        let marked = render(&request(vec![camera], [0.0, 0.0, 2.0, 2.0], [2, 2]));
        assert_eq!(marked.image[(0, 1)], opaque(SATURATED_COLOR));
        assert_ne!(marked.image[(1, 0)], opaque(SATURATED_COLOR));
    }
}
