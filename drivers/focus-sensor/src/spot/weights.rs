//! Moments of a part of an image under a Gaussian weight.

use super::Part;

/// Weights beyond this many widths are not worth their time: exp(−8) of the largest.
const REACH: f64 = 4.0;

/// A place on the image, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    pub(super) x: f64,
    pub(super) y: f64,
}

/// Weights of columns and rows, whose product is the weight of a pixel.
#[derive(Debug, Clone)]
pub(super) struct Weights {
    columns: Vec<f64>,
    rows: Vec<f64>,
}

/// Sums over pixels with weight w at distances x, y and light v above the background.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    /// Σw.
    pub(super) weight: f64,
    /// Σw².
    pub(super) squares: f64,
    /// Σwv.
    pub(super) light: f64,
    x: f64,
    y: f64,
    xx: f64,
    yy: f64,
}

impl Weights {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self { columns: vec![0.0; width], rows: vec![0.0; height] }
    }

    /// Moments around a place under a weight of width `sigma`.
    pub(super) fn moments(&mut self, part: &Part<'_>, at: Place, sigma: f64) -> Moments {
        let columns = part.columns_near(at.x, REACH * sigma);
        let rows = part.rows_near(at.y, REACH * sigma);
        let weight = |distance: f64| (-0.5 * (distance / sigma).powi(2)).exp();
        for column in columns.clone() {
            self.columns[column] = weight(column as f64 - at.x);
        }
        for row in rows.clone() {
            self.rows[row] = weight(row as f64 - at.y);
        }
        let across = &self.columns[columns.clone()];
        let (sum, squares) = sums(across);
        let (sum_rows, squares_rows) = sums(&self.rows[rows.clone()]);
        let mut all =
            Moments { weight: sum * sum_rows, squares: squares * squares_rows, ..Moments::default() };
        for row in rows {
            let (mut light, mut first, mut second) = (0.0, 0.0, 0.0);
            let line = part.row(row, columns.clone());
            for ((&count, &weight), column) in line.iter().zip(across).zip(columns.start..) {
                let value = weight * (f64::from(count) - part.background.level);
                let x = column as f64 - at.x;
                light += value;
                first += value * x;
                second += value * x * x;
            }
            let (weight, y) = (self.rows[row], row as f64 - at.y);
            all.light += weight * light;
            all.x += weight * first;
            all.xx += weight * second;
            all.y += weight * light * y;
            all.yy += weight * light * y * y;
        }
        all
    }
}

impl Moments {
    /// Centroid under the weight, from the place of the weight; `None` without light.
    pub(super) fn offset(&self) -> Option<(f64, f64)> {
        (self.light > 0.0).then(|| (self.x / self.light, self.y / self.light))
    }

    /// 1 for a spot as wide as the weight, less for wider and narrower ones, by the worse of both directions.
    pub(super) fn width_match(&self, sigma: f64) -> f64 {
        let Some((x, y)) = self.offset() else { return 0.0 };
        let square = sigma * sigma;
        // A Gaussian of variance v under a weight of variance s has the variance vs/(v + s).
        let ratio = |seen: f64| {
            let true_square = if seen < square { seen * square / (square - seen) } else { f64::INFINITY };
            let ratio = (true_square.max(0.0) / square).sqrt();
            ratio.min(ratio.recip())
        };
        ratio(self.xx / self.light - x * x).min(ratio(self.yy / self.light - y * y))
    }
}

fn sums(weights: &[f64]) -> (f64, f64) {
    weights.iter().fold((0.0, 0.0), |(sum, squares), weight| (sum + weight, squares + weight * weight))
}
