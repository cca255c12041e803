//! Images as they are drawn: whose pixels they are, how large a pixel is, in which colors.
//!
//! In: the newest pictures and a subject. Out: [`Layer`]s and numbers to read off. Never: copies pixels.
//! Fails: not at all; a subject that is not there yet has no layers.

use super::bench::Pictures;
use super::view::{Subject, View};
use crate::display::{Colormap, Contrast, Limits, Rgb, default_colors};
use crate::reconstruction::{PixelMap, SofiStage, StageImage};
use ndarray::Array2;
use std::sync::Arc;

/// Values that limits are taken from at most.
const SAMPLES: usize = 1 << 16;

/// The pixels of an image.
#[derive(Debug, Clone)]
pub enum Pixels {
    /// Raw counts, row by row.
    Counts {
        /// The counts.
        counts: Arc<Vec<u16>>,
        /// Columns.
        width: usize,
        /// Counts from which on pixels are marked; none to mark nothing.
        saturation: Option<u16>,
    },
    /// A computed image.
    Values(Arc<Array2<f32>>),
}

impl Pixels {
    /// Rows and columns.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        match self {
            Self::Counts { counts, width, .. } => (counts.len() / (*width).max(1), *width),
            Self::Values(image) => image.dim(),
        }
    }

    /// The value of a pixel that is there.
    #[must_use]
    pub fn value(&self, row: usize, column: usize) -> f32 {
        match self {
            Self::Counts { counts, width, .. } => {
                counts.get(row * width + column).copied().map_or(f32::NAN, f32::from)
            }
            Self::Values(image) => image.get((row, column)).copied().unwrap_or(f32::NAN),
        }
    }

    /// Whether two are the same pixels, by where they are kept.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Counts { counts: a, .. }, Self::Counts { counts: b, .. }) => Arc::ptr_eq(a, b),
            (Self::Values(a), Self::Values(b)) => Arc::ptr_eq(a, b),
            _ => false,
        }
    }

    /// Limits of a contrast, from every so manieth pixel of large images.
    #[must_use]
    pub fn limits(&self, contrast: Contrast) -> Limits {
        let (rows, columns) = self.size();
        let step = (rows * columns).div_ceil(SAMPLES).max(1);
        // A step that shares a factor with the width would see some columns only.
        let step = (step..).find(|step| columns % step != 0 || *step == 1).unwrap_or(1);
        let values: Vec<f32> = (0..rows * columns)
            .step_by(step)
            .map(|place| self.value(place / columns, place % columns))
            .collect();
        contrast.limits(&values)
    }
}

/// How values become colors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Paint {
    /// By a colormap.
    Map(Colormap),
    /// From black to a color; several layers add up.
    Color(Rgb),
}

/// One image in its colors.
#[derive(Debug, Clone)]
pub struct Layer {
    /// Camera, spectral channel or species.
    pub name: String,
    /// Its pixels.
    pub pixels: Pixels,
    /// Side of a pixel in the sample, nanometers.
    pub pixel_pitch_nm: f64,
    /// Its colors.
    pub paint: Paint,
    /// From the pixels that it is drawn on to its own, where those are not the same.
    pub warp: Option<PixelMap>,
}

impl Layer {
    /// Width and height, micrometers.
    #[must_use]
    pub fn extent_um(&self) -> [f64; 2] {
        let (rows, columns) = self.pixels.size();
        [columns, rows].map(|pixels| pixels as f64 * self.pixel_pitch_nm / 1e3)
    }

    /// The pixel at a place, micrometers from the corner: column, row, value.
    #[must_use]
    pub fn at(&self, place_um: [f64; 2]) -> Option<(usize, usize, f32)> {
        let [x, y] = place_um.map(|um| um * 1e3 / self.pixel_pitch_nm);
        let (row, column) = self.pixel(y, x)?;
        Some((column, row, self.pixels.value(row, column)))
    }

    /// Row and column of its own pixel at a place in pixels from the corner of what it is drawn on.
    #[must_use]
    pub fn pixel(&self, y: f64, x: f64) -> Option<(usize, usize)> {
        let (rows, columns) = self.pixels.size();
        // Maps are from middle to middle of pixels.
        let [y, x] = self.warp.map_or([y, x], |warp| warp.apply([y - 0.5, x - 0.5]).map(|at| at + 0.5));
        let is_inside = y >= 0.0 && x >= 0.0 && y < rows as f64 && x < columns as f64;
        is_inside.then_some((y as usize, x as usize))
    }
}

/// The layers of what is shown; none as long as it is not there.
#[must_use]
pub fn layers(pictures: &Pictures, view: &View) -> Vec<Layer> {
    match view.subject {
        Subject::Camera(camera) => cameras(pictures, view)
            .into_iter()
            .skip(camera)
            .take(1)
            .map(|layer| painted(layer, view))
            .collect(),
        Subject::Overlay => {
            let colors = default_colors(2);
            let known = pictures.cameras.as_ref().and_then(|look| look.transmitted_from_reflected);
            let warps = [None, known.filter(|_| view.applies_registration)];
            cameras(pictures, view)
                .into_iter()
                .zip(colors)
                .zip(warps)
                .map(|((layer, color), warp)| Layer { paint: Paint::Color(color), warp, ..layer })
                .collect()
        }
        Subject::One(stage, index) => {
            let sofi = pictures.sofi.as_ref();
            let image = sofi.and_then(|sofi| sofi.stage(stage).nth(index));
            image.map(of_stage).map(|layer| painted(layer, view)).into_iter().collect()
        }
        Subject::Composite(stage) => composite(pictures, stage),
    }
}

/// The mean image of both cameras, which a split view shows beside the result.
#[must_use]
pub fn mean_layers(pictures: &Pictures) -> Vec<Layer> {
    composite(pictures, SofiStage::Mean)
}

fn composite(pictures: &Pictures, stage: SofiStage) -> Vec<Layer> {
    let Some(sofi) = &pictures.sofi else { return Vec::new() };
    // As long as later steps are missing, the last one that is there is shown.
    let stage = if sofi.stage(stage).next().is_some() { Some(stage) } else { sofi.last_stage() };
    let images: Vec<_> = stage.into_iter().flat_map(|stage| sofi.stage(stage)).collect();
    let colors = default_colors(images.len());
    images
        .iter()
        .zip(colors)
        .map(|(image, color)| Layer { paint: Paint::Color(color), ..of_stage(image) })
        .collect()
}

fn of_stage(image: &StageImage) -> Layer {
    Layer {
        name: format!("{} {}", image.name, image.stage.name()),
        pixels: Pixels::Values(Arc::clone(&image.image)),
        pixel_pitch_nm: image.pixel_pitch_nm,
        paint: Paint::Map(Colormap::Gray),
        warp: None,
    }
}

fn painted(layer: Layer, view: &View) -> Layer {
    Layer { paint: Paint::Map(view.colormap), ..layer }
}

fn cameras(pictures: &Pictures, view: &View) -> Vec<Layer> {
    let Some(look) = &pictures.cameras else { return Vec::new() };
    let both = look.cameras.iter().zip(["camera R", "camera T"]);
    both.map(|(camera, name)| Layer {
        name: name.to_owned(),
        pixels: Pixels::Counts {
            counts: Arc::clone(&camera.counts),
            width: look.width,
            saturation: view.marks_saturation.then_some(camera.saturation_counts),
        },
        pixel_pitch_nm: look.pixel_pitch_nm,
        paint: Paint::Map(Colormap::Gray),
        warp: None,
    })
    .collect()
}
