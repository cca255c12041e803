//! How state is laid out: full-width bands of rows, each with its own planes, so that bands can work side by side.

use super::algebra::{LANES, Lanes};
use std::ops::Range;

/// Columns are padded to this, the widest SIMD register in `f32`.
pub(super) const COLUMN_PADDING: usize = 16;

/// Rows of one band: small enough that a band's sums stay in the second-level cache.
const BAND_ROWS: usize = 8;

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

    pub(super) fn bands(&self) -> usize {
        self.height.div_ceil(BAND_ROWS)
    }

    /// The band that a camera row is in.
    pub(super) fn band_of(&self, y: usize) -> usize {
        y / BAND_ROWS
    }

    /// Camera rows of a band.
    pub(super) fn rows(&self, band: usize) -> Range<usize> {
        band * BAND_ROWS..self.height.min((band + 1) * BAND_ROWS)
    }

    /// Numbers in one plane of a band.
    pub(super) fn plane_len(&self, band: usize) -> usize {
        self.rows(band).len() * self.stride
    }

    /// One zeroed vector of `planes` planes per band.
    pub(super) fn zeroed<T: Clone + Default>(&self, planes: usize) -> Vec<Vec<T>> {
        (0..self.bands()).map(|band| vec![T::default(); planes * self.plane_len(band)]).collect()
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

/// Calls `work` with the camera position of every register of pixels of a band and its place in the band's planes.
#[inline(always)]
pub(super) fn for_each_register(layout: &Layout, band: usize, mut work: impl FnMut(i64, i64, usize)) {
    for (row, y) in layout.rows(band).enumerate() {
        for x in (0..layout.stride).step_by(LANES) {
            work(y as i64, x as i64, row * layout.stride + x);
        }
    }
}
