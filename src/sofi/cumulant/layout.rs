//! How state is laid out: full-width bands of rows, each with its own planes, so that bands can work side by side.

use super::algebra::{LANES, Lanes};
use std::ops::Range;

/// Columns are padded to this, the widest SIMD register in `f32`.
pub(super) const COLUMN_PADDING: usize = 16;

/// Rows of one band: small enough that a band's sums stay in the second-level cache.
pub(super) const BAND_ROWS: usize = 16;

/// Sizes of the camera region and of its bands, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) height: usize,
    pub(super) width: usize,
    /// Padded width.
    pub(super) stride: usize,
}

impl Layout {
    pub(super) fn new(height: usize, width: usize) -> Self {
        Self { height, width, stride: width.next_multiple_of(COLUMN_PADDING) }
    }

    #[inline(always)]
    pub(super) fn bands(&self) -> usize {
        self.height.div_ceil(BAND_ROWS)
    }

    /// The band that a camera row is in.
    #[inline(always)]
    pub(super) fn band_of(&self, y: usize) -> usize {
        y / BAND_ROWS
    }

    /// Camera rows of a band.
    #[inline(always)]
    pub(super) fn rows(&self, band: usize) -> Range<usize> {
        band * BAND_ROWS..self.height.min((band + 1) * BAND_ROWS)
    }

    /// Numbers in one plane of a band, with a gap to the next one.
    ///
    /// Without the gap, sums of one pixel would be powers of two apart and push each other out of the cache.
    #[inline(always)]
    pub(super) fn plane_len(&self, band: usize) -> usize {
        self.rows(band).len() * self.stride + COLUMN_PADDING
    }

    /// One zeroed vector of `planes` planes per band.
    pub(super) fn zeroed<T: Clone + Default>(&self, planes: usize) -> Vec<Vec<T>> {
        (0..self.bands()).map(|band| vec![T::default(); planes * self.plane_len(band)]).collect()
    }

    /// One padded row of a plane; `None` outside the camera region.
    #[inline(always)]
    pub(super) fn row<'a, T>(&self, bands: &'a [Vec<T>], plane: usize, y: i64) -> Option<&'a [T]> {
        let y = usize::try_from(y).ok().filter(|&y| y < self.height)?;
        let (band, row) = (y / BAND_ROWS, y % BAND_ROWS);
        let start = plane * self.plane_len(band) + row * self.stride;
        Some(&bands[band][start..start + self.stride])
    }

    /// The columns at which pixels `a` and `b` columns further are both inside the padded rows.
    #[inline(always)]
    pub(super) fn shared_columns(&self, a: i32, b: i32) -> Range<usize> {
        let left = (-a).max(-b).max(0) as usize;
        let right = a.max(b).max(0) as usize;
        left..self.stride - right
    }

    /// [`LANES`] values of one plane starting at `(y, x)`; zero outside the camera region.
    #[inline(always)]
    pub(super) fn load<T: Copy + Into<f64>>(&self, bands: &[Vec<T>], plane: usize, y: i64, x: i64) -> Lanes {
        if y < 0 || y >= self.height as i64 {
            return [0.0; LANES];
        }
        let (band, row) = (y as usize / BAND_ROWS, y as usize % BAND_ROWS);
        let start = plane * self.plane_len(band) + row * self.stride;
        load_row(&bands[band][start..start + self.stride], x)
    }
}

/// The part of a row that is `dx` columns further than `columns`.
#[inline(always)]
pub(super) fn shifted<T>(row: &[T], columns: Range<usize>, dx: i32) -> &[T] {
    let start = columns.start.wrapping_add_signed(dx as isize);
    &row[start..start + columns.len()]
}

/// [`LANES`] values of a row starting at column `x`; zero outside the row.
#[inline(always)]
pub(super) fn load_row<T: Copy + Into<f64>>(row: &[T], x: i64) -> Lanes {
    if x >= 0 && x as usize + LANES <= row.len() {
        let inside = &row[x as usize..x as usize + LANES];
        return std::array::from_fn(|lane| inside[lane].into());
    }
    std::array::from_fn(|lane| {
        let column = usize::try_from(x + lane as i64).ok();
        column.and_then(|column| row.get(column)).map_or(0.0, |&value| value.into())
    })
}

/// The camera position of every register of pixels of a band, and its place in the band's planes.
#[inline(always)]
pub(super) fn registers(layout: &Layout, band: usize) -> impl Iterator<Item = (i64, i64, usize)> + use<> {
    let (rows, stride) = (layout.rows(band), layout.stride);
    rows.enumerate().flat_map(move |(row, y)| {
        (0..stride).step_by(LANES).map(move |x| (y as i64, x as i64, row * stride + x))
    })
}
