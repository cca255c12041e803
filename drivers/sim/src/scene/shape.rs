//! Where the emitters of a species sit.
//!
//! In: tables of a species in the scene file. Out: shapes with their size and number of emitters.
//! Never: draws random numbers. All coordinates are `[y, x]` in pixels of camera R; pixel centers are integers.

use serde::{Deserialize, Serialize};

use super::drawing::{distance_in_cells, full_cells, read_drawing};
use crate::geometry::{Line, between};
use sofiscope_form::Form;

/// Coordinates of scene files lie within these limits.
pub(super) const COORDINATE_PX: std::ops::RangeInclusive<f64> = -20_000.0..=20_000.0;
const WIDTH_PX: std::ops::RangeInclusive<f64> = 0.0..=1000.0;
pub(super) const DENSITY_PER_UM2: std::ops::RangeInclusive<f64> = 1e-6..=1e6;

/// One place with emitters of one species; coordinates `[y, x]` in pixels of camera R.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Shape {
    /// A straight band.
    Filament {
        /// One end of the axis.
        from_px: [f64; 2],
        /// The other end of the axis.
        to_px: [f64; 2],
        /// Full width of the band.
        width_px: f64,
        /// Emitters per square micrometer of the band.
        density_per_um2: f64,
    },
    /// A band along a smooth curve through some points (Catmull-Rom).
    Curve {
        /// The points, at least two.
        points_px: Vec<[f64; 2]>,
        /// Full width of the band.
        width_px: f64,
        /// Emitters per square micrometer of the band.
        density_per_um2: f64,
    },
    /// A band along an ellipse with axes parallel to those of the image.
    Ring {
        /// Center of the ellipse.
        center_px: [f64; 2],
        /// Half axes along y and x.
        radius_px: [f64; 2],
        /// Full width of the band.
        width_px: f64,
        /// Emitters per square micrometer of the band.
        density_per_um2: f64,
    },
    /// A uniformly filled circle.
    Disc {
        /// Center of the circle.
        center_px: [f64; 2],
        /// Radius of the circle.
        radius_px: f64,
        /// Emitters per square micrometer.
        density_per_um2: f64,
    },
    /// A round Gaussian cloud.
    Blob {
        /// Center of the cloud.
        center_px: [f64; 2],
        /// Standard deviation along each axis.
        sigma_px: f64,
        /// Number of emitters.
        emitters: u64,
    },
    /// A rectangle filled at random.
    Random {
        /// Corner with the least coordinates.
        from_px: [f64; 2],
        /// Corner with the greatest coordinates.
        to_px: [f64; 2],
        /// Number of emitters.
        emitters: u64,
        /// No two emitters are closer than this.
        minimum_distance_px: f64,
    },
    /// A small image: each character is a square cell, a digit its density in ninths.
    Drawing {
        /// Corner of the first cell, the least coordinates of the drawing.
        from_px: [f64; 2],
        /// Side of a cell.
        cell_px: f64,
        /// Rows of digits, dots and spaces.
        rows: Vec<String>,
        /// Emitters per square micrometer in a cell of 9.
        density_per_um2: f64,
    },
}

impl Shape {
    /// Number of emitters on this shape, density times area to the nearest whole number.
    #[must_use]
    pub fn num_emitters(&self, pixel_pitch_nm: f64) -> u64 {
        let um2_per_px2 = (pixel_pitch_nm * 1e-3).powi(2);
        let by_density = |area_px2: f64, density: f64| (area_px2 * um2_per_px2 * density).round();
        let number = match self {
            Self::Filament { width_px, density_per_um2, .. }
            | Self::Curve { width_px, density_per_um2, .. }
            | Self::Ring { width_px, density_per_um2, .. } => {
                let length_px = self.axis().map_or(0.0, |axis| axis.length());
                by_density(length_px * width_px, *density_per_um2)
            }
            Self::Disc { radius_px, density_per_um2, .. } => {
                by_density(std::f64::consts::PI * radius_px * radius_px, *density_per_um2)
            }
            Self::Drawing { cell_px, rows, density_per_um2, .. } => {
                by_density(full_cells(rows) * cell_px * cell_px, *density_per_um2)
            }
            Self::Blob { emitters, .. } | Self::Random { emitters, .. } => return *emitters,
        };
        number as u64
    }

    /// The axis of a filament, curve or ring.
    pub(crate) fn axis(&self) -> Option<Line> {
        match self {
            Self::Filament { from_px, to_px, .. } => Some(Line::new(vec![*from_px, *to_px])),
            Self::Curve { points_px, .. } => Some(Line::smooth(points_px)),
            Self::Ring { center_px, radius_px, .. } => Some(Line::ellipse(*center_px, *radius_px)),
            Self::Disc { .. } | Self::Blob { .. } | Self::Random { .. } | Self::Drawing { .. } => None,
        }
    }

    /// Distance from a shape without an axis: 0 inside, else from its edge; a cloud ends at two sigmas.
    pub(crate) fn distance_from_area(&self, point: [f64; 2]) -> f64 {
        match self {
            Self::Disc { center_px, radius_px, .. } => (between(*center_px, point) - radius_px).max(0.0),
            Self::Blob { center_px, sigma_px, .. } => (between(*center_px, point) - 2.0 * sigma_px).max(0.0),
            Self::Random { from_px, to_px, .. } => {
                let beyond =
                    |axis: usize| (from_px[axis] - point[axis]).max(point[axis] - to_px[axis]).max(0.0);
                beyond(0).hypot(beyond(1))
            }
            Self::Drawing { from_px, cell_px, rows, .. } => {
                let place = [0, 1].map(|axis| (point[axis] - from_px[axis]) / cell_px);
                distance_in_cells(rows, place) * cell_px
            }
            Self::Filament { .. } | Self::Curve { .. } | Self::Ring { .. } => f64::INFINITY,
        }
    }
}

/// Reads one table of a kind of shape.
type Reader = fn(&Form<'_>) -> Shape;

/// Reads all shapes of one species.
pub(super) fn read_shapes(species: &Form<'_>, field: [[f64; 2]; 2]) -> Vec<Shape> {
    let readers: [(&'static str, Reader); 6] = [
        ("filament", read_filament),
        ("curve", read_curve),
        ("ring", read_ring),
        ("disc", read_disc),
        ("blob", read_blob),
        ("drawing", read_drawing),
    ];
    let mut shapes = Vec::new();
    for (key, read) in readers {
        for form in species.tables(key) {
            shapes.push(read(&form));
            form.finish();
        }
    }
    for form in species.tables("random") {
        shapes.push(read_random(&form, field));
        form.finish();
    }
    shapes
}

fn read_filament(form: &Form<'_>) -> Shape {
    let (from_px, to_px) = (form.pair("from_px", COORDINATE_PX), form.pair("to_px", COORDINATE_PX));
    Shape::Filament {
        from_px,
        to_px,
        width_px: form.number("width_px", WIDTH_PX),
        density_per_um2: form.number("density_per_um2", DENSITY_PER_UM2),
    }
}

fn read_curve(form: &Form<'_>) -> Shape {
    Shape::Curve {
        points_px: form.points("points_px", COORDINATE_PX),
        width_px: form.number("width_px", WIDTH_PX),
        density_per_um2: form.number("density_per_um2", DENSITY_PER_UM2),
    }
}

fn read_ring(form: &Form<'_>) -> Shape {
    Shape::Ring {
        center_px: form.pair("center_px", COORDINATE_PX),
        radius_px: form.pair("radius_px", 0.1..=10_000.0),
        width_px: form.number("width_px", WIDTH_PX),
        density_per_um2: form.number("density_per_um2", DENSITY_PER_UM2),
    }
}

fn read_disc(form: &Form<'_>) -> Shape {
    Shape::Disc {
        center_px: form.pair("center_px", COORDINATE_PX),
        radius_px: form.number("radius_px", 0.0..=10_000.0),
        density_per_um2: form.number("density_per_um2", DENSITY_PER_UM2),
    }
}

fn read_blob(form: &Form<'_>) -> Shape {
    Shape::Blob {
        center_px: form.pair("center_px", COORDINATE_PX),
        sigma_px: form.number("sigma_px", 0.0..=1000.0),
        emitters: form.whole("emitters", 1..=super::MAX_EMITTERS),
    }
}

fn read_random(form: &Form<'_>, field: [[f64; 2]; 2]) -> Shape {
    let from_px = form.pair_if_any("from_px", COORDINATE_PX).unwrap_or(field[0]);
    let to_px = form.pair_if_any("to_px", COORDINATE_PX).unwrap_or(field[1]);
    let emitters = form.whole("emitters", 1..=super::MAX_EMITTERS);
    let minimum_distance_px = form.number_or("minimum_distance_px", 0.0, 0.0..=1000.0);
    let (height, width) = (to_px[0] - from_px[0], to_px[1] - from_px[1]);
    if height <= 0.0 || width <= 0.0 {
        form.fault("to_px", "is not beyond `from_px`", "give the corner of greater y and x");
    } else if minimum_distance_px > 0.0 {
        check_packing(form, height * width, emitters, minimum_distance_px);
    }
    Shape::Random { from_px, to_px, emitters, minimum_distance_px }
}

/// Discs dropped at random jam at 54.7 % of an area; up to 40 % they find a place soon.
fn check_packing(form: &Form<'_>, area_px2: f64, emitters: u64, distance_px: f64) {
    let covered = emitters as f64 * std::f64::consts::PI * (distance_px / 2.0).powi(2);
    // Placement compares all pairs.
    if covered > 0.4 * area_px2 || emitters > 10_000 {
        form.fault(
            "minimum_distance_px",
            format!("leaves no room for {emitters} emitters"),
            "give fewer emitters (10000 at most), a larger area or a smaller distance",
        );
    }
}
